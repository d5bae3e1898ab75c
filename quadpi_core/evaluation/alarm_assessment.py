# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How good the alarm is on flights: false alarms, delay of detection, and how well each signal ranks misses.

A model is off at an instant if of the three seconds that follow, more than half of the samples of an axis
lie outside their interval. Detection is late by the time from the first such instant to the alarm; an alarm
that is raised already is not late.

A flight is outside the envelope while an input is beyond its warning limit (10 % of its training range). An
alarm that begins there is counted apart and never false: there the model promises nothing. One that begins
inside is false if no span of three seconds that contains its begin is off. Leverage and width do not define
what is outside, since the alarm uses them itself.

CHANGE has a rate by flight: it counts the flights on which it is raised, and says what it names.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import betaincinv, gammaincinv

from quadpi_core.core import compiled
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import LiveSamples
from quadpi_core.models.aerodynamic import AerodynamicModel, recorded_evaluation
from quadpi_core.models.alarm_limits import BOUND_CONFIDENCE, ChangeLimits
from quadpi_core.models.interval_rules import inside_interval
from quadpi_core.monitor.alarm import Alarm, MonitorSettings, NotJudgedReason, not_judged_reasons
from quadpi_core.monitor.alarm_log import reasons
from quadpi_core.monitor.change import AXIS_NOISE, BLOCK_S, OF_THRUST
from quadpi_core.monitor.preparation import Prepared, Verdict
from quadpi_core.records import brief_repr, record_dtype
from quadpi_core.results import CAUSES, CHANGE, LEVEL_ALARM, Alarms

# Fewest blocks of a flight, 1 s, and flights, that are compared.
_FEWEST_BLOCKS, _FEWEST_FLIGHTS = 10, 3
# Deviations of a difference that is told, the largest of those between all flights.
_TOLD = 4.0
# Least deviation that is told, N and Nm.
_FINEST = 1e-6
# What a residual to the positive and to the negative side says, and the unit.
_SIDES = {
    "Fx": ("more force forward", "more force backward", "mN"),
    "Fy": ("more force to the right", "more force to the left", "mN"),
    "Fz": ("more force downward", "more force upward", "mN"),
    "Mx": ("more moment to the right in roll", "more moment to the left in roll", "mNm"),
    "My": ("more moment nose up", "more moment nose down", "mNm"),
}


class Constant(NamedTuple):
    """A constant of a flight and its standard deviation, N or Nm."""

    value: float
    deviation: float


def flight_constants(limits: ChangeLimits, time: Array, errors: Array) -> dict[str, Constant]:
    """What a flight leaves of the model all the time, by axis: least squares with the noise of sound flights.

    Args:
        limits: of the model.
        time: (N,) s.
        errors: (N, 6) measured − predicted.
    """
    numbers, starts, counts = np.unique(
        np.floor(time / BLOCK_S).astype(np.int64), return_index=True, return_counts=True
    )
    if len(numbers) < _FEWEST_BLOCKS:
        return {}
    means = np.add.reduceat(errors, starts, axis=0) / counts[:, np.newaxis]
    constants = {}
    for axis, left in limits.axes.items():
        noise = np.zeros(1, AXIS_NOISE)
        for name in ("keep", "process", "white"):
            noise[name] = getattr(left, name)
        whitened, _, ones, _ = room = np.empty((4, len(numbers)))
        compiled.whiten_blocks(noise, np.ascontiguousarray(means[:, AXES.index(axis)]), numbers, *room)
        known = float(ones @ ones)
        value = float(ones @ whitened) / known
        spread = float(np.sqrt(np.mean(np.square(whitened - value * ones))))
        # The mean of a walk deviates by a third of the variance at its end.
        walked = left.walk * len(numbers) / 3.0
        constants[axis] = Constant(value, float(np.sqrt(spread * spread / known + walked)))
    return constants


def differences(flights: Mapping[str, Mapping[str, Constant]]) -> Iterator[str]:
    """Sentences on the flights that differ most from the others, one an axis, if by more than noise."""
    for axis, (positive, negative, unit) in _SIDES.items():
        of_axis = {name: constants[axis] for name, constants in flights.items() if axis in constants}
        if len(of_axis) < _FEWEST_FLIGHTS:
            continue
        names = sorted(of_axis, key=lambda name: of_axis[name].value)
        values, squares = np.array([(of_axis[name].value, of_axis[name].deviation ** 2) for name in names]).T
        split = int(np.argmax(np.diff(values))) + 1
        parts = (slice(0, split), slice(split, None))
        fewer, others = sorted(parts, key=lambda part: len(names[part]))
        difference = float(values[fewer].mean() - values[others].mean())
        variance = sum(float(squares[part].sum()) / len(names[part]) ** 2 for part in parts)
        gap = float(values[split] - values[split - 1])
        if gap <= _TOLD * float(np.sqrt(squares[split] + squares[split - 1])):
            continue
        side = positive if difference > 0.0 else negative
        unsure = max(float(np.sqrt(variance)), _FINEST)
        # To the first digit that is not sure.
        place = -math.floor(math.log10(1e3 * unsure))
        size, more_or_less = (f"{round(1e3 * of, place):g}" for of in (abs(difference), unsure))
        yield f"{', '.join(sorted(names[fewer]))}: {size} ± {more_or_less} {unit} {side} than the others"


