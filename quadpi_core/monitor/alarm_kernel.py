# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The compiled part of the alarm: its limits, its state and how a sample changes it; see `monitor.alarm`."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.flight import AXES, NO_STAMP
from quadpi_core.frames import Array
from quadpi_core.inputs import COSINES, INPUT_NAMES
from quadpi_core.models.envelope import distance_outside
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.monitor.data_quality import GAP, IN_FLIGHT_ONLY, NOT_FINITE, ROTORS_MISSING
from quadpi_core.monitor.ground import Ground, follow_ground
from quadpi_core.monitor.preparation import Verdict
from quadpi_core.monitor.rotor_thrust import (
    RotorGeometry,
    RotorThrust,
    are_stopped,
    follow_thrust,
    forget_thrust,
)
from quadpi_core.records import Records, record_dtype
from quadpi_core.results import (
    ACTIVE,
    BAD_DATA,
    CARRIED,
    CAUSES,
    EXTRAPOLATION,
    JUDGED,
    LEVEL_ALARM,
    LEVEL_OK,
    LEVEL_WARNING,
    MISCOVERAGE,
    NO_SAMPLES,
    SETTLES,
    UNAVAILABLE,
    WAITING,
)

# Charge that BAD_DATA starts with, and from which on it and MISCOVERAGE are a warning.
WARNING_CHARGE = 0.5
# Sums of steps such as 50 × 0.02 miss 1 by rounding.
ROUNDING = 1e-9
# A gap between samples counts as this long [s], as nothing is known of what happened in it.
STEP_MAX_S = 0.02
# The cumulative sum of MISCOVERAGE stops at this multiple of its limit, so that it comes down again soon;
# at or below the second one, its alarm or warning is cleared.
SUM_MOST, SUM_OVER = 1.5, 0.25
# Time constant [s] of the published share of misses.
SHARE_S = 2.0
# After this long without a usable sample [s], the model is not judged.
SILENT_S = 0.1

# Columns of the causes.
_OF_EXTRAPOLATION, _OF_MISCOVERAGE, _OF_BAD_DATA = map(CAUSES.index, (EXTRAPOLATION, MISCOVERAGE, BAD_DATA))

_FZ = AXES.index("Fz")

_PerInput: TypeAlias = Annotated[Array, len(INPUT_NAMES)]
_PerAxis: TypeAlias = Annotated[Array, len(AXES)]
_PerCause: TypeAlias = Annotated[Array, len(CAUSES)]
_WholePerCause: TypeAlias = Annotated[npt.NDArray[np.int64], len(CAUSES)]


class Limits:
    """Limits of the signals, `near_` those of a warning, and the times that the alarm follows them in.

    The distance of an input is from the middle of its training range, in half widths: 1 at the ends.
    """

    lower: _PerInput
    upper: _PerInput
    scale: _PerInput  # width of the training range
    distance: _PerInput
    near_distance: _PerInput
    leverage: _PerAxis
    near_leverage: _PerAxis
    width: _PerAxis
    near_width: _PerAxis
    miscoverage_s: (
        _PerAxis  # of the cumulative sum of misses; infinite for an axis that the model does not hold
    )
    interval_ratio: (
        _PerAxis  # width of the intervals that the limits were calibrated with over that of those used
    )
    allowance: float  # share of misses at which the sum neither rises nor falls
    persistence_s: float
    release_s: float
    hover_square: float  # (rad/s)², squared rotor speed in hover; 0 where unknown
    rotors: RotorGeometry
    period_ns: int  # of the rows between changes
    health_in_flight: int  # ACTIVE, or UNCALIBRATED


class Row:
    """An alarm row as it is published; its evidence and faults are those since the row before it."""

    time_ns: int
    level: int
    causes: int
    cause_level: _WholePerCause
    cause_health: _WholePerCause
    cause_evidence: _PerCause
    leverage: _PerAxis
    width: _PerAxis
    miscoverage: _PerAxis
    miss_share: _PerAxis
    input_score: _PerInput
    input_excess: _PerInput
    faults: int
    stopped: int  # bit per rotor
    why_not_judged: int  # of `quadpi_core.results.WHY_NOT_JUDGED`, or JUDGED
    not_judged_share: float  # of the time since the first sample


