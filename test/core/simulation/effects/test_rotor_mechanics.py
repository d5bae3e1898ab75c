# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotors as built: inertia, coefficients, mounting, damage."""

from __future__ import annotations

import numpy as np
import pytest

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