SIGNALS = ("inputs", "leverage", "width", "miscoverage")
# Least monitored flight for a rate per hour: of less, a single alarm would make more than 60 per hour.
SHORTEST_HOURS = 1.0 / 60.0
_OFF_SHARE, _OFF_S = 0.5, 3.0
# A row of the alarm for every sample.
_EVERY_SAMPLE_HZ = 1e9


@dataclass(frozen=True)
class FlightAlarm:
    """The alarm at each sample of one flight.

    Attributes:
        scores: by name of :data:`SIGNALS` (N,), the worst input's or axis' value over its limit.
        raised: (N,) whether EXTRAPOLATION or MISCOVERAGE is at alarm level.
        missed: (N, 6) whether the measured wrench lay outside its interval, order as `AXES`.
        monitored: (N,) False where the alarm had no sample.
        outside: (N,) whether an input is outside the envelope: beyond its warning limit.
        change: what CHANGE says, nothing where it was not raised; None where it is not judged.
        constants: what the flight leaves of the model all the time, by axis.
    """

    __repr__ = brief_repr

    scores: Mapping[str, Array]
    raised: npt.NDArray[np.bool_]
    missed: npt.NDArray[np.bool_]
    monitored: npt.NDArray[np.bool_]
    outside: npt.NDArray[np.bool_]
    change: tuple[str, ...] | None = None
    constants: Mapping[str, Constant] = field(default_factory=dict)


def alarm_of_flight(
    model: AerodynamicModel, time: Array, live: LiveSamples, confidence: float
) -> FlightAlarm:
    """Run the alarm over a flight in the air.

    Args:
        model: with the limits of the alarm.
        time: (N,) s.
        live: the samples as a monitor would have had them.
        confidence: of the intervals.
    """
    known, wrench = live.known, live.wrench[live.known]
    inputs, derivatives = live.inputs[known], live.derivatives[known]
    evaluation = recorded_evaluation(model, time[known], inputs, derivatives, confidence)
    alarm = Alarm(
        model.envelope,
        # The flight was in the air all the time, as the alarm takes it without a rotor speed of hover.
        replace(model.alarm_limits, hover_rotor_speed=0.0),
        MonitorSettings(alarm_rate_hz=_EVERY_SAMPLE_HZ),
        held=np.array([axis in model.axes for axis in AXES]),
        interval_ratio=model.interval_ratio(confidence),
        vehicle=model.flown,
        change=model.change_limits,
    )
    samples = len(time)
    speeds = derivatives["rotor_speeds"]
    verdicts = np.zeros(samples, record_dtype(Verdict, speeds.shape[1]))
    verdicts["time_ns"] = np.round(1e9 * time)
    verdicts["usable"], verdicts["settled"] = known, True
    verdicts["rotor_speeds"][known] = speeds
    prepared = Prepared(verdicts, inputs, wrench, verdicts["time_ns"][known], derivatives)
    rows = alarm.step(prepared, evaluation)
    missed = np.zeros((samples, len(AXES)), dtype=np.bool_)
    missed[known] = ~inside_interval(wrench, evaluation.lower, evaluation.upper)
    outside = np.zeros(samples, dtype=np.bool_)
    beyond = model.envelope.input_excess(inputs) > model.envelope.near.margin
    outside[known] = beyond.any(axis=1)
    inside = ~beyond[:, ~OF_THRUST].any(axis=1)
    errors = wrench - 0.5 * (evaluation.lower + evaluation.upper)
    scores = (rows.input_score, rows.leverage, rows.width, rows.miscoverage)
    return FlightAlarm(
        {name: score.max(axis=1) for name, score in zip(SIGNALS, scores, strict=True)},
        (rows.cause_level[:, :2] == LEVEL_ALARM).any(axis=1),
        missed,
        known,
        outside,
        *_of_change(model, time[known][inside], errors[inside], rows),
    )


