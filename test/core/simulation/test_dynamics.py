# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Equations of motion, and what is logged of them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.frames import rotate_body_to_world, rotation_matrix
from quadpi_core.signals.wrench import newton_euler
from quadpi_core.simulation.applied_effects import (
    EFFECTS,
    compose,
    effect_wrench,
    memory_at_rest,
    read_effects,
    with_memory,
)
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.state_records import LOGGED, Controls, Demand, Memory, Physics, fly
from quadpi_core.simulation.truth import LOG_HZ, STEP_HZ, Truth

from .references import COUPLED

AERODYNAMICS = (
    *("thrust", "torque", "rotor_force_along", "rotor_force_across", "rotor_moment_along"),
    *("rotor_moment_across", "airframe_fx", "airframe_fy", "airframe_fz", "airframe_mx", "airframe_my"),
    "airframe_mz",
)
HALF_A_SECOND = 501


@pytest.fixture(scope="module")
def thrown():
    """The log of every step of a vehicle without aerodynamics that is thrown up and tumbles; the vehicle."""
    vehicle = SimulatedVehicle.load("bebop2")
    record = vehicle.record()
    controls = Controls.from_nominal(record.copy(), vehicle.aerodynamics.effectiveness)
    for name in AERODYNAMICS:
        record[name] = 0.0
    position, none = np.array([1.0, 2.0, -20.0]), np.zeros((HALF_A_SECOND, 3))
    level = np.zeros(HALF_A_SECOND)
    demand = Demand(none + position, none, none, none, level, level, np.zeros((len(none), 2)), level, none)
    start = np.array([3.0, -1.0, -2.0])
    memory = Memory.at(position, start, np.array([1.0, 0.0, 0.0, 0.0]), np.full(4, 500.0), np.zeros(6))
    memory.motions[0]["rates"] = [0.6, -0.4, 9.0]
    log, done = np.zeros(HALF_A_SECOND, dtype=LOGGED), np.zeros(1, dtype=np.int64)
    law = vehicle.aerodynamics
    fly(Physics(record, law.function, law.numbers, compose({})), controls, demand, memory, log, done)
    assert done[0] == HALF_A_SECOND - 1
    return log, vehicle


def test_without_forces_a_vehicle_falls_along_a_parabola(thrown):
    log, vehicle = thrown
    time = np.arange(HALF_A_SECOND)[:, None] / STEP_HZ
    gravity = np.array([0.0, 0.0, vehicle.vehicle.gravity_m_s2])
    parabola = [1.0, 2.0, -20.0] + time * [3.0, -1.0, -2.0] + 0.5 * time**2 * gravity
    np.testing.assert_allclose(log["position"], parabola, atol=1e-12)
    np.testing.assert_allclose(log["acceleration"], np.tile(gravity, (len(log), 1)), atol=1e-12)
    assert not log["wrench"].any()


def test_without_moments_it_keeps_its_angular_momentum_and_energy(thrown):
    log, vehicle = thrown
    momentum = log["rates"] @ vehicle.vehicle.inertia
    energy = 0.5 * np.sum(log["rates"] * momentum, axis=1)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
    in_world = Rotation.from_quat(np.roll(log["attitude"], -1, axis=1)).apply(momentum)
    np.testing.assert_allclose(in_world, np.tile(in_world[0], (len(log), 1)), atol=1e-9 * energy[0])
    # It does tumble: the axis of rotation moves in the body.
    assert np.ptp(log["rates"], axis=0).min() > 1e-3


def test_a_rotor_approaches_its_command_exponentially(thrown):
    """The command is held for a step: what is missing falls by e^(−Δt/τ)."""
    log, vehicle = thrown
    missing = vehicle.motor_time_constant * log["rotor_accelerations"][:-1]
    kept = np.exp(-1.0 / (STEP_HZ * vehicle.motor_time_constant))
    after = log["rotor_speeds"][:-1] + (1.0 - kept) * missing
    np.testing.assert_allclose(log["rotor_speeds"][1:], after, atol=1e-9 * np.abs(missing).max())
    assert np.abs(missing).max() > 10.0


