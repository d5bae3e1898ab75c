# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From evidence per sample to an alarm of three causes, with persistence and hysteresis, O(1) per sample.

Every signal is a score, its value over its limit. What is charged fills while there is evidence, within
`persistence_s`, and drains without, within `release_s`: so evidence with short gaps still counts, one
sample inside changes nothing and nothing chatters.

EXTRAPOLATION keeps two charges. A signal beyond its near limit, a plain fraction outside of what training
has shown, charges the warning; one beyond the limit of a stated rate of false alarms (a score above 1) the
alarm. Either is raised when its charge is full and cleared when it is empty. No warning comes after its
alarm, as the near limit is never the farther one; where no flights calibrated the limits they are the same.

BAD_DATA keeps one charge, by faults: an alarm when it is full, a warning from half full on, until it is
empty. A single sample that cannot be judged charges it to one half at once: it is reported, and becomes
an alarm if more follow.

MISCOVERAGE is a sequential test per axis (Page 1954): S ← max(0, S + dt (miss − k)), with the model's
own interval and k between the allowed share of misses and the alternative (`models.alarm_limits`). S
over its limit is the score, and takes the place of the charge: full at 1, half full at ½, empty at ¼.

On the ground neither EXTRAPOLATION nor MISCOVERAGE is judged, for there the wrench is not aerodynamic.
While the state settles (`monitor.preparation.SETTLE_NS`) the sums of MISCOVERAGE stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import QuadpiError
from quadpi_core.flight import AXES, NO_STAMP, Stamps
from quadpi_core.frames import Array
from quadpi_core.models.alarm_limits import AlarmLimits
from quadpi_core.models.envelope import Envelope
from quadpi_core.monitor import alarm_kernel as kernel
from quadpi_core.results import (
    ACTIVE,
    BAD_DATA,
    CAUSES,
    LEVEL_ALARM,
    UNAVAILABLE,
    UNCALIBRATED,
    Alarms,
)