class State:
    """All that the alarm remembers."""

    row: Row  # the next one
    # Evidence that has gathered, 0 to 1. Of EXTRAPOLATION there is one more charge, for its warning; that of
    # MISCOVERAGE is its largest score, at most SUM_MOST.
    charge: _PerCause
    near_charge: float
    miss_sum_s: _PerAxis  # cumulative sum of the sequential test
    miss_share: _PerAxis
    silent_s: float  # since the last usable sample
    ground: Ground
    thrust: RotorThrust
    since_first_s: float  # since the first sample
    not_judged_s: float  # of that, for which the model was not judged
    previous_ns: int  # stamp of the last sample; NO_STAMP before the first
    settled: bool  # whether the misses of the last usable sample counted
    reported_inputs: int  # bits of the inputs outside that rows have reported since the level was last ok
    reported_faults: int  # the same for faults


LIMITS, ROW, STATE = record_dtype(Limits), record_dtype(Row), record_dtype(State)


def forget(states: Records) -> None:
    """Empty the state (1,)."""
    states[:] = np.zeros(1, STATE)
    states["previous_ns"] = NO_STAMP
    states["ground"]["why"] = NO_SAMPLES
    states["thrust"]["since_zero_s"] = np.inf


@njit(cache=True)
def advance(
    limits_of: Records,
    states: Records,
    verdicts: Records,
    inputs: Array,
    measured: Array,
    said: tuple[Array, ...],
    rows: Records,
) -> int:
    """Take K samples, of which U are usable; fill the rows to publish and return their number.

    Args:
        limits_of: (1,) :class:`Limits`.
        states: (1,) :class:`State`, which changes.
        verdicts: (K,) :class:`quadpi_core.monitor.preparation.Verdict` of all samples.
        inputs: (U, 19) input vectors of the usable samples.
        measured: (U, 6) their wrench.
        said: fields of the model's :class:`Evaluation` of them, with its own intervals.
        rows: (K,) :class:`Row`.
    """
    limits, state = limits_of[0], states[0]
    evaluation = Evaluation(said[0], said[1], said[2], said[3], said[4])
    count, used = 0, 0
    for i in range(verdicts.size):
        sample = verdicts[i]
        before_ns, first = state.previous_ns, state.previous_ns == NO_STAMP
        step_s = 0.0 if first else min(max((sample.time_ns - before_ns) * 1e-9, 0.0), STEP_MAX_S)
        state.previous_ns = sample.time_ns
        beyond, faults, stopped, why = 0, sample.faults, state.thrust.stopped, state.row.why_not_judged
        if sample.usable:
            state.silent_s = 0.0
            state.settled = sample.settled
            faults = _follow_vehicle(limits, state, sample, measured[used], step_s)
            if state.ground.flying:
                if state.ground.why == JUDGED:
                    beyond = _judge_extrapolation(limits, state, inputs[used], evaluation, used, step_s)
                    _judge_miscoverage(limits, state, measured[used], evaluation, used, step_s)
                _judge_rotors(state)
            used += 1
        else:
            state.silent_s += step_s
            if sample.absent != 0 and state.ground.flying:
                faults = follow_thrust(limits.rotors, state.thrust, sample, sample.wrench, step_s)
                _judge_rotors(state)
        faults = _judge_data(limits, state, sample, faults, step_s)
        _count_time(state, step_s)

        is_due = _set_levels(limits, state) or first
        is_due |= state.thrust.stopped != stopped or state.row.why_not_judged != why
        is_due |= sample.time_ns // limits.period_ns != before_ns // limits.period_ns
        if state.row.level == LEVEL_OK:
            state.reported_inputs, state.reported_faults = 0, 0
        else:
            is_due |= beyond & ~state.reported_inputs != 0 or faults & ~state.reported_faults != 0
        if is_due:
            state.row.time_ns = sample.time_ns
            rows[count] = state.row
            count += 1
            _begin_next_row(limits, state)
    return count


@njit(cache=True)
def _follow_vehicle(limits: Limits, state: State, sample: Verdict, measured: Array, step_s: float) -> int:
    """Decide whether the vehicle flies, and with all rotors; returns the faults that count there.

    On the ground the evidence against the model is forgotten.
    """
    follow_ground(state.ground, limits.hover_square, sample, step_s)
    if state.ground.flying:
        return int(follow_thrust(limits.rotors, state.thrust, sample, measured, step_s))
    forget_thrust(state.thrust)
    state.miss_sum_s[:] = 0.0
    state.miss_share[:] = 0.0
    state.charge[_OF_EXTRAPOLATION] = state.charge[_OF_MISCOVERAGE] = state.near_charge = 0.0
    return int(sample.faults)


