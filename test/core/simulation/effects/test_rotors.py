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


# Rotors as built: inertia, coefficients, mounting, damage.


INERTIA = 8e-6


def momentum(model, rotor_speeds):
    """Angular momentum of the rotors along z."""
    return INERTIA * rotor_speeds @ model.vehicle.rotor_spins


def test_precession_follows_the_angular_momentum_of_the_rotors(states, added, model):
    along_z = momentum(model, states["rotor_speeds"])[:, None] * np.array([0.0, 0.0, 1.0])
    moment = added("gyroscopic", states)[:, 3:]
    np.testing.assert_allclose(moment, -np.cross(states["rates"], along_z), atol=1e-15)


def test_the_body_gets_the_momentum_that_the_rotors_lose(states, added, model):
    step = 1e-3
    later = momentum(model, states["rotor_speeds"] + step * states["rotor_accelerations"])
    change = (later - momentum(model, states["rotor_speeds"])) / step
    np.testing.assert_allclose(added("spin_up", states)[:, 5], -change, atol=1e-9)


def test_another_air_density_is_a_share_of_all_aerodynamics(states, added):
    """Whatever else acts on the vehicle, such as another effect or a measured force."""
    whole = added("thrust_coefficient", states, change=0.2)
    np.testing.assert_allclose(whole, 0.2 * states["aerodynamics"])
    pushed = states.copy()
    pushed["wrench"] += 3.0
    pushed["force_is_measured"] = 1.0
    np.testing.assert_array_equal(added("thrust_coefficient", pushed, change=0.2), whole)


def test_coefficients_of_rotors_add_up_to_thrust_and_torque(states, added):
    names = [f"{name}_change" for name in ("first", "second", "third", "fourth")]
    whole = added("rotor_thrusts", states, **dict.fromkeys(names, 0.2))
    np.testing.assert_allclose(whole[:, 2], -0.2 * states["thrusts"].sum(axis=1))
    np.testing.assert_allclose(whole[:, 5], 0.2 * states["torques"].sum(axis=1), atol=1e-15)
    alone = sum(added("rotor_thrusts", states, **(dict.fromkeys(names, 0.0) | {name: 0.2})) for name in names)
    np.testing.assert_allclose(alone, whole, atol=1e-12)


def test_rotors_in_still_air_are_all_that_is_denser_there(hover, added):
    """Without airspeed and rates nothing but thrust and torque is in proportion to the density."""
    names = [f"{name}_change" for name in ("first", "second", "third", "fourth")]
    state = hover()
    denser = added("thrust_coefficient", state, change=0.2)
    np.testing.assert_allclose(
        denser, added("rotor_thrusts", state, **dict.fromkeys(names, 0.2)), rtol=1e-9, atol=1e-12
    )


def test_one_weak_rotor_moves_all_axes_it_should(hover, added, model):
    state = hover()
    for rotor, (x, y, _) in enumerate(model.vehicle.rotor_positions):
        wrench = added("weak_rotor", state, rotor=rotor + 1)[0]
        lost = 0.1 * state["thrusts"][0, rotor]
        np.testing.assert_allclose(wrench[[2, 3, 4]], [lost, y * lost, -x * lost])
        assert wrench[5] == pytest.approx(-0.1 * state["torques"][0, rotor])


def test_a_nicked_rotor_has_more_drag_in_its_plane(states, added, record, model):
    """Its share of the rotor-local model's force along the airspeed of its hub."""
    position = model.vehicle.rotor_positions[2]
    airspeed = states["velocity_air"] + np.cross(states["rates"], position)
    drag = 0.3 * record["rotor_force_along"][0] * states["rotor_speeds"][:, [2]] * airspeed[:, :2]
    wrench = added("weak_rotor", states, rotor=3, loss=0.0, torque_change=0.3)
    np.testing.assert_allclose(wrench[:, :2], drag, rtol=1e-9)
    turn = position[0] * drag[:, 1] - position[1] * drag[:, 0]
    np.testing.assert_allclose(wrench[:, 5], 0.3 * states["torques"][:, 2] + turn, rtol=1e-9, atol=1e-15)


def test_a_tilted_rotor_has_the_same_thrust_and_torque_in_another_direction(states, added, model):
    thrust, torque = states["thrusts"][:, 1], states["torques"][:, 1]
    wrench = added("rotor_tilt", states, rotor=2, forward_deg=3.0, right_deg=-4.0)
    force = wrench[:, :3] + thrust[:, None] * [0.0, 0.0, -1.0]
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), np.abs(thrust))
    np.testing.assert_allclose(
        force[:, :2], thrust[:, None] * np.sin(np.radians([3.0, -4.0])), rtol=1e-9, atol=1e-15
    )
    # About its hub, the torque along its axis.
    own = wrench[:, 3:] - np.cross(model.vehicle.rotor_positions[1], wrench[:, :3])
    own[:, 2] += torque
    np.testing.assert_allclose(own, -torque[:, None] * force / thrust[:, None], rtol=1e-9, atol=1e-12)
