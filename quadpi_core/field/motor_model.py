# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speed from command and battery voltage, and what that says of the tachometers.

    n = c · (1, u, u², V, u V),      followed by a first-order lag and a dead time,

of each rotor, by least squares on some flights and judged on others. A rotor whose tachometer reads another
multiple of what its command gives than the others' do is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.signal import lfilter

from quadpi_core.field.airborne import Flown, velocity_of
from quadpi_core.field.estimates import CONFIDENCE, Estimate, beyond_zero, jackknife
from quadpi_core.field.field_log import FieldLog
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.records import Threshold
from quadpi_core.rotor_order import lag_weights
from quadpi_core.vehicle import HALF_READING, TERMS, USUAL_GAIN, Motors, Vehicle

GRID_HZ = 100.0
ORDER = Threshold(
    "correlation of changes of speed with another command at least, with its own at most, in a wrong order",
    (0.6, 0.4),
    "",
    "changes over 0.2 s of sound flights have 0.77 or more with their own, 0.22 or less with others",
    "one flight each of imrc_brushless, imrc_brushed and indiflight in ../shared/data",
)
# Samples of the grid that changes are summed over: longer than the lag of motors.
_LAGGED = 20
SLOWEST_HZ = 20.0
LAGS_S = (0.0, 0.01, 0.02, 0.025, 0.03, 0.035, 0.04, 0.05, 0.06, 0.07, 0.08, 0.1, 0.12, 0.15, 0.2)
_DEAD_S = (0.0, 0.004, 0.008, 0.012, 0.016, 0.02, 0.03)
# Flights on which lag and dead time are chosen.
_CHOSEN_ON = 3
# As many fits, each without its share of the flights.
_FOLDS_MOST = 5
# Weight of the curve that the motors have in common: few flights at few voltages do not tell those of each.
# 1e-4 to 1e-2 lower the errors of imrc_brushed alike, where it was set; imrc_brushless does not mind.
_ALIKE, _GAIN_STEPS = 1e-3, 5
# Pieces of flight that are left out for the interval of the lag.
_PIECE_S = 10.0
_Part = tuple[Array, Array, Array]  # commands (N, R), volts (N, 1) or (N, 0), speeds (N, R)


@dataclass(frozen=True)
class MotorModel:
    """Motors of one vehicle.

    Attributes:
        error: root mean square on what was left out, over the mean speed, all rotors together.
        error_scaled: the same after one gain for each flight, as a battery that is not logged asks for.
        by_rotor: `error` of each rotor.
        width: half of an interval of 95 %, by what others left out err, over the mean speed.
        coverage: share of what was left out inside; uncalibrated where `flights` is 1.
        lag: of the first order, s, with its interval; not identified at the ends of the grid.
        dead_s: before it, transport and the filter of the tachometer together; None at the end of its grid.
        with_battery: whether voltage is in it.
        flights: number; each fifth of them is judged by a fit on the others, of a single flight each half.
    """

    error: float
    error_scaled: float
    by_rotor: tuple[float, ...]
    width: float
    coverage: float
    lag: Estimate
    dead_s: float | None
    with_battery: bool
    flights: int


@dataclass(frozen=True)
class Tachometers:
    """Rotor speeds of one flight against its commands.

    Attributes:
        gain: speed over command of the middle rotor, rad/s.
        ratio: (R) speed of each rotor over that of the others at the same command.
        odd: rotors, from 1, whose tachometers read another multiple.
        order: of each rotor speed the command, from 1, that it follows; empty where that is its own.
    """

    gain: float
    ratio: tuple[float, ...]
    odd: tuple[int, ...]
    order: tuple[int, ...] = ()


