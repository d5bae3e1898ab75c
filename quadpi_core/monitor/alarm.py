# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From evidence per sample to an alarm of three causes, with persistence and hysteresis, O(1) per sample.

Every signal is a score, its value over its limit. EXTRAPOLATION and BAD_DATA keep a charge between 0 and
1: evidence (a score above 1, a fault) fills it within `persistence_s`, its absence drains it within
`release_s`. The cause is raised when the charge is full and cleared when it is empty, so that evidence
with short gaps still raises it, one sample inside does not clear it and nothing chatters. Between, from
half full on, it is a warning. A single sample that cannot be judged charges BAD_DATA to one half at
once: it is reported, and becomes an alarm if more follow.

MISCOVERAGE is a sequential test per axis (Page 1954): S ← max(0, S + dt (miss − k)), with the model's
own interval and k between the allowed share of misses and the alternative (`models.alarm_limits`). S
over its limit is the score, and takes the place of the charge: full at 1, half full at ½, empty at ¼.

On the ground neither of the two is judged, for there the wrench is not aerodynamic.
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
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.alarm_limits import AlarmLimits
from quadpi_core.models.envelope import Envelope
from quadpi_core.monitor.faults import IN_FLIGHT_ONLY
from quadpi_core.monitor.output import Alarms

LEVEL_OK, LEVEL_WARNING, LEVEL_ALARM = 0, 1, 2
EXTRAPOLATION, MISCOVERAGE, BAD_DATA = 1, 2, 4
CAUSES = (EXTRAPOLATION, MISCOVERAGE, BAD_DATA)
# Judged; not judged on the ground; nor for want of usable samples; judged by limits without a stated rate.
ACTIVE, WAITING, UNAVAILABLE, UNCALIBRATED = 0, 1, 2, 3

_WARNING_CHARGE = 0.5
# Sums of steps such as 50 × 0.02 miss 1 by rounding.
_ROUNDING = 1e-9
# A gap in the samples counts as this long: nobody knows what happened in it.
_STEP_MAX_S = 0.02
_NO_STAMP = np.iinfo(np.int64).min
# The sum of the test ends here, in limits, so that it comes down again; below the other, it is over.
_SUM_MOST, _SUM_OVER = 1.5, 0.25
# Over which the share of misses is told.
_SHARE_S = 2.0
# Without a usable sample for so long, there is nothing to judge.
_SILENT_S = 0.1
# The vehicle flies from this share of its weight on. It stands when the rotors carry less than the other one
# and it stays slow: in the air 0.3 g would have made it faster within that time.
_LIFTED, _STANDING, _STANDING_M_S, _STANDING_S = 0.9, 0.7, 0.3, 0.3

_INPUTS, _AXES = len(INPUT_NAMES), len(AXES)
_OMEGA_AVG = INPUT_INDEX["omega_avg"]
# Places of the limits of the kernel.
_LOWER, _UPPER, _SCALE, _MARGIN = 0, _INPUTS, 2 * _INPUTS, 3 * _INPUTS
_LEVERAGE = 4 * _INPUTS
_WIDTH, _MISSES, _RATIO = _LEVERAGE + _AXES, _LEVERAGE + 2 * _AXES, _LEVERAGE + 3 * _AXES
_PERSISTENCE = _LEVERAGE + 4 * _AXES
_RELEASE, _ALLOWANCE, _LIFT_SQUARE, _STAND_SQUARE, _PERIOD, _RATED = range(_PERSISTENCE + 1, _PERSISTENCE + 7)
# Places of its state: first what a row holds (the largest since the row before), then what it remembers.
_ROW_SCORE, _ROW_EXCESS = 0, _INPUTS
_ROW_LEVERAGE = 2 * _INPUTS
_ROW_WIDTH, _ROW_MISSES, _ROW_SHARE = (
    _ROW_LEVERAGE + _AXES,
    _ROW_LEVERAGE + 2 * _AXES,
    _ROW_LEVERAGE + 3 * _AXES,
)
_ROW_EVIDENCE = _ROW_LEVERAGE + 4 * _AXES
_ROW_SIZE = _ROW_EVIDENCE + len(CAUSES)
_SUM, _SHARE, _CHARGE = _ROW_SIZE, _ROW_SIZE + _AXES, _ROW_SIZE + 2 * _AXES
_SILENT, _STANDING_FOR = _CHARGE + len(CAUSES), _CHARGE + len(CAUSES) + 1
_STATE_SIZE = _STANDING_FOR + 1
# Places of the integers of a row, and of those remembered.
_TIME, _LEVEL, _CAUSES, _CAUSE_LEVEL, _HEALTH, _FAULTS = 0, 1, 2, 3, 6, 9
_ROW_INTEGERS = 10
_PREVIOUS, _FLYING, _NAMED, _TOLD, _MEMORY_SIZE = 10, 11, 12, 13, 14


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


