# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""An IMU away from the body's origin feels what a rigid body says; moved back, it is one at the origin."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.frames import rotation_matrix
from quadpi_core.messages.mounting import LAG_S, Mounting

RATE_HZ = 500.0
ARM = np.array([0.05, -0.03, 0.08])
TURN = rotation_matrix(np.array([0.8, 0.2, -0.4, 0.4]) / np.linalg.norm([0.8, 0.2, -0.4, 0.4]))


def swinging(seconds: float) -> tuple[np.ndarray, ...]:
    """Stamps, rates and specific force at the origin, and what an IMU measures, turned and away from it."""
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    pulse = 2.0 * np.pi * np.array([3.0, 2.0, 1.0])
    amplitude = np.array([4.0, 3.0, 2.0])
    rates = amplitude * np.sin(np.outer(time_s, pulse))
    angular = amplitude * pulse * np.cos(np.outer(time_s, pulse))
    force = np.array([0.3, -0.2, -9.81]) + 0.0 * rates
    there = force + np.cross(angular, ARM) + np.cross(rates, np.cross(rates, ARM))
    return np.rint(1e9 * time_s).astype(np.int64), rates, force, rates @ TURN, there @ TURN


def test_turned_and_moved_back() -> None:
    time_ns, rates, force, turned, felt = swinging(3.0)
    assert np.abs(felt @ TURN.T - force).max() > 5.0
    Mounting(TURN, ARM).move(time_ns, turned, felt)
    np.testing.assert_allclose(turned, rates, atol=1e-12)
    # What the angular acceleration changes in the lag and half a step, at most its own derivative times that.
    jerk = np.linalg.norm((2.0 * np.pi * np.array([3.0, 2.0, 1.0])) ** 2 * np.array([4.0, 3.0, 2.0]))
    bound = (LAG_S + 0.5 / RATE_HZ) * jerk * np.linalg.norm(ARM)
    assert np.abs(felt - force)[20:].max() < bound
    assert bound < 0.4


def test_without_an_arm_it_is_a_turn_alone() -> None:
    time_ns, rates, _, turned, felt = swinging(0.5)
    there = felt @ TURN.T
    Mounting(TURN, np.zeros(3)).move(time_ns, turned, felt)
    np.testing.assert_allclose(felt, there, atol=1e-12)
    np.testing.assert_allclose(turned, rates, atol=1e-12)


@pytest.mark.parametrize("block", [1, 7])
def test_blocks_of_any_length_give_the_same_bits(block: int) -> None:
    time_ns, _, _, rates, force = swinging(0.4)
    time_ns[100:] += 200_000_000
    rates[50] = np.nan
    whole_rates, whole_force = rates.copy(), force.copy()
    Mounting(TURN, ARM).move(time_ns, whole_rates, whole_force)
    mounting = Mounting(TURN, ARM)
    for start in range(0, len(time_ns), block):
        part = slice(start, start + block)
        mounting.move(time_ns[part], rates[part], force[part])
    np.testing.assert_array_equal(rates, whole_rates)
    np.testing.assert_array_equal(force, whole_force)
    # One sample without numbers spoils no other.
    assert np.flatnonzero(~np.isfinite(force).all(axis=1)).tolist() == [50]


def test_stamps_that_nearly_coincide_give_no_acceleration() -> None:
    time_ns, _, force, turned, felt = swinging(1.0)
    time_ns[100] = time_ns[99] + 1
    Mounting(TURN, ARM).move(time_ns, turned, felt)
    assert np.abs(felt - force).max() < 20.0


def test_rates_that_cannot_be_spoil_no_other_sample() -> None:
    time_ns, _, force, turned, felt = swinging(1.0)
    turned[100] = 1e20
    Mounting(TURN, ARM).move(time_ns, turned, felt)
    error = np.abs(felt - force).max(axis=1)
    assert np.flatnonzero(error[20:] > 1.0).tolist() == [80]
