# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The alarm's kernel, and where its limits, its state and its rows keep what; see `monitor.alarm`."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.flight import AXES as AXIS_NAMES
from quadpi_core.flight import NO_STAMP
from quadpi_core.inputs import COSINES, INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.envelope import excess_of_cosine
from quadpi_core.monitor.data_quality import IN_FLIGHT_ONLY
from quadpi_core.results import (
    ACTIVE,
    BAD_DATA,
    CAUSES,
    EXTRAPOLATION,
    LEVEL_ALARM,
    LEVEL_OK,
    LEVEL_WARNING,
    MISCOVERAGE,
    UNAVAILABLE,
    WAITING,
)

WARNING_CHARGE = 0.5
# Sums of steps such as 50 × 0.02 miss 1 by rounding.
ROUNDING = 1e-9
# A gap in the samples counts as this long: nobody knows what happened in it.
STEP_MAX_S = 0.02
# The sum of the test ends here, in limits, so that it comes down again; below the other, it is over.
SUM_MOST, SUM_OVER = 1.5, 0.25
# Over which the share of misses is told.
SHARE_S = 2.0
# Without a usable sample for so long, there is nothing to judge.
SILENT_S = 0.1
# The vehicle flies from this share of its weight on. It stands when the rotors carry less than the other one
# and it stays slow: in the air 0.3 g would have made it faster within that time.
LIFTED, STANDING, STANDING_M_S, STANDING_S = 0.9, 0.7, 0.3, 0.3

INPUTS, AXES = len(INPUT_NAMES), len(AXIS_NAMES)
OMEGA_AVG = INPUT_INDEX["omega_avg"]
# Places of the limits; those of a warning are NEAR. Distances of inputs are from the middle of the range.
LOWER, UPPER, SCALE, DISTANCE, NEAR_DISTANCE = 0, INPUTS, 2 * INPUTS, 3 * INPUTS, 4 * INPUTS
LEVERAGE = 5 * INPUTS
WIDTH, NEAR_LEVERAGE, NEAR_WIDTH = LEVERAGE + AXES, LEVERAGE + 2 * AXES, LEVERAGE + 3 * AXES
MISSES, RATIO = LEVERAGE + 4 * AXES, LEVERAGE + 5 * AXES
PERSISTENCE = LEVERAGE + 6 * AXES
RELEASE, ALLOWANCE, LIFT_SQUARE, STAND_SQUARE, PERIOD, RATED, LIMITS_SIZE = range(
    PERSISTENCE + 1, PERSISTENCE + 8
)
# Places of its state: first what a row holds (the largest since the row before), then what it remembers.
ROW_SCORE, ROW_EXCESS = 0, INPUTS
ROW_LEVERAGE = 2 * INPUTS
ROW_WIDTH, ROW_MISSES, ROW_SHARE = (
    ROW_LEVERAGE + AXES,
    ROW_LEVERAGE + 2 * AXES,
    ROW_LEVERAGE + 3 * AXES,
)
ROW_EVIDENCE = ROW_LEVERAGE + 4 * AXES
ROW_SIZE = ROW_EVIDENCE + len(CAUSES)
SUM, SHARE, CHARGE = ROW_SIZE, ROW_SIZE + AXES, ROW_SIZE + 2 * AXES
# Charge of the warning of EXTRAPOLATION, beside that of its alarm.
NEAR_CHARGE = CHARGE + len(CAUSES)
SILENT, STANDING_FOR, STATE_SIZE = NEAR_CHARGE + 1, NEAR_CHARGE + 2, NEAR_CHARGE + 3
# Places of the integers of a row, and of those remembered.
ROW_TIME, ROW_LEVEL, ROW_CAUSES, ROW_CAUSE_LEVEL, ROW_HEALTH, ROW_FAULTS = 0, 1, 2, 3, 6, 9
ROW_INTEGERS = 10
PREVIOUS, FLYING, SETTLED, NAMED, TOLD, MEMORY_SIZE = 10, 11, 12, 13, 14, 15


_excess_of_cosine = njit(cache=True)(excess_of_cosine)