def tachometers(log: FieldLog, flight: Flown) -> Tachometers | str:
    """Whether the tachometers of one flight read what the commands give, or why it cannot be told."""
    parts = _parts(log, flight)
    if isinstance(parts, str):
        return parts
    commands, speeds = (np.vstack([part[place] for part in parts]) for place in (0, 2))
    if speeds.shape[1] < 2:
        return "one rotor has none beside it"
    # Around hover speed grows about linearly with command, the same for motors of one kind.
    gains = np.median(speeds / np.maximum(commands, 1e-6), axis=0)
    ratios = [gains[rotor] / max(np.median(np.delete(gains, rotor)), 1e-9) for rotor in range(len(gains))]
    low, high = HALF_READING.value
    odd = tuple(rotor + 1 for rotor, ratio in enumerate(ratios) if not low < ratio < high)
    return Tachometers(float(np.median(gains)), tuple(map(float, ratios)), odd, _order(commands, speeds))


def _order(commands: Array, speeds: Array) -> tuple[int, ...]:
    """Which command each rotor follows, where that is clearly another's; empty else."""
    whole = len(speeds) // _LAGGED * _LAGGED
    if whole < 10 * _LAGGED:
        return ()
    # Means over a lag of the motors, less what all have in common, which manoeuvres move together.
    count = speeds.shape[1]
    means = [own[:whole].reshape(-1, _LAGGED, count).mean(axis=1) for own in (speeds, commands)]
    own, told = (np.diff(values - values.mean(axis=1, keepdims=True), axis=0) for values in means)
    if not (np.ptp(own, axis=0).all() and np.ptp(told, axis=0).all()):
        return ()
    alike = np.corrcoef(own.T, told.T)[:count, count:]
    rotors, follows = linear_sum_assignment(-alike)
    wrong, (sure, most) = rotors != follows, ORDER.value
    if alike[rotors, follows].min() < sure or np.diag(alike)[wrong].max(initial=-1.0) > most:
        return ()
    return tuple(int(one) + 1 for one in follows) if np.any(wrong) else ()


def motor_model(flights: Sequence[tuple[FieldLog, Flown]]) -> MotorModel | str:
    """The motors of one vehicle, or why they cannot be told."""
    fit = _Fit.from_flights(flights)
    if isinstance(fit, str):
        return fit
    by_rotor, scaled, width, coverage = fit.errors()
    return MotorModel(
        error=float(np.sqrt(np.mean(by_rotor**2))),
        error_scaled=scaled,
        by_rotor=tuple(map(float, by_rotor)),
        width=width,
        coverage=coverage,
        lag=fit.lag,
        dead_s=fit.dead_s if fit.dead_s < _DEAD_S[-1] else None,
        with_battery=fit.volts,
        flights=len(fit.known),
    )


def identified_motors(
    flights: Sequence[tuple[FieldLog, Flown]], source: str
) -> tuple[Motors, dict[str, Motors]] | str:
    """The motors of a vehicle by flights with rotor speeds; and by the source of each, those by the others.

    A model that is judged on flights left out has to meet the errors of motors that do not know them.

    Args:
        flights: at least one.
        source: of the commands.
    """
    fit = _Fit.from_flights(flights)
    if isinstance(fit, str):
        return fit
    errors = tuple(map(float, fit.errors()[0]))
    sums = [_sums(parts, fit.lag_s) for parts in fit.known]
    volts = [part[1] for parts in fit.known for part in parts]
    mean_v = float(np.mean(np.concatenate(volts))) if fit.volts else 1.0

    def motors(coefficients: Sequence[Array]) -> Motors:
        return Motors(
            source=source,
            coefficients=tuple(tuple(own.tolist()) + (0.0,) * (TERMS - len(own)) for own in coefficients),
            lag_s=fit.lag_s,
            dead_s=fit.dead_s,
            volts=mean_v,
            error=errors,
            gain=gain,
        )

    places = range(len(sums)) if len(sums) > 1 else ()
    without = [_solved([*sums[:place], *sums[place + 1 :]]) for place in places]
    gains = [_gain(*_told(fits, fit.known[place], fit.lag_s)) for place, fits in enumerate(without)]
    gain = float(np.sqrt(np.mean(np.square(np.array(gains) - 1.0)))) if gains else USUAL_GAIN.value
    return motors(_solved(sums)), {fit.names[place]: motors(fits) for place, fits in enumerate(without)}


