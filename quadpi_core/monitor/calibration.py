# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of the alarm from flights left out in turn, to a stated rate of false alarms.

A flight that the model and the envelope of the others have not seen, but that lies mostly within their
ranges, is what the alarm must keep quiet on. For each signal (distance of the worst input, leverage and
width of the worst axis, the sequential test of each axis) the flights are cut into blocks of a few
seconds, and of each block only the largest value that lasts long enough to raise the alarm counts.
Beyond the highest tenth of these maxima the excess is taken to be exponential. For the sequential test
that is what theory says of a walk that drifts downward, with dependent steps too (Cramér and Lundberg;
Glynn and Whitt 1994); for the rest it is the generalised Pareto law with the shape that so few maxima
cannot tell set to zero.

The mean excess is taken at the upper end of its confidence interval, with twice as many degrees of freedom
as flights, not blocks. Where no theory gives the law, only flights that have a part in the excess count, by
their effective number (Kish 1965): where one flight in twelve makes all of it, little can be said of once in
an hour, and limits are wide.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from quadpi_core.compiled import njit
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import COSINES, INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.alarm_limits import FEWEST_FLIGHTS, AlarmLimits, allowance
from quadpi_core.models.envelope import LEVERAGE_HEADROOM, WIDTH_HEADROOM, Envelope, excess_of_cosine
from quadpi_core.models.evaluation import Evaluation
from quadpi_core.models.rules import FEWEST_INSIDE, FlightErrors, HeldOutRule
from quadpi_core.monitor.alarm import MonitorSettings
from quadpi_core.monitor.alarm_kernel import STEP_MAX_S
from quadpi_core.monitor.live import LiveSamples

# Long against the persistence and against what correlates the samples, short against a flight.
BLOCK_S = 5.0
# Confidence of the upper bound of the tail's mean.
_SURE = 0.8
# Thresholds that the lasting maximum of a block is looked for among.
_LEVELS = 200
# Share of the blocks that tells the tail, and least number of them, if need be up to half.
_TAIL_SHARE, _TAIL_BLOCKS = 0.1, 10
# Least mean excess, in training ranges, peaks or seconds: what never moved is no reason for a tight limit.
_LEAST_EXCESS = 0.02


class Judged(Protocol):
    """What is needed of a flight: what it was identified on, and what a monitor would have had of it."""

    @property
    def time(self) -> Array:
        """(N,) s."""

    @property
    def inputs(self) -> Array:
        """(N, 19) columns as `quadpi_core.inputs.INPUT_NAMES`."""

    @property
    def wrench(self) -> Array:
        """(N, 6) measured."""

    @property
    def judged(self) -> LiveSamples:
        """The same as the live path has it."""


@dataclass(frozen=True)
class LeftOut:
    """Signals of one flight under what the other flights support; columns zero for axes not held.

    Attributes:
        time: (N,) s.
        inputs: (N, 19) as the live path has them.
        lower, upper: (19,) :meth:`Envelope.flight_range` of the flight.
        leverage, width: (N, 6) over their peaks in the other flights.
        miss: (N, 6) whether the measured wrench left the interval, 0 or 1; NaN where not known.
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
        envelope: of all flights, with its plain limits; what it gives back has calibrated ones.
        flights: each under the model of the others, at least one.
        confidence: of the intervals that `miss` was told by.
        rate_per_hour: false alarms per flight hour.
        hover_rotor_speed: see :class:`~quadpi_core.models.alarm_limits.AlarmLimits`.
    """
    limits = AlarmLimits(
        allowance=allowance(confidence), hover_rotor_speed=hover_rotor_speed, rate_per_hour=rate_per_hour
    )
    if len(flights) < FEWEST_FLIGHTS:
        return envelope, limits
    usual = [
        (flight, others)
        for flight, others in zip(flights, _ranges_of_others(flights), strict=True)
        if _share_inside(flight, others) >= FEWEST_INSIDE
    ]
    if len(usual) < FEWEST_FLIGHTS:
        return envelope, limits
    times = [flight.time for flight, _ in usual]
    usual_axes = ~np.isnan(usual[0][0].miss[0])
    settings = MonitorSettings()
    lasting = (settings.persistence_s, settings.release_s)
    of_each = [
        [_input_distance(flight.inputs, others).max(axis=1) for flight, others in usual],
        [flight.leverage.max(axis=1) for flight, _ in usual],
        [flight.width.max(axis=1) for flight, _ in usual],
    ]
    known = [series for series in of_each if any(np.any(values) for values in series)]
    rate = 0.5 * rate_per_hour / len(known)
    # What the training flights reached is never beyond.
    ratio, leverage, width = (
        max(_Tail.of(series, times, lasting).limit(rate), 1.0)
        if any(np.any(values) for values in series)
        else None
        for series in of_each
    )
    calibrated = replace(
        envelope,
        margin=np.full(len(INPUT_NAMES), 0.5 * ((ratio or 1.0) - 1.0)),
        leverage_limit=envelope.of_peak(envelope.leverage_peak, leverage or LEVERAGE_HEADROOM),
        width_limit=envelope.of_peak(envelope.width_peak, width or WIDTH_HEADROOM),
    )
    sums = [_sums(flight.time, flight.miss, limits.allowance) for flight, _ in usual]
    misses = limits.miscoverage_s.copy()
    tails = {k: _Tail.of([s[:, k] for s in sums], times, None) for k in np.flatnonzero(usual_axes)}
    pooled = float(np.mean([tail.mean for tail in tails.values()]))
    for axis, tail in tails.items():
        # Which axes fail in which manoeuvre takes more flights to tell than how they do.
        misses[axis] = replace(tail, mean=max(tail.mean, pooled)).limit(0.5 * rate_per_hour / len(tails))
    return calibrated, replace(
        limits,
        miscoverage_s=misses,
        flights=len(usual),
        hours=sum(float(time[-1] - time[0]) for time in times) / 3600.0,
    )