@njit(cache=True)
def _count_time(state: State, step_s: float) -> None:
    """Note why the model is not judged, and for what share of the time."""
    row = state.row
    if state.silent_s >= SILENT_S:
        row.why_not_judged = NO_SAMPLES
    elif state.ground.why == JUDGED and not state.settled:
        row.why_not_judged = SETTLES
    else:
        row.why_not_judged = state.ground.why
    state.since_first_s += step_s
    if row.why_not_judged != JUDGED:
        state.not_judged_s += step_s
    row.not_judged_share = state.not_judged_s / state.since_first_s if state.since_first_s > 0.0 else 1.0


@njit(cache=True)
def _judge_extrapolation(
    limits: Limits, state: State, inputs: Array, evaluation: Evaluation, used: int, step_s: float
) -> int:
    """Charge alarm and warning of EXTRAPOLATION; returns the inputs beyond their near limit as bits."""
    row = state.row
    worst, beyond, near = 0.0, 0, False
    for k in range(inputs.size):
        lower, upper, scale = limits.lower[k], limits.upper[k], limits.scale[k]
        outside = distance_outside(inputs[k], lower, upper, scale, COSINES[k])
        distance = 1.0 + 2.0 * outside
        if distance > limits.near_distance[k]:
            beyond |= 1 << k
        score = distance / limits.distance[k]
        worst = max(worst, score)
        row.input_score[k] = max(row.input_score[k], score)
        row.input_excess[k] = max(row.input_excess[k], outside)
    for axis in range(len(AXES)):
        leverage, width = evaluation.leverage[used, axis], evaluation.relative_width[used, axis]
        near |= leverage > limits.near_leverage[axis] or width > limits.near_width[axis]
        leverage /= limits.leverage[axis]
        width /= limits.width[axis]
        worst = max(worst, leverage, width)
        row.leverage[axis] = max(row.leverage[axis], leverage)
        row.width[axis] = max(row.width[axis], width)
    row.cause_evidence[_OF_EXTRAPOLATION] = max(row.cause_evidence[_OF_EXTRAPOLATION], worst)
    charge = state.charge[_OF_EXTRAPOLATION]
    state.charge[_OF_EXTRAPOLATION] = _charged(charge, worst > 1.0, step_s, limits)
    state.near_charge = _charged(state.near_charge, near or beyond != 0, step_s, limits)
    return beyond


@njit(cache=True)
def _judge_miscoverage(
    limits: Limits, state: State, measured: Array, evaluation: Evaluation, used: int, step_s: float
) -> None:
    """Advance the sequential test of each axis; while the state settles, that of Fz alone."""
    row = state.row
    worst = 0.0
    keep = SHARE_S / (SHARE_S + step_s)
    for axis in range(len(AXES)):
        limit = limits.miscoverage_s[axis]
        if limit == np.inf:
            continue
        if state.settled or axis == _FZ:
            lower, upper = evaluation.lower[used, axis], evaluation.upper[used, axis]
            half = 0.5 * (upper - lower) * limits.interval_ratio[axis]
            miss = 1.0 if abs(measured[axis] - 0.5 * (upper + lower)) > half else 0.0
            total = state.miss_sum_s[axis] + step_s * (miss - limits.allowance)
            state.miss_sum_s[axis] = min(max(total, 0.0), SUM_MOST * limit)
            state.miss_share[axis] = keep * state.miss_share[axis] + (1.0 - keep) * miss
            row.miss_share[axis] = max(row.miss_share[axis], state.miss_share[axis])
        score = state.miss_sum_s[axis] / limit
        worst = max(worst, score)
        row.miscoverage[axis] = max(row.miscoverage[axis], score)
    state.charge[_OF_MISCOVERAGE] = worst


