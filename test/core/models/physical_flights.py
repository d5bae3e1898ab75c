# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights of the physical model itself, flown by a small controller: their parameters are known."""

from __future__ import annotations

import numpy as np

from quadpi_core.flight import AXES
from quadpi_core.frames import Array, from_rotation_vector, matrix, product
from quadpi_core.inputs import DERIVATIVES, aerodynamic_inputs
from quadpi_core.models.fitted_physical import FittedPhysical, PhysicalAxis, PhysicalFit
from quadpi_core.models.interval_rules import NormalRule
from quadpi_core.models.model_kind import TrainingSamples
from quadpi_core.models.physical_fit import FitStep, PhysicalFlight, Sensing
from quadpi_core.models.physical_terms import (
    MOTION,
    TERM_INDEX,
    TERM_NAMES,
    TERMS,
    acting_terms,
    physical_vehicle,
    scales,
    wrenches,
)
from quadpi_core.records import Records
from quadpi_core.vehicle import Vehicle

VEHICLE = Vehicle.load("neurobem")
REFERENCE = 1.55e-6
STEP_S = 0.01
NOISE = np.array([0.05, 0.05, 0.1, 0.005, 0.005, 0.002])


def known_parameters() -> Array:
    """Parameters (P,) of a plausible vehicle."""
    share = {
        "thrust": 1.3,
        "thrust_axial": 1.0,
        "thrust_induced": 2.0,
        "torque": 0.2,
        "rotor_drag": 1.0,
        "hub_height": -0.5,
        "drag_x": 1.0,
        "drag_y": 1.5,
        "drag_z": 1.0,
        "damping_r": 3.0,
        "thrust_in_plane": 1.0,
    }
    values = np.zeros(len(TERMS))
    scale = scales(VEHICLE, REFERENCE)
    for name, size in share.items():
        values[TERM_INDEX[name]] = size * scale[TERM_INDEX[name]]
    return values


def flown(
    seconds: float, seed: int, *, speed: float = 4.0, noise: float = 1.0, values: Array | None = None
) -> PhysicalFlight:
    """A flight along random smooth velocities, by the midpoint rule; its measured wrench has noise.

    Args:
        seconds: duration.
        seed: of velocities and noise.
        speed: m/s of the wanted velocity, 0 for hover.
        noise: in units of NOISE.
        values: parameters, else those of `known_parameters`.
    """
    values = known_parameters() if values is None else values
    rng = np.random.default_rng(seed)
    count = round(seconds / STEP_S)
    vehicle = physical_vehicle(VEHICLE, REFERENCE)
    motion = np.zeros(count, MOTION)
    wrench = np.zeros((count, 6))
    attitude, velocity, rates = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3)
    speeds = np.full(4, np.sqrt(VEHICLE.mass_kg * VEHICLE.gravity_m_s2 / 4 / REFERENCE))
    frequencies, phases = rng.uniform(0.5, 2.5, (3, 3)), rng.uniform(0, 2 * np.pi, (3, 3))
    turning, turning_phase = rng.uniform(0.2, 1.0), rng.uniform(0, 2 * np.pi)
    x, y = VEHICLE.rotor_positions[:, 0], VEHICLE.rotor_positions[:, 1]
    mixing = np.linalg.inv(REFERENCE * np.stack([np.ones(4), -y, x, -0.013 * VEHICLE.rotor_spins]))
    now = np.zeros(1, MOTION)
    for k in range(count):
        t = k * STEP_S
        wanted = speed * np.sin(frequencies * t + phases).mean(axis=1) * np.array([1.0, 1.0, 0.5])
        rotation = matrix(attitude)
        push = 3.0 * (wanted - velocity) - np.array([0.0, 0.0, VEHICLE.gravity_m_s2])
        down = -push / np.linalg.norm(push)
        tilt = rotation.T @ np.cross(rotation[:, 2], down)
        spin = min(speed, 1.0) * np.sin(turning * t + turning_phase)
        wanted_rates = np.array([8.0 * tilt[0], 8.0 * tilt[1], spin])
        moment = VEHICLE.inertia @ (20.0 * (wanted_rates - rates)) + 1e-3 * rng.normal(size=3) * min(speed, 1)
        thrust = VEHICLE.mass_kg * max(-float(push @ rotation[:, 2]), 2.0)
        squares = np.clip(mixing @ np.array([thrust, *moment]), 300.0**2, 2500.0**2)
        before = speeds
        speeds = speeds + 0.5 * (np.sqrt(squares) - speeds)
        now["velocity"], now["rates"], now["rotor_speeds"] = rotation.T @ velocity, rates, speeds
        now["rotor_accelerations"] = (speeds - before) / STEP_S
        motion[k] = now[0]
        wrench[k] = wrenches(now, vehicle, values)[0]
        acceleration = rotation @ wrench[k, :3] / VEHICLE.mass_kg + np.array([0, 0, VEHICLE.gravity_m_s2])
        gyroscopic = np.cross(rates, VEHICLE.inertia @ rates)
        angular = np.linalg.solve(VEHICLE.inertia, wrench[k, 3:] - gyroscopic)
        motion[k]["angular_acceleration"] = angular
        half = rates + 0.5 * STEP_S * angular
        velocity = velocity + STEP_S * acceleration
        attitude = np.array(product(attitude, from_rotation_vector(STEP_S * half)))
        rates = rates + STEP_S * angular
    wrench += noise * NOISE * rng.normal(size=wrench.shape)
    jerks = np.gradient(motion["rotor_accelerations"], STEP_S, axis=0)
    return PhysicalFlight(f"flight_{seed}", STEP_S * np.arange(count), motion, jerks, wrench)


