# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.frames import from_rotation_vector
from quadpi_core.signals.chain import (
    first_gap,
    interpolate,
    interpolate_attitude,
    nominal_rate,
    uniform_stamps,
)

STAMPS = np.array([100, 200, 300, 700, 800], dtype=np.int64)


def test_linear_between_samples_and_never_beyond_them_or_across_a_gap():
    at = np.array([50, 100, 250, 300, 500, 700, 750, 800, 801], dtype=np.int64)
    values, valid = interpolate(STAMPS, STAMPS[:, None] * 2.0, at, max_gap_ns=100)
    assert valid.tolist() == [False, True, True, True, False, True, True, True, False]
    np.testing.assert_allclose(values[valid, 0], 2.0 * at[valid])
    assert np.all(np.isfinite(values))
    assert values[0, 0] == 200.0
    assert values[-1, 0] == 1600.0


def test_one_sample_serves_only_its_own_stamp():
    values, valid = interpolate(STAMPS[:1], np.array([[3.0]]), np.array([99, 100, 101]), max_gap_ns=1000)
    assert valid.tolist() == [False, True, False]
    assert values.tolist() == [[3.0]] * 3


def test_large_stamps_lose_no_precision():
    epoch = 1_700_000_000_000_000_000
    at = epoch + np.array([101, 102], dtype=np.int64)
    values, _ = interpolate(epoch + STAMPS, STAMPS[:, None].astype(float), at, max_gap_ns=1000)
    np.testing.assert_allclose(values[:, 0], [101.0, 102.0], rtol=1e-12)


def test_attitudes_of_any_sign_turn_the_short_way():
    axis = np.array([0.0, 0.6, 0.8])
    attitude = np.array([from_rotation_vector(axis * angle) for angle in (0.0, 0.1, 0.2)])
    attitude[1] *= -1.0
    time_ns = np.array([0, 100, 200], dtype=np.int64)
    values, valid = interpolate_attitude(time_ns, attitude, np.array([50, 125]), max_gap_ns=100)
    assert valid.all()
    expected = np.array([from_rotation_vector(axis * angle) for angle in (0.05, 0.125)])
    np.testing.assert_allclose(np.abs(np.sum(values * expected, axis=1)), 1.0, atol=1e-10)


def test_attitude_interpolation_error_is_what_the_docstring_says():
    angle = 0.1
    ends = np.array([from_rotation_vector(np.array([0.0, 0.0, a])) for a in (0.0, angle)])
    at = np.arange(0, 1001, dtype=np.int64)
    values, _ = interpolate_attitude(np.array([0, 1000], dtype=np.int64), ends, at, max_gap_ns=1000)
    turned = 2.0 * np.arctan2(values[:, 3], values[:, 0])
    assert np.max(np.abs(turned - angle * at / 1000.0)) < angle**3 / 200.0


@pytest.mark.parametrize("rate", [500.0, 506.4, 300.0])
def test_nominal_rate_survives_jitter_rounding_and_lost_samples(rate):
    rng = np.random.default_rng(7)
    time = np.arange(2000) / rate + rng.uniform(-1e-4, 1e-4, 2000)
    stamps = np.rint(time[rng.random(2000) > 0.01] * 1e6).astype(np.int64) * 1000
    assert nominal_rate(stamps) == pytest.approx(rate, rel=1e-3)


def test_uniform_grid_of_a_uniform_sensor_is_its_own_stamps():
    stamps = 5_000 + np.rint(np.arange(1000) * 1e9 / 300.0).astype(np.int64)
    assert np.max(np.abs(uniform_stamps(stamps) - stamps)) < 1_000
    assert len(uniform_stamps(stamps)) == 1000


def test_first_gap_names_the_sample_after_it():
    assert first_gap(STAMPS, 100) == 3
    assert first_gap(STAMPS, 400) is None