@njit(cache=True)
def _extrapolation(
    inputs: Any, leverage: Any, width: Any, limits: Any, state: Any
) -> tuple[float, int, bool]:
    """Largest score of one sample, which inputs are beyond their near limit, and whether any signal is.

    Raises the peaks of the row.
    """
    worst, beyond, near = 0.0, 0, False
    for k in range(INPUTS):
        outside = max(limits[LOWER + k] - inputs[k], inputs[k] - limits[UPPER + k]) / limits[SCALE + k]
        if COSINES[k] and outside > 0.0:
            outside = _excess_of_cosine(outside)
        distance = 1.0 + 2.0 * outside
        if distance > limits[NEAR_DISTANCE + k]:
            beyond |= 1 << k
        score = distance / limits[DISTANCE + k]
        worst = max(worst, score)
        state[ROW_SCORE + k] = max(state[ROW_SCORE + k], score)
        state[ROW_EXCESS + k] = max(state[ROW_EXCESS + k], outside)
    for axis in range(AXES):
        near |= leverage[axis] > limits[NEAR_LEVERAGE + axis] or width[axis] > limits[NEAR_WIDTH + axis]
        by_leverage = leverage[axis] / limits[LEVERAGE + axis]
        by_width = width[axis] / limits[WIDTH + axis]
        worst = max(worst, by_leverage, by_width)
        state[ROW_LEVERAGE + axis] = max(state[ROW_LEVERAGE + axis], by_leverage)
        state[ROW_WIDTH + axis] = max(state[ROW_WIDTH + axis], by_width)
    return worst, beyond, near or beyond != 0


@njit(cache=True)
def _miscoverage(measured: Any, lower: Any, upper: Any, limits: Any, state: Any, step_s: float) -> float:
    """Advance the sequential test of each axis; return the largest score."""
    worst = 0.0
    keep = SHARE_S / (SHARE_S + step_s)
    for axis in range(AXES):
        limit = limits[MISSES + axis]
        if limit == np.inf:
            continue
        half = 0.5 * (upper[axis] - lower[axis]) * limits[RATIO + axis]
        miss = 1.0 if abs(measured[axis] - 0.5 * (upper[axis] + lower[axis])) > half else 0.0
        total = state[SUM + axis] + step_s * (miss - limits[ALLOWANCE])
        state[SUM + axis] = min(max(total, 0.0), SUM_MOST * limit)
        state[SHARE + axis] = keep * state[SHARE + axis] + (1.0 - keep) * miss
        score = state[SUM + axis] / limit
        worst = max(worst, score)
        state[ROW_MISSES + axis] = max(state[ROW_MISSES + axis], score)
        state[ROW_SHARE + axis] = max(state[ROW_SHARE + axis], state[SHARE + axis])
    return worst


@njit(cache=True)
def _charge(evidence: bool, step_s: float, limits: Any, state: Any, place: int) -> float:
    """Charge or drain what stands at a place of the state."""
    change = step_s / limits[PERSISTENCE] if evidence else -step_s / limits[RELEASE]
    charge = min(1.0, max(0.0, state[place] + change))
    state[place] = charge
    return float(charge)


@njit(cache=True)
def _level(charge: float, empty: float, before: int) -> int:
    """Level of a cause with one charge, from how full it is."""
    if charge >= 1.0 - ROUNDING:
        return LEVEL_ALARM
    if charge <= empty + ROUNDING:
        return LEVEL_OK
    if charge >= WARNING_CHARGE and before == LEVEL_OK:
        return LEVEL_WARNING
    return before


@njit(cache=True)
def _stands(charge: float, stood: bool) -> bool:
    """Whether a level stands that is raised by a full charge and cleared by an empty one."""
    return bool(charge >= 1.0 - ROUNDING or (stood and charge > ROUNDING))


@njit(cache=True)
def _level_of_two(far: float, near: float, before: int) -> int:
    """Level of EXTRAPOLATION: an alarm and a warning, each by its own charge."""
    if _stands(far, before == LEVEL_ALARM):
        return LEVEL_ALARM
    return LEVEL_WARNING if _stands(near, before != LEVEL_OK) else LEVEL_OK


@njit(cache=True)
def _follow_ground(inputs: Any, velocity: Any, limits: Any, state: Any, memory: Any, step_s: float) -> None:
    """Tell whether the vehicle flies; on the ground forget what was said of the model."""
    square = inputs[OMEGA_AVG] * inputs[OMEGA_AVG]
    if memory[FLYING] == 0:
        memory[FLYING] = square >= limits[LIFT_SQUARE]
        state[STANDING_FOR] = 0.0
    speed_square = velocity[0] * velocity[0] + velocity[1] * velocity[1] + velocity[2] * velocity[2]
    if square < limits[STAND_SQUARE] and speed_square < STANDING_M_S * STANDING_M_S:
        state[STANDING_FOR] += step_s
    else:
        state[STANDING_FOR] = 0.0
    if state[STANDING_FOR] >= STANDING_S:
        memory[FLYING] = 0
    if memory[FLYING] == 0:
        state[SUM:CHARGE] = 0.0
        state[CHARGE : CHARGE + 2] = 0.0
        state[NEAR_CHARGE] = 0.0


