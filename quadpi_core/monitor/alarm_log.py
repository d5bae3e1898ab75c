# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The log of alarm events, and the words for what is behind an alarm."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from quadpi_core.flight import AXES
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.envelope import LEVERAGE_HEADROOM, WIDTH_HEADROOM
from quadpi_core.monitor.alarm_kernel import WARNING_CHARGE
from quadpi_core.monitor.data_quality import fault_words
from quadpi_core.records import ROTORS_MAX
from quadpi_core.results import (
    BAD_DATA,
    CARRIED,
    CAUSES,
    EVENTS_KEPT,
    EXTRAPOLATION,
    JUDGED,
    LEVEL_ALARM,
    MISCOVERAGE,
    SETTLES,
    WHY_NOT_JUDGED,
    AlarmEvent,
    Alarms,
    Events,
)

# Inputs or axes named of each kind of evidence, the strongest.
_MOST = 3
# Distance of an input from the middle of its training range, in half widths, from which on it is named:
# below its limits, as leverage and width may come from it.
_OUTSIDE = 1.05


class EventLog:
    """When each cause was raised and cleared, its peak and why; holds the last :data:`EVENTS_KEPT` events."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all events."""
        self._open: dict[int, AlarmEvent] = {}
        self._closed: deque[AlarmEvent] = deque(maxlen=EVENTS_KEPT)
        self._count = 0

    @property
    def events(self) -> Events:
        """The last events, the oldest first; those still raised come last."""
        return [*self._closed, *self._open.values()][-EVENTS_KEPT:]

    def take(self, alarms: Alarms) -> Events:
        """Take the rows of a block; returns every event that opened or closed, in order."""
        changed: Events = []
        if not self._open and not (alarms.level == LEVEL_ALARM).any():
            return changed
        for row in range(len(alarms)):
            now = int(alarms.time_ns[row])
            for column, cause in enumerate(CAUSES):
                level = alarms.cause_level[row, column]
                evidence = float(alarms.cause_evidence[row, column])
                event = self._open.get(cause)
                if event is None and level == LEVEL_ALARM:
                    self._count += 1
                    why = reasons(alarms, row, cause)
                    self._open[cause] = AlarmEvent(self._count, cause, now, now, 0, evidence, why)
                    changed.append(self._open[cause])
                elif event is not None and level != LEVEL_ALARM:
                    self._closed.append(replace(self._open.pop(cause), time_ns=now, end_ns=now))
                    changed.append(self._closed[-1])
                elif event is not None and evidence > event.peak_evidence:
                    why = reasons(alarms, row, cause) or event.reasons
                    self._open[cause] = replace(event, peak_evidence=evidence, reasons=why)
        return changed


def reasons(alarms: Alarms, row: int, causes: int | None = None) -> tuple[str, ...]:
    """Why the causes are not ok in one row, strongest evidence first, and why the model is not judged.

    Inputs are given by their distance from the middle of their training range over half of that range,
    leverage and width by the multiple of their peaks in training, miscoverage by the share of recent
    samples outside the interval.

    Args:
        alarms: of the monitor.
        row: its index.
        causes: bits of the causes to explain; those of the row unless given.
    """
    wanted = int(alarms.causes[row]) if causes is None else causes
    words: list[str] = []
    if wanted & EXTRAPOLATION:
        ratio = 1.0 + 2.0 * alarms.input_excess[row]
        words += [f"{INPUT_NAMES[k]} {ratio[k]:.1f} x the training range" for k in _beyond(ratio, _OUTSIDE)]
        for name, ratios, scores, headroom in (
            ("leverage", alarms.leverage_ratio[row], alarms.leverage[row], LEVERAGE_HEADROOM),
            ("width", alarms.width_ratio[row], alarms.width[row], WIDTH_HEADROOM),
        ):
            # Beyond the limit of the warning, or that of the alarm where it is nearer.
            far = np.where((ratios > headroom) | (scores > 1.0), ratios, 0.0)
            words += [f"{AXES[k]} {name} {far[k]:.1f} x its peak in training" for k in _beyond(far, 0.0)]
    if wanted & MISCOVERAGE:
        words += [f"rotor {k + 1} stopped" for k in range(ROTORS_MAX) if alarms.stopped[row] & 1 << k]
        words += [
            f"{AXES[k]} outside its interval {100.0 * alarms.miss_share[row, k]:.0f} % of the time"
            for k in _beyond(alarms.miscoverage[row], WARNING_CHARGE)
        ]
    if wanted & BAD_DATA:
        words += fault_words(int(alarms.faults[row]), alarms.more_faults[row].tolist())
    why = int(alarms.why_not_judged[row])
    if causes is None and why != JUDGED:
        of_what = "coverage not judged" if why == SETTLES else "not judged"
        share = 100.0 * alarms.not_judged_share[row]
        words.append(f"{of_what}: {WHY_NOT_JUDGED[why]} ({share:.0f} % of the time so far)")
    elif wanted & BAD_DATA and why == CARRIED:
        words.append(WHY_NOT_JUDGED[why])
    return tuple(words)


def reasons_by_row(alarms: Alarms) -> list[tuple[str, ...]]:
    """Why the causes are not ok, for each row of a block, as :func:`reasons`."""
    return [reasons(alarms, row) for row in range(len(alarms))]


def _beyond(scores: np.ndarray, limit: float) -> list[int]:
    """Indices of the largest scores beyond the limit, the largest first."""
    order = np.argsort(-scores, kind="stable")[:_MOST]
    return [int(k) for k in order if scores[k] > limit]
