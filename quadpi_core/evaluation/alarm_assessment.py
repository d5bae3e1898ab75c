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
from dataclasses import dataclass, field, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import betaincinv, gammaincinv

from quadpi_core.core import compiled
from quadpi_core.flight import AXES, Stamps
from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.inputs import MEASURED, flown_in
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.alarm_limits import BOUND_CONFIDENCE, ChangeLimits
from quadpi_core.models.interval_rules import inside_interval
from quadpi_core.monitor.alarm import MonitorSettings, NotJudgedReason, not_judged_reasons
from quadpi_core.monitor.alarm_log import reasons
from quadpi_core.monitor.change import AXIS_NOISE, BLOCK_S, OF_THRUST
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.monitor.replay import monitored, recorded_flight
from quadpi_core.records import brief_repr
from quadpi_core.results import (
    CAUSES,
    CHANGE,
    EXTRAPOLATION,
    JUDGED,
    LEVEL_ALARM,
    MISCOVERAGE,
    NO_SAMPLES,
    NOT_BEGUN,
    SETTLES,
    UNCALIBRATED_WORDS,
    WHY_NOT_JUDGED,
    WIND_UNKNOWN,
)

# Fewest blocks of a flight, 1 s, and flights, that are compared.
_FEWEST_BLOCKS, _FEWEST_FLIGHTS = 10, 3
# Standard deviations by which flights have to differ; a group by its mean, if the gap to the others, over the
# spread within groups, is one that 3 to 5 % of n alike flights show, 1.2 (1 + 15 / (n - 2)), n from 5 to 60.
_TOLD, _GAP, _GAP_OF_FEW, _FEWEST_OF_GROUPS = 4.0, 1.2, 15.0, 5
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