@dataclass(frozen=True)
class _Fit:
    """Flights on a grid, and the lag and dead time that fit them best."""

    names: list[str]
    known: list[list[_Part]]
    lag: Estimate
    lag_s: float
    dead_s: float
    volts: bool

    @classmethod
    def from_flights(cls, flights: Sequence[tuple[FieldLog, Flown]]) -> _Fit | str:
        """Of the flights that tell."""
        usable = [(log, flight) for log, flight in flights if not isinstance(_parts(log, flight), str)]
        if not usable:
            return str(_parts(*flights[0]))
        volts = all(log.battery is not None for log, _ in usable)
        lag, lag_s, dead_s = _lag_and_dead_time(
            usable[:: max(1, len(usable) // _CHOSEN_ON)], with_battery=volts
        )
        known = [_known(log, flight, dead_s, with_battery=volts) for log, flight in usable]
        return cls([log.source for log, _ in usable], known, lag, lag_s, dead_s, volts)

    def errors(self) -> tuple[Array, float, float, float]:
        """RMS of what is left out over the mean speed: by rotor (R,), and after a gain of each flight.

        Also the half width of an interval by what the other folds err, and the share inside.
        """
        if len(self.known) == 1:
            folds = [[[_parted(part, 2)[which] for part in self.known[0]]] for which in (0, 1)]
        else:
            folds = [self.known[first::_FOLDS_MOST] for first in range(min(len(self.known), _FOLDS_MOST))]
        sums = [[_sums(parts, self.lag_s) for parts in fold] for fold in folds]
        told = []
        for one, fold in enumerate(folds):
            fit = _solved([own for other in (*sums[:one], *sums[one + 1 :]) for own in other])
            told.append([_told(fit, parts, self.lag_s) for parts in fold])
        mean = float(np.mean(np.concatenate([speeds for own in told for _, speeds in own])))
        left = [np.concatenate([speeds - own for own, speeds in fold]) / mean for fold in told]
        scaled = [speeds - _gain(own, speeds) * own for fold in told for own, speeds in fold]
        widths = [
            float(np.quantile(abs(np.concatenate([*left[:one], *left[one + 1 :]])), CONFIDENCE.value))
            for one in range(len(left))
        ]
        inside = np.concatenate([abs(own) <= width for own, width in zip(left, widths, strict=True)])
        by_rotor = np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0))
        after = float(np.sqrt(np.mean(np.concatenate(scaled) ** 2)) / mean)
        return by_rotor, after, max(widths), float(inside.mean())


def _lag_and_dead_time(
    flights: Sequence[tuple[FieldLog, Flown]], *, with_battery: bool
) -> tuple[Estimate, float, float]:
    """Those of the grid that leave the smallest error; the lag with its interval, finer than the grid."""
    curves = {}
    for dead in _DEAD_S:
        parts = [part for own in flights for part in _known(*own, dead, with_battery=with_battery)]
        pieces = [
            piece
            for part in parts
            for piece in _parted(part, max(1, round(len(part[0]) / (_PIECE_S * GRID_HZ))))
        ]
        curves[dead] = np.array([_curve(pieces, lag) for lag in LAGS_S])  # (L, pieces)
    dead_s = min(_DEAD_S, key=lambda dead: float(curves[dead].sum(axis=1).min()))
    # At each lag the dead time that fits it best: the two stand in for each other.
    best = np.min([own.sum(axis=1) for own in curves.values()], axis=0)
    of_lag = np.argmin([own.sum(axis=1) for own in curves.values()], axis=0)
    profile = np.stack([curves[_DEAD_S[dead]][lag] for lag, dead in enumerate(of_lag)])
    lag_s = lowest(LAGS_S, curves[dead_s].sum(axis=1))
    if not 0 < int(np.argmin(best)) < len(LAGS_S) - 1:
        return beyond_zero(Estimate(lag_s, unit="s", reason="at the end of what is searched")), lag_s, dead_s
    whole, count = lowest(LAGS_S, best), profile.shape[1]
    without = np.array([[lowest(LAGS_S, best - profile[:, piece])] for piece in range(count)])
    even = np.ones((count, 1))
    low, high = (float(end[0]) for end in jackknife(np.array([whole]), without, even))
    return beyond_zero(Estimate(whole, low, high, "s")), lag_s, dead_s