@dataclass(frozen=True)
class MonitorSettings:
    """How quickly the alarm follows the evidence, how often its state is published, which intervals go out.

    Attributes:
        persistence_s: of evidence, before a warning or an alarm is raised.
        release_s: without evidence, before it is cleared.
        alarm_rate_hz: of the alarm's state between changes.
        adaptive: publish intervals that adapt to the measured wrench (:mod:`quadpi_core.monitor.adaptive`)
            instead of the model's own. The alarm goes by the model's own either way.

    Raises:
        QuadpiError: for a time or rate that is not positive.
    """

    persistence_s: float = 0.1
    release_s: float = 0.5
    alarm_rate_hz: float = 10.0
    adaptive: bool = False

    def __post_init__(self) -> None:
        for name in ("persistence_s", "release_s", "alarm_rate_hz"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise QuadpiError(f"monitor setting {name} must be positive, found {value}")


class Judged(NamedTuple):
    """What the alarm goes by: U usable samples, in order; columns of axes as `AXES`, zero where not held.

    Attributes:
        inputs: (U, 19) input vectors.
        velocity: (U, 3) over ground, m/s.
        leverage, relative_width: (U, 6).
        measured, lower, upper: (U, 6) measured wrench and the model's own interval.
        settled: (U,) False while a state that has just begun, or come back, still errs: its misses say
            nothing of the model.
    """

    inputs: Array
    velocity: Array
    leverage: Array
    relative_width: Array
    measured: Array
    lower: Array
    upper: Array
    settled: npt.NDArray[np.bool_]


class Alarm:
    """Follows one vehicle; rows come at every change and at a steady rate by stamps in between.

    A row comes when the level or health of a cause changes, when one more input leaves the envelope or one
    more fault shows while the level is not ok, and at the first sample of each period of `alarm_rate_hz`. Its
    evidence is the largest since the row before it.

    Args:
        envelope: of the model, with its limits.
        limits: the other limits.
        settings: how quickly it follows.
        held: (6,) axes that the model holds; all unless given.
        interval_ratio: (6,) width of the intervals that the limits were calibrated with over the width of
            those that :meth:`step` will be given.
    """

    def __init__(
        self,
        envelope: Envelope,
        limits: AlarmLimits,
        settings: MonitorSettings,
        held: npt.NDArray[np.bool_] | None = None,
        interval_ratio: Array | None = None,
    ) -> None:
        misses = limits.miscoverage_s if held is None else np.where(held, limits.miscoverage_s, np.inf)
        near = envelope.near
        self._limits = np.zeros(kernel.LIMITS_SIZE)
        for place, values in (
            (kernel.LOWER, envelope.lower),
            (kernel.UPPER, envelope.upper),
            (kernel.SCALE, envelope.scale),
            (kernel.DISTANCE, 1.0 + 2.0 * envelope.margin),
            (kernel.NEAR_DISTANCE, 1.0 + 2.0 * near.margin),
            (kernel.LEVERAGE, envelope.leverage_limit),
            (kernel.WIDTH, envelope.width_limit),
            (kernel.NEAR_LEVERAGE, near.leverage_limit),
            (kernel.NEAR_WIDTH, near.width_limit),
            (kernel.MISSES, misses),
            (kernel.RATIO, np.ones(len(AXES)) if interval_ratio is None else interval_ratio),
        ):
            self._limits[place : place + len(values)] = values
        hover_square = limits.hover_rotor_speed**2
        self._limits[kernel.ALLOWANCE] = limits.allowance
        self._limits[kernel.LIFT_SQUARE] = kernel.LIFTED * hover_square
        self._limits[kernel.STAND_SQUARE] = kernel.STANDING * hover_square
        self._limits[kernel.RATED] = ACTIVE if limits.calibrated else UNCALIBRATED
        self._per_peak = (
            envelope.leverage_limit * _inverse(envelope.leverage_peak),
            envelope.width_limit * _inverse(envelope.width_peak),
        )
        self.change(settings)
        self.reset()

    def change(self, settings: MonitorSettings) -> None:
        """Go on with other times and rates."""
        self._limits[kernel.PERSISTENCE] = settings.persistence_s
        self._limits[kernel.RELEASE] = settings.release_s
        self._limits[kernel.PERIOD] = round(1e9 / settings.alarm_rate_hz)

    def reset(self) -> None:
        """Forget all evidence; the next sample gives a row."""
        self._state = np.zeros(kernel.STATE_SIZE)
        self._memory = np.zeros(kernel.MEMORY_SIZE, dtype=np.int64)
        self._memory[kernel.PREVIOUS] = NO_STAMP

    def step(
        self,
        time_ns: Stamps,
        usable: npt.NDArray[np.bool_],
        faults: npt.NDArray[np.int64],
        judged: Judged,
    ) -> Alarms:
        """Take K samples.

        Args:
            time_ns: (K,) stamps of all samples.
            usable: (K,) False for a sample that cannot be judged (BAD_DATA).
            faults: (K,) what is wrong with a sample, usable or not, bits of `monitor.data_quality`.
            judged: the usable samples.
        """
        integers = np.empty((len(time_ns), kernel.ROW_INTEGERS), dtype=np.int64)
        numbers = np.empty((len(time_ns), kernel.ROW_SIZE))
        count = kernel.advance(
            time_ns, usable, faults, *judged, self._limits, self._state, self._memory, integers, numbers
        )
        return _rows(integers[:count], numbers[:count], *self._per_peak) if count else _NO_ROWS

    def unheard(self, time_ns: int) -> Alarms:
        """A row for an instant without a sample: BAD_DATA, beside the causes that stand; changes nothing."""
        integers = self._memory[: kernel.ROW_INTEGERS].copy()
        integers[kernel.ROW_TIME], integers[kernel.ROW_FAULTS] = time_ns, 0
        integers[kernel.ROW_LEVEL] = LEVEL_ALARM
        integers[kernel.ROW_CAUSES] |= BAD_DATA
        integers[kernel.ROW_CAUSE_LEVEL + CAUSES.index(BAD_DATA)] = LEVEL_ALARM
        integers[kernel.ROW_HEALTH : kernel.ROW_FAULTS] = UNAVAILABLE
        numbers = np.zeros(kernel.ROW_SIZE)
        numbers[kernel.ROW_EVIDENCE + CAUSES.index(BAD_DATA)] = 1.0
        return _rows(integers[np.newaxis], numbers[np.newaxis], *self._per_peak)


def _inverse(peaks: Array) -> Array:
    """1 / peak (6,); 0 for axes that the model does not hold."""
    return np.divide(1.0, peaks, out=np.zeros_like(peaks), where=peaks > 0.0)


def _rows(
    integers: npt.NDArray[np.int64], numbers: Array, leverage_per_peak: Array, width_per_peak: Array
) -> Alarms:
    """Rows from what the kernel filled, and the limits (6,) of leverage and width over their peaks."""
    levels = integers[:, kernel.ROW_LEVEL : kernel.ROW_FAULTS].astype(np.uint8)
    of_causes = kernel.ROW_CAUSE_LEVEL - kernel.ROW_LEVEL
    leverage = numbers[:, kernel.ROW_LEVERAGE : kernel.ROW_WIDTH]
    width = numbers[:, kernel.ROW_WIDTH : kernel.ROW_MISSES]
    return Alarms(
        time_ns=integers[:, kernel.ROW_TIME],
        level=levels[:, 0],
        causes=levels[:, kernel.ROW_CAUSES - kernel.ROW_LEVEL],
        cause_level=levels[:, of_causes : of_causes + len(CAUSES)],
        cause_health=levels[:, of_causes + len(CAUSES) :],
        cause_evidence=numbers[:, kernel.ROW_EVIDENCE :],
        leverage=leverage,
        leverage_ratio=leverage * leverage_per_peak,
        width=width,
        width_ratio=width * width_per_peak,
        miscoverage=numbers[:, kernel.ROW_MISSES : kernel.ROW_SHARE],
        miss_share=numbers[:, kernel.ROW_SHARE : kernel.ROW_EVIDENCE],
        input_score=numbers[:, kernel.ROW_SCORE : kernel.ROW_EXCESS],
        input_excess=numbers[:, kernel.ROW_EXCESS : kernel.ROW_LEVERAGE],
        faults=integers[:, kernel.ROW_FAULTS],
    )


_NO_ROWS = _rows(
    np.empty((0, kernel.ROW_INTEGERS), dtype=np.int64), np.empty((0, kernel.ROW_SIZE)), np.ones(6), np.ones(6)
)


class AlarmTime(NamedTuple):
    """How much of a flight stood at a level or above, and since when.

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
    """Sum up alarm rows (M,), each of which stands until the next; the last until `end_ns`."""
    raised = level >= at_least
    durations = np.diff(time_ns, append=max(end_ns, int(time_ns[-1])))
    fraction = float(durations[raised].sum() / max(durations.sum(), 1))
    return AlarmTime(fraction, int(time_ns[np.argmax(raised)]) if raised.any() else None)
