# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Innovations of motions known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.records import STANDARD_GRAVITY
from quadpi_core.screening.excerpt import STEP_S, Excerpt, Innovation, cost, innovation

from .conftest import CELLS, excerpt_of

DOWN = np.array([0.0, 0.0, 1.0])
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def at_rest(rates: object = 0.0, force: object = 0.0) -> Excerpt:
    """A level vehicle at rest, with errors of gyro and accelerometer."""
    still = np.zeros((CELLS, 3))
    attitude, position = np.tile(LEVEL, (CELLS + 1, 1)), np.zeros((CELLS + 1, 3))
    return excerpt_of(attitude, position, still + rates, still - STANDARD_GRAVITY * DOWN + force)


def test_a_steady_turn_and_fall_are_measured_as_they_are():
    time = STEP_S * np.arange(CELLS + 1)
    rates, acceleration = np.array([0.5, -1.0, 2.0]), np.array([1.0, 2.0, -3.0])
    turned = Rotation.from_rotvec(time[:, None] * rates)
    position = 0.5 * np.outer(time**2, acceleration) + np.outer(time, [3.0, -1.0, 2.0])
    middle = Rotation.from_rotvec((time[:-1, None] + 0.5 * STEP_S) * rates)
    force = middle.apply(acceleration - STANDARD_GRAVITY * DOWN, inverse=True)
    found = innovation(
        excerpt_of(turned.as_quat(scalar_first=True), position, np.tile(rates, (CELLS, 1)), force)
    )
    for values, expected in (
        (found.turned, rates),
        (found.turned_attitude, rates),
        (found.needed, acceleration - STANDARD_GRAVITY * DOWN),
        (found.force, acceleration - STANDARD_GRAVITY * DOWN),
    ):
        assert values.shape[0] > 40
        np.testing.assert_allclose(values, np.tile(expected, (len(values), 1)), atol=1e-4)


def test_sound_sensors_cost_next_to_nothing(sound):
    found = innovation(sound)
    assert cost(found, found.motion) < 0.01
    assert found.motion[0] > 0.5
    assert found.motion[1] > 1.0


@pytest.mark.parametrize("wrong", [{"rates": [0.0, 0.1, 0.0]}, {"force": [0.0, 0.3, 0.0]}])
def test_a_cost_of_one_is_what_sensors_of_sound_flights_differ_by(wrong):
    """At rest 0.1 rad/s or 0.3 m/s²; in motion a tenth of it more."""
    found = innovation(at_rest(**wrong))
    assert cost(found, (0.0, 0.0)) == pytest.approx(1.0, rel=1e-6)
    assert cost(found, (1.0, 3.0)) == pytest.approx(0.25, rel=1e-6)


@pytest.mark.parametrize(("wild", "counts"), [(10, False), (11, True)])
def test_the_largest_tenth_of_the_innovations_does_not_count(wild, counts):
    off = np.zeros((100, 3))
    off[:wild] = 50.0
    zero = np.zeros((100, 3))
    found = Innovation(off, zero, off, zero, np.tile(LEVEL, (100, 1)))
    assert (found.turn_rad_s > 1.0) == (found.fall_m_s2 > 1.0) == counts