def lowest(grid: Sequence[float], errors: Array) -> float:
    """The lag of the smallest error: the bottom of a parabola through it and its neighbours."""
    place = int(np.clip(np.argmin(errors), 1, len(errors) - 2))
    around = slice(place - 1, place + 2)
    lags = np.array(grid[around])
    curve, slope, _ = np.polyfit(lags, errors[around], 2)
    return float(np.clip(-0.5 * slope / curve, lags[0], lags[-1])) if curve > 0.0 else float(lags[1])


def _parted(part: _Part, count: int) -> list[_Part]:
    """A stretch in so many pieces."""
    return list(zip(*(np.array_split(own, count) for own in part), strict=True))


def _curve(pieces: Sequence[_Part], lag_s: float) -> Array:
    """Sum of squared errors of each piece at a lag, by coefficients of all."""
    fits = _solved([_sums(pieces, lag_s)])
    told = [_told(fits, [piece], lag_s) for piece in pieces]
    return np.array([float(np.sum((speeds - own) ** 2)) for own, speeds in told])


def _known(log: FieldLog, flight: Flown, dead_s: float, *, with_battery: bool) -> list[_Part]:
    parts = _parts(log, flight, dead_s)
    assert not isinstance(parts, str)
    return parts if with_battery else [(commands, own[:, :0], speeds) for commands, own, speeds in parts]


def _parts(log: FieldLog, flight: Flown, dead_s: float = 0.0) -> list[_Part] | str:
    """Stretches of a flight on one grid, commands by the dead time late, or why there are none."""
    if log.commands is None or log.rotor_speeds is None:
        return "the log has not both commands and rotor speeds"
    rotors = log.rotor_speeds.values.shape[1]
    if log.commands.values.shape[1] != rotors:
        return f"the log has {log.commands.values.shape[1]} commands for {rotors} rotor speeds"
    slow = min(log.commands.rate_hz, log.rotor_speeds.rate_hz)
    if slow < SLOWEST_HZ:
        return f"commands and rotor speeds are logged at {slow:.0f} Hz, slower than motors are"
    parts = [_gridded(log, one.begin, one.end, dead_s) for one in flight.stretches]
    return [part for part in parts if len(part[0]) > 2 * GRID_HZ] or "the flight is too short"


def _gridded(log: FieldLog, begin: float, end: float, dead_s: float) -> _Part:
    assert log.commands is not None
    assert log.rotor_speeds is not None
    edges = np.arange(begin, end, 1.0 / GRID_HZ)
    time = 0.5 * (edges[1:] + edges[:-1])
    speeds = log.rotor_speeds.filled_means(edges)
    # The same samples for every dead time: errors compare, and a short flight is short for all of them.
    latest, commands = (log.commands.filled_means(edges - late) for late in (_DEAD_S[-1], dead_s))
    volts = np.empty((len(time), 0)) if log.battery is None else log.battery.at(time)
    good = np.isfinite(np.hstack([latest, commands, speeds, volts])).all(axis=1)
    return commands[good], volts[good], speeds[good]


def command_columns(u: Array, volts: Array, lag_s: float) -> Array:
    """What rotor speed is made of, behind the lag, on the grid.

    Args:
        u: (N,) commands.
        volts: (N, 1), or (N, 0) where it is not known.
        lag_s: of the first order.
    """
    terms = [np.ones_like(u), u, u * u]
    if volts.shape[1]:
        terms += [volts[:, 0], u * volts[:, 0]]
    return lagged(np.stack(terms, axis=1), lag_s)


def lagged(columns: Array, lag_s: float) -> Array:
    """Columns (N, C) on the grid behind a lag of the first order, begun at rest."""
    (keep,), (now,), (before,) = lag_weights(np.array([1.0 / GRID_HZ]), lag_s)
    found: Array = lfilter([now, before], [1.0, -keep], columns, axis=0, zi=columns[:1] * (1.0 - now))[0]
    return found


