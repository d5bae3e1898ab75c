# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From evidence per sample to an alarm of four causes, with persistence and hysteresis, O(1) per sample.

Every signal is a score, its value over its limit. A charge fills while there is evidence, within
`persistence_s`, and drains without, within `release_s`: evidence with short gaps still counts, single samples
change nothing and the level does not chatter.

EXTRAPOLATION has two charges. A signal beyond its near limit, a plain fraction outside of what training has
shown, charges the warning; one beyond the limit of a stated rate of false alarms (a score above 1) the alarm.
Either is raised when its charge is full and cleared when it is empty. No warning comes after its alarm, as
the near limit is never the farther one; where no flights calibrated the limits they are the same.

BAD_DATA has one charge, filled by faults: an alarm when it is full, a warning from half full on, until it is
empty. A single sample that cannot be judged charges it to one half at once: it is reported, and becomes an
alarm if more follow.

MISCOVERAGE is a sequential test per axis (Page 1954): S ← max(0, S + dt (miss − k)), with the model's own
interval and k between the allowed share of misses and the alternative (`models.alarm_limits`). Its score, S
over its limit, takes the place of the charge: full at 1, half full at ½, empty at ¼.

CHANGE is evidence by the sizes of the residuals that the vehicle is not that of the flights
(`monitor.change`). It has no warning, and an alarm stands until the vehicle lands. Samples beyond a near
limit are evidence of a load alone.

On the ground neither EXTRAPOLATION nor MISCOVERAGE is judged, for there the wrench is not aerodynamic; what
`monitor.alarm_kernel` takes for flying is. A vehicle that moves with all rotors at 0 is half of the charge of
BAD_DATA: it is carried, or there is no telemetry. A rotor that stops (`monitor.alarm_kernel`) is an alarm of
MISCOVERAGE at once, and no fault of its sensor.
While the state settles (`monitor.preparation.SETTLE_NS`) of the sums of MISCOVERAGE that of Fz alone changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.flight import MAX_JUMP_BACK_NS, Stamps
from quadpi_core.frames import Array
from quadpi_core.models.alarm_limits import AlarmLimits, ChangeLimits
from quadpi_core.models.envelope import Envelope
from quadpi_core.monitor import alarm_kernel as kernel
from quadpi_core.monitor.alarm_kernel import geometry_record
from quadpi_core.monitor.change import found_columns, sound_noise
from quadpi_core.records import Records
from quadpi_core.results import (
    ACTIVE,
    BAD_DATA,
    CAUSES,
    LEVEL_ALARM,
    NO_SAMPLES,
    NOT_BEGUN,
    UNAVAILABLE,
    UNCALIBRATED,
    WHY_NOT_JUDGED,
    Alarms,
)
from quadpi_core.vehicle import Vehicle


@dataclass(frozen=True)
class MonitorSettings:
    """How quickly the alarm follows the evidence, how often its state is published, which intervals go out.

    Attributes:
        persistence_s: of evidence, before a warning or an alarm is raised.
        release_s: without evidence, before it is cleared.
        alarm_rate_hz: of the alarm's state between changes.
        adaptive: publish intervals that adapt to the measured wrench (:mod:`quadpi_core.monitor.adaptive`)
            instead of the model's own. The alarm goes by the model's own either way.
        change: judge CHANGE.

    Raises:
        ArgumentError: for a time or rate that is not positive, and what is neither true nor false.
    """

    persistence_s: float = 0.1
    release_s: float = 0.5
    alarm_rate_hz: float = 10.0
    adaptive: bool = False
    change: bool = True

    def __post_init__(self) -> None:
        for name in ("persistence_s", "release_s", "alarm_rate_hz"):
            array_checks.number(f"monitor setting {name}", getattr(self, name), above=0.0)
        for name in ("adaptive", "change"):
            array_checks.instance(f"monitor setting {name}", getattr(self, name), bool)


