# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records of the alarm, see core/include/quadpi/monitor/alarm_state.hpp: its limits, rows and state."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.flight import AXES, NO_STAMP
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.monitor.change import Change, ChangeFound, SoundNoise, nothing_found
from quadpi_core.monitor.data_quality import MoreFaults
from quadpi_core.monitor.ground import Ground
from quadpi_core.monitor.rotor_thrust import RotorGeometry, RotorThrust
from quadpi_core.records import Records, record_dtype
from quadpi_core.results import CAUSES, NO_SAMPLES

WARNING_CHARGE, ROUNDING, STEP_MAX_S = compiled.WARNING_CHARGE, compiled.ROUNDING, compiled.STEP_MAX_S

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
    change: SoundNoise


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
    more_faults: MoreFaults
    stopped: int  # bit per rotor
    why_not_judged: int  # of `quadpi_core.results.WHY_NOT_JUDGED`, or JUDGED
    not_judged_share: float  # of the time since the first sample
    change: ChangeFound


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
    reported_more_faults: MoreFaults
    extrapolates: bool  # whether the last usable sample lies beyond a limit of a warning
    change: Change


LIMITS, ROW, STATE = record_dtype(Limits), record_dtype(Row), record_dtype(State)


def forget(states: Records) -> None:
    """Empty the state (1,)."""
    states[:] = np.zeros(1, STATE)
    states["previous_ns"] = NO_STAMP
    states["ground"]["why"] = NO_SAMPLES
    states["thrust"]["since_zero_s"] = np.inf
    states["change"]["found"] = states["row"]["change"] = nothing_found(1)