@pytest.mark.parametrize("name", ["none", *EFFECTS])
def test_logged_instants_obey_newton_and_euler(name):
    effects = {} if name == "none" else read_effects({name: None}, "test")
    vehicle = SimulatedVehicle.load("bebop2")
    truth = simulate_flight("swing", vehicle, COUPLED, effects=effects, seed=3)
    weight = truth.vehicle.mass_kg * truth.vehicle.gravity_m_s2 * np.array([0.0, 0.0, 1.0])
    force = rotate_body_to_world(truth.attitude, truth.wrench[:, :3]) + weight
    assert np.abs(truth.vehicle.mass_kg * truth.acceleration - force).max() < 1e-12
    inertia = truth.vehicle.inertia
    moment = newton_euler(
        truth.specific_force, truth.rates, truth.angular_acceleration, truth.vehicle.mass_kg, inertia
    )[:, 3:]
    assert np.abs(moment - truth.wrench[:, 3:]).max() < 1e-12
    assert np.abs(np.linalg.norm(truth.attitude, axis=1) - 1.0).max() < 1e-12


def test_wrench_without_effects_is_that_of_the_model():
    vehicle = SimulatedVehicle.load("bebop2")
    truth = simulate_flight("swing", vehicle, COUPLED)
    wrench = vehicle.aerodynamics.wrench(truth.velocity, truth.rates, truth.rotor_speeds)
    np.testing.assert_allclose(truth.wrench, wrench, rtol=1e-11, atol=1e-13)


def derivative(values):
    """Central differences of eighth order over the log, without four samples at either end."""
    weights = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
    count = len(values) - 8
    return LOG_HZ * sum(w * values[i : i + count] for i, w in enumerate(weights))


def test_logged_derivatives_are_those_of_the_logged_states():
    """Commands change every step, so that accelerations have corners: bounds, not machine precision."""
    truth = simulate_flight("swing", SimulatedVehicle.load("bebop2"), COUPLED)
    world = rotate_body_to_world(truth.attitude, truth.velocity)
    rotation = rotation_matrix(truth.attitude)
    turning = np.einsum("nji,njk->nik", rotation[4:-4], derivative(rotation))
    for differences, logged, bound in (
        (derivative(truth.position), world, 1e-8),
        (derivative(world), truth.acceleration, 1e-4),
        (np.stack((turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]), axis=1), truth.rates, 1e-4),
        (derivative(truth.rates), truth.angular_acceleration, 0.1),
    ):
        # The reference ends in a corner.
        assert np.abs(differences - logged[4:-4])[:-20].max() < bound


def test_motors_are_first_order_within_their_limits():
    vehicle = SimulatedVehicle.load("bebop2")
    truth = simulate_flight("swing", vehicle, COUPLED)
    command = truth.rotor_speeds + vehicle.motor_time_constant * truth.rotor_accelerations
    assert command.min() > -1e-9
    assert command.max() < vehicle.vehicle.rotor_speed_max_rad_s + 1e-9


def _recorded_states(vehicle: SimulatedVehicle, truth: Truth) -> npt.NDArray[np.void]:
    return vehicle.aerodynamics.states(
        truth.velocity,
        truth.rates,
        truth.rotor_speeds,
        rotor_accelerations=truth.rotor_accelerations,
        position=truth.position,
        attitude=truth.attitude,
    )


WRENCH = [e for e in EFFECTS.values() if e.kind == "wrench"]


@pytest.mark.parametrize("name", [effect.name for effect in WRENCH if not effect.at_rest])
def test_an_effect_adds_in_flight_what_it_adds_on_the_recorded_states(name):
    """Whatever else is switched on: its parameters mean the same under a payload."""
    vehicle = SimulatedVehicle.load("bebop2")
    effects = read_effects({name: None, "payload": None}, "test")
    truth = simulate_flight("swing", vehicle, COUPLED, effects=effects)
    states = _recorded_states(vehicle, truth)
    added = effect_wrench(name, effects[name], states, vehicle.record())
    np.testing.assert_allclose(truth.wrench, states["wrench"] + added, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("name", [effect.name for effect in WRENCH if effect.at_rest])
def test_a_state_of_its_own_is_the_same_in_flight_and_along_the_record(name):
    vehicle = SimulatedVehicle.load("bebop2")
    effects = read_effects({name: None}, "test")
    truth = simulate_flight("swing", vehicle, COUPLED, effects=effects)
    states = _recorded_states(vehicle, truth)
    without, record = states["wrench"].copy(), vehicle.record()
    states["wrench"], states["force_is_measured"] = truth.wrench, 1.0
    own = with_memory(name, effects[name], states, record, memory_at_rest(effects), 0.002)
    added = effect_wrench(name, effects[name], own, record)
    assert np.ptp(added, axis=0).max() > 0.05
    np.testing.assert_allclose(truth.wrench, without + added, atol=2e-4)
