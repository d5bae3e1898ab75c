# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Drag per mass of one vehicle from its flights, with the wind of each, and PX4's coefficients of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadpi_core.field.drag_fit import WIND, DragFit
from quadpi_core.field.drag_samples import STEP_S, DragSamples
from quadpi_core.field.estimates import PIECES_FEWEST, Estimate, beyond_zero, not_identified
from quadpi_core.frames import Array
from quadpi_core.inputs import UNKNOWN_AIR
from quadpi_core.records import CONVENTION, Threshold

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
    body = np.vstack([one.body_velocity[:, :2] for one in flights])
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