@njit(cache=True)
def _judge_causes(limits: Any, state: Any, memory: Any) -> bool:
    """Set level and health of each cause, and the level of all; True if any changed."""
    health = ACTIVE if memory[FLYING] != 0 else WAITING
    if health == ACTIVE:
        health = int(limits[RATED])
    if state[SILENT] >= SILENT_S:
        health = UNAVAILABLE
    changed = False
    memory[ROW_LEVEL], memory[ROW_CAUSES] = LEVEL_OK, 0
    for cause in range(len(CAUSES)):
        own_health = ACTIVE if CAUSES[cause] == BAD_DATA else health
        if CAUSES[cause] == MISCOVERAGE and memory[SETTLED] == 0 and health != UNAVAILABLE:
            own_health = WAITING
        charge, before = state[CHARGE + cause], memory[ROW_CAUSE_LEVEL + cause]
        if CAUSES[cause] == EXTRAPOLATION:
            level = _level_of_two(charge, state[NEAR_CHARGE], before)
        else:
            level = _level(charge, SUM_OVER if CAUSES[cause] == MISCOVERAGE else 0.0, before)
        changed |= level != before or own_health != memory[ROW_HEALTH + cause]
        memory[ROW_CAUSE_LEVEL + cause], memory[ROW_HEALTH + cause] = level, own_health
        memory[ROW_LEVEL] = max(memory[ROW_LEVEL], level)
        if level != LEVEL_OK:
            memory[ROW_CAUSES] |= CAUSES[cause]
    return changed


@njit(cache=True)
def advance(
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
    settled: Any,
    limits: Any,
    state: Any,
    memory: Any,
    integers: Any,
    numbers: Any,
) -> int:
    """Advance the state over K samples and fill the rows to publish; return their number."""
    rows, used = 0, 0
    period_ns = np.int64(limits[PERIOD])
    for i in range(time_ns.size):
        now, before = time_ns[i], memory[PREVIOUS]
        first = before == NO_STAMP
        step_s = 0.0 if first else min(max((now - before) * 1e-9, 0.0), STEP_MAX_S)
        memory[PREVIOUS] = now
        beyond = 0
        if usable[i]:
            state[SILENT] = 0.0
            _follow_ground(inputs[used], velocity[used], limits, state, memory, step_s)
            memory[SETTLED] = settled[used]
            if memory[FLYING] != 0:
                worst, beyond, near = _extrapolation(inputs[used], leverage[used], width[used], limits, state)
                state[ROW_EVIDENCE] = max(state[ROW_EVIDENCE], worst)
                _charge(worst > 1.0, step_s, limits, state, CHARGE)
                _charge(near, step_s, limits, state, NEAR_CHARGE)
                if settled[used]:
                    state[CHARGE + 1] = _miscoverage(
                        measured[used], lower[used], upper[used], limits, state, step_s
                    )
                state[ROW_EVIDENCE + 1] = max(state[ROW_EVIDENCE + 1], state[CHARGE + 1])
            used += 1
        else:
            state[SILENT] += step_s
        found = faults[i] if memory[FLYING] != 0 else faults[i] & ~IN_FLIGHT_ONLY
        bad = found != 0 or not usable[i]
        if bad:
            state[CHARGE + 2] = max(state[CHARGE + 2], WARNING_CHARGE)
        state[ROW_EVIDENCE + 2] = max(
            state[ROW_EVIDENCE + 2], _charge(bad, step_s, limits, state, CHARGE + 2)
        )
        memory[ROW_FAULTS] |= found

        publish = _judge_causes(limits, state, memory)
        publish |= first or now // period_ns != before // period_ns
        if memory[ROW_LEVEL] == LEVEL_OK:
            memory[NAMED], memory[TOLD] = 0, 0
        else:
            publish |= beyond & ~memory[NAMED] != 0 or found & ~memory[TOLD] != 0
        if publish:
            memory[ROW_TIME] = now
            integers[rows] = memory[:ROW_INTEGERS]
            numbers[rows] = state[:ROW_SIZE]
            rows += 1
            for k in range(INPUTS):
                if 1.0 + 2.0 * state[ROW_EXCESS + k] > limits[NEAR_DISTANCE + k]:
                    memory[NAMED] |= 1 << k
            memory[TOLD] |= memory[ROW_FAULTS]
            memory[ROW_FAULTS] = 0
            state[:ROW_SIZE] = 0.0
    return rows
