# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Drag per mass of one vehicle from its flights, with the wind of each, and PX4's coefficients of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from quadpi_core.field.airborne import Flown, averages, cut, velocity_of
from quadpi_core.field.estimates import (
    PIECES_FEWEST,
    Estimate,
    beyond_zero,
    effective_pieces,
    jackknife,
    not_identified,
)
from quadpi_core.field.field_log import FieldLog, Series
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.inputs import STANDARD_DENSITY, UNKNOWN_AIR
from quadpi_core.messages.payloads import Indices
from quadpi_core.records import CONVENTION, STANDARD_GRAVITY, Threshold

# Samples are means of the specific force over a fifth of a second: no state comes less often, and vibration
# and the lever arm of the IMU average out.
STEP_S = 0.2
PIECE_S = Threshold(
    "shortest and longest pieces that intervals leave out; a tenth of the flights lies between",
    (3.0, 10.0),
    "s",
    "gusts at 2 to 50 m of height are correlated for 1 to 10 s at 5 m/s and more (Dryden, MIL-F-8785C)",
    "simulated windy flights of seeds below 100, other than those whose coverage is counted",
)
# Pieces of one flight: an hour takes no more than ten minutes do.
_PIECES_MOST = 60


@dataclass(frozen=True)
class DragSamples:
    """Samples (N,) of one flight, a fifth of a second apart where it was in the air.

    Attributes:
        time: s.
        piece: (N,) the piece of flight of each.
        force: (N, 3) m/s² body.
        velocity: (N, 3) m/s over ground, world.
        turn: (N, 3, 3) body to world.
        density: kg/m³, of the air; None where the log does not tell it.
    """

    time: Array
    piece: Array
    force: Array
    velocity: Array
    turn: Array
    density: float | None

    def every(self, stride: int) -> DragSamples:
        """One sample of so many."""
        names = ("time", "piece", "force", "velocity", "turn")
        return replace(self, **{name: getattr(self, name)[::stride] for name in names})

    @property
    def air_ratio(self) -> float:
        """Density of the air over that of standard air; 1 where it is not known."""
        return 1.0 if self.density is None else self.density / STANDARD_DENSITY


def piece_lengths_s(airborne_s: Sequence[float]) -> list[float]:
    """Length of the pieces of each flight that intervals leave out.

    Of many flights drag leaves out whole ones, and the pieces tell of the wind of theirs alone.
    """
    are_many, together = len(airborne_s) >= PIECES_FEWEST.value, sum(airborne_s)
    told = [own if are_many else together for own in airborne_s]
    return [max(min(max(0.1 * own, PIECE_S.value[0]), PIECE_S.value[1]), own / _PIECES_MOST) for own in told]


def drag_samples(log: FieldLog, flight: Flown, piece_s: float) -> DragSamples | str:
    """The samples of a flight that tell of drag, or what the log lacks for them.

    Args:
        log: of the flight.
        flight: when it was in the air.
        piece_s: see :func:`piece_lengths_s`.
    """
    velocity = velocity_of(log)
    if log.imu is None or log.attitude is None or velocity is None:
        needed = {"specific force": log.imu, "attitude": log.attitude, "velocity": velocity}
        lacking = [name for name, series in needed.items() if series is None]
        return f"the log has no {' and no '.join(lacking)}"
    forces = Series(log.imu.time, log.imu.values[:, 3:])
    (force,), time, piece = averages(cut(flight.stretches, piece_s), STEP_S, forces)
    moving, attitude = velocity.at(time), log.attitude.at(time)
    length = np.linalg.norm(attitude, axis=1, keepdims=True)
    good = np.isfinite(np.hstack([moving, attitude])).all(axis=1) & (length[:, 0] > 0.5)
    if not good.any():
        return "specific force, attitude and velocity do not overlap"
    air = None if log.density is None else float(np.median(log.density.values))
    turn = rotation_matrix(attitude[good] / length[good])
    return DragSamples(time[good], piece[good], force[good], moving[good], turn, air)


