# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of rotor speeds that are made of motor commands, as noise of a search, and what they hide.

Nothing measured these speeds: each flight has a gain of all of them, one of each rotor and a lag of its own,
known as well as motors predicted flights that they were not identified on. Motors that are known by thrust
alone, and of no other flights than those searched, take their scale from them: what scales all thrust
(a mass, a thrust coefficient) is then in the speeds already.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.simulations import Simulation
from quadpi_core.discrepancy.whitening import Columns, OfEachFlight
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.applied_effects import EFFECTS
from quadpi_core.vehicle import Motors, Vehicle

GAIN_LEAST = Threshold(
    "least standard deviation of the gain of all rotor speeds from commands",
    0.005,
    "share",
    "another pack on another day; flights of one afternoon differ by less",
    "imrc_payload of ../shared/data by the motors of imrc_brushless",
)
ROTORS_DIFFER = Threshold(
    "standard deviation of the speed of a rotor at the command of the others, where no tachometer told it",
    0.03,
    "share",
    "motors of one kind differ; motors known by thrust alone are taken as alike",
    "motors of imrc_brushed of ../shared/data by their tachometers",
)
LAG_ERROR = Threshold(
    "standard deviation of the lag of rotor speeds from commands",
    0.15,
    "of the lag",
    "a first-order lag is a simplification: rotors spool up faster than down",
    CONVENTION,
)
# Thrust goes with the square of speed but for what airspeed adds: steps in which the scale converges.
_SCALE_STEPS = 4
# Of a scale that only the searched flights tell: larger than any effect.
_UNKNOWN_SCALE = 0.5
# Steps of the differences: 1 % of speed, 2 ms of lag.
_SHARE, _LATE_S = 0.01, 0.002


def at_scale_of(simulation: Simulation, flights: Sequence[Flight]) -> list[Flight]:
    """The flights with rotor speeds of an assumed scale brought to that of a simulation, all by one factor.

    With it the simulated thrust along the body is on average the measured one.
    """

    def is_assumed(flight: Flight) -> bool:
        return flight.motors is not None and not scale_is_known(flight.motors, simulation.vehicle)

    assumed, gain = [own for own in flights if is_assumed(own)], 1.0
    if not assumed or simulation.own_inputs:
        return list(flights)
    measured = sum(float(measured_wrench(own, simulation.vehicle)[:, 2].sum()) for own in assumed)
    for _ in range(_SCALE_STEPS):
        scaled = [replace(own, rotor_speeds=gain * own.rotor_speeds) for own in assumed]
        simulated = sum(float(simulation.wrench(own)[:, 2].sum()) for own in scaled)
        if simulated * measured <= 0.0:
            return list(flights)
        gain *= float(np.sqrt(measured / simulated))
    return [replace(own, rotor_speeds=gain * own.rotor_speeds) if is_assumed(own) else own for own in flights]


def errors_of_speeds(flights: Sequence[Compared]) -> tuple[OfEachFlight, ...]:
    """What flights have of their own as their rotor speeds are of commands; empty where all are measured."""
    if all(own.flight.motors is None for own in flights):
        return ()
    vehicle = flights[0].simulation.vehicle
    columns = Columns(tuple(own.spectrum(_columns(own)) for own in flights))
    each = [np.diag(deviations(own.flight.motors, vehicle, len(flights))) for own in flights]
    return (OfEachFlight(columns, np.stack(each)),)


def _columns(flight: Compared) -> Array:
    """What a gain of all speeds, one of each rotor (by 1) and a lag [s] add to the residual (M, 6, K)."""
    scale, delay = EFFECTS["rotor_speed_scale"], EFFECTS["sensor_delay"]
    rotors = range(flight.flight.rotor_speeds.shape[1] + 1)
    gains = [flight.added(scale, np.array([rotor, _SHARE])) / _SHARE for rotor in rotors]
    return np.stack([*gains, flight.added(delay, np.array([_LATE_S, 0.0])) / _LATE_S], axis=2)


def deviations(motors: Motors | None, vehicle: Vehicle, flights: int) -> Array:
    """Standard deviations (K,) of these of one of several flights; what flights share is in each of them."""
    rotors = vehicle.rotor_count
    if motors is None:
        return np.zeros(rotors + 2)
    gain, own, lag_s = max(motors.gain, GAIN_LEAST.value), np.zeros(rotors), LAG_ERROR.value * motors.lag_s
    # As many deviations as flights: their mean then deviates by as much as what they share.
    shared = np.sqrt(flights)
    own = np.array(motors.error) if motors.error else np.full(rotors, shared * ROTORS_DIFFER.value)
    if not scale_is_known(motors, vehicle):
        gain = np.hypot(gain, shared * _UNKNOWN_SCALE)
    return np.concatenate(([gain], own, [lag_s]))


def scale_is_known(motors: Motors, vehicle: Vehicle) -> bool:
    """Whether tachometers, or other flights than those searched, tell the scale of the speeds."""
    return bool(motors.error) or motors == vehicle.motors