class Judged(NamedTuple):
    """What the alarm goes by: U usable samples, in order; columns of axes as `AXES`, zero where not held.

    Attributes:
        inputs: (U, 19) input vectors.
        velocity: (U, 3) over ground, m/s.
        leverage, relative_width: (U, 6).
        measured, lower, upper: (U, 6) measured wrench and the model's own interval.
    """

    inputs: Array
    velocity: Array
    leverage: Array
    relative_width: Array
    measured: Array
    lower: Array
    upper: Array


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
        hover_square = limits.hover_rotor_speed**2
        self._limits = np.concatenate(
            (
                envelope.lower,
                envelope.upper,
                envelope.scale,
                envelope.margin,
                envelope.leverage_limit,
                envelope.width_limit,
                misses,
                np.ones(_AXES) if interval_ratio is None else interval_ratio,
                np.zeros(2),
                [limits.allowance, _LIFTED * hover_square, _STANDING * hover_square, 0.0],
                [ACTIVE if limits.calibrated else UNCALIBRATED],
            )
        )
        self.change(settings)
        self.reset()

    def change(self, settings: MonitorSettings) -> None:
        """Go on with other times and rates."""
        self._limits[_PERSISTENCE] = settings.persistence_s
        self._limits[_RELEASE] = settings.release_s
        self._limits[_PERIOD] = round(1e9 / settings.alarm_rate_hz)

    def reset(self) -> None:
        """Forget all evidence; the next sample gives a row."""
        self._state = np.zeros(_STATE_SIZE)
        self._memory = np.zeros(_MEMORY_SIZE, dtype=np.int64)
        self._memory[_PREVIOUS] = _NO_STAMP

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
            faults: (K,) what is wrong with a sample, usable or not, bits of `monitor.faults`.
            judged: the usable samples.
        """
        integers = np.empty((len(time_ns), _ROW_INTEGERS), dtype=np.int64)
        numbers = np.empty((len(time_ns), _ROW_SIZE))
        count = _alarm_kernel(
            time_ns, usable, faults, *judged, self._limits, self._state, self._memory, integers, numbers
        )
        return _rows(integers[:count], numbers[:count]) if count else _NO_ROWS


def _rows(integers: npt.NDArray[np.int64], numbers: Array) -> Alarms:
    levels = integers[:, _LEVEL:_FAULTS].astype(np.uint8)
    return Alarms(
        time_ns=integers[:, _TIME],
        level=levels[:, 0],
        causes=levels[:, _CAUSES - _LEVEL],
        cause_level=levels[:, _CAUSE_LEVEL - _LEVEL : _HEALTH - _LEVEL],
        cause_health=levels[:, _HEALTH - _LEVEL :],
        cause_evidence=numbers[:, _ROW_EVIDENCE:],
        leverage=numbers[:, _ROW_LEVERAGE:_ROW_WIDTH],
        width=numbers[:, _ROW_WIDTH:_ROW_MISSES],
        miscoverage=numbers[:, _ROW_MISSES:_ROW_SHARE],
        miss_share=numbers[:, _ROW_SHARE:_ROW_EVIDENCE],
        input_score=numbers[:, _ROW_SCORE:_ROW_EXCESS],
        input_excess=numbers[:, _ROW_EXCESS:_ROW_LEVERAGE],
        faults=integers[:, _FAULTS],
    )


_NO_ROWS = _rows(np.empty((0, _ROW_INTEGERS), dtype=np.int64), np.empty((0, _ROW_SIZE)))


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
def _extrapolation(inputs: Any, leverage: Any, width: Any, limits: Any, state: Any) -> tuple[float, int]:
    """Largest score of one sample, and which inputs are beyond their limit; raises the peaks."""
    worst, beyond = 0.0, 0
    for k in range(_INPUTS):
        outside = max(limits[_LOWER + k] - inputs[k], inputs[k] - limits[_UPPER + k])
        # Distance from the middle of the range over half of its width, and the same of the limit.
        score = (1.0 + 2.0 * outside / limits[_SCALE + k]) / (1.0 + 2.0 * limits[_MARGIN + k])
        if score > 1.0:
            beyond |= 1 << k
        worst = max(worst, score)
        state[_ROW_SCORE + k] = max(state[_ROW_SCORE + k], score)
        state[_ROW_EXCESS + k] = max(state[_ROW_EXCESS + k], outside / limits[_SCALE + k])
    for axis in range(_AXES):
        by_leverage = leverage[axis] / limits[_LEVERAGE + axis]
        by_width = width[axis] / limits[_WIDTH + axis]
        worst = max(worst, by_leverage, by_width)
        state[_ROW_LEVERAGE + axis] = max(state[_ROW_LEVERAGE + axis], by_leverage)
        state[_ROW_WIDTH + axis] = max(state[_ROW_WIDTH + axis], by_width)
    return worst, beyond


@njit(cache=True)
def _miscoverage(measured: Any, lower: Any, upper: Any, limits: Any, state: Any, step_s: float) -> float:
    """Advance the sequential test of each axis; return the largest score."""
    worst = 0.0
    keep = _SHARE_S / (_SHARE_S + step_s)
    for axis in range(_AXES):
        limit = limits[_MISSES + axis]
        if limit == np.inf:
            continue
        half = 0.5 * (upper[axis] - lower[axis]) * limits[_RATIO + axis]
        miss = 1.0 if abs(measured[axis] - 0.5 * (upper[axis] + lower[axis])) > half else 0.0
        total = state[_SUM + axis] + step_s * (miss - limits[_ALLOWANCE])
        state[_SUM + axis] = min(max(total, 0.0), _SUM_MOST * limit)
        state[_SHARE + axis] = keep * state[_SHARE + axis] + (1.0 - keep) * miss
        score = state[_SUM + axis] / limit
        worst = max(worst, score)
        state[_ROW_MISSES + axis] = max(state[_ROW_MISSES + axis], score)
        state[_ROW_SHARE + axis] = max(state[_ROW_SHARE + axis], state[_SHARE + axis])
    return worst


@njit(cache=True)
def _charge(evidence: bool, step_s: float, limits: Any, state: Any, cause: int) -> float:
    """Charge or drain one cause."""
    change = step_s / limits[_PERSISTENCE] if evidence else -step_s / limits[_RELEASE]
    charge = min(1.0, max(0.0, state[_CHARGE + cause] + change))
    state[_CHARGE + cause] = charge
    return float(charge)


@njit(cache=True)
def _level(charge: float, empty: float, before: int) -> int:
    """Level of a cause from how full it is."""
    if charge >= 1.0 - _ROUNDING:
        return LEVEL_ALARM
    if charge <= empty + _ROUNDING:
        return LEVEL_OK
    if charge >= _WARNING_CHARGE and before == LEVEL_OK:
        return LEVEL_WARNING
    return before


@njit(cache=True)
def _follow_ground(inputs: Any, velocity: Any, limits: Any, state: Any, memory: Any, step_s: float) -> None:
    """Tell whether the vehicle flies; on the ground forget what was said of the model."""
    square = inputs[_OMEGA_AVG] * inputs[_OMEGA_AVG]
    if memory[_FLYING] == 0:
        memory[_FLYING] = square >= limits[_LIFT_SQUARE]
        state[_STANDING_FOR] = 0.0
    speed_square = velocity[0] * velocity[0] + velocity[1] * velocity[1] + velocity[2] * velocity[2]
    if square < limits[_STAND_SQUARE] and speed_square < _STANDING_M_S * _STANDING_M_S:
        state[_STANDING_FOR] += step_s
    else:
        state[_STANDING_FOR] = 0.0
    if state[_STANDING_FOR] >= _STANDING_S:
        memory[_FLYING] = 0
    if memory[_FLYING] == 0:
        state[_SUM:_CHARGE] = 0.0
        state[_CHARGE : _CHARGE + 2] = 0.0


@njit(cache=True)
def _judge_causes(limits: Any, state: Any, memory: Any) -> bool:
    """Set level and health of each cause, and the level of all; True if any changed."""
    health = ACTIVE if memory[_FLYING] != 0 else WAITING
    if health == ACTIVE:
        health = int(limits[_RATED])
    if state[_SILENT] >= _SILENT_S:
        health = UNAVAILABLE
    changed = False
    memory[_LEVEL], memory[_CAUSES] = LEVEL_OK, 0
    for cause in range(len(CAUSES)):
        empty = _SUM_OVER if CAUSES[cause] == MISCOVERAGE else 0.0
        own_health = ACTIVE if CAUSES[cause] == BAD_DATA else health
        before = memory[_CAUSE_LEVEL + cause]
        level = _level(state[_CHARGE + cause], empty, before)
        changed |= level != before or own_health != memory[_HEALTH + cause]
        memory[_CAUSE_LEVEL + cause], memory[_HEALTH + cause] = level, own_health
        memory[_LEVEL] = max(memory[_LEVEL], level)
        if level != LEVEL_OK:
            memory[_CAUSES] |= CAUSES[cause]
    return changed


@njit(cache=True)
def _alarm_kernel(
    time_ns: Any,
    usable: Any,
    faults: Any,
    inputs: Any,
    velocity: Any,
    leverage: Any,
    width: Any,
    measured: Any,
    lower: Any,
    upper: Any,
    limits: Any,
    state: Any,
    memory: Any,
    integers: Any,
    numbers: Any,
) -> int:
    """Advance the state over K samples and fill the rows to publish; return their number."""
    rows, used = 0, 0
    period_ns = np.int64(limits[_PERIOD])
    for i in range(time_ns.size):
        now, before = time_ns[i], memory[_PREVIOUS]
        first = before == _NO_STAMP
        step_s = 0.0 if first else min(max((now - before) * 1e-9, 0.0), _STEP_MAX_S)
        memory[_PREVIOUS] = now
        beyond = 0
        if usable[i]:
            state[_SILENT] = 0.0
            _follow_ground(inputs[used], velocity[used], limits, state, memory, step_s)
            if memory[_FLYING] != 0:
                worst, beyond = _extrapolation(inputs[used], leverage[used], width[used], limits, state)
                state[_ROW_EVIDENCE] = max(state[_ROW_EVIDENCE], worst)
                _charge(worst > 1.0, step_s, limits, state, 0)
                state[_CHARGE + 1] = _miscoverage(
                    measured[used], lower[used], upper[used], limits, state, step_s
                )
                state[_ROW_EVIDENCE + 1] = max(state[_ROW_EVIDENCE + 1], state[_CHARGE + 1])
            used += 1
        else:
            state[_SILENT] += step_s
        found = faults[i] if memory[_FLYING] != 0 else faults[i] & ~IN_FLIGHT_ONLY
        bad = found != 0 or not usable[i]
        if bad:
            state[_CHARGE + 2] = max(state[_CHARGE + 2], _WARNING_CHARGE)
        state[_ROW_EVIDENCE + 2] = max(state[_ROW_EVIDENCE + 2], _charge(bad, step_s, limits, state, 2))
        memory[_FAULTS] |= found

        publish = _judge_causes(limits, state, memory)
        publish |= first or now // period_ns != before // period_ns
        if memory[_LEVEL] == LEVEL_OK:
            memory[_NAMED], memory[_TOLD] = 0, 0
        else:
            publish |= beyond & ~memory[_NAMED] != 0 or found & ~memory[_TOLD] != 0
        if publish:
            memory[_TIME] = now
            integers[rows] = memory[:_ROW_INTEGERS]
            numbers[rows] = state[:_ROW_SIZE]
            rows += 1
            for k in range(_INPUTS):
                if state[_ROW_SCORE + k] > 1.0:
                    memory[_NAMED] |= 1 << k
            memory[_TOLD] |= memory[_FAULTS]
            memory[_FAULTS] = 0
            state[:_ROW_SIZE] = 0.0
    return rows
