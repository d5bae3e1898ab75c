# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speed from command without any tachometer: by the thrust that the accelerometer measures.

    m · (−a_z) = k Σ n_i²,      n_i = c · (1, u_i, u_i², V, u_i V) behind a first-order lag,

the same c for all rotors, as their sum does not tell them apart; where the velocity is known, without what
climbing takes from thrust and speed adds. Speeds are known up to a scale, which the thrust coefficient of the
vehicle file gives, or a usual one: a model that is identified on them has it in its own.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from quadpi_core.field.airborne import Flown, velocity_of
from quadpi_core.field.field_log import FieldLog
from quadpi_core.field.motor_model import GRID_HZ, LAGS_S, SLOWEST_HZ, command_columns
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.vehicle import TERMS, USUAL_GAIN, Motors, Vehicle

# Of C_T = T / (ρ π R⁴ ω²); propellers from 23 to 130 mm radius have 0.01 to 0.035.
_USUAL_THRUST_COEFFICIENT = 0.02
# Share of the vehicle's largest rotor speed that the fastest commanded one has at most.
_FASTEST = 0.9
_STEPS, _SHORTEST_S = 8, 5.0
# Weight of a motor whose speed is in proportion to command and voltage, which the quadratic is drawn to:
# hover alone tells no slope. Set on seven flights of imrc_brushless, whose tachometers tell 2.24 (2.15 here).
_RIDGE = 1e-3
# Commands (N, R), volts (N, 1) or (N, 0), thrust (N,) N, and what motion does to it (N, 2) or (N, 0).
_Part = tuple[Array, Array, Array, Array]


def motors_by_thrust(
    flights: Sequence[tuple[FieldLog, Flown]], source: str, vehicle: Vehicle
) -> tuple[Motors, dict[str, Motors]] | str:
    """The motors of a vehicle, and by the source of each flight those by the others; or why there is none."""
    told = [(log, _parts(log, flight, vehicle)) for log, flight in flights]
    usable = [(log, parts) for log, parts in told if not isinstance(parts, str)]
    if not usable:
        return str(told[0][1])
    volts = all(log.battery is not None for log, _ in usable)
    moves = all(log.attitude is not None and velocity_of(log) is not None for log, _ in usable)
    known = {
        log.source: [
            (u, v if volts else v[:, :0], thrust, moved if moves else moved[:, :0])
            for u, v, thrust, moved in parts
        ]
        for log, parts in usable
    }
    everything = [part for parts in known.values() for part in parts]
    fits = {lag: _fitted(everything, lag, vehicle) for lag in LAGS_S}
    lag_s = min(LAGS_S, key=lambda lag: fits[lag][1])
    mean_v = float(np.mean(np.concatenate([part[1] for part in everything]))) if volts else 1.0
    scale = _scale(everything, fits[lag_s][0], vehicle)

    def motors(coefficients: Array) -> Motors:
        own = tuple((scale * coefficients).tolist()) + (0.0,) * (TERMS - len(coefficients))
        of_all = (own,) * vehicle.rotor_count
        return Motors(source=source, coefficients=of_all, lag_s=lag_s, volts=mean_v, gain=gain)

    without = {}
    for name in known if len(known) > 1 else ():
        others = [part for other, parts in known.items() if other != name for part in parts]
        without[name] = _fitted(others, lag_s, vehicle)[0]
    gains = [_gain(parts, without[name], lag_s) for name, parts in known.items() if name in without]
    gain = float(np.sqrt(np.mean(np.square(np.array(gains) - 1.0)))) if gains else USUAL_GAIN.value
    return motors(fits[lag_s][0]), {name: motors(coefficients) for name, coefficients in without.items()}


