# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Surfaces near the rotors, each rotor at its own height."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

TILTED = Rotation.from_euler("ZYX", [70.0, -12.0, 25.0], degrees=True)


@pytest.fixture(scope="module")
def tilted(hover):
    """tilted(height) → one state at rest that leans to the right and forward."""
    return lambda height: hover(height=height, attitude=np.roll(TILTED.as_quat(), 1))


def hub_heights(model, height):
    return height - TILTED.apply(model.vehicle.rotor_positions)[:, 2]


def moments(model, gains):
    """Of more thrust (4,) along -z of each hub."""
    forces = np.outer(gains, [0.0, 0.0, -1.0])
    return np.cross(model.vehicle.rotor_positions, forces).sum(axis=0)


def test_hovering_rotors_gain_what_cheeseman_and_bennett_say(model, tilted, added):
    state = tilted(0.3)
    ratio = model.vehicle.rotor_radius_m / (4.0 * hub_heights(model, 0.3))
    gains = state["thrusts"][0] * (1.0 / (1.0 - ratio**2) - 1.0)
    # Rotors at rest in the air: no speed in the plane.
    wrench = added("ground_effect", state)[0]
    np.testing.assert_allclose(wrench[2:5], [-gains.sum(), *moments(model, gains)[:2]], rtol=1e-9)


def test_rotors_below_a_ceiling_gain_with_the_square_of_their_distance(model, tilted, added):
    state = tilted(3.7)
    distance = 4.0 - hub_heights(model, 3.7)
    gains = state["thrusts"][0] * 0.2 * (model.vehicle.rotor_radius_m / distance) ** 2
    wrench = added("ceiling_effect", state)[0]
    np.testing.assert_allclose(wrench[2:5], [-gains.sum(), *moments(model, gains)[:2]], rtol=1e-9)


def test_ceiling_effect_grows_up_to_half_a_radius(model, hover, added):
    hubs = 0.03 + 0.5 * model.vehicle.rotor_radius_m
    nearest, nearer, beyond = (
        added("ceiling_effect", hover(height=4.0 - hubs + further))[0, 2] for further in (0.0, 0.02, 1.0)
    )
    assert nearest == pytest.approx(nearer) == pytest.approx(beyond)
    assert abs(added("ceiling_effect", hover(height=4.0 - hubs - 0.02))[0, 2]) < 0.7 * abs(nearest)


def test_ground_effect_grows_down_to_half_a_radius_and_is_gone_far_away(hover, added):
    def lift(height):
        return -added("ground_effect", hover(height=height))[0, 2]

    heights = np.array([-1.0, 0.0, 0.01, 0.05, 0.1, 0.2, 0.5, 2.0, 50.0])
    lifts = np.array([lift(height) for height in heights])
    assert lifts[0] == lifts[1] > 0.0
    assert np.all(np.diff(lifts[2:]) < 0.0)
    assert lifts[-1] < 1e-6
    assert lift(2.0 * 0.075 - 0.03) == pytest.approx(0.016 * 3.67, rel=0.03)


def test_ground_effect_fades_with_speed(hover, added, model):
    """At twice the induced velocity in the plane, the source's square of R/4h counts a fifth."""
    speed = 2.0 * model.vehicle.hover_induced_velocity
    state = hover(height=0.1, velocity=(speed, 0.0, 0.0))
    gain = -added("ground_effect", state)[0, 2] / state["thrusts"].sum()
    ratio = model.vehicle.rotor_radius_m / (4.0 * 0.13)
    assert gain == pytest.approx(1.0 / (1.0 - 0.2 * ratio**2) - 1.0)


def test_ground_lifts_the_lower_side(hover, added):
    rolled_right = np.array([np.cos(0.1), np.sin(0.1), 0.0, 0.0])
    assert added("ground_effect", hover(height=0.1, attitude=rolled_right))[0, 3] < 0.0
