# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From evidence per sample to an alarm with persistence and hysteresis, O(1) per sample.

Each cause keeps a charge between 0 and 1: evidence fills it within `persistence_s`, its absence drains
it within `release_s`. The cause is raised when the charge is full and cleared when it is empty, so that
evidence with short gaps still raises it, one sample inside does not clear it and nothing chatters.
Between, from half full on, the cause is a warning. A single sample that cannot be judged charges
BAD_DATA to one half at once: it is reported, and becomes an alarm if more follow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.errors import QuadpiError
from quadpi_core.flight import AXES, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.monitor.envelope import Envelope
from quadpi_core.monitor.output import Alarms

LEVEL_OK, LEVEL_WARNING, LEVEL_ALARM = 0, 1, 2
EXTRAPOLATION, MISCOVERAGE, BAD_DATA = 1, 2, 4

# Rows of the per-cause state; MISCOVERAGE has none, its bit is never set here.
_EXTRAPOLATION_ROW, _BAD_DATA_ROW = 0, 1
_CAUSE_BITS = (EXTRAPOLATION, BAD_DATA)

_WARNING_CHARGE = 0.5
# Sums of steps such as 50 × 0.02 miss 1 by rounding.
_ROUNDING = 1e-9
# A gap in the samples counts as this long: nobody knows what happened in it.
_STEP_MAX_S = 0.02
_NO_STAMP = np.iinfo(np.int64).min