class Alarm:
    """The alarm of one vehicle: rows at every change, and at a steady rate by stamps in between.

    A row comes when the level or health of a cause changes, when one more input leaves the envelope or one
    more fault shows while the level is not ok, and at the first sample of each period of `alarm_rate_hz`. Its
    evidence is the largest since the row before it.

    Args:
        envelope: of the model, with its limits.
        limits: the other limits.
        settings: how quickly it follows.
        held: (6,) axes that the model holds; all unless given.
        interval_ratio: (6,) width of the intervals that the limits were calibrated with over the width of
            those that it will be given.
        vehicle: whose rotors may stop, and that may change; without one neither is watched.
        change: what sound flights leave of the model; without it CHANGE is not judged.

    Attributes:
        limits: :class:`.alarm_kernel.Limits` (1,).
        state: :class:`.alarm_kernel.State` (1,), which compiled code changes in place.
        no_rows: what most samples give.
    """

    def __init__(
        self,
        envelope: Envelope,
        limits: AlarmLimits,
        settings: MonitorSettings,
        held: npt.NDArray[np.bool_] | None = None,
        interval_ratio: Array | None = None,
        vehicle: Vehicle | None = None,
        change: ChangeLimits | None = None,
    ) -> None:
        self._vehicle = vehicle
        near = envelope.near
        self.limits = np.zeros(1, kernel.LIMITS)
        for name, values in {
            "lower": envelope.lower,
            "upper": envelope.upper,
            "scale": envelope.scale,
            "distance": 1.0 + 2.0 * envelope.margin,
            "near_distance": 1.0 + 2.0 * near.margin,
            "leverage": envelope.leverage_limit,
            "near_leverage": near.leverage_limit,
            "width": envelope.width_limit,
            "near_width": near.width_limit,
            "miscoverage_s": np.where(True if held is None else held, limits.miscoverage_s, np.inf),
            "interval_ratio": 1.0 if interval_ratio is None else interval_ratio,
            "allowance": limits.allowance,
            "hover_square": limits.hover_rotor_speed * limits.hover_rotor_speed,
            "health_in_flight": ACTIVE if limits.calibrated else UNCALIBRATED,
        }.items():
            self.limits[name] = values
        self._change = sound_noise(change, vehicle)
        self.limits["rotors"]["rotors"] = 4
        if vehicle is not None:
            self.limits["rotors"] = geometry_record(vehicle, limits.hover_rotor_speed)
        # Limits of leverage and width over their peaks in training: a score times this is a multiple of the
        # peak.
        self._leverage_per_peak = envelope.leverage_limit * _inverse(envelope.leverage_peak)
        self._width_per_peak = envelope.width_limit * _inverse(envelope.width_peak)
        self.state = np.zeros(1, kernel.STATE)
        # Kept while it is not given to anyone: most samples fill no row, and numpy takes 1.4 µs to make one.
        self._rows = np.empty(0, kernel.ROW)
        self.no_rows = self.alarms(self._rows)
        self.change(settings)
        self.reset()

    def change(self, settings: MonitorSettings) -> None:
        """Update times, rates and what is judged in flight."""
        self.limits["change"] = self._change
        if not settings.change:
            self.limits["change"]["evidence"] = 0.0
        self.limits["persistence_s"] = settings.persistence_s
        self.limits["release_s"] = settings.release_s
        self.limits["period_ns"] = max(1, round(1e9 / settings.alarm_rate_hz))

    def reset(self) -> None:
        """Forget all evidence; the next sample gives a row."""
        kernel.forget(self.state)

    def room(self, samples: int) -> Records:
        """Room for the rows (K,) of as many samples, or more; :meth:`taken` takes those that were filled."""
        if len(self._rows) < samples:
            self._rows = np.empty(samples, kernel.ROW)
        return self._rows

    def taken(self, count: int) -> Alarms:
        """The first rows of :meth:`room`."""
        if not count:
            return self.no_rows
        # Whoever is given rows keeps them.
        rows, self._rows = self._rows[:count], self._rows[:0]
        return self.alarms(rows)

    def without_sample(self, time_ns: int) -> Alarms:
        """A row for an instant without a sample: BAD_DATA beside the causes raised; changes nothing."""
        row = self.state["row"].copy()
        bad_data = CAUSES.index(BAD_DATA)
        row["time_ns"], row["faults"], row["why_not_judged"] = time_ns, 0, NO_SAMPLES
        row["more_faults"] = 0
        row["level"] = row["cause_level"][:, bad_data] = LEVEL_ALARM
        row["causes"] |= BAD_DATA
        row["cause_health"] = UNAVAILABLE
        for name in ("leverage", "width", "miscoverage", "miss_share", "input_score", "input_excess"):
            row[name] = 0.0
        row["cause_evidence"] = 0.0
        row["cause_evidence"][:, bad_data] = 1.0
        return self.alarms(row)

    def alarms(self, rows: Records) -> Alarms:
        """Rows (M,) as the kernel filled them, with leverage and width in multiples of their peaks too."""
        columns = {name: rows[name] for name in kernel.ROW.names or () if name != "change"}
        columns |= found_columns(rows["change"], self._vehicle)
        for name in ("level", "causes", "cause_level", "cause_health"):
            columns[name] = rows[name].astype(np.uint8)
        return Alarms(
            **columns,
            leverage_ratio=rows["leverage"] * self._leverage_per_peak,
            width_ratio=rows["width"] * self._width_per_peak,
        )