_Sums = tuple[Array, Array]  # normal equations of a flight, by rotor: gram (R, P, P) and pull (R, P)


def _sums(parts: Sequence[_Part], lag_s: float) -> _Sums:
    grams, pulls = [], []
    for rotor, speeds in enumerate(np.vstack([part[2] for part in parts]).T):
        columns = np.vstack([command_columns(part[0][:, rotor], part[1], lag_s) for part in parts])
        grams.append(columns.T @ columns)
        pulls.append(columns.T @ speeds)
    return np.array(grams), np.array(pulls)


def _solved(sums: Sequence[_Sums]) -> list[Array]:
    """Coefficients of each rotor, drawn to what all motors have in common but for a gain."""
    grams, pulls = (np.sum(own, axis=0) for own in zip(*sums, strict=True))
    gains = np.ones(len(grams))
    for _ in range(_GAIN_STEPS):
        common = _ridged(np.einsum("r,rpq->pq", gains**2, grams), gains @ pulls, 1e-6, 0.0)
        gains = np.array(
            [pull @ common / (common @ gram @ common) for gram, pull in zip(grams, pulls, strict=True)]
        )
        gains /= np.mean(gains)
    return [
        _ridged(gram, pull, _ALIKE, gain * common)
        for gram, pull, gain in zip(grams, pulls, gains, strict=True)
    ]


def _ridged(gram: Array, pull: Array, weight: float, towards: Array | float) -> Array:
    """Least squares, drawn to coefficients: a battery that holds its voltage is no reason to fail."""
    scale = np.maximum(np.sqrt(np.diag(gram)), 1e-9)
    ridged = gram / np.outer(scale, scale) + weight * np.eye(len(gram))
    return np.linalg.solve(ridged, pull / scale + weight * scale * towards) / scale


def _gain(told: Array, speeds: Array) -> float:
    """By which one factor the rotors of a flight turn faster than they are told."""
    return float(np.sum(told * speeds) / np.sum(told * told))


def _told(fits: Sequence[Array], parts: Sequence[_Part], lag_s: float) -> tuple[Array, Array]:
    """Speeds (N, R) of a flight by coefficients of each rotor, and as measured."""
    told = [
        np.concatenate([command_columns(part[0][:, rotor], part[1], lag_s) @ own for part in parts])
        for rotor, own in enumerate(fits)
    ]
    return np.stack(told, axis=1), np.vstack([part[2] for part in parts])


#     m · (−a_z) = k Σ n_i²,      n_i = c · (1, u_i, u_i², V, u_i V) behind a first-order lag,
#
# the same c for all rotors, as their sum does not tell them apart; where the velocity is known, without what
# climbing takes from thrust and speed adds. Speeds are known up to a scale, which the thrust coefficient of
# the vehicle file gives, or a usual one: a model that is identified on them has it in its own.

USUAL_THRUST = Threshold(
    "C_T = T / (ρ π R⁴ ω²) of propellers: the least, a usual one and the greatest",
    (0.01, 0.02, 0.035),
    "",
    "those from 23 to 130 mm radius have 0.012 to 0.034",
    "vehicle files, and flights of ../shared/data",
)
# Share of the vehicle's largest rotor speed that the fastest commanded one has at most.
_FASTEST = 0.9
_STEPS, _SHORTEST_S = 8, 5.0
# Weight of a motor whose speed is in proportion to command and voltage, which the quadratic is drawn to:
# hover alone tells no slope. Set on seven flights of imrc_brushless, whose tachometers tell 2.24 (2.15 here).
_RIDGE = 1e-3
# Commands (N, R), volts (N, 1) or (N, 0), thrust (N,) N, and what motion does to it (N, 2) or (N, 0).
_Lift = tuple[Array, Array, Array, Array]