def _of_change(
    model: AerodynamicModel, time: Array, errors: Array, rows: Alarms
) -> tuple[tuple[str, ...] | None, dict[str, Constant]]:
    """What CHANGE says of a flight, and its constants."""
    if model.change_limits is None or model.flown is None:
        return None, {}
    raised = np.flatnonzero(rows.cause_level[:, CAUSES.index(CHANGE)] == LEVEL_ALARM)
    sentences = reasons(rows, int(raised[-1]), CHANGE) if len(raised) else ()
    return sentences, flight_constants(model.change_limits, time, errors)


@dataclass(frozen=True)
class Counted:
    """Number of alarms, and the hours that were monitored for them.

    Attributes:
        false_alarms, hours_inside: inside the envelope, while the model is not off.
        alarms_outside, hours_outside: outside the envelope, whether the model is off or not.
        hours_monitored: inside, outside and off.
        hours_flown: from lift-off to touch-down.
        hours_recorded: with the time on the ground.
    """

    false_alarms: int
    hours_inside: float
    alarms_outside: int
    hours_outside: float
    hours_monitored: float
    hours_flown: float
    hours_recorded: float

    @classmethod
    def total(cls, parts: Sequence[Counted]) -> Counted:
        """The sum over several flights."""
        return cls(*(sum(getattr(part, field.name) for part in parts) for field in fields(cls)))