# An accelerometer senses no gravity, and the thrust of a multirotor has no part along body x and y: what it
# reads there is drag over mass, its bias, and a tilt of its mounting. With linear drag, k in 1/s,
#
#     f_x = −k_x (Rᵀ(v − w))_x + b_x + e_x (f_z + g),        f_y likewise,
#
# where R turns body into world, v is the velocity over ground and w the wind, horizontal and slow. Neither
# rotor speeds nor mass are needed. Source: D. Abeywardena et al., Improved state estimation in quadrotor MAVs
# (IEEE RAM 2013), eqs. 5–7; PX4's drag_fusion.cpp for the split into momentum drag and bluff-body drag.
#
# The wind of each flight is a polygon over time whose steps are a random walk. All is solved together by
# Gauss–Newton; intervals leave out pieces of flight (see :mod:`quadpi_core.field.estimates`).

# What is known before: bias of an accelerometer with the tilt of its mounting [m/s²], wind [m/s], its change
# in the square root of a second [m/s], lean of the mounting [rad].
BIAS, WIND, WALK, _LEAN = 0.5, 6.0, 0.3, 0.05
_KNOTS_S = 10.0
# Of all flights together: an hour takes no more than ten minutes do.
_KNOTS_MOST, _SAMPLES_MOST = 60, 6000
_ITERATIONS, _SETTLED = 12, 1e-5
# Information on what is known: more than any flight's.
_KNOWN = 1e12


class _Information(NamedTuple):
    """What a piece of a flight tells of the parameters at `columns` (C,): (C, C) and (C,)."""

    flight: int
    columns: Indices
    information: Array
    gradient: Array