def _inverse(peaks: Array) -> Array:
    """1 / peak (6,); 0 for axes that the model does not hold."""
    return np.divide(1.0, peaks, out=np.zeros_like(peaks), where=peaks > 0.0)


class AlarmTime(NamedTuple):
    """For how much of a flight the alarm was at a level or above, and from when on.

    Attributes:
        fraction: share of the time from the first alarm row to the end.
        first_ns: stamp of the first such row; None without one.
    """

    fraction: float
    first_ns: int | None

    def first_s(self, start_ns: int) -> float | None:
        """Seconds from a stamp to that row."""
        return None if self.first_ns is None else 1e-9 * (self.first_ns - start_ns)


def alarm_time(
    time_ns: Stamps, level: npt.NDArray[np.uint8], end_ns: int, at_least: int = LEVEL_ALARM
) -> AlarmTime:
    """Sum up alarm rows (M,), each of which holds until the next one, see :func:`held_ns`."""
    raised = level >= at_least
    durations = held_ns(time_ns, end_ns)
    fraction = float(durations[raised].sum() / max(durations.sum(), 1))
    return AlarmTime(fraction, int(time_ns[np.argmax(raised)]) if raised.any() else None)


@dataclass(frozen=True)
class NotJudgedReason:
    """Why a model was not judged, in words, and for what fraction of the flight."""

    reason: str
    fraction: float


def held_ns(time_ns: Stamps, end_ns: int) -> Stamps:
    """For how long each of the stamps (N,) holds: until the next one, the last until `end_ns`.

    A pause counts for MAX_JUMP_BACK_NS at most, as nothing is known of the rest; a fall of the clock for 0.
    """
    return np.clip(np.diff(time_ns, append=max(end_ns, int(time_ns[-1]))), 0, MAX_JUMP_BACK_NS)


def not_judged(
    time_ns: Stamps, why: npt.NDArray[np.int64], before_ns: int, end_ns: int
) -> tuple[NotJudgedReason, ...]:
    """Why, and for what shares of a flight, its coverage has no verdict, by alarm rows (M,).

    While the state settles, EXTRAPOLATION is judged all the same.

    Args:
        time_ns: of the rows.
        why: keys of `results.WHY_NOT_JUDGED`, or JUDGED.
        before_ns: length of the flight before the first row: no state, or no rotor speeds, yet.
        end_ns: of the flight.
    """
    durations = held_ns(time_ns, end_ns).astype(np.float64)
    before = float(before_ns)
    whole = max(before + float(durations.sum()), 1.0)
    shares = {NOT_BEGUN: before / whole}
    shares |= {words: float(durations[why == key].sum()) / whole for key, words in WHY_NOT_JUDGED.items()}
    return not_judged_reasons(shares)


def not_judged_reasons(shares: Mapping[str, float]) -> tuple[NotJudgedReason, ...]:
    """Reasons in words, with their shares of a flight, those above 0, the largest first."""
    largest_first = sorted(shares.items(), key=lambda item: -item[1])
    return tuple(NotJudgedReason(words, share) for words, share in largest_first if share > kernel.ROUNDING)
