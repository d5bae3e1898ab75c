# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of the alarm from flights left out in turn, to a stated rate of false alarms.

The alarm should be silent on a new flight of the same kind. Each flight that lies mostly within the ranges of
the others, under model and envelope of the others, is an example of one; `tail_limits` bounds the next.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import LiveSamples
from quadpi_core.inputs import INPUT_INDEX
from quadpi_core.models.aerodynamic import Motion
from quadpi_core.models.alarm_limits import (
    BOUND_CONFIDENCE,
    FEWEST_FLIGHTS,
    AlarmLimits,
    allowance,
    least_carried,
)
from quadpi_core.models.envelope import LEVERAGE_HEADROOM, WIDTH_HEADROOM, Envelope
from quadpi_core.models.interval_rules import FEWEST_INSIDE, FlightErrors, HeldOutRule, inside_interval
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.monitor.alarm import MonitorSettings
from quadpi_core.monitor.alarm_kernel import STEP_MAX_S
from quadpi_core.records import Records

# Flights are the units, as they differ more than their blocks: each contributes its largest sustained value.
# The tail of these is exponential (:class:`Tail`); a dozen flights tell it poorly, so what is usual enters.

# Weight of what is usual, in flights.
USUAL_FLIGHTS = 6
# Least value and mean excess, in the unit of the signal: one that never moved justifies no tight limit.
_LEAST = 0.02
# Numbers drawn for what is not known of a tail.
DRAWS = 4000
# Share of the flights that a tail is fitted to, and their least number, at most half of all.
_TAIL_SHARE, _TAIL_FLIGHTS = 0.25, 5
# Least spread between flights of the end of an input's range, in its width: a cosine always reaches its end.
_ALIKE = 0.01
# Bisections in the search for a largest sustained value: to 1e-9 of its range.
_HALVINGS = 30


def lasting_maximum(values: Array, time: Array, persistence_s: float, release_s: float) -> float:
    """Highest level that a signal (N,) exceeds long enough to raise the alarm; its least value if none.

    Args:
        values: (N,).
        time: (N,) s.
        persistence_s: time above the level that raises the alarm.
        release_s: time below the level that clears the evidence.
    """
    steps, values = _steps(time), np.ascontiguousarray(values)
    low, high = float(values.min()), float(values.max())
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if compiled.lasts(values, steps, middle, persistence_s, release_s):
            low = middle
        else:
            high = middle
    return low