@dataclass(frozen=True)
class MonitorSettings:
    """How quickly the alarm follows the evidence, how often its state is published, which intervals go out.

    Attributes:
        persistence_s: of evidence, before a cause is raised.
        release_s: without evidence, before a cause is cleared.
        alarm_rate_hz: of the alarm's state between changes.
        adaptive: publish intervals that adapt to the measured wrench (:mod:`quadpi_core.intervals.adaptive`)
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


class _Limits(NamedTuple):
    """The envelope and settings as the kernel takes them."""

    lower: Array
    upper: Array
    scale: Array
    margin: Array
    leverage: Array
    width: Array
    persistence_s: float
    release_s: float
    period_ns: int


class _State(NamedTuple):
    """What the kernel remembers; arrays, because it changes them in place.

    `charge` and `level` hold one entry per cause, `published` the level and causes of the latest row. The
    peaks are the largest evidence since that row. `named` marks the inputs beyond their margin in any row
    since the level left ok.
    """

    previous_ns: npt.NDArray[np.int64]
    charge: Array
    level: npt.NDArray[np.uint8]
    published: npt.NDArray[np.uint8]
    named: npt.NDArray[np.bool_]
    peak_excess: Array
    peak_leverage: Array
    peak_width: Array


class Alarm:
    """Follows one vehicle; rows come at every change and at a steady rate by stamps in between.

    A row comes when the level or the causes change, when one more input leaves the envelope while the level
    is not ok, and at the first sample of each period of `alarm_rate_hz`. Its evidence is the largest since
    the row before it.
    """

    def __init__(self, envelope: Envelope, settings: MonitorSettings) -> None:
        self._limits = _Limits(
            lower=envelope.lower,
            upper=envelope.upper,
            scale=envelope.scale,
            margin=envelope.margin,
            leverage=envelope.leverage_limit,
            width=envelope.width_limit,
            persistence_s=settings.persistence_s,
            release_s=settings.release_s,
            period_ns=round(1e9 / settings.alarm_rate_hz),
        )
        self.reset()

    def reset(self) -> None:
        """Forget all evidence; the next sample gives a row."""
        self._state = _State(
            previous_ns=np.array([_NO_STAMP]),
            charge=np.zeros(len(_CAUSE_BITS)),
            level=np.zeros(len(_CAUSE_BITS), dtype=np.uint8),
            published=np.zeros(2, dtype=np.uint8),
            named=np.zeros(len(INPUT_NAMES), dtype=np.bool_),
            peak_excess=np.zeros(len(INPUT_NAMES)),
            peak_leverage=np.zeros(len(AXES)),
            peak_width=np.zeros(len(AXES)),
        )

    def step(
        self,
        time_ns: Stamps,
        usable: npt.NDArray[np.bool_],
        inputs: Array,
        leverage: Array,
        relative_width: Array,
    ) -> Alarms:
        """Take K samples.

        Args:
            time_ns: (K,) stamps of all samples.
            usable: (K,) False for a sample that cannot be judged (BAD_DATA).
            inputs: (U, 19) input vectors of the U usable samples, in order.
            leverage: (U, 6), zero columns for axes not held.
            relative_width: (U, 6), likewise.
        """
        samples = len(time_ns)
        rows = Alarms(
            time_ns=np.empty(samples, dtype=np.int64),
            level=np.empty(samples, dtype=np.uint8),
            causes=np.empty(samples, dtype=np.uint8),
            leverage=np.empty((samples, len(AXES))),
            width=np.empty((samples, len(AXES))),
            input_excess=np.empty((samples, len(INPUT_NAMES))),
        )
        count = _alarm_kernel(
            time_ns,
            usable,
            inputs,
            leverage,
            relative_width,
            self._limits,
            self._state,
            rows.time_ns,
            rows.level,
            rows.causes,
            rows.leverage,
            rows.width,
            rows.input_excess,
        )
        if count == samples:
            return rows
        return Alarms(
            rows.time_ns[:count],
            rows.level[:count],
            rows.causes[:count],
            rows.leverage[:count],
            rows.width[:count],
            rows.input_excess[:count],
        )


class AlarmTime(NamedTuple):
    """How much of a flight stood at alarm level, and since when.

    Attributes:
        fraction: share of the time from the first alarm row to the end.
        first_ns: stamp of the first row at alarm level; None without one.
    """

    fraction: float
    first_ns: int | None


def alarm_time(time_ns: Stamps, level: npt.NDArray[np.uint8], end_ns: int) -> AlarmTime:
    """Sum up alarm rows (M,), each of which stands until the next; the last until `end_ns`."""
    raised = level == LEVEL_ALARM
    durations = np.diff(time_ns, append=max(end_ns, int(time_ns[-1])))
    fraction = float(durations[raised].sum() / max(durations.sum(), 1))
    return AlarmTime(fraction, int(time_ns[np.argmax(raised)]) if raised.any() else None)


@njit(cache=True)
def _raise_peaks(excess: Any, limits: Any, inputs: Any, leverage: Any, width: Any, state: Any) -> bool:
    """Take one usable sample into the peaks and fill `excess` (19,); True if it is beyond a limit."""
    beyond = False
    for k in range(inputs.size):
        outside = max(limits.lower[k] - inputs[k], inputs[k] - limits.upper[k], 0.0)
        excess[k] = outside / limits.scale[k]
        beyond |= excess[k] > limits.margin[k]
        state.peak_excess[k] = max(state.peak_excess[k], excess[k])
    for axis in range(leverage.size):
        leverage_ratio = leverage[axis] / limits.leverage[axis]
        width_ratio = width[axis] / limits.width[axis]
        beyond |= leverage_ratio > 1.0 or width_ratio > 1.0
        state.peak_leverage[axis] = max(state.peak_leverage[axis], leverage_ratio)
        state.peak_width[axis] = max(state.peak_width[axis], width_ratio)
    return beyond


@njit(cache=True)
def _follow(evidence: bool, step_s: float, limits: Any, state: Any, cause: int) -> None:
    """Charge or drain one cause and set its level."""
    charge = state.charge[cause]
    charge += step_s / limits.persistence_s if evidence else -step_s / limits.release_s
    charge = min(1.0, max(0.0, charge))
    state.charge[cause] = charge
    if charge >= 1.0 - _ROUNDING:
        state.level[cause] = LEVEL_ALARM
    elif charge <= _ROUNDING:
        state.level[cause] = LEVEL_OK
    elif charge >= _WARNING_CHARGE and state.level[cause] == LEVEL_OK:
        state.level[cause] = LEVEL_WARNING


@njit(cache=True)
def _alarm_kernel(
    time_ns: Any,
    usable: Any,
    inputs: Any,
    leverage: Any,
    width: Any,
    limits: Any,
    state: Any,
    row_time_ns: Any,
    row_level: Any,
    row_causes: Any,
    row_leverage: Any,
    row_width: Any,
    row_excess: Any,
) -> int:
    """Advance the state over K samples and fill the rows to publish; return their number."""
    excess = np.zeros(inputs.shape[1])
    rows = 0
    used = 0
    for i in range(time_ns.size):
        now, before = time_ns[i], state.previous_ns[0]
        first = before == _NO_STAMP
        step_s = 0.0 if first else min(max((now - before) * 1e-9, 0.0), _STEP_MAX_S)
        state.previous_ns[0] = now

        excess[:] = 0.0
        if usable[i]:
            beyond = _raise_peaks(excess, limits, inputs[used], leverage[used], width[used], state)
            used += 1
            _follow(beyond, step_s, limits, state, _EXTRAPOLATION_ROW)
        else:
            state.charge[_BAD_DATA_ROW] = max(state.charge[_BAD_DATA_ROW], _WARNING_CHARGE)
        _follow(not usable[i], step_s, limits, state, _BAD_DATA_ROW)

        level = np.uint8(LEVEL_OK)
        causes = np.uint8(0)
        for cause in range(len(_CAUSE_BITS)):
            level = max(level, state.level[cause])
            if state.level[cause] != LEVEL_OK:
                causes |= np.uint8(_CAUSE_BITS[cause])

        publish = first or now // limits.period_ns != before // limits.period_ns
        publish |= level != state.published[0] or causes != state.published[1]
        if level == LEVEL_OK:
            state.named[:] = False
        else:
            for k in range(excess.size):
                publish |= excess[k] > limits.margin[k] and not state.named[k]
        if publish:
            row_time_ns[rows] = now
            row_level[rows] = level
            row_causes[rows] = causes
            row_leverage[rows] = state.peak_leverage
            row_width[rows] = state.peak_width
            row_excess[rows] = state.peak_excess
            rows += 1
            state.published[0] = level
            state.published[1] = causes
            for k in range(excess.size):
                state.named[k] |= state.peak_excess[k] > limits.margin[k]
            state.peak_excess[:] = 0.0
            state.peak_leverage[:] = 0.0
            state.peak_width[:] = 0.0
    return rows
