# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The rotors, each in the air that its hub meets."""

from __future__ import annotations

import numpy as np
import pytest


def hubs(model, states):
    """Airspeed (N, 4, 3) of the hubs."""
    turning = np.cross(states["rates"][:, None], model.vehicle.rotor_positions)
    return states["velocity_air"][:, None] + turning


def shares(model, states):
    """Share (N, 4) that a rotor has of a coefficient."""
    return states["rotor_speeds"] / (4.0 * model.hover_rotor_speed)


def summed(model, forces):
    """Wrench (N, 6) of forces (N, 4, 3) at the hubs."""
    moments = np.cross(model.vehicle.rotor_positions, forces)
    return np.concatenate((forces.sum(axis=1), moments.sum(axis=1)), axis=1)


def test_drag_of_each_rotor_is_against_the_airspeed_of_its_hub(model, states, added):
    forces = -0.11 * shares(model, states)[:, :, None] * hubs(model, states) * [1.0, 1.0, 0.0]
    np.testing.assert_allclose(added("rotor_drag", states), summed(model, forces), rtol=1e-9, atol=1e-12)


def test_cross_flow_pushes_each_rotor_across_its_airspeed_by_its_spin(model, states, added):
    across = np.cross(hubs(model, states), [0.0, 0.0, 1.0])
    spins = model.vehicle.rotor_spins[:, None]
    forces = 0.064 * spins * shares(model, states)[:, :, None] * across
    np.testing.assert_allclose(added("cross_flow", states), summed(model, forces), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("direction", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0.6, -0.8, 0)])
def test_flapping_raises_the_side_that_flies_ahead(hover, added, direction):
    wrench = added("blade_flapping", hover(velocity=direction))
    np.testing.assert_allclose(wrench[0, 3:], 0.0129 * np.cross([0, 0, 1], direction), atol=1e-9)


def test_inflow_damps_climb_and_roll(model, hover, added):
    """A roll rate moves the hubs up and down: of each, arm times rate."""
    assert added("inflow_damping", hover(velocity=(0.0, 0.0, -2.0)))[0, 2] == pytest.approx(0.33 * 2.0)
    arms = np.square(model.vehicle.rotor_positions[:, 1]).mean()
    assert added("inflow_damping", hover(rates=(3.0, 0.0, 0.0)))[0, 3] == pytest.approx(-0.33 * 3.0 * arms)


def test_lift_of_translation_grows_with_the_square_up_to_the_largest_advance_ratio(model, hover, added):
    def lift(speed):
        return -added("translational_lift", hover(velocity=(0.6 * speed, 0.8 * speed, 3.0)))[0, 2]

    tip = model.hover_rotor_speed * model.vehicle.rotor_radius_m
    assert lift(8.0) == pytest.approx(0.0058 * 64.0)
    assert lift(0.59 * tip) == pytest.approx(0.0058 * (0.59 * tip) ** 2)
    assert lift(0.61 * tip) == lift(2.0 * tip) == pytest.approx(0.0058 * (0.6 * tip) ** 2)


def test_dissymmetry_is_a_moment_of_unlike_airspeeds(model, states, added):
    more = np.square(hubs(model, states)).sum(axis=2) - np.square(states["velocity_air"]).sum(axis=1)[:, None]
    forces = (5e-4 * shares(model, states) * more)[:, :, None] * [0.0, 0.0, -1.0]
    wrench = added("rotor_dissymmetry", states)
    np.testing.assert_allclose(wrench[:, 3:5], summed(model, forces)[:, 3:5], rtol=1e-9, atol=1e-12)
    assert not wrench[:, :3].any()


def test_vortex_ring_only_in_descent_and_worst_at_the_induced_velocity(hover, added, model):
    induced = model.vehicle.hover_induced_velocity

    def loss(sink, forward=0.0):
        state = hover(velocity=(forward, 0.0, sink))
        return added("vortex_ring", state)[0, 2] / state["thrusts"].sum()

    assert loss(-induced) == loss(0.0) == 0.0
    assert loss(induced) == pytest.approx(0.13)
    assert loss(0.5 * induced) < loss(induced) > loss(1.5 * induced) > 0.0
    assert loss(induced, forward=10.0) < 0.1 * loss(induced)


@pytest.mark.parametrize(
    ("direction", "axis", "sign"),
    [((10, 0, 0), 4, 1), ((-10, 0, 0), 4, -1), ((0, 10, 0), 3, -1), ((0, -10, 0), 3, 1)],
)
def test_rotors_behind_lose_thrust(hover, added, direction, axis, sign):
    wrench = added("rotor_interaction", hover(velocity=direction))[0]
    assert wrench[2] > 0.0
    assert np.sign(wrench[axis]) == sign
    assert abs(wrench[7 - axis]) < 0.1 * abs(wrench[axis])


def test_a_rotor_straight_behind_loses_the_whole_share(model, hover, added):
    """Towards one rotor, at a speed far above the induced one, the opposite one loses 15 %."""
    x, y, _ = model.vehicle.rotor_positions[0]
    ahead = 1000.0 * np.array([x, y, 0.0]) / np.hypot(x, y)
    state = hover(velocity=ahead)
    bearing = model.vehicle.rotor_positions[:, :2] / np.hypot(x, y)
    behind = np.maximum(0.0, -bearing @ bearing[0])
    assert behind.max() == pytest.approx(1.0)
    assert added("rotor_interaction", state)[0, 2] == pytest.approx(0.15 * state["thrusts"][0] @ behind)