@dataclass(frozen=True)
class Tail:
    """Exponential tail of the largest values of flights: of a value beyond `start`, the excess.

    Attributes:
        start: where it begins.
        mean: of the excess.
        share: of the flights that go beyond `start`.
        count: number of these flights.
        draws: of the excess that `mean` is as good as: flights, and what is known beforehand.
    """

    start: float
    mean: float
    share: float
    count: int
    draws: int

    @classmethod
    def from_flights(cls, largest: Array) -> Tail:
        """Of values (n,), at least two."""
        ordered = np.sort(largest)[::-1]
        count = min(max(int(_TAIL_SHARE * len(ordered)), _TAIL_FLIGHTS), len(ordered) // 2)
        start = float(ordered[count])
        excess = max(float(ordered[:count].mean()) - start, _LEAST)
        return cls(start, excess, count / len(ordered), count, count)

    def with_usual(self, excess: float) -> Tail:
        """With a usual mean excess as a prior worth :data:`USUAL_FLIGHTS`."""
        draws = self.count + USUAL_FLIGHTS
        return replace(self, mean=(self.count * self.mean + USUAL_FLIGHTS * excess) / draws, draws=draws)

    def limit(self, alarms: float) -> float:
        """Level that one more flight exceeds so often on average, what is not known of `mean` included.

        Of n draws, the next one exceeds x with probability (1 + x / (n mean))⁻ⁿ, the average of
        exp(-x / mean) over what the draws say of the mean (Gelman et al., Bayesian Data Analysis: the
        exponential model without prior knowledge).
        """
        rarer = max(self.share / -float(np.expm1(-alarms)), 1.0)
        folds = self.draws * (float(rarer ** (1.0 / self.draws)) - 1.0)
        return self.start + self.mean * folds

    def chances(self, limit: float, random: np.random.Generator) -> Array:
        """Chances (:data:`DRAWS`,) that one more flight exceeds a limit, as far as the flights tell."""
        means = self.mean * self.draws / random.gamma(self.draws, size=DRAWS)
        beyond = self.share * random.gamma(self.count, size=DRAWS) / self.count
        return beyond * np.exp(-max(limit - self.start, 0.0) / means)


def tails_of_misses(largest: Array) -> list[Tail]:
    """Tails of the sequential test of each axis, from the largest sums (n, K) of flights, in seconds.

    There are too few flights to tell the tail of each axis alone: its mean excess is at least the part of its
    start that it is on average of all, which counts as much as a prior.
    """
    tails = [Tail.from_flights(of_axis) for of_axis in np.maximum(largest, _LEAST).T]
    part = float(np.mean([tail.mean / tail.start for tail in tails]))
    usual = [max(tail.mean, part * tail.start) for tail in tails]
    return [replace(tail, mean=mean).with_usual(mean) for tail, mean in zip(tails, usual, strict=True)]


def sums_of_misses(time: Array, miss: Array, allowed: float) -> Array:
    """The sequential test (N, 6) of a flight, in seconds, without its end at the limit.

    Args:
        time: (N,) s.
        miss: (N, 6) whether the measured wrench left its interval, 0 or 1; NaN where not known.
        allowed: share of misses at which it neither rises nor falls.
    """
    sums = np.empty(miss.shape)
    compiled.sum_misses(_steps(time), np.ascontiguousarray(miss), allowed, sums)
    return sums


def _steps(time: Array) -> Array:
    """Seconds (N,) since the previous sample; a gap counts as one step, as in the alarm."""
    steps = np.diff(time, prepend=time[0])
    return np.minimum(steps, max(float(np.median(steps)), STEP_MAX_S))


class _Excess(NamedTuple):
    """Mean excess beyond the farthest quarter of flights: in spreads between ends, or in logarithms."""

    ends: float
    leverage: float
    width: float


# Of 488 and of 600 simulated flights, in sets of 8 to 75 (experiments/results/alarm.md).
_USUAL_EXCESS = _Excess(0.5, 0.4, 0.1)
# Of the interval of an estimated rate, as a person reads it: 95 %.
_ENDS = (0.5 - 0.5 * BOUND_CONFIDENCE.value, 0.5 + 0.5 * BOUND_CONFIDENCE.value)


class Judged(Motion, Protocol):
    """A flight as it was identified on and as a monitor would have had it."""

    @property
    def wrench(self) -> Array:
        """(N, 6) measured."""

    @property
    def judged(self) -> LiveSamples:
        """The samples as the live path has them."""


@dataclass(frozen=True)
class LeftOut:
    """Signals of one flight under what the other flights support; columns zero for axes not held.

    Attributes:
        time: (N,) s.
        inputs: (N, 19) as the live path has them.
        lower, upper: (19,) :meth:`Envelope.flight_range` of the flight.
        leverage, width: (N, 6) over their peaks in the other flights.
        miss: (N, 6) 1 where the measured wrench left the interval, else 0; NaN for axes not held.
    """

    time: Array
    inputs: Array
    lower: Array
    upper: Array
    leverage: Array
    width: Array
    miss: Array


def calibrate_alarm(
    envelope: Envelope,
    flights: Sequence[LeftOut],
    *,
    confidence: float,
    rate_per_hour: float,
    hover_rotor_speed: float,
) -> tuple[Envelope, AlarmLimits]:
    """Envelope and limits for a rate of false alarms, shared evenly by EXTRAPOLATION and MISCOVERAGE.

    Args:
        envelope: of all flights, with the fixed limits.
        flights: each under the model of the others, at least one.
        confidence: of the intervals that `miss` refers to.
        rate_per_hour: false alarms per flight hour that are asked for; the limits state no less than the
            flights carry, see :func:`.alarm_limits.least_carried`.
        hover_rotor_speed: see :class:`~quadpi_core.models.alarm_limits.AlarmLimits`.
    """
    limits = AlarmLimits(
        allowance=allowance(confidence), hover_rotor_speed=hover_rotor_speed, rate_per_hour=rate_per_hour
    )
    if len(flights) < FEWEST_FLIGHTS:
        return envelope, limits
    usual = [
        flight
        for flight, others in zip(flights, ranges_of_others(flights), strict=True)
        if _share_inside(flight, others) >= FEWEST_INSIDE
    ]
    if len(usual) < FEWEST_FLIGHTS:
        return envelope, limits
    times = [flight.time for flight in usual]
    hours = sum(float(time[-1] - time[0]) for time in times) / 3600.0
    rate_per_hour = max(rate_per_hour, least_carried(hours))
    # Fixed, so that the same flights give the same model.
    random = np.random.default_rng(0)
    per_flight = 0.5 * rate_per_hour * hours / len(usual)
    margin, leverage, width, chances = _limits_of_extrapolation(envelope, usual, per_flight, random)
    calibrated = replace(
        envelope,
        margin=margin,
        leverage_limit=envelope.of_peak(envelope.leverage_peak, leverage),
        width_limit=envelope.of_peak(envelope.width_peak, width),
    )
    largest = np.array(
        [sums_of_misses(flight.time, flight.miss, limits.allowance).max(axis=0) for flight in usual]
    )
    misses = limits.miscoverage_s.copy()
    axes = np.flatnonzero(~np.isnan(usual[0].miss[0]))
    for axis, tail in zip(axes, tails_of_misses(largest[:, axes]), strict=True):
        misses[axis] = tail.limit(per_flight / len(axes))
        chances += tail.chances(misses[axis], random)
    rates = chances * len(usual) / hours
    low, high = np.quantile(rates, _ENDS)
    estimate = (float(np.mean(rates)), float(low), float(high))
    return calibrated, replace(
        limits,
        miscoverage_s=misses,
        rate_per_hour=rate_per_hour,
        flights=len(usual),
        hours=hours,
        estimate_per_hour=estimate,
    )


def _limits_of_extrapolation(
    envelope: Envelope, usual: Sequence[LeftOut], alarms_per_flight: float, random: np.random.Generator
) -> tuple[Array, float, float, Array]:
    """Margins (19,) of the inputs, limits of leverage and width over their peaks in training.

    Args:
        envelope: of all flights.
        usual: flights within the ranges of the others.
        alarms_per_flight: expected number of false alarms, of all signals together.
        random: for what is not known of the tails.

    Returns:
        The limits, and numbers of false alarms in a flight that they may have (DRAWS,).
    """
    settings = MonitorSettings()

    def largest(series: Sequence[Array]) -> Array:
        return np.array(
            [
                lasting_maximum(values, flight.time, settings.persistence_s, settings.release_s)
                for values, flight in zip(series, usual, strict=True)
            ]
        )

    ends = [_Ends.between([*usual[:k], *usual[k + 1 :]]) for k in range(len(usual))]
    goes = largest([others.passed_by(flight.inputs) for flight, others in zip(usual, ends, strict=True)])
    over_peak = (
        (largest([flight.leverage.max(axis=1) for flight in usual]), _USUAL_EXCESS.leverage),
        (largest([flight.width.max(axis=1) for flight in usual]), _USUAL_EXCESS.width),
    )
    known = sum(bool(np.any(values)) for values, _ in over_peak)
    # Half of the alarms are left to the inputs, which tell most of a new flight; without the others, all.
    tail = Tail.from_flights(goes).with_usual(_USUAL_EXCESS.ends)
    far = tail.limit(alarms_per_flight * (0.5 if known else 1.0))
    alarms = tail.chances(far, random)
    limits = [LEVERAGE_HEADROOM, WIDTH_HEADROOM]
    for k, (values, excess) in enumerate(over_peak):
        if np.any(values):
            tail = Tail.from_flights(np.log(np.maximum(values, _LEAST))).with_usual(excess)
            # Never below what the training flights reached.
            limit = max(tail.limit(0.5 * alarms_per_flight / known), 0.0)
            limits[k] = float(np.exp(limit))
            alarms = alarms + tail.chances(limit, random)
    return _Ends.between(usual).margin(far, envelope), limits[0], limits[1], alarms


class _Ends(NamedTuple):
    """Ends of the ranges of flights: their medians (19,) and spreads (19,) between flights."""

    lower: Array
    lower_spread: Array
    upper: Array
    upper_spread: Array

    @classmethod
    def between(cls, flights: Sequence[LeftOut]) -> _Ends:
        """Of at least two flights."""
        # Few flights tell each spread poorly: what ends have in common, in widths, counts as some flights.
        ends = np.array([(flight.lower, flight.upper) for flight in flights])
        width, freedom = Envelope.extent(ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)), len(flights) - 1
        own = (ends.std(axis=0, ddof=1) / width) ** 2
        differ = own > _ALIKE**2
        common = float(own[differ].mean()) if differ.any() else 0.0
        square = np.maximum((USUAL_FLIGHTS * common + freedom * own) / (USUAL_FLIGHTS + freedom), _ALIKE**2)
        (lower, upper), (below, above) = np.median(ends, axis=0), width * np.sqrt(square)
        return cls(lower, below, upper, above)

    def passed_by(self, inputs: Array) -> Array:
        """How far (N,) the worst of inputs (N, 19) lies beyond the median of its ends, in their spread."""
        passed = np.maximum(
            (self.lower - inputs) / self.lower_spread, (inputs - self.upper) / self.upper_spread
        )
        return passed.max(axis=1)

    def margin(self, far: float, envelope: Envelope) -> Array:
        """Margins (19,) of the envelope that reach as many spreads beyond the medians; none is negative."""
        reach = np.array([self.lower - far * self.lower_spread, self.upper + far * self.upper_spread])
        return envelope.input_excess(reach).max(axis=0)


