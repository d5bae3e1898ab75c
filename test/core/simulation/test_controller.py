# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The controller follows its reference, as far as the nominal vehicle and its rotors go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.simulation.applied_effects import read_effects
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.truth import Reference

from .references import COUPLED, STATION, held_still, sines

VEHICLES = ("bebop2", "hdbeetle")
POSITION_GAIN = 5.0


@pytest.fixture(scope="module")
def vehicle():
    return SimulatedVehicle.load("bebop2")


def wanted(**demanded):
    """Thrust and moments (4,) that a level vehicle asks of its rotors, and their speeds squared.

    Rotors follow their command until they turn as it wants.
    """
    model = SimulatedVehicle.load("bebop2").aerodynamics
    x, y, _ = model.vehicle.rotor_positions.T
    slope = model.vehicle.mass_kg * model.vehicle.gravity_m_s2 / (4.0 * model.hover_rotor_speed**2)
    ratio = model.coefficients.torque[0] / model.coefficients.thrust[0] * model.vehicle.rotor_radius_m
    effect = slope * np.stack((np.ones(4), -y, x, model.vehicle.rotor_spins * ratio))
    squares = held_still(200, **demanded)[1]["rotor_speeds"][0, :4] ** 2
    return effect @ squares, squares


def test_in_hover_the_rotors_carry_the_weight(vehicle):
    weight = vehicle.vehicle.mass_kg * vehicle.vehicle.gravity_m_s2
    np.testing.assert_allclose(wanted()[0], [weight, 0.0, 0.0, 0.0], atol=1e-9)


def test_what_the_wrench_lacked_is_asked_for_in_addition(vehicle):
    """An air that pushes down with 0.3 N, and a moment of 0.01 Nm about each axis."""
    weight = vehicle.vehicle.mass_kg * vehicle.vehicle.gravity_m_s2
    asked, _ = wanted(disturbance=[0.0, 0.0, 0.3, 0.01, 0.01, 0.003])
    np.testing.assert_allclose(asked, [weight + 0.3, -0.01, -0.01, -0.003], atol=1e-9)


def test_a_velocity_error_asks_for_an_acceleration_against_it(vehicle):
    """Of four per second: downward at 0.5 m/s, upward force of 2 m/s² more."""
    mass, gravity = vehicle.vehicle.mass_kg, vehicle.vehicle.gravity_m_s2
    thrust = wanted(velocity=(0.0, 0.0, 0.5))[0][0]
    assert thrust == pytest.approx(mass * (gravity + 4.0 * 0.5))
    # Forward at 0.5 m/s: nose up, and no moment about the other axes.
    _, roll, pitch, yaw = wanted(velocity=(0.5, 0.0, 0.0))[0]
    assert pitch > 0.01
    assert [roll, yaw] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_where_rotors_saturate_yaw_gives_way_first_then_thrust(vehicle):
    mass, gravity = vehicle.vehicle.mass_kg, vehicle.vehicle.gravity_m_s2
    most = vehicle.vehicle.rotor_speed_max_rad_s**2
    modest, (spinning, squares) = wanted(yaw_rate=1.0)[0], wanted(yaw_rate=100.0)
    # Six per second of yaw rate; roll goes with it by the product of inertia.
    roll, _, yaw = vehicle.vehicle.inertia @ [0.0, 0.0, 6.0]
    np.testing.assert_allclose(modest, [mass * gravity, roll, 0.0, yaw], atol=1e-9)
    # Thrust and the other moments as asked; of the turn what leaves two rotors at their limit.
    np.testing.assert_allclose(spinning[:3], [mass * gravity, 100.0 * roll, 0.0], atol=1e-9)
    assert yaw < spinning[3] < 100.0 * yaw
    assert min(squares.min(), most - squares.max()) == pytest.approx(0.0, abs=1e-6 * most)
    # More than the rotors have, and a moment: the moment is kept.
    roll = [0.0, 0.0, 0.0, 0.05, 0.0, 0.0]
    climbing, squares = wanted(acceleration=(0.0, 0.0, -100.0), disturbance=roll)
    np.testing.assert_allclose(climbing[1:], [-0.05, 0.0, 0.0], atol=1e-9)
    assert squares.max() == pytest.approx(most)


@pytest.mark.parametrize("name", VEHICLES)
def test_tracks_sines_up_to_fourteen_metres_per_second(name):
    truth = simulate_flight(
        "dash", SimulatedVehicle.load(name), sines([20.0, 0.0, 0.0], [0.11, 0.1, 0.1], 20.0, 0.0)
    )
    assert np.linalg.norm(truth.velocity, axis=1).max() > 13.5
    assert np.sqrt(np.mean(truth.position_error**2)) < 0.5
    coupled = simulate_flight("coupled", SimulatedVehicle.load(name), COUPLED)
    assert np.sqrt(np.mean(coupled.position_error**2)) < 0.1


def test_excitation_on_top_of_the_controller_shows_in_pitch_and_thrust():
    vehicle = SimulatedVehicle.load("hdbeetle")
    calm = Reference.hover(STATION, 2001)
    pulse = np.zeros(2001)
    pulse[500:650] = 1.0
    pitched = simulate_flight("pitch", vehicle, replace(calm, tilt=np.outer(pulse, [0.0, 0.3])))
    assert pitched.rates[:, 1].max() > 1.0
    assert np.abs(pitched.rates[:, 0]).max() < 0.2
    pushed = simulate_flight("thrust", vehicle, replace(calm, thrust=0.3 * pulse))
    weight = vehicle.vehicle.mass_kg * vehicle.vehicle.gravity_m_s2
    assert pushed.wrench[:, 2].min() < -1.2 * weight


def test_effects_come_as_a_surprise_to_the_controller():
    """It knows the nominal mass: with a payload the vehicle sags until the position gain compensates."""
    vehicle = SimulatedVehicle.load("bebop2")
    loaded = simulate_flight(
        "loaded", vehicle, COUPLED, effects=read_effects({"payload": {"mass_kg": 0.05}}, "test")
    )
    assert loaded.vehicle.mass_kg == pytest.approx(vehicle.vehicle.mass_kg + 0.05)
    bare = simulate_flight("bare", vehicle, COUPLED)
    assert loaded.rotor_speeds.mean() > bare.rotor_speeds.mean() + 20.0
    sag = (loaded.position - loaded.reference.position)[len(loaded) // 4 :, 2].mean()
    missing = vehicle.vehicle.gravity_m_s2 * 0.05 / vehicle.vehicle.mass_kg
    assert sag == pytest.approx(missing / POSITION_GAIN, rel=0.15)
    assert bare.position_error.max() < 0.3 * sag
