# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from quadpi_core.frames import Array
from quadpi_core.models.physical_rollout import (
    ATTITUDE,
    POSITION,
    RATES,
    VELOCITY,
    Disturbance,
    Disturbances,
    Track,
    roll_out,
)
from quadpi_core.models.physical_terms import TERM_INDEX, TERMS
from quadpi_core.models.rollout_model import RolloutFlight
from test.core.models.flights_ahead import ahead, true_model
from test.core.models.physical_flights import VEHICLE, known_parameters

HORIZONS = np.array([1, 10, 50])
STARTS = np.array([0, 100, 200, 300])


@pytest.fixture(scope="module")
def flight() -> RolloutFlight:
    return ahead(5.0, 1)


@pytest.fixture(scope="module")
def track(flight: RolloutFlight) -> Track:
    return true_model().track(flight)


def held(wrench: Array, slopes: Array | None = None, decay: float = 1.0) -> Disturbances:
    """The same disturbance at each of the starts."""
    none = np.zeros((0, 0, 0)) if slopes is None else np.tile(slopes, (len(STARTS), 1, 1))
    return Disturbances(np.tile(wrench, (len(STARTS), 1)), none, np.full(6, decay))


def test_the_parameters_that_flew_fly_the_same(track: Track) -> None:
    errors = np.abs(roll_out(track, STARTS, HORIZONS, known_parameters(), derivatives=False).errors[:, -1])
    # What is left is that of two integrators at 100 Hz.
    assert np.all(errors[:, POSITION] < 0.02)
    assert np.all(errors[:, VELOCITY] < 0.15)
    assert np.all(errors[:, ATTITUDE] < 0.05)
    assert np.all(errors[:, RATES] < 0.5)


def test_without_rotors_and_air_a_body_falls(track: Track) -> None:
    path = roll_out(track, STARTS, HORIZONS, np.zeros(len(TERMS)), derivatives=False).path
    assert path["velocity"][:, -1, 2] - path["velocity"][:, 0, 2] == pytest.approx(0.5 * VEHICLE.gravity_m_s2)
    fallen = path["displacement"][:, -1] - 0.5 * path["velocity"][:, 0]
    np.testing.assert_allclose(fallen[:, 2], 0.125 * VEHICLE.gravity_m_s2, rtol=1e-9)
    np.testing.assert_allclose(fallen[:, :2], 0.0, atol=1e-9)


def test_a_disturbance_pushes_and_decays(track: Track) -> None:
    nothing = np.zeros(len(TERMS))
    decay, push = 0.9, np.array([0.0, 0.0, 0.0, 0.0, 1e-4, 0.0])
    rates = [
        roll_out(track, STARTS, HORIZONS, nothing, derivatives=False, disturbances=own).path["rates"][:, -1]
        for own in (held(push, decay=decay), held(0.0 * push, decay=decay))
    ]
    gained = 0.01 * push[4] / VEHICLE.inertia[1, 1] * (1.0 - decay**50) / (1.0 - decay)
    np.testing.assert_allclose((rates[0] - rates[1])[:, 1], gained, rtol=0.1)


@pytest.mark.parametrize(
    "name",
    ["thrust", "thrust_axial", "torque", "rotor_drag", "hub_height", "drag_x", "bias_pitch", "damping_r"],
)
def test_derivatives_are_those_of_the_roll_out(name: str, track: Track) -> None:
    k, values = TERM_INDEX[name], known_parameters()
    # A disturbance that depends on the parameter, as the residual of a flight does.
    slopes = np.zeros((6, len(TERMS)))
    slopes[:, k] = [0.1, 0.0, -0.2, 1e-3, 2e-3, 0.0]
    scale = max(abs(values[k]), 1e-6)
    found = roll_out(
        track, STARTS, HORIZONS, values, derivatives=True, disturbances=held(np.zeros(6), slopes, 0.95)
    ).derivatives[..., k]
    numeric = np.zeros_like(found)
    for sign in (-1.0, 1.0):
        moved = values.copy()
        moved[k] += sign * 1e-4 * scale
        pushed = held(sign * 1e-4 * scale * slopes[:, k], None, 0.95)
        errors = roll_out(track, STARTS, HORIZONS, moved, derivatives=False, disturbances=pushed).errors
        numeric += sign / (2e-4 * scale) * errors
    for part in (POSITION, VELOCITY, ATTITUDE, RATES):
        np.testing.assert_allclose(
            found[..., part], numeric[..., part], atol=1e-3 * np.abs(numeric[..., part]).max() + 1e-9
        )


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