@njit(cache=True)
def _judge_rotors(state: State) -> None:
    """Raise MISCOVERAGE for a rotor without thrust, which contradicts every model of four."""
    row = state.row
    if state.thrust.stopped != 0:
        state.charge[_OF_MISCOVERAGE] = SUM_MOST
        row.stopped |= state.thrust.stopped
    evidence = max(row.cause_evidence[_OF_MISCOVERAGE], state.charge[_OF_MISCOVERAGE])
    row.cause_evidence[_OF_MISCOVERAGE] = evidence


@njit(cache=True)
def _judge_data(limits: Limits, state: State, sample: Verdict, faults: int, step_s: float) -> int:
    """Charge BAD_DATA; returns the faults of the sample that count where the vehicle is."""
    row, charge = state.row, state.charge[_OF_BAD_DATA]
    if not state.ground.flying:
        faults &= ~IN_FLIGHT_ONLY
    judged = sample.usable
    if are_stopped(state.thrust, sample.absent):
        # No reading of a rotor that has stopped is no fault: what was said of it is taken back.
        faults &= ~(NOT_FINITE | ROTORS_MISSING | GAP)
        judged, charge = True, 0.0
    bad = faults != 0 or not judged
    if bad:
        charge = max(charge, WARNING_CHARGE)
    charge = _charged(charge, bad, step_s, limits)
    if state.ground.why == CARRIED:
        charge = max(charge, WARNING_CHARGE)
    state.charge[_OF_BAD_DATA] = charge
    row.cause_evidence[_OF_BAD_DATA] = max(row.cause_evidence[_OF_BAD_DATA], charge)
    row.faults |= faults
    return faults


@njit(cache=True)
def _charged(charge: float, evidence: bool, step_s: float, limits: Limits) -> float:
    """A charge after one more step with or without evidence."""
    change = step_s / limits.persistence_s if evidence else -step_s / limits.release_s
    return min(1.0, max(0.0, charge + change))


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
def _is_raised(charge: float, was_raised: bool) -> bool:
    """Whether a level is raised that a full charge raises and an empty one clears."""
    return bool(charge >= 1.0 - ROUNDING or (was_raised and charge > ROUNDING))


@njit(cache=True)
def _level_of_two(far: float, near: float, before: int) -> int:
    """Level of EXTRAPOLATION: an alarm and a warning, each by its own charge."""
    if _is_raised(far, before == LEVEL_ALARM):
        return LEVEL_ALARM
    return LEVEL_WARNING if _is_raised(near, before != LEVEL_OK) else LEVEL_OK


@njit(cache=True)
def _set_levels(limits: Limits, state: State) -> bool:
    """Set level and health of each cause, and the highest level; True if any of a cause changed."""
    row = state.row
    health_of_model = limits.health_in_flight if state.ground.why == JUDGED else WAITING
    if state.silent_s >= SILENT_S:
        health_of_model = UNAVAILABLE
    changed = False
    row.level, row.causes = LEVEL_OK, 0
    for cause in range(len(CAUSES)):
        health = ACTIVE if cause == _OF_BAD_DATA else health_of_model
        if cause == _OF_MISCOVERAGE and not state.settled and health != UNAVAILABLE:
            health = WAITING
        charge, before = state.charge[cause], row.cause_level[cause]
        if cause == _OF_EXTRAPOLATION:
            level = _level_of_two(charge, state.near_charge, before)
        else:
            level = _level(charge, SUM_OVER if cause == _OF_MISCOVERAGE else 0.0, before)
        changed |= level != before or health != row.cause_health[cause]
        row.cause_level[cause], row.cause_health[cause] = level, health
        row.level = max(row.level, level)
        if level != LEVEL_OK:
            row.causes |= CAUSES[cause]
    return changed


@njit(cache=True)
def _begin_next_row(limits: Limits, state: State) -> None:
    """Remember what the row reports, and clear its evidence; levels and health stay."""
    row = state.row
    for k in range(row.input_excess.size):
        if 1.0 + 2.0 * row.input_excess[k] > limits.near_distance[k]:
            state.reported_inputs |= 1 << k
    state.reported_faults |= row.faults
    row.faults = row.stopped = 0
    row.cause_evidence[:] = 0.0
    row.leverage[:] = 0.0
    row.width[:] = 0.0
    row.miscoverage[:] = 0.0
    row.miss_share[:] = 0.0
    row.input_score[:] = 0.0
    row.input_excess[:] = 0.0