def swept(
    seconds: float, seed: int, *, delay_s: float = 0.0, noise: float = 1.0, fastest_hz: float = 8.0
) -> PhysicalFlight:
    """Samples of sines without any dynamics, whose derivatives are exact; rotor speeds act after a delay.

    Args:
        seconds: duration.
        seed: of the sines and the noise.
        delay_s: of the rotor speeds.
        noise: of the wrench, in units of NOISE.
        fastest_hz: of the sines.
    """
    rng = np.random.default_rng(seed)
    time = STEP_S * np.arange(round(seconds / STEP_S))
    omega, phase = 2.0 * np.pi * rng.uniform(0.3, fastest_hz, (10, 6)), rng.uniform(0.0, 2.0 * np.pi, (10, 6))

    def sines(at: Array, derivative: int) -> Array:
        angles = at[:, np.newaxis, np.newaxis] * omega + phase + 0.5 * np.pi * derivative
        return np.sum(omega**derivative * np.sin(angles), axis=2)

    def motion(at: Array) -> Records:
        now = np.zeros(len(at), MOTION)
        value, slope = sines(at, 0), sines(at, 1)
        now["velocity"], now["rates"] = value[:, :3], 0.5 * value[:, 3:6]
        now["angular_acceleration"] = 0.5 * slope[:, 3:6]
        now["rotor_speeds"] = 1300.0 + 60.0 * value[:, 6:]
        now["rotor_accelerations"] = 60.0 * slope[:, 6:]
        return now

    measured, acting = motion(time), motion(time)
    late = motion(time - delay_s)
    for name in ("rotor_speeds", "rotor_accelerations"):
        acting[name] = late[name]
    values = known_parameters()
    values[TERM_INDEX["rotor_inertia_spin"]] = 1e-6
    wrench = wrenches(acting, physical_vehicle(VEHICLE, REFERENCE), values)
    wrench += noise * NOISE * rng.normal(size=wrench.shape)
    return PhysicalFlight(f"swept_{seed}", time, measured, 60.0 * sines(time, 2)[:, 6:], wrench)


def inputs_of(flight: PhysicalFlight) -> Array:
    """Input vectors (N, 19) of a flight, level: the physical model does not go by its attitude."""
    level = np.tile([1.0, 0.0, 0.0, 0.0], (len(flight.time), 1))
    columns = (flight.motion[name] for name in ("velocity", "rates", "rotor_speeds"))
    velocity, rates, speeds = (np.ascontiguousarray(column) for column in columns)
    return aerodynamic_inputs(velocity, level, rates, speeds, VEHICLE)


def derivatives_of(flight: PhysicalFlight) -> Records:
    """Derivatives (N,) of a flight."""
    derivatives = np.zeros(len(flight.time), DERIVATIVES)
    for name in ("angular_acceleration", "rotor_accelerations"):
        derivatives[name] = flight.motion[name]
    derivatives["rotor_jerks"] = flight.rotor_jerks
    return derivatives


def samples_of(flights: list[PhysicalFlight]) -> TrainingSamples:
    """What a kind of model is fitted to."""
    return TrainingSamples(
        VEHICLE,
        np.concatenate([flight.time for flight in flights]),
        np.concatenate([inputs_of(flight) for flight in flights]),
        np.concatenate([derivatives_of(flight) for flight in flights]),
        np.concatenate([flight.wrench for flight in flights]),
        np.repeat(np.arange(len(flights)), [len(flight.time) for flight in flights]),
        [flight.name for flight in flights],
    )


def fitted_physical(*axes: str, delay_s: float = 0.0, **values: float) -> FittedPhysical:
    """Axes of the known model, whose terms all have the same leverage."""
    parameters = known_parameters()
    for name, value in values.items():
        parameters[TERM_INDEX[name]] = value
    shared = PhysicalFit(
        parameters,
        np.eye(len(TERMS)),
        physical_vehicle(VEHICLE, REFERENCE),
        VEHICLE.inertia,
        Sensing(delay_s),
        None,
        {"drag_x": "not identified"},
        (FitStep("rotor delay", "0 ms", 1.0),),
    )
    own = {}
    for axis in axes:
        acting = tuple(TERM_NAMES[k] for k in np.flatnonzero(acting_terms()[:, AXES.index(axis)]))
        own[axis] = PhysicalAxis(acting, 1e-6 * np.eye(len(acting)), 1.0, 0.01, NormalRule(), 1.0)
    return FittedPhysical(own, shared)
