# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.signals.wrench import as_recorded, band_limited, newton_euler

MASS = 0.8
INERTIA = np.array([[2.5e-3, 1e-4, -2e-4], [1e-4, 2.1e-3, 3e-4], [-2e-4, 3e-4, 4.3e-3]])


@pytest.fixture
def motion():
    """Specific force, rates and angular acceleration of random samples."""
    rng = np.random.default_rng(5)
    return rng.normal(scale=(10.0, 5.0, 50.0), size=(40, 3, 3)).transpose(2, 0, 1).copy()


def test_force_is_mass_times_specific_force(motion):
    np.testing.assert_allclose(newton_euler(*motion, MASS, INERTIA)[:, :3], MASS * motion[0], rtol=1e-14)


def test_gyroscopic_moment_does_no_work(motion):
    specific_force, rates, _ = motion
    moment = newton_euler(specific_force, rates, np.zeros_like(rates), MASS, INERTIA)[:, 3:]
    power = np.sum(moment * rates, axis=1)
    assert np.all(np.linalg.norm(moment, axis=1) > 1e-6)
    np.testing.assert_allclose(power, 0.0, atol=1e-14)


def test_spin_about_a_principal_axis_needs_no_moment():
    _, axes = np.linalg.eigh(INERTIA)
    rates = np.ascontiguousarray(20.0 * axes.T)
    moment = newton_euler(np.zeros((3, 3)), rates, np.zeros((3, 3)), MASS, INERTIA)[:, 3:]
    np.testing.assert_allclose(moment, 0.0, atol=1e-14)


def test_moment_is_the_change_of_angular_momentum(true_flight):
    step = 1e-5
    true = true_flight(np.array([1.0 - step, 1.0, 1.0 + step]))
    rotation = Rotation.from_quat(np.roll(true.attitude, -1, axis=1))
    momentum = rotation.apply(true.rates @ INERTIA)
    world_moment = (momentum[2] - momentum[0]) / (2.0 * step)
    moment = newton_euler(true.specific_force, true.rates, true.angular_acceleration, MASS, INERTIA)[1, 3:]
    np.testing.assert_allclose(rotation[1].apply(moment), world_moment, rtol=1e-6, atol=1e-10)


TIME = np.arange(0.0, 4.0, 0.01)
MIDDLE = slice(100, 300)


def test_slow_forces_pass_and_fast_ones_do_not() -> None:
    rates = np.zeros((len(TIME), 3))
    slow, fast = (np.sin(2.0 * np.pi * hz * TIME)[:, None, None] * np.ones((1, 3, 1)) for hz in (0.5, 30.0))
    np.testing.assert_allclose(band_limited(TIME, rates, slow, 8.0)[MIDDLE], slow[MIDDLE], atol=1e-3)
    assert np.abs(band_limited(TIME, rates, fast, 8.0)[MIDDLE]).max() < 0.01


def test_a_force_that_stays_in_the_world_stays_where_the_body_spins() -> None:
    """Three turns a second about z: in body axes the force turns faster than the bandwidth."""
    spin = 6.0 * np.pi
    rates = np.tile([0.0, 0.0, spin], (len(TIME), 1))
    force = np.stack((np.cos(spin * TIME), -np.sin(spin * TIME), np.zeros_like(TIME)), axis=1)[:, :, None]
    np.testing.assert_allclose(band_limited(TIME, rates, force, 1.0)[MIDDLE], force[MIDDLE], atol=0.01)


@pytest.mark.parametrize("bandwidth", [None, 60.0])
def test_without_a_bandwidth_or_beyond_half_the_rate_forces_stay(bandwidth: float | None) -> None:
    wrench = np.random.default_rng(0).normal(size=(len(TIME), 6))
    inputs = np.zeros((len(TIME), len(INPUT_NAMES)))
    np.testing.assert_array_equal(as_recorded(TIME, inputs, wrench, bandwidth), wrench)


def test_moments_of_a_wrench_stay() -> None:
    rng = np.random.default_rng(0)
    wrench, inputs = rng.normal(size=(len(TIME), 6)), np.zeros((len(TIME), len(INPUT_NAMES)))
    inputs[:, INPUT_INDEX["p"]] = 1.0
    smooth = as_recorded(TIME, inputs, wrench, 8.0)
    np.testing.assert_array_equal(smooth[:, 3:], wrench[:, 3:])
    assert np.all(np.std(smooth[:, :3], axis=0) < 0.7)