class LiveErrors(NamedTuple):
    """One flight, left out, as the live path would have had it.

    Attributes:
        rows: (M,) which of its samples these are.
        errors: by axis held, of M samples.
    """

    rows: npt.NDArray[np.int64]
    errors: dict[str, FlightErrors]


def live_errors(
    flights: Sequence[Judged],
    held_out: Mapping[str, Sequence[FlightErrors]],
    evaluate: Callable[[Array], Evaluation],
) -> list[LiveErrors]:
    """Errors on each flight, left out, of the live path.

    Errors, spread and leverage of a flight left out are known for the smoothed states that it would have been
    identified on. What the causal states of the live path change of them, the model of all flights tells: to
    first order in the error of the state, one flight more or less makes no difference to that.

    Args:
        flights: that were identified on.
        held_out: by axis held, the errors on each flight, left out; every so manieth sample of it.
        evaluate: the model of all flights.
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
    """Signals of the flights of an identification, each left out, on the live path.

    Args:
        flights: that were identified on.
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
    """What live states change, (M, 6) each: added to the error, and factors of spread and leverage."""

    error: Array
    spread: Array
    leverage: Array

    def of(self, errors: FlightErrors, known: npt.NDArray[np.bool_], column: int) -> FlightErrors:
        """The errors at the samples that the live path knows, as it has them."""
        spread = self.spread[:, column]
        return FlightErrors(
            errors.error[known] + self.error[:, column],
            errors.spread[known] * spread,
            errors.inside[known],
            None if errors.width is None else errors.width[known] * spread,
            None if errors.leverage is None else errors.leverage[known] * self.leverage[:, column],
        )


def _changes(flight: Judged, rows: Any, evaluate: Callable[[Array], Evaluation]) -> _Changes:
    was, now = evaluate(flight.inputs[rows]), evaluate(flight.judged.inputs[rows])
    error = flight.judged.wrench[rows] - 0.5 * (now.lower + now.upper)
    return _Changes(
        error - (flight.wrench[rows] - 0.5 * (was.lower + was.upper)),
        _ratio(now.relative_width, was.relative_width),
        _ratio(now.leverage, was.leverage),
    )


def _ratio(now: Array, was: Array) -> Array:
    """1 where there is no such signal."""
    return np.divide(now, was, out=np.ones_like(now), where=was > 0.0)


def _ranges_of_others(flights: Sequence[LeftOut]) -> list[tuple[Array, Array]]:
    """Range of the inputs (19,), (19,) over all flights but one, for each."""
    lower, upper = np.array([(flight.lower, flight.upper) for flight in flights]).swapaxes(0, 1)
    ranges = []
    for k in range(len(flights)):
        others = np.arange(len(flights)) != k
        ranges.append((lower[others].min(axis=0), upper[others].max(axis=0)))
    return ranges


def _share_inside(flight: LeftOut, others: tuple[Array, Array]) -> float:
    if len(flight.inputs) == 0:
        return 0.0
    lower, upper = others
    return float(np.mean(np.all((flight.inputs >= lower) & (flight.inputs <= upper), axis=1)))


