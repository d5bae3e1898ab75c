# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Open-loop roll-outs: from measured states on, how far do simulation and flight drift apart?

A rigid body starts at the measured state of many instants and moves by the simulated wrench of the rotor
speeds that were measured; nothing corrects it. What is left of the error with the measured wrench itself is
that of sensors and estimator: no simulation comes below it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.simulations import Simulation
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.rotations import rotate_body_to_world, rotate_world_to_body
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.vehicle import Vehicle

HORIZON_S = 0.5
# Between starts: the errors of neighbours are then about independent.
EVERY_S = 0.25
STEP_HZ = 100.0


class RolloutError(NamedTuple):
    """Root-mean-square errors at the horizon, over all starts.

    Attributes:
        velocity_m_s: over ground.
        attitude_deg: angle of rotation.
        rates_rad_s: of the body.
        starts: number of roll-outs.
    """

    velocity_m_s: float
    attitude_deg: float
    rates_rad_s: float
    starts: int


class _Motion(NamedTuple):
    """State (K, ·) of K bodies; velocity [m/s] and position [m] in the world."""

    position: Array
    velocity: Array
    attitude: Array
    rates: Array

    def moved(self, slope: _Motion, step: float) -> _Motion:
        position, velocity, attitude, rates = (
            value + step * change for value, change in zip(self, slope, strict=True)
        )
        return _Motion(position, velocity, attitude / np.linalg.norm(attitude, axis=1, keepdims=True), rates)


# Wrench (K, 6) of K bodies, each at a time [s] of the flight of its own.
_Wrench: TypeAlias = Callable[[Array, _Motion], Array]


def rollout(flight: Flight, simulation: Simulation, horizon_s: float = HORIZON_S) -> RolloutError:
    """Roll a simulation out from many instants of a flight.

    Effects on sensors are taken out of the flight first, as the simulation knows them.

    Raises:
        DiscrepancyError: for a flight shorter than the horizon.
    """
    if isinstance(simulation, AugmentedSimulation):
        flight, simulation = simulation.corrected(flight), simulation.physical
    return _rolled_out(flight, simulation.vehicle, _simulated(flight, simulation), horizon_s)


def rollout_floor(flight: Flight, vehicle: Vehicle, horizon_s: float = HORIZON_S) -> RolloutError:
    """Roll the measured wrench of a flight out: what is left is no fault of a simulation.

    Raises:
        DiscrepancyError: for a flight shorter than the horizon.
    """
    measured = measured_wrench(flight, vehicle)

    def wrench(time: Array, _: _Motion) -> Array:
        return _at(flight.time, measured, time)

    return _rolled_out(flight, vehicle, wrench, horizon_s)


def _simulated(flight: Flight, simulation: Simulation) -> _Wrench:
    """The wrench of a simulation for bodies in states of their own, with rotor speeds and wind of the flight.

    Each is asked for at three instants, so that what depends on how fast rotors change has its differences:
    over a whole step, which add up to the change of the speeds.
    """
    step = 0.5 / STEP_HZ

    def wrench(time: Array, motion: _Motion) -> Array:
        instants = (time[:, None] + step * np.array([-1.0, 0.0, 1.0])).ravel()
        at = [np.repeat(values, 3, axis=0) for values in motion]
        position, velocity, attitude, rates = at
        none = np.zeros((len(instants), 3))
        asked = replace(
            flight,
            time=instants,
            position=position,
            attitude=attitude,
            velocity=rotate_world_to_body(attitude, velocity),
            rates=rates,
            angular_acceleration=none,
            specific_force=none,
            rotor_speeds=_at(flight.time, flight.rotor_speeds, instants),
            wind=_at(flight.time, flight.wind, instants),
        )
        return simulation.wrench(asked)[1::3]

    return wrench


def _rolled_out(flight: Flight, vehicle: Vehicle, wrench: _Wrench, horizon_s: float) -> RolloutError:
    first, last = flight.time[0], flight.time[-1] - horizon_s
    if last <= first:
        raise DiscrepancyError(f"{flight.source}: shorter than the {horizon_s:g} s of a roll-out")
    time = np.arange(first, last, EVERY_S)
    motion = _measured(flight, time)
    steps = max(1, round(horizon_s * STEP_HZ))
    step = horizon_s / steps
    for _ in range(steps):
        slope = _slope(vehicle, wrench(time, motion), motion)
        halfway = motion.moved(slope, 0.5 * step)
        slope = _slope(vehicle, wrench(time + 0.5 * step, halfway), halfway)
        motion = motion.moved(slope, step)
        time = time + step
    true = _measured(flight, time)
    cosine = np.abs(np.sum(motion.attitude * true.attitude, axis=1)).clip(max=1.0)
    return RolloutError(
        velocity_m_s=_rms(motion.velocity - true.velocity),
        attitude_deg=float(np.degrees(np.sqrt(np.mean(np.square(2.0 * np.arccos(cosine)))))),
        rates_rad_s=_rms(motion.rates - true.rates),
        starts=len(time),
    )


def _measured(flight: Flight, time: Array) -> _Motion:
    velocity = rotate_body_to_world(flight.attitude, flight.velocity)
    attitude = _at(flight.time, flight.attitude, time)
    return _Motion(
        _at(flight.time, flight.position, time),
        _at(flight.time, velocity, time),
        attitude / np.linalg.norm(attitude, axis=1, keepdims=True),
        _at(flight.time, flight.rates, time),
    )


def _slope(vehicle: Vehicle, wrench: Array, motion: _Motion) -> _Motion:
    """Equations of motion: v̇ = R F/m + g, I Ω̇ = M − Ω × IΩ, q̇ = ½ q (0, Ω)."""
    acceleration = rotate_body_to_world(motion.attitude, wrench[:, :3] / vehicle.mass_kg)
    acceleration[:, 2] += vehicle.gravity_m_s2
    moment = wrench[:, 3:] - np.cross(motion.rates, motion.rates @ vehicle.inertia)
    w, x, y, z = motion.attitude.T
    p, q, r = motion.rates.T
    turning = np.stack(
        (-x * p - y * q - z * r, w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p), axis=1
    )
    return _Motion(motion.velocity, acceleration, 0.5 * turning, moment @ np.linalg.inv(vehicle.inertia).T)


def _at(time: Array, values: Array, wanted: Array) -> Array:
    """Values (N, C) at times (M,), linear between samples."""
    return np.stack([np.interp(wanted, time, column) for column in values.T], axis=1)


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))