class LiveErrors(NamedTuple):
    """Held-out errors on one flight as the live path would make them.

    Attributes:
        rows: (M,) indices of the samples of the flight.
        errors: by axis held, of these samples.
    """

    rows: npt.NDArray[np.int64]
    errors: dict[str, FlightErrors]


def live_errors(
    flights: Sequence[Judged],
    held_out: Mapping[str, Sequence[FlightErrors]],
    evaluate: Callable[[Array, Records], Evaluation],
) -> list[LiveErrors]:
    """Errors that the live path would make on each flight, left out.

    Held-out errors, spread and leverage are known for the smoothed states. The causal states of the live path
    change them; that change is taken from the model of all flights, since to first order in the error of the
    state it is the same for the model without the flight.

    Args:
        flights: of the identification.
        held_out: by axis held, the held-out errors on each flight; all samples or every k-th.
        evaluate: the model of all flights, of inputs (M, 19) and derivatives (M,).
    """
    live = []
    for k, flight in enumerate(flights):
        errors = {axis: of_flights[k] for axis, of_flights in held_out.items()}
        step = -(-len(flight.time) // len(next(iter(errors.values())).error))
        known = flight.judged.known[::step]
        rows = np.arange(0, len(flight.time), step)[known]
        changes = _changes(flight, rows, evaluate)
        live.append(
            LiveErrors(rows, {axis: changes.of(one, known, AXES.index(axis)) for axis, one in errors.items()})
        )
    return live


def left_out(
    flights: Sequence[Judged],
    rules: Mapping[str, HeldOutRule],
    live: Sequence[LiveErrors],
    confidence: float,
) -> list[LeftOut]:
    """Signals of the alarm on each flight of an identification, left out, on the live path.

    Args:
        flights: of the identification.
        rules: by axis held.
        live: as :func:`live_errors` gives it.
        confidence: of the intervals.
    """
    misses = {
        axis: rule.held_out_misses([one.errors[axis] for one in live], confidence)
        for axis, rule in rules.items()
    }
    signals = []
    for k, (flight, (rows, errors)) in enumerate(zip(flights, live, strict=True)):
        leverage, width = np.zeros((2, len(rows), len(AXES)))
        miss = np.full((len(rows), len(AXES)), np.nan)
        for axis, now in errors.items():
            column = AXES.index(axis)
            width[:, column] = 0.0 if now.width is None else now.width
            leverage[:, column] = 0.0 if now.leverage is None else now.leverage
            miss[:, column] = misses[axis][k]
        signals.append(
            LeftOut(
                flight.time[rows],
                flight.judged.inputs[rows],
                *Envelope.flight_range(flight.inputs),
                leverage,
                width,
                miss,
            )
        )
    return signals


class _Changes(NamedTuple):
    """Change by the live states, (M, 6) each: added to the error, and factors of spread and leverage."""

    error: Array
    spread: Array
    leverage: Array

    def of(self, errors: FlightErrors, known: npt.NDArray[np.bool_], column: int) -> FlightErrors:
        """Errors of the live path, at the samples that it can judge."""
        spread = self.spread[:, column]
        return FlightErrors(
            errors.error[known] + self.error[:, column],
            errors.spread[known] * spread,
            errors.inside[known],
            None if errors.width is None else errors.width[known] * spread,
            None if errors.leverage is None else errors.leverage[known] * self.leverage[:, column],
        )


def _changes(flight: Judged, rows: Any, evaluate: Callable[[Array, Records], Evaluation]) -> _Changes:
    was, now = (evaluate(of.inputs[rows], of.derivatives[rows]) for of in (flight, flight.judged))
    error = flight.judged.wrench[rows] - 0.5 * (now.lower + now.upper)
    return _Changes(
        error - (flight.wrench[rows] - 0.5 * (was.lower + was.upper)),
        _ratio(now.relative_width, was.relative_width),
        _ratio(now.leverage, was.leverage),
    )


def _ratio(now: Array, was: Array) -> Array:
    """1 where there is no such signal."""
    return np.divide(now, was, out=np.ones_like(now), where=was > 0.0)


def ranges_of_others(flights: Sequence[LeftOut]) -> list[tuple[Array, Array]]:
    """Range of the inputs (19,), (19,) over all flights but one, for each."""
    lower, upper = np.array([(flight.lower, flight.upper) for flight in flights]).swapaxes(0, 1)
    every = range(len(flights))
    return [(np.delete(lower, k, 0).min(axis=0), np.delete(upper, k, 0).max(axis=0)) for k in every]


def _share_inside(flight: LeftOut, others: tuple[Array, Array]) -> float:
    inside = np.all(inside_interval(flight.inputs, *others), axis=1)
    return float(inside.sum() / max(len(inside), 1))


def hover_rotor_speed(inputs: Array, wrench: Array, weight: float) -> float:
    """Mean rotor speed, rad/s, at which thrust, taken as a multiple of its square, carries the weight.

    Args:
        inputs: (N, 19) of flights.
        wrench: (N, 6) measured there.
        weight: N.
    """
    squares = np.square(inputs[:, INPUT_INDEX["omega_avg"]])
    thrust = -float(squares @ wrench[:, 2])
    return float(np.sqrt(weight * float(squares @ squares) / thrust)) if thrust > 0.0 else 0.0