def _parts(log: FieldLog, flight: Flown, vehicle: Vehicle) -> list[_Part] | str:
    if log.commands is None or log.imu is None:
        return "the log has not both commands and accelerometer"
    if log.commands.values.shape[1] != vehicle.rotor_count:
        return f"the log has {log.commands.values.shape[1]} commands for {vehicle.rotor_count} rotors"
    if min(log.commands.rate_hz, log.imu.rate_hz) < SLOWEST_HZ:
        slow = "commands" if log.commands.rate_hz < SLOWEST_HZ else "IMU"
        return f"{slow} at {getattr(log, slow.lower()).rate_hz:.0f} Hz, {SLOWEST_HZ:g} Hz are needed"
    parts, velocity = [], velocity_of(log)
    for one in flight.stretches:
        edges = np.arange(one.begin, one.end, 1.0 / GRID_HZ)
        time = 0.5 * (edges[1:] + edges[:-1])
        u, imu = log.commands.filled_means(edges), log.imu.filled_means(edges)
        v = np.empty((len(time), 0)) if log.battery is None else log.battery.at(time)
        moved = np.empty((len(time), 0))
        if velocity is not None and log.attitude is not None:
            of_body = rotate_world_to_body(log.attitude.at(time), velocity.at(time))
            moved = np.stack([of_body[:, 2], of_body[:, 0] ** 2 + of_body[:, 1] ** 2], axis=1)
        good = np.isfinite(np.hstack([u, imu, v, moved])).all(axis=1)
        if np.sum(good) >= _SHORTEST_S * GRID_HZ:
            parts.append((u[good], v[good], -vehicle.mass_kg * imu[good, 5], moved[good]))
    return parts or "the flight is too short"


def _fitted(parts: Sequence[_Part], lag_s: float, vehicle: Vehicle) -> tuple[Array, float]:
    """Coefficients with k = 1, in √N, and the sum of squared errors of thrust, N²."""
    rotors = vehicle.rotor_count
    columns = np.concatenate(
        [
            np.stack([command_columns(part[0][:, rotor], part[1], lag_s) for rotor in range(rotors)], axis=1)
            for part in parts
        ]
    )  # (N, R, P)
    thrust = np.concatenate([part[2] for part in parts])
    hover = np.sqrt(max(float(np.mean(thrust)), 1e-6) / rotors)
    moved = np.concatenate([part[3] for part in parts]) * np.mean(thrust)
    terms, scale = columns.shape[2], np.maximum(np.sqrt(np.mean(columns**2, axis=(0, 1))), 1e-9)
    begin = np.zeros(terms + moved.shape[1])
    last = terms - 1 if terms == TERMS else 1
    begin[last] = hover / max(float(np.mean(columns[:, :, last])), 1e-6)
    ridge = np.full(len(begin), 1e-9)
    ridge[:terms] = _RIDGE * len(thrust) * hover**2 * scale**2
    found = begin
    for _ in range(_STEPS):
        speeds = columns @ found[:terms]
        slopes = np.hstack([2.0 * np.einsum("nr,nrp->np", speeds, columns), moved])
        lacking = thrust - np.sum(speeds**2, axis=1) - moved @ found[terms:]
        gram = slopes.T @ slopes + np.diag(ridge)
        found = found + np.linalg.solve(gram, slopes.T @ lacking + ridge * (begin - found))
    left = thrust - np.sum((columns @ found[:terms]) ** 2, axis=1) - moved @ found[terms:]
    return found[:terms], float(np.sum(left**2))


def _gain(parts: Sequence[_Part], coefficients: Array, lag_s: float) -> float:
    """By which one factor the rotors of a flight turn faster than coefficients tell, by its thrust."""
    told = thrust = 0.0
    for commands, volts, own, _ in parts:
        for rotor in range(commands.shape[1]):
            speeds = command_columns(commands[:, rotor], volts, lag_s) @ coefficients
            told += float(np.sum(speeds**2))
        thrust += float(np.sum(own))
    return float(np.sqrt(max(thrust, 0.0) / max(told, 1e-9)))


def _scale(parts: Sequence[_Part], coefficients: Array, vehicle: Vehicle) -> float:
    """Rotor speed [rad/s] for a square root of thrust [√N]."""
    known = vehicle.thrust_coefficient or _USUAL_THRUST_COEFFICIENT
    k = known * vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**4
    fastest = max(
        float(np.max(command_columns(part[0][:, rotor], part[1], 0.0) @ coefficients))
        for part in parts
        for rotor in range(vehicle.rotor_count)
    )
    return float(min(1.0 / np.sqrt(k), _FASTEST * vehicle.rotor_speed_max_rad_s / max(fastest, 1e-9)))