def flight_constants(limits: ChangeLimits, time_ns: Stamps, errors: Array) -> dict[str, Constant]:
    """What a flight leaves of the model all the time, by axis: least squares with the noise of sound flights.

    Args:
        limits: of the model.
        time_ns: (N,) stamps.
        errors: (N, 6) measured − predicted.
    """
    numbers, starts, counts = np.unique(
        time_ns // round(1e9 * BLOCK_S), return_index=True, return_counts=True
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
        unsure = np.sqrt(sum(float(squares[part].sum()) / len(names[part]) ** 2 for part in parts))
        gap, unsure = float(values[split] - values[split - 1]), max(float(unsure), _FINEST)
        within = sum(float(values[part].var()) * len(names[part]) for part in parts) / (len(names) - 2)
        wide = _GAP * (1.0 + _GAP_OF_FEW / (len(names) - 2)) * np.sqrt(within)
        apart = gap > wide and len(names) >= _FEWEST_OF_GROUPS
        by_noise = gap > _TOLD * np.sqrt(squares[split] + squares[split - 1])
        if not by_noise and not (apart and abs(difference) > _TOLD * unsure):
            continue
        side = positive if difference > 0.0 else negative
        # To the first digit that is not sure.
        place = -math.floor(math.log10(1e3 * unsure))
        size, more_or_less = (f"{round(1e3 * of, place):g}" for of in (abs(difference), unsure))
        yield f"{', '.join(sorted(names[fewer]))}: {size} ± {more_or_less} {unit} {side} than the others"


SIGNALS = ("inputs", "leverage", "width", "miscoverage")
# Least monitored flight for a rate per hour: of less, a single alarm would make more than 60 per hour.
SHORTEST_HOURS = 1.0 / 60.0
_OFF_SHARE, _OFF_S = 0.5, 3.0
_OF_MODEL = [CAUSES.index(cause) for cause in (EXTRAPOLATION, MISCOVERAGE)]
_EVERY_SAMPLE_HZ = 1e9  # of rows of the alarm


@dataclass(frozen=True)
class Counted:
    """Number of alarms, and the hours that were monitored for them.

    Attributes:
        false_alarms, hours_inside: inside the envelope, while the model is not off.
        alarms_outside, hours_outside: outside the envelope, whether the model is off or not.
        hours_monitored: inside, outside and off.
        hours_flown: in the air, from the first sample that a monitor has.
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
class FlightAlarm:
    """The alarm at each sample that a monitor has of a flight, as in a replay.

    Attributes:
        time: (N,) s since the first of them.
        scores: by name of :data:`SIGNALS` (N,), the worst input's or axis' value over its limit.
        raised: (N, 4) whether a cause is at alarm level, order as `results.CAUSES`.
        missed: (N, A) whether the measured wrench lay outside its interval, by axis that the model holds.
        why_not_judged: (N,) keys of `results.WHY_NOT_JUDGED`, or JUDGED.
        outside: (N,) whether an input is outside the envelope: beyond its warning limit.
        change: what CHANGE says, nothing where it was not raised; None where it is not judged.
        constants: what the flight leaves of the model all the time, by axis.
        name: of the flight.
        recorded_s: that the recording lasts, with the time on the ground.
    """

    __repr__ = brief_repr

    time: Array
    scores: Mapping[str, Array]
    raised: npt.NDArray[np.bool_]
    missed: npt.NDArray[np.bool_]
    why_not_judged: npt.NDArray[np.int64]
    outside: npt.NDArray[np.bool_]
    change: tuple[str, ...] | None = None
    constants: Mapping[str, Constant] = field(default_factory=dict)
    name: str = ""
    recorded_s: float = 0.0

    def hours(self, *why: int) -> Array:
        """Hours (N,) until the next sample, 0 unless `why_not_judged` has one of these keys."""
        hours = np.diff(self.time, append=self.time[-1]) / 3600.0
        return hours * np.isin(self.why_not_judged, why)

    @property
    def _doubted(self) -> npt.NDArray[np.bool_]:
        """(N,) whether EXTRAPOLATION or MISCOVERAGE is raised."""
        return np.asarray(self.raised[:, _OF_MODEL].any(axis=1))

    def off(self) -> npt.NDArray[np.bool_]:
        """Instants (N,) at which the model is off."""
        starts, stops = np.arange(len(self.time)), np.searchsorted(self.time, self.time + _OFF_S)
        counts: Array = np.zeros((len(self.time) + 1, self.missed.shape[1]))
        np.cumsum(self.missed, axis=0, out=counts[1:])
        shares = (counts[stops] - counts[starts]) / np.maximum(stops - starts, 1)[:, None]
        whole = self.time + _OFF_S <= self.time[-1]
        return (shares > _OFF_SHARE).any(axis=1) & whole

    def delay_s(self) -> float | None:
        """Seconds from where the model is off to the alarm; infinite without one, None if it is never off."""
        if not (off := self.off()).any():
            return None
        start = int(np.argmax(off))
        raised = np.flatnonzero(self._doubted[start:])
        return float(self.time[start + raised[0]] - self.time[start]) if len(raised) else float("inf")

    def counted(self) -> Counted:
        """Alarms inside and outside the envelope."""
        off = np.flatnonzero(self.off())
        bad = np.zeros(len(self.time) + 1)
        np.add.at(bad, off, 1.0)
        np.add.at(bad, np.searchsorted(self.time, self.time[off] + _OFF_S), -1.0)
        inside = (np.cumsum(bad)[:-1] <= 0.0) & ~self.outside
        begins = self._doubted & ~np.concatenate(([False], self._doubted[:-1]))
        hours = self.hours(JUDGED)
        return Counted(
            false_alarms=int(np.sum(begins & inside)),
            hours_inside=float(hours[inside].sum()),
            alarms_outside=int(np.sum(begins & self.outside)),
            hours_outside=float(hours[self.outside].sum()),
            hours_monitored=float(hours.sum()),
            hours_flown=float(self.hours(JUDGED, SETTLES, WIND_UNKNOWN, NO_SAMPLES).sum()),
            hours_recorded=max(self.recorded_s, float(self.time[-1])) / 3600.0,
        )


def alarm_of_flight(model: AerodynamicModel, flight: PreparedFlight, confidence: float) -> FlightAlarm | None:
    """Run the monitor over a flight, as a replay does; None for one of which no recording is left.

    Args:
        model: with the limits of the alarm.
        flight: of its vehicle.
        confidence: of the intervals.
    """
    if flight.recording is None:
        return None
    vehicle = model.load_vehicle()
    monitor = Monitor(model, vehicle, None, confidence, MonitorSettings(alarm_rate_hz=_EVERY_SAMPLE_HZ))
    # Arrays give the density of the air apart from the recording.
    apart = flight.air == MEASURED and flown_in(flight.recording) is None
    density = vehicle.air_density_kg_m3 * (1.0 + float(flight.derivatives["density_excess"][0]))
    said, rows = [], []
    change: tuple[str, ...] = ()
    for stretch, conditions in monitored(recorded_flight(flight.recording, vehicle), [monitor]):
        if apart:
            monitor.fly_in(density)
        own, alarms, _ = monitor.step(*stretch.samples, conditions)
        said.append((own.time_ns.copy(), *np.stack((own.measured, own.lower, own.upper))))
        levels, beyond = alarms.cause_level == LEVEL_ALARM, alarms.input_excess > model.envelope.near.margin
        scores = (alarms.input_score, alarms.leverage, alarms.width, alarms.miscoverage)
        worst = [score.max(axis=1) for score in scores]
        rows.append((alarms.time_ns.copy(), alarms.why_not_judged.copy(), levels, beyond, *worst))
        changed = np.flatnonzero(levels[:, CAUSES.index(CHANGE)])
        change = reasons(alarms, int(changed[-1]), CHANGE) if len(changed) else change
    stamps, wrench, lower, upper = map(np.concatenate, zip(*said, strict=True))
    time_ns, why, raised, outside, *signals = map(np.concatenate, zip(*rows, strict=True))
    at = np.searchsorted(time_ns, stamps)
    missed = np.zeros((len(time_ns), len(AXES)), dtype=np.bool_)
    known = why[at] == JUDGED
    missed[at[known]] = ~inside_interval(wrench, lower, upper)[known]
    limits, constants = model.change_limits, {}
    if limits is not None:
        known &= ~outside[at][:, ~OF_THRUST].any(axis=1)
        constants = flight_constants(limits, stamps[known], (wrench - 0.5 * (lower + upper))[known])
    return FlightAlarm(
        1e-9 * (time_ns - time_ns[0]),
        dict(zip(SIGNALS, signals, strict=True)),
        raised,
        missed[:, [AXES.index(axis) for axis in model.axes]],
        why,
        np.asarray(outside.any(axis=1)),
        None if limits is None else change,
        constants,
        flight.name,
        1e-9 * float(np.ptp(flight.recording.imu.time_ns)),
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


def assess(flights: Sequence[FlightAlarm]) -> AlarmAssessment:
    """How good the alarm is on flights, all of them together."""
    counted = Counted.total([flight.counted() for flight in flights])
    delays = [delay for flight in flights if (delay := flight.delay_s()) is not None]
    detected = [delay for delay in delays if np.isfinite(delay)]
    known = np.concatenate([flight.why_not_judged for flight in flights]) == JUDGED
    missed = np.concatenate([flight.missed.any(axis=1) for flight in flights])[known]
    recorded = max(counted.hours_recorded, 1e-9)
    unjudged = {
        words: float(sum(flight.hours(key).sum() for flight in flights))
        for key, words in WHY_NOT_JUDGED.items()
    }
    unjudged[NOT_BEGUN] = counted.hours_recorded - counted.hours_monitored - sum(unjudged.values())
    reasons = not_judged_reasons({words: hours / recorded for words, hours in unjudged.items()})
    judged = [(flight.name, flight.change) for flight in flights if flight.change is not None]
    # What that means is said once for all of them.
    short = {UNCALIBRATED_WORDS: UNCALIBRATED_WORDS.split(":")[0]}
    changed = [f"{name}: {'; '.join(short.get(one, one) for one in said)}" for name, said in judged if said]
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
            name: auroc(np.concatenate([flight.scores[name] for flight in flights])[known], missed)
            for name in SIGNALS
        },
        flights_judged=len(judged),
        flights_changed=len(changed),
        flights_changed_bound=share_bound(len(changed), len(judged)),
        changes=tuple(changed),
        differences=tuple(differences({flight.name: flight.constants for flight in flights})),
    )


def share_bound(events: int, flights: int) -> float | None:
    """Exact upper bound of a share of flights, at `BOUND_CONFIDENCE`; None without flights."""
    if events == flights:
        return 1.0 if flights else None
    return float(betaincinv(events + 1, flights - events, BOUND_CONFIDENCE.value))


def auroc(scores: Array, positive: npt.NDArray[np.bool_]) -> float | None:
    """Chance that the score (N,) of a positive is above that of another, ties half; None without both."""
    count, others = int(positive.sum()), int((~positive).sum())
    if count == 0 or others == 0:
        return None
    _, place, counts = np.unique(scores, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - 0.5 * (counts - 1))[place]
    return float((ranks[positive].sum() - 0.5 * count * (count + 1)) / (count * others))