@dataclass(frozen=True)
class Assessed:
    """One flight with its alarm and the misses that it should have detected.

    Attributes:
        time: (N,) s.
        missed: (N, A) whether the measured wrench lies outside the interval, per axis held.
        alarm: of the flight.
        recorded_s: that the recording lasts, with the time on the ground.
        name: of the flight.
    """

    time: Array
    missed: npt.NDArray[np.bool_]
    alarm: FlightAlarm
    recorded_s: float = 0.0
    name: str = ""

    def off(self) -> npt.NDArray[np.bool_]:
        """Instants (N,) at which the model is off."""
        return self._shares_above(np.searchsorted(self.time, self.time + _OFF_S))

    def _shares_above(self, stops: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        starts = np.arange(len(self.time))
        counts: Array = np.zeros((len(self.time) + 1, self.missed.shape[1]))
        np.cumsum(self.missed, axis=0, out=counts[1:])
        shares = (counts[stops] - counts[starts]) / np.maximum(stops - starts, 1)[:, None]
        whole = self.time + _OFF_S <= self.time[-1]
        return (shares > _OFF_SHARE).any(axis=1) & whole

    def delay_s(self) -> float | None:
        """Seconds from where the model is off to the alarm; infinite without one, None if it is never off."""
        off = self.off()
        if not off.any():
            return None
        start = int(np.argmax(off))
        raised = np.flatnonzero(self.alarm.raised[start:])
        return float(self.time[start + raised[0]] - self.time[start]) if len(raised) else float("inf")

    def counted(self) -> Counted:
        """Alarms inside and outside the envelope."""
        off = np.flatnonzero(self.off())
        bad = np.zeros(len(self.time) + 1)
        np.add.at(bad, off, 1.0)
        np.add.at(bad, np.searchsorted(self.time, self.time[off] + _OFF_S), -1.0)
        outside = self.alarm.outside
        inside = (np.cumsum(bad)[:-1] <= 0.0) & ~outside
        begins = self.alarm.raised & ~np.concatenate(([False], self.alarm.raised[:-1]))
        hours = np.diff(self.time, append=self.time[-1]) * self.alarm.monitored / 3600.0
        flown_s = float(self.time[-1] - self.time[0])
        return Counted(
            false_alarms=int(np.sum(begins & inside)),
            hours_inside=float(hours[inside].sum()),
            alarms_outside=int(np.sum(begins & outside)),
            hours_outside=float(hours[outside].sum()),
            hours_monitored=float(hours.sum()),
            hours_flown=flown_s / 3600.0,
            hours_recorded=max(self.recorded_s, flown_s) / 3600.0,
        )


def per_hour(count: float, hours: float) -> float | None:
    """A rate; None for less time than :data:`SHORTEST_HOURS`, which is too short to state one."""
    return count / hours if hours >= SHORTEST_HOURS else None


def rate_bound(events: int, hours: float) -> float | None:
    """Exact upper bound of a Poisson rate, at `BOUND_CONFIDENCE`: for no event, 3.0 over the time."""
    return float(gammaincinv(events + 1, BOUND_CONFIDENCE.value)) / hours if hours > 0.0 else None


def rate_interval(events: int, hours: float) -> tuple[float, float] | None:
    """Exact interval of a Poisson rate (Garwood 1936), at `BOUND_CONFIDENCE`; None without any time."""
    tail = 0.5 * (1.0 - BOUND_CONFIDENCE.value)
    if hours <= 0.0:
        return None
    low = float(gammaincinv(events, tail)) if events else 0.0
    return low / hours, float(gammaincinv(events + 1, 1.0 - tail)) / hours


@dataclass(frozen=True)
class AlarmAssessment(Counted):
    """How good the alarm is on flights.

    Attributes:
        not_judged_fraction: share of the recordings in which the model was not judged.
        not_judged_reasons: that it is made of, the largest first.
        false_alarms_per_hour: inside the envelope; None for too short a time to state a rate.
        false_alarms_per_hour_bound: upper bound of the rate that the time supports, see :func:`rate_bound`;
            None without any time.
        false_alarms_per_hour_interval: both ends of what the count leaves possible, see
            :func:`rate_interval`.
        flights_off: flights in which the model is off.
        flights_undetected: flights off in which no alarm followed.
        detection_delay_s: median delay in the other flights off; None without any.
        auroc: by name of :data:`SIGNALS`, area under the ROC curve of the signal for samples that lie outside
            their interval in any axis; None where all or none do.
        flights_judged: flights on which CHANGE is judged.
        flights_changed: of these, on which it is raised.
        flights_changed_bound: upper bound of the share of flights like these on which it is (Clopper and
            Pearson 1934, at `BOUND_CONFIDENCE`); None without any.
        changes: what it says there.
        differences: how flights differ in what they leave of the model all the time.
    """

    not_judged_fraction: float
    not_judged_reasons: tuple[NotJudgedReason, ...]
    false_alarms_per_hour: float | None
    false_alarms_per_hour_bound: float | None
    false_alarms_per_hour_interval: tuple[float, float] | None
    flights_off: int
    flights_undetected: int
    detection_delay_s: float | None
    auroc: Mapping[str, float | None]
    flights_judged: int = 0
    flights_changed: int = 0
    flights_changed_bound: float | None = None
    changes: tuple[str, ...] = ()
    differences: tuple[str, ...] = ()


def assess(flights: Sequence[Assessed]) -> AlarmAssessment:
    """How good the alarm is on flights, all of them together."""
    counted = Counted.total([flight.counted() for flight in flights])
    delays = [delay for flight in flights if (delay := flight.delay_s()) is not None]
    detected = [delay for delay in delays if np.isfinite(delay)]
    missed = np.concatenate([flight.missed.any(axis=1) for flight in flights])
    recorded = max(counted.hours_recorded, 1e-9)
    unjudged = {
        "on the ground, or without a state": counted.hours_recorded - counted.hours_flown,
        "the state settles, or no usable samples": counted.hours_flown - counted.hours_monitored,
    }
    reasons = not_judged_reasons({words: hours / recorded for words, hours in unjudged.items()})
    judged = [(flight.name, flight.alarm.change) for flight in flights if flight.alarm.change is not None]
    changed = [f"{name}: {'; '.join(said)}" for name, said in judged if said]
    return AlarmAssessment(
        **vars(counted),
        not_judged_fraction=sum(reason.fraction for reason in reasons),
        not_judged_reasons=reasons,
        false_alarms_per_hour=per_hour(counted.false_alarms, counted.hours_inside),
        false_alarms_per_hour_bound=rate_bound(counted.false_alarms, counted.hours_inside),
        false_alarms_per_hour_interval=rate_interval(counted.false_alarms, counted.hours_inside),
        flights_off=len(delays),
        flights_undetected=len(delays) - len(detected),
        detection_delay_s=float(np.median(detected)) if detected else None,
        auroc={
            name: auroc(np.concatenate([flight.alarm.scores[name] for flight in flights]), missed)
            for name in SIGNALS
        },
        flights_judged=len(judged),
        flights_changed=len(changed),
        flights_changed_bound=share_bound(len(changed), len(judged)),
        changes=tuple(changed),
        differences=tuple(differences({flight.name: flight.alarm.constants for flight in flights})),
    )


def share_bound(events: int, flights: int) -> float | None:
    """Exact upper bound of a share of flights, at `BOUND_CONFIDENCE`; None without flights."""
    if flights == 0:
        return None
    if events == flights:
        return 1.0
    return float(betaincinv(events + 1, flights - events, BOUND_CONFIDENCE.value))


def auroc(scores: Array, positive: npt.NDArray[np.bool_]) -> float | None:
    """Chance that the score (N,) of a positive is above that of another, ties half; None without both."""
    count = int(positive.sum())
    others = len(positive) - count
    if count == 0 or others == 0:
        return None
    _, place, counts = np.unique(scores, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - 0.5 * (counts - 1))[place]
    return float((ranks[positive].sum() - 0.5 * count * (count + 1)) / (count * others))
