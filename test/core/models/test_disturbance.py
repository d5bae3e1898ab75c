# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from quadpi_core.frames import Array
from quadpi_core.models.physical_rollout import Disturbance

STEP_S = 0.01


def residuals(seed: int, time_s: float = 0.4, noise: float = 1.0, seconds: float = 60.0) -> Array:
    """(N, 6) of a process of deviation 1 with white noise."""
    rng = np.random.default_rng(seed)
    decay, count = np.exp(-STEP_S / time_s), round(seconds / STEP_S)
    drive = np.sqrt(1.0 - decay**2) * rng.normal(size=(count, 6))
    return lfilter([1.0], [1.0, -decay], drive, axis=0) + noise * rng.normal(size=(count, 6))


def test_size_and_time_of_a_process_are_found() -> None:
    found = Disturbance.of_residuals([residuals(seed) for seed in range(4)], STEP_S)
    for axis in found.axes:
        assert axis.deviation == pytest.approx(1.0, rel=0.15)
        assert axis.time_s == pytest.approx(0.4, rel=1.01)
    # That of the Kalman filter: 0.2.
    assert np.all((found.gain >= 0.1) & (found.gain <= 0.3))


def test_held_disturbances_predict_the_next_residuals() -> None:
    found, new = Disturbance.of_residuals([residuals(1)], STEP_S), residuals(9, noise=0.3)
    held = found.filtered(new)
    coming = np.stack([np.mean(new[k + 1 : k + 11], axis=0) for k in range(len(new) - 20)])
    before = np.mean(np.square(coming))
    assert np.mean(np.square(coming - held[: len(coming)])) < 0.4 * before


def test_a_disturbance_is_that_of_the_past() -> None:
    found, series = Disturbance.of_residuals([residuals(1)], STEP_S), residuals(2)
    changed = series.copy()
    changed[3001:] += 100.0
    np.testing.assert_array_equal(found.filtered(series)[:3001], found.filtered(changed)[:3001])


def test_a_flight_may_be_filtered_in_parts() -> None:
    found, series = Disturbance.of_residuals([residuals(1)], STEP_S), residuals(2)
    first = found.filtered(series[:700])
    parts = np.concatenate((first, found.filtered(series[700:], first[-1])))
    np.testing.assert_allclose(parts, found.filtered(series), rtol=1e-12, atol=1e-15)


def test_white_residuals_hold_nothing() -> None:
    rng = np.random.default_rng(3)
    found = Disturbance.of_residuals([rng.normal(size=(6000, 6))], STEP_S)
    assert np.all(found.gain <= 0.01)
    assert max(axis.deviation for axis in found.axes) < 0.2


def test_the_variance_left_after_filtering_is_that_of_the_errors() -> None:
    rng = np.random.default_rng(5)
    decay, count = np.exp(-STEP_S / 0.4), 60000
    process = lfilter([1.0], [1.0, -decay], np.sqrt(1.0 - decay**2) * rng.normal(size=(count, 6)), axis=0)
    measured = process + rng.normal(size=process.shape)
    found = Disturbance.of_residuals([measured], STEP_S)
    left = np.mean(np.square(found.filtered(measured) - process), axis=0)
    np.testing.assert_allclose(found.filtered_variance, left, rtol=0.35)