def lacking_for_motors(log: FieldLog, vehicle: Vehicle) -> str:
    """Why commands and IMU of a log do not tell of the motors of a vehicle; empty where they do."""
    if log.commands is None or log.imu is None:
        return "the log has not both commands and IMU"
    if (found := log.commands.values.shape[1]) != vehicle.rotor_count:
        return f"the log has commands of {found} motors, the vehicle file {vehicle.rotor_count} rotors"
    rates = {"commands": log.commands.rate_hz, "IMU": log.imu.rate_hz}
    slow = [f"{name} are logged at {rate:.0f} Hz" for name, rate in rates.items() if rate < SLOWEST_HZ]
    return f"{', '.join(slow)}, slower than motors are: {SLOWEST_HZ:g} Hz are needed" if slow else ""


def motors_by_thrust(
    flights: Sequence[tuple[FieldLog, Flown]], source: str, vehicle: Vehicle
) -> tuple[Motors, dict[str, Motors]] | str:
    """The motors of a vehicle, and by the source of each flight those by the others; or why there is none."""
    told = [(log, _lifts(log, flight, vehicle)) for log, flight in flights]
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
    fits = {lag: _fitted_thrust(everything, lag, vehicle) for lag in LAGS_S}
    lag_s = min(LAGS_S, key=lambda lag: fits[lag][1])
    mean_v = float(np.mean(np.concatenate([part[1] for part in everything]))) if volts else 1.0
    scale = _scale_of_thrust(everything, fits[lag_s][0], vehicle)

    def motors(coefficients: Array) -> Motors:
        own = tuple((scale * coefficients).tolist()) + (0.0,) * (TERMS - len(coefficients))
        of_all = (own,) * vehicle.rotor_count
        return Motors(source=source, coefficients=of_all, lag_s=lag_s, volts=mean_v, gain=gain)

    without = {}
    for name in known if len(known) > 1 else ():
        others = [part for other, parts in known.items() if other != name for part in parts]
        without[name] = _fitted_thrust(others, lag_s, vehicle)[0]
    gains = [_gain_of_thrust(parts, without[name], lag_s) for name, parts in known.items() if name in without]
    gain = float(np.sqrt(np.mean(np.square(np.array(gains) - 1.0)))) if gains else USUAL_GAIN.value
    return motors(fits[lag_s][0]), {name: motors(coefficients) for name, coefficients in without.items()}


def _lifts(log: FieldLog, flight: Flown, vehicle: Vehicle) -> list[_Lift] | str:
    if why := lacking_for_motors(log, vehicle):
        return why
    assert log.commands is not None
    assert log.imu is not None
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


def _fitted_thrust(parts: Sequence[_Lift], lag_s: float, vehicle: Vehicle) -> tuple[Array, float]:
    """Coefficients with k = 1, in √N, and the sum of squared errors of thrust, N²."""
    rotors = vehicle.rotor_count
    told = [np.stack([command_columns(u, part[1], lag_s) for u in part[0].T], axis=1) for part in parts]
    columns = np.concatenate(told)  # (N, R, P)
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


def _gain_of_thrust(parts: Sequence[_Lift], coefficients: Array, lag_s: float) -> float:
    """By which one factor the rotors of a flight turn faster than coefficients tell, by its thrust."""
    told = thrust = 0.0
    for commands, volts, own, _ in parts:
        speeds = [command_columns(one, volts, lag_s) @ coefficients for one in commands.T]
        told += float(np.sum(np.square(speeds)))
        thrust += float(np.sum(own))
    return float(np.sqrt(max(thrust, 0.0) / max(told, 1e-9)))


def _scale_of_thrust(parts: Sequence[_Lift], coefficients: Array, vehicle: Vehicle) -> float:
    """Rotor speed [rad/s] for a square root of thrust [√N]."""
    known = vehicle.thrust_coefficient or USUAL_THRUST.value[1]
    k = known * vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**4
    columns = [command_columns(own, part[1], 0.0) for part in parts for own in part[0].T]
    fastest = max(float(np.max(own @ coefficients)) for own in columns)
    return float(min(1.0 / np.sqrt(k), _FASTEST * vehicle.rotor_speed_max_rad_s / max(fastest, 1e-9)))
