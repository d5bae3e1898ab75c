# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results of the monitor: predictions, alarms and events as records, with the names of levels and causes."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import Stamps
from quadpi_core.frames import Array

LEVEL_OK, LEVEL_WARNING, LEVEL_ALARM = 0, 1, 2
# Causes of an alarm, one bit each.
EXTRAPOLATION, MISCOVERAGE, BAD_DATA = 1, 2, 4
CAUSES = (EXTRAPOLATION, MISCOVERAGE, BAD_DATA)
# Health of a cause. ACTIVE: judged with a stated rate of false alarms. WAITING: not judged on the ground, nor
# MISCOVERAGE while the state settles. UNAVAILABLE: no usable samples. UNCALIBRATED: judged by plain limits.
ACTIVE, WAITING, UNAVAILABLE, UNCALIBRATED = 0, 1, 2, 3
# The log of alarm events holds the last ones only: /alarm_log and its memory stay small.
EVENTS_KEPT = 64


@dataclass(frozen=True)
class Predictions:
    """One row per IMU sample; columns Fx, Fy, Fz (N), Mx, My, Mz (Nm), body forward-right-down.

    Columns of axes that the model does not hold are zero. `relative_width` is that of the
    model's own interval, also where `lower` and `upper` adapt.
    """

    time_ns: Stamps
    predicted: Array
    lower: Array
    upper: Array
    measured: Array
    relative_width: Array


@dataclass(frozen=True)
class Alarms:
    """One row per published alarm state; its evidence is the largest since the row before it.

    Columns of causes: EXTRAPOLATION, MISCOVERAGE, BAD_DATA. A score is a value over its limit.

    Attributes:
        level: (M,) 0 ok, 1 warning, 2 alarm; the highest of the causes.
        causes: (M,) bit flags of the causes that are not ok, 1 extrapolation, 2 miscoverage, 4 bad data.
        cause_level, cause_health: (M, 3) level and health of each cause.
        cause_evidence: (M, 3) largest score of the signals of each cause.
        leverage, width, miscoverage: (M, 6) scores per axis.
        leverage_ratio, width_ratio: (M, 6) leverage and width over their peaks in training.
        miss_share: (M, 6) share of recent samples outside the model's own interval.
        input_score: (M, 19) scores of the inputs' distances from the middle of their training range.
        input_excess: (M, 19) how far each input lies outside its training range, in widths of that
            range, zero inside; columns as `quadpi_core.inputs.INPUT_NAMES`.
        faults: (M,) what is wrong with the data, bits of `monitor.data_quality`.
    """

    time_ns: Stamps
    level: npt.NDArray[np.uint8]
    causes: npt.NDArray[np.uint8]
    cause_level: npt.NDArray[np.uint8]
    cause_health: npt.NDArray[np.uint8]
    cause_evidence: Array
    leverage: Array
    leverage_ratio: Array
    width: Array
    width_ratio: Array
    miscoverage: Array
    miss_share: Array
    input_score: Array
    input_excess: Array
    faults: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.time_ns)

    def row(self, index: int) -> Alarms:
        """One row, as arrays of length one."""
        return Alarms(*(getattr(self, column.name)[index : index + 1] for column in fields(self)))


@dataclass(frozen=True)
class AlarmEvent:
    """One cause at alarm level; a warning is no event.

    Attributes:
        number: counts the events of a log from 1.
        cause: EXTRAPOLATION, MISCOVERAGE or BAD_DATA.
        time_ns: stamp of the sample that this state of the event follows from.
        start_ns: stamp at which the cause was raised.
        end_ns: stamp at which it was cleared; 0 while it stands.
        peak_evidence: largest score so far.
        reasons: at the peak, in plain words.
    """

    number: int
    cause: int
    time_ns: int
    start_ns: int
    end_ns: int
    peak_evidence: float
    reasons: tuple[str, ...]


Events: TypeAlias = list[AlarmEvent]