class DragFit:
    """The joint problem of several flights: drag of the vehicle, wind and bias of each flight.

    Attributes:
        theta: (P,) drag parameters first.
        prior: (P, P) information of what is known before; the square terms `without` are known to be 0.
        mean: (P,) what it is known to be.

    Args:
        flights: samples of each.
        quadratic: EKF2's split of drag, or else one coefficient an axis.
        without: axes that have no square term.
        known: drag (2,) along x and y, 1/s, where it is not to be found.
        wind: standard deviation of the wind beforehand, m/s.
    """

    def __init__(
        self,
        flights: Sequence[DragSamples],
        *,
        quadratic: bool,
        without: Sequence[int] = (),
        known: Sequence[float] | None = None,
        wind: float = WIND,
    ) -> None:
        stride = -(-sum(len(one.time) for one in flights) // _SAMPLES_MOST)
        self.flights, self.step_s = [one.every(stride) for one in flights], stride * STEP_S
        self.drags = 3 if quadratic else 2
        self.quadratic = quadratic
        self.layout: list[tuple[int, Array]] = []
        place = self.drags
        for one in flights:
            count = round((one.time[-1] - one.time[0]) / _KNOTS_S) + 1
            knots = np.linspace(
                one.time[0], one.time[-1], max(2, min(count, 2 * _KNOTS_MOST // len(flights), _KNOTS_MOST))
            )
            self.layout.append((place, knots))
            place += 4 + 2 * len(knots)
        self.theta = np.zeros(place)
        # No drag leaves the wind without an effect: begin at that of a usual vehicle.
        self.theta[: self.drags] = [0.15, 0.005, 0.005] if quadratic else [0.3, 0.3]
        self.mean, self.prior, self.scale = np.zeros(place), self._prior(wind), np.array([0.3, 0.3])
        for axis in without:
            self.theta[1 + axis], self.prior[1 + axis, 1 + axis] = 0.0, _KNOWN
        for axis, value in enumerate(known or ()):
            self.theta[axis] = self.mean[axis] = value
            self.prior[axis, axis] = _KNOWN
        self._solve()

    def _prior(self, wind: float) -> Array:
        prior = np.zeros((len(self.theta), len(self.theta)))
        for place, knots in self.layout:
            prior[range(place, place + 4), range(place, place + 4)] = np.repeat([BIAS**-2, _LEAN**-2], 2)
            for axis in range(2):
                own = place + 4 + axis * len(knots) + np.arange(len(knots))
                prior[own, own] += wind**-2 / len(knots)
                steps = np.diff(np.eye(len(knots)), axis=0) / (WALK * np.sqrt(np.diff(knots)))[:, np.newaxis]
                prior[np.ix_(own, own)] += steps.T @ steps
        return prior

    def _weights(self, flight: int, time: Array) -> Array:
        """Shares (N, K) of the knots of the wind at times (N,) s."""
        _, knots = self.layout[flight]
        return np.stack([np.interp(time, knots, own) for own in np.eye(len(knots))], axis=1)

    def wind_at(self, flight: int, time: Array) -> Array:
        """Wind (N, 2) of a flight to north and east, m/s, at times (N,) s."""
        place, knots = self.layout[flight]
        winds = self.theta[place + 4 : place + 4 + 2 * len(knots)].reshape(2, -1).T
        return self._weights(flight, time) @ winds

    def residuals(self, flight: int) -> tuple[Array, Array, Array]:
        """Residuals (N, 2) in m/s², slopes (N, 2, C) by its columns, airspeed (N, 3) in body axes."""
        one, (place, knots), theta = self.flights[flight], self.layout[flight], self.theta
        weights, count = self._weights(flight, one.time), len(knots)
        air = one.velocity.copy()
        air[:, :2] -= self.wind_at(flight, one.time)
        body = np.einsum("nji,nj->ni", one.turn, air)
        speed = np.linalg.norm(body, axis=1)
        slopes = np.zeros((len(body), 2, self.drags + 4 + 2 * count))
        residuals = np.empty((len(body), 2))
        thrust = one.force[:, 2] + STANDARD_GRAVITY
        for axis in range(2):
            if self.quadratic:
                # EKF2: −(MCOEF √(ρ/ρ0) + ½ ρ |v| / BCOEF) v.
                linear, square = np.sqrt(one.air_ratio), 0.5 * STANDARD_DENSITY * one.air_ratio * speed
                gain = theta[0] * linear + theta[1 + axis] * square
                slopes[:, axis, 0] = linear * body[:, axis]
                slopes[:, axis, 1 + axis] = square * body[:, axis]
            else:
                gain = np.full(len(body), theta[axis])
                slopes[:, axis, axis] = body[:, axis]
            bias, lean = theta[place + axis], theta[place + 2 + axis]
            residuals[:, axis] = one.force[:, axis] + gain * body[:, axis] - bias - lean * thrust
            slopes[:, axis, self.drags + axis], slopes[:, axis, self.drags + 2 + axis] = -1.0, -thrust
            for world in range(2):
                own = self.drags + 4 + world * count + np.arange(count)
                slopes[:, axis, own] = -(gain * one.turn[:, world, axis])[:, np.newaxis] * weights
        return residuals, slopes, body

    def columns(self, flight: int) -> Indices:
        """Places (C,) of the parameters that a flight tells of: drag, and its own."""
        place, knots = self.layout[flight]
        return np.concatenate([np.arange(self.drags), place + np.arange(4 + 2 * len(knots))])

    def normal(self) -> tuple[Array, Array, list[_Information]]:
        """Information (P, P) and gradient (P,) with what was known before; and of each piece."""
        whole, pull = self.prior.copy(), self.prior @ (self.theta - self.mean)
        pieces = []
        for flight, one in enumerate(self.flights):
            residuals, slopes, _ = self.residuals(flight)
            slopes, scaled = slopes / self.scale[:, np.newaxis], residuals / self.scale
            columns = self.columns(flight)
            for piece in np.unique(one.piece):
                rows = one.piece == piece
                flat = slopes[rows].reshape(-1, len(columns))
                information, gradient = flat.T @ flat, flat.T @ scaled[rows].ravel()
                pieces.append(_Information(flight, columns, information, gradient))
                whole[np.ix_(columns, columns)] += information
                pull[columns] += gradient
        return whole, pull, pieces

    def _solve(self) -> None:
        for _ in range(_ITERATIONS):
            whole, pull, _ = self.normal()
            step = np.linalg.solve(whole, pull)
            self.theta = self.theta - step
            # Drag that turns up slightly negative would flip the wind on the way.
            self.theta[: self.drags] = np.maximum(self.theta[: self.drags], -0.5)
            together = np.vstack([self.residuals(flight)[0] for flight in range(len(self.flights))])
            # Of autocorrelated samples fewer count: a second's worth each.
            self.scale = np.sqrt(np.mean(together**2, axis=0) / min(self.step_s, 1.0)) + 1e-6
            if np.abs(step[: self.drags]).max() < _SETTLED:
                break

    def intervals(self, *, by_flight: bool) -> tuple[Array, Array, Array]:
        """Drag parameters and mean wind, north and east, of each flight (M,), and ends of intervals (M, 2).

        Also the number (D,) of pieces that would share the information on each drag parameter evenly.

        Args:
            by_flight: leave out whole flights for drag. A wind has one flight: its pieces are left out with
                drag held, and the other flights for what their drag does to it.
        """
        whole, pull, pieces = self.normal()
        wanted = np.zeros((self.drags + 2 * len(self.layout), len(self.theta)))
        wanted[range(self.drags), range(self.drags)] = 1.0
        for flight, (place, knots) in enumerate(self.layout):
            for axis in range(2):
                own = place + 4 + axis * len(knots) + np.arange(len(knots))
                wanted[self.drags + 2 * flight + axis, own] = 1.0 / len(knots)
        groups = [[one] for one in pieces]
        if by_flight:
            groups = [[one for one in pieces if one.flight == flight] for flight in range(len(self.flights))]
        without = np.array([self._without(whole, pull, group) @ wanted.T for group in groups])
        told = np.array([sum(np.diag(one.information)[: self.drags] for one in group) for group in groups])
        share = np.hstack([told, np.ones((len(told), len(wanted) - self.drags))])
        value = wanted @ self.theta
        half = jackknife(value, without, share)[1] - value
        if by_flight:
            for flight in range(len(self.flights)):
                own = self.drags + 2 * flight + np.arange(2)
                half[own] = self._wind_half(whole, pull, groups[flight], wanted[own])
                others = np.delete(without, flight, axis=0)[:, own]
                half[own] = np.hypot(
                    half[own], jackknife(value[own], others, np.ones_like(others))[1] - value[own]
                )
        # Of the wind the pieces tell what the data do, and the information what was known before.
        known = np.einsum("mp,pm->m", wanted, np.linalg.solve(whole, wanted.T))
        half[self.drags :] = np.hypot(half, 2.0 * np.sqrt(known))[self.drags :]
        return value, np.stack([value - half, value + half], axis=1), effective_pieces(told)

    def _without(self, whole: Array, pull: Array, group: Sequence[_Information]) -> Array:
        """Parameters (P,) without some pieces, by one Newton step."""
        less, rest = whole.copy(), pull.copy()
        for one in group:
            less[np.ix_(one.columns, one.columns)] -= one.information
            rest[one.columns] -= one.gradient
        return self.theta - np.linalg.solve(less, rest)

    def _wind_half(self, whole: Array, pull: Array, group: Sequence[_Information], wanted: Array) -> Array:
        """Half the interval (2,) of the wind of a flight from its own pieces; not finite for too few."""
        if len(group) < PIECES_FEWEST.value:
            return np.full(2, np.inf)
        own, drags = group[0].columns[self.drags :], self.drags
        part, held, slope = wanted[:, own], whole[np.ix_(own, own)], pull[own]
        steps = [
            np.linalg.solve(held - one.information[drags:, drags:], slope - one.gradient[drags:])
            for one in group
        ]
        value = part @ self.theta[own]
        without = value - np.array(steps) @ part.T
        return jackknife(value, without, np.ones((len(group), 2)))[1] - value


USABLE_SPEED = Threshold(
    "speed over ground from which a sample tells of drag",
    0.5,
    "m/s",
    "at less, an estimated velocity errs by as much as it says",
    "default logs of PX4 and ArduPilot: GPS velocity errs by 0.1 to 0.3 m/s",
)
USABLE_FEWEST = Threshold(
    "usable samples below which no drag is told",
    50,
    "samples",
    "of a fifth of a second: ten seconds, a pass there and back; logs of 12 and 38 gave drag of either sign",
    "the default logs named in the brief of this report",
)
WIDEST_RATIO = Threshold(
    "upper over lower end of the interval of a BCOEF from which it is not told",
    5.0,
    "",
    "the middle of a wider one is off by a factor of two as often as not",
    CONVENTION,
)


@dataclass(frozen=True)
class DragResult:
    """Drag and wind of one vehicle.

    Attributes:
        per_mass: drag over mass and airspeed along x and y, 1/s, best for the speeds flown.
        momentum, ballistic: EKF2_MCOEF in 1/s; EKF2_BCOEF_X and _Y in kg/m², at standard density.
        speed: 5 and 95 % quantile of the airspeed, m/s.
        usable: number of usable samples.
        by_flight: whether intervals leave out flights; else pieces of these, and flights to come may differ.
        advice: what to fly next; empty where nothing is lacking.
        wind: of each flight: north and east, m/s, mean over the flight.
        fitted: share of the variance of f_x, f_y that drag, wind and bias explain; NaN without a fit.
    """

    per_mass: tuple[Estimate, Estimate]
    momentum: Estimate
    ballistic: tuple[Estimate, Estimate]
    speed: tuple[float, float]
    usable: int
    by_flight: bool
    advice: str
    wind: tuple[tuple[Estimate, Estimate], ...] = ()
    fitted: tuple[float, float] = (np.nan, np.nan)

    def likely_wind(self, flight: int) -> Array:
        """The likeliest wind (2,) of a flight, m/s: 0 where nothing tells it, however wide its interval."""
        if not self.wind:
            return np.zeros(2)
        ends = [(one.low, one.high) for one in self.wind[flight]]
        return np.array([0.0 if low is None or high is None else 0.5 * (low + high) for low, high in ends])


def identify_drag(flights: Sequence[DragSamples]) -> DragResult:
    """Drag per mass of one vehicle from its flights, with the wind of each.

    With enough flights, intervals leave out flights rather than pieces of them, and hold for flights to come.
    """
    by_flight = len(flights) >= PIECES_FEWEST.value
    body = np.vstack([np.einsum("nji,nj->ni", one.turn, one.velocity)[:, :2] for one in flights])
    usable = int(np.sum(np.hypot(*body.T) >= USABLE_SPEED.value))
    pieces = sum(len(np.unique(one.piece)) for one in flights)
    if usable < USABLE_FEWEST.value or pieces < PIECES_FEWEST.value:
        said = (
            f"too slow, {usable} usable samples of {len(body)}: fly at 5 m/s or more"
            if usable < min(USABLE_FEWEST.value, 0.5 * len(body))
            else f"too short, {len(body) * STEP_S:.0f} s in the air"
        )
        advice = "fly to and fro along the nose, then sideways, at 5 m/s or more, for a minute each"
        none, coefficient = not_identified("1/s", said), not_identified("kg/m²", said)
        return DragResult(
            (none, none), none, (coefficient, coefficient), _speeds(body), usable, by_flight, advice
        )
    linear = DragFit(flights, quadratic=False)
    value, ends, effective = linear.intervals(by_flight=by_flight)
    along, across = (_drag_estimate(value[axis], ends[axis], "1/s", effective[axis]) for axis in range(2))
    winds = [_wind_estimate(one, *own) for one, own in zip(value[2:], ends[2:], strict=True)]
    momentum, ballistic = _coefficients(flights, by_flight=by_flight)
    residuals, _, air = zip(*map(linear.residuals, range(len(flights))), strict=True)
    force = np.vstack([one.force[:, :2] - one.force[:, :2].mean(axis=0) for one in linear.flights])
    left = np.mean(np.vstack(residuals) ** 2, axis=0) / np.maximum(np.mean(force**2, axis=0), 1e-12)
    return DragResult(
        (along, across),
        momentum,
        ballistic,
        _speeds(np.vstack(air)[:, :2]),
        usable,
        by_flight,
        _advice((along, across), body, usable),
        wind=tuple(zip(winds[::2], winds[1::2], strict=True)),
        fitted=(float(1.0 - left[0]), float(1.0 - left[1])),
    )


def _speeds(horizontal: Array) -> tuple[float, float]:
    low, high = np.quantile(np.hypot(*horizontal.T), [0.05, 0.95])
    return float(low), float(high)


def _drag_estimate(value: float, ends: Array, unit: str, pieces: float = np.inf) -> Estimate:
    low, high = map(float, ends)
    if pieces < 0.5 * PIECES_FEWEST.value:
        return not_identified(unit, "one short pass tells it all")
    return beyond_zero(Estimate(float(value), low, high, unit))


def _wind_estimate(value: float, low: float, high: float) -> Estimate:
    if not np.isfinite(high - low):
        return not_identified("m/s", "the flight is too short")
    if high - low > WIND:
        said = "its interval is too wide: fly with the nose to all sides, for longer"
        return not_identified("m/s", said, float(low), float(high))
    return Estimate(float(value), float(low), float(high), "m/s")


def _coefficients(
    flights: Sequence[DragSamples], *, by_flight: bool
) -> tuple[Estimate, tuple[Estimate, Estimate]]:
    """EKF2_MCOEF, and EKF2_BCOEF_X and _Y with the ends of their inverses."""
    without: list[int] = []
    while True:
        fit = DragFit(flights, quadratic=True, without=without)
        values, ends, pieces = fit.intervals(by_flight=by_flight)
        squares = [_square_estimate(values[1 + axis], ends[1 + axis], pieces[1 + axis]) for axis in range(2)]
        # A square of no known size would take its part of the drag from the other terms.
        unknown = [axis for axis in range(2) if axis not in without and squares[axis].value is None]
        if not unknown:
            break
        without += unknown
    said = "drag that grows with the square of speed is within its error: fly faster; MCOEF is without it"
    for axis in without:
        squares[axis] = not_identified("kg/m²", said)
    momentum = _drag_estimate(values[0], ends[0], "1/s", pieces[0])
    if any(one.density is None for one in flights):
        thinnest, densest = UNKNOWN_AIR.value
        # Momentum drag goes with the square root of the density, bluff-body drag with the density.
        momentum = _in_any_air(momentum, densest**-0.5, thinnest**-0.5)
        squares = [_in_any_air(one, thinnest, densest) for one in squares]
    return momentum, (squares[0], squares[1])


def _in_any_air(one: Estimate, least: float, most: float) -> Estimate:
    """A coefficient whose air nothing told, wider by the shares of it that this leaves."""
    if one.value is None or one.low is None or one.high is None:
        return one
    low, high = (
        one.value + side * np.hypot(end - one.value, (share - 1.0) * one.value)
        for side, end, share in ((-1.0, one.low, least), (1.0, one.high, most))
    )
    ends = f"{100.0 * (least - 1.0):.0f} to {100.0 * (most - 1.0):+.0f} %"
    said = f"no pressure and temperature: {ends} for the density of the air"
    return replace(one, low=float(low), high=float(high), reason=said)


def _square_estimate(value: float, ends: Array, pieces: float) -> Estimate:
    """BCOEF of a square term with its interval."""
    square = _drag_estimate(value, ends, "m²/kg", pieces)
    if square.value is None or square.low is None or square.high is None:
        return square
    if square.high > WIDEST_RATIO.value * square.low:
        return not_identified("kg/m²", "its interval is too wide")
    return Estimate(1.0 / square.value, 1.0 / square.high, 1.0 / square.low, "kg/m²")


def _advice(per_mass: Sequence[Estimate], body: Array, usable: int) -> str:
    """The flight that would narrow the wider of both intervals to a tenth of the value."""
    widths = []
    for one in per_mass:
        half = one.half_width
        middle = None if one.low is None or one.high is None else 0.5 * abs(one.low + one.high)
        widths.append(np.inf if half is None or not middle else half / middle)
    axis = int(np.argmax(widths))
    goal = 0.1
    if widths[axis] <= goal:
        return ""
    spread = float(np.std(body[:, axis]))
    speed = max(5.0, float(np.quantile(np.abs(body[:, axis]), 0.95)))
    # The error falls with the square root of time, and with the spread of the speed.
    seconds = usable * STEP_S * min(widths[axis] / goal, 10.0) ** 2 * min(1.0, (spread / (0.7 * speed)) ** 2)
    way = ("to and fro along the nose", "sideways to and fro")[axis]
    return f"fly {way} at {speed:.0f} m/s for {max(30.0, min(seconds, 600.0)):.0f} s"
