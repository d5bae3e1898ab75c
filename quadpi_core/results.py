# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results of the monitor: predictions, alarms and events as records, with the names of levels and causes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.records import brief_repr

LEVEL_OK, LEVEL_WARNING, LEVEL_ALARM = 0, 1, 2
# Causes of an alarm, one bit each.
EXTRAPOLATION, MISCOVERAGE, BAD_DATA, CHANGE = 1, 2, 4, 8
CAUSES = (EXTRAPOLATION, MISCOVERAGE, BAD_DATA, CHANGE)
CAUSE_NAMES = {
    EXTRAPOLATION: "extrapolation",
    MISCOVERAGE: "miscoverage",
    BAD_DATA: "bad data",
    CHANGE: "change",
}
# What has changed: nothing that is known, the mass [kg], a force [N] that pushes, the centre of gravity [m],
# or the share of its thrust that a rotor has lost.
UNCHANGED, CHANGED_MASS, CHANGED_FORCE_FORWARD, CHANGED_FORCE_RIGHT = range(4)
CHANGED_CENTRE_FORWARD, CHANGED_CENTRE_RIGHT, CHANGED_ROTOR = range(4, 7)
# Health of a cause. ACTIVE: judged with a stated rate of false alarms. WAITING: not judged, as the vehicle
# does not fly or, for MISCOVERAGE and CHANGE, while the state settles. UNAVAILABLE: no usable samples or, for
# CHANGE, a model of too few flights. UNCALIBRATED: judged by plain limits or, for CHANGE, where residuals are
# louder than on any flight that told what is sound.
ACTIVE, WAITING, UNAVAILABLE, UNCALIBRATED = 0, 1, 2, 3
UNCALIBRATED_WORDS = "uncalibrated: as no flight of the calibration was, no rate of false alarms holds"
# Why a model is not judged: the vehicle does not fly, there are no samples, or the state settles, when only
# MISCOVERAGE and CHANGE are not judged, or, of horizontal forces, the wind is still to be told.
JUDGED, PARKED, IDLES, CARRIED, MOVED, NO_SAMPLES, SETTLES, LANDS, WIND_UNKNOWN = range(9)
WHY_NOT_JUDGED = {
    PARKED: "on the ground, rotors at rest",
    IDLES: "on the ground, rotors turn too slowly to fly",
    CARRIED: "carried, or no telemetry: it moves with all rotors at 0",
    MOVED: "moved by something else: its rotors turn too slowly to fly",
    LANDS: "it lands: its rotors slow down, and something else carries it",
    NO_SAMPLES: "no usable samples",
    SETTLES: "the state settles, the downward force alone is judged",
    WIND_UNKNOWN: "the wind is not told yet, the horizontal forces are not judged: fly or turn",
}
# Of a flight before the first sample that a monitor could take.
NOT_BEGUN = "state or rotor speeds have not begun"
# Events that the log keeps, and that a late subscriber to /alarm_log is given.
EVENTS_KEPT = 64


@dataclass(frozen=True)
class Predictions:
    """One row per IMU sample; columns Fx, Fy, Fz (N), Mx, My, Mz (Nm), body forward-right-down.

    Columns of axes that the model does not hold are zero. `relative_width` is that of the
    model's own interval, also where `lower` and `upper` adapt.
    """

    __repr__ = brief_repr

    time_ns: Stamps
    predicted: Array
    lower: Array
    upper: Array
    measured: Array
    relative_width: Array


class PredictionRows(NamedTuple):
    """U predictions as the core leaves them, for whoever is done with them before the next ones come.

    Attributes:
        time_ns: (U,) stamps.
        wrenches: (5, R, 6) room whose first U rows are predicted, lower, upper, measured and relative width,
            see :class:`Predictions`.
    """

    time_ns: list[int]
    wrenches: Array

    @classmethod
    def from_predictions(cls, predictions: Predictions) -> PredictionRows:
        """A copy of predictions."""
        time_ns, *columns = vars(predictions).values()
        return cls(time_ns.tolist(), np.stack(columns))

    @property
    def predictions(self) -> Predictions:
        """The same; views."""
        return Predictions(np.array(self.time_ns, np.int64), *self.wrenches[:, : len(self.time_ns)])