def _input_distance(inputs: Array, others: tuple[Array, Array]) -> Array:
    """Distance (N, 19) of inputs from the middle of a range over half of it."""
    lower, upper = others
    half = 0.5 * Envelope.extent(lower, upper)
    distance: Array = np.abs(inputs - 0.5 * (lower + upper)) / half
    outside = np.maximum(0.5 * (distance - 1.0), 0.0)
    return np.where(COSINES & (outside > 0.0), 1.0 + 2.0 * excess_of_cosine(outside), distance)


@dataclass(frozen=True)
class _Tail:
    """Block maxima of a signal beyond `start`: `per_hour` of them, with an exponential excess."""

    start: float
    mean: float
    per_hour: float

    @classmethod
    def of(
        cls, series: Sequence[Array], times: Sequence[Array], lasting: tuple[float, float] | None
    ) -> _Tail:
        """Tail of a signal.

        Args:
            series: (N,) per flight.
            times: (N,) s per flight.
            lasting: persistence and release in seconds; None for a signal that raises at once.
        """
        maxima = []
        for values, time in zip(series, times, strict=True):
            starts = _block_starts(time)
            if lasting is None:
                maxima.append(np.maximum.reduceat(values, starts))
            else:
                levels = np.linspace(np.quantile(values, 0.5), values.max(), _LEVELS)
                maxima.append(_lasting_maxima(values, _steps(time), starts, levels, *lasting))
        ordered = np.sort(np.concatenate(maxima))[::-1]
        blocks = len(ordered)
        count = min(max(int(_TAIL_SHARE * blocks), _TAIL_BLOCKS), blocks // 2)
        start = float(ordered[count])
        hours = sum(float(time[-1] - time[0]) for time in times) / 3600.0
        excess = np.array([np.maximum(of_flight - start, 0.0).sum() for of_flight in maxima])
        total = float(excess.sum())
        if total == 0.0:
            return cls(start, _LEAST_EXCESS, count / hours)
        # A walk is exponential whatever the flights.
        flights = float(len(series)) if lasting is None else total**2 / float(np.sum(excess**2))
        freedom = 2.0 * flights
        unsure = freedom / float(chi2.ppf(1.0 - _SURE, freedom))
        return cls(start, max(total / count * unsure, _LEAST_EXCESS), count / hours)

    def limit(self, rate_per_hour: float) -> float:
        """Level that is passed so often."""
        folds = float(np.log(max(self.per_hour / rate_per_hour, 1.0)))
        return self.start + self.mean * folds


def _block_starts(time: Array) -> Any:
    """First samples of blocks of about :data:`BLOCK_S`."""
    count = max(round(float(time[-1] - time[0]) / BLOCK_S), 1)
    return np.linspace(0, len(time), count, endpoint=False).astype(np.int64)


def _sums(time: Array, miss: Array, allowed: float) -> Array:
    """The sequential test (N, 6) of a flight, without its end at the limit."""
    sums = np.empty(miss.shape)
    _sums_kernel(_steps(time), miss, allowed, sums)
    return sums


def _steps(time: Array) -> Array:
    """Seconds (N,) since the sample before; a gap counts as a moment, as the alarm has it."""
    steps = np.diff(time, prepend=time[0])
    return np.minimum(steps, max(float(np.median(steps)), STEP_MAX_S))


@njit(cache=True)
def _sums_kernel(steps: Any, miss: Any, allowed: float, sums: Any) -> None:
    for axis in range(miss.shape[1]):
        total = 0.0
        for i in range(steps.size):
            if not np.isnan(miss[i, axis]):
                total = max(0.0, total + steps[i] * (miss[i, axis] - allowed))
            sums[i, axis] = total


@njit(cache=True)
def _lasting_maxima(
    worst: Any, steps: Any, starts: Any, levels: Any, persistence_s: float, release_s: float
) -> Any:
    """Per block the highest of the levels (L,), ascending, that a signal passes for long enough."""
    maxima = np.full(starts.size, levels[0])
    charge = np.zeros(levels.size)
    for block in range(starts.size):
        stop = starts[block + 1] if block + 1 < starts.size else worst.size
        for i in range(max(starts[block], 1), stop):
            for k in range(levels.size):
                change = steps[i] / persistence_s if worst[i] > levels[k] else -steps[i] / release_s
                charge[k] = min(1.0, max(0.0, charge[k] + change))
                if charge[k] >= 1.0 - 1e-9:
                    maxima[block] = max(maxima[block], levels[k])
                elif charge[k] == 0.0 and worst[i] <= levels[k]:
                    # Nor can any higher level be charged.
                    break
    return maxima


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