@dataclass(frozen=True)
class AlarmRows:
    """One row per published alarm state, as the monitor gives it and as its message says it.

    The evidence of a row is the largest since the row before it. A score is a value over its limit. Columns
    of causes: EXTRAPOLATION, MISCOVERAGE, BAD_DATA, CHANGE; of axes: Fx … Mz.

    Attributes:
        level: (M,) 0 ok, 1 warning, 2 alarm; the highest of the causes.
        causes: (M,) bit flags of the causes that are not ok, 1 extrapolation, 2 miscoverage, 4 bad data,
            8 change.
        cause_level, cause_health: (M, 4) level and health of each cause.
        cause_evidence: (M, 4) largest score of the signals of each cause.
        leverage, width, miscoverage: (M, 6) scores per axis.
        miss_share: (M, 6) share of recent samples outside the model's own interval.
        changed: (M,) what has changed, such as CHANGED_MASS; UNCHANGED where nothing shows.
        changed_rotor: (M,) which rotor, from 1; 0 for none.
        change_size, change_lower, change_upper: (M,) by how much, and its interval of 95 %; kg, N, m, or a
            share of a rotor's thrust.
        change_since_ns: (M,) stamp at which the change began; 0 without one.
        change_from_start: (M,) whether that is the first that was judged since take-off.
    """

    __repr__ = brief_repr

    time_ns: Stamps
    level: npt.NDArray[np.uint8]
    causes: npt.NDArray[np.uint8]
    cause_level: npt.NDArray[np.uint8]
    cause_health: npt.NDArray[np.uint8]
    cause_evidence: Array
    leverage: Array
    width: Array
    miscoverage: Array
    miss_share: Array
    changed: npt.NDArray[np.uint8]
    changed_rotor: npt.NDArray[np.uint8]
    change_size: Array
    change_lower: Array
    change_upper: Array
    change_since_ns: Stamps
    change_from_start: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True, repr=False)
class Alarms(AlarmRows):
    """Alarm rows of the monitor, with the evidence behind the words of a message.

    Attributes:
        leverage_ratio, width_ratio: (M, 6) leverage and width over their peaks in training.
        input_score: (M, 19) scores of the inputs' distances from the middle of their training range;
            columns as `quadpi_core.inputs.INPUT_NAMES`.
        input_excess: (M, 19) how far each input lies outside its training range, in widths of that range,
            zero inside.
        faults: (M,) what is wrong with the data, bits of `monitor.preparation`.
        more_faults: (M, 2) the same of rotors 5 to 8, and 9 to 12.
        stopped: (M,) rotors that have stopped, one bit each.
        why_not_judged: (M,) keys of `WHY_NOT_JUDGED`, or JUDGED.
        not_judged_share: (M,) of the time since the first sample.
    """

    leverage_ratio: Array
    width_ratio: Array
    input_score: Array
    input_excess: Array
    faults: npt.NDArray[np.int64]
    more_faults: npt.NDArray[np.int64]
    stopped: npt.NDArray[np.int64]
    why_not_judged: npt.NDArray[np.int64]
    not_judged_share: Array


@dataclass(frozen=True, repr=False)
class ReportedAlarms(AlarmRows):
    """Alarm rows as messages say them.

    Attributes:
        envelope_distance: (M,) how far the worst input lies outside its training range.
        inputs_outside: names of the inputs outside the envelope, the farthest first, per message.
        reasons: why the causes are not ok, in plain words, per message.
    """

    envelope_distance: Array
    inputs_outside: list[tuple[str, ...]]
    reasons: list[tuple[str, ...]]

    @property
    def of_samples(self) -> npt.NDArray[np.bool_]:
        """(M,) False for a message without a sample: by the monitor's own clock, while nothing came."""
        return self.cause_health[:, CAUSES.index(BAD_DATA)] != UNAVAILABLE

    def where(self, chosen: npt.NDArray[np.bool_]) -> ReportedAlarms:
        """Those that a mask (M,) chooses."""
        rows = np.flatnonzero(chosen)
        kept: dict[str, Any] = {
            name: [values[k] for k in rows] if isinstance(values, list) else values[rows]
            for name, values in vars(self).items()
        }
        return ReportedAlarms(**kept)


@dataclass(frozen=True)
class AlarmEvent:
    """The time that one cause spends at alarm level; warnings are no events.

    Attributes:
        number: counts the events of a log from 1.
        cause: EXTRAPOLATION, MISCOVERAGE, BAD_DATA or CHANGE.
        time_ns: stamp of the sample that led to this state of the event.
        start_ns: stamp at which the cause was raised.
        end_ns: stamp at which it was cleared; 0 until then.
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
