# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The log of events: when each cause was raised and cleared, its peak and why; the last ones are kept."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from quadpi_core.monitor.reasons import reasons
from quadpi_core.results import CAUSES, EVENTS_KEPT, LEVEL_ALARM, AlarmEvent, Alarms, Events


# Events that a log keeps, and that a late subscriber is given.
class EventLog:
    """Follows the rows of an alarm; memory is bounded."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all events."""
        self._open: dict[int, AlarmEvent] = {}
        self._closed: deque[AlarmEvent] = deque(maxlen=EVENTS_KEPT)
        self._count = 0

    @property
    def events(self) -> Events:
        """The last events, the oldest first; those that stand come last."""
        return [*self._closed, *self._open.values()][-EVENTS_KEPT:]

    def take(self, alarms: Alarms) -> Events:
        """Take the rows of a block; returns every event that opened or closed, in order."""
        changed: Events = []
        if len(alarms) == 0 or (not self._open and not (alarms.level == LEVEL_ALARM).any()):
            return changed
        for row in range(len(alarms)):
            now = int(alarms.time_ns[row])
            for column, cause in enumerate(CAUSES):
                level = alarms.cause_level[row, column]
                evidence = float(alarms.cause_evidence[row, column])
                event = self._open.get(cause)
                if event is None and level == LEVEL_ALARM:
                    self._count += 1
                    told = reasons(alarms, row, cause)
                    self._open[cause] = AlarmEvent(self._count, cause, now, now, 0, evidence, told)
                    changed.append(self._open[cause])
                elif event is not None and level != LEVEL_ALARM:
                    self._closed.append(replace(self._open.pop(cause), time_ns=now, end_ns=now))
                    changed.append(self._closed[-1])
                elif event is not None and evidence > event.peak_evidence:
                    told = reasons(alarms, row, cause) or event.reasons
                    self._open[cause] = replace(event, peak_evidence=evidence, reasons=told)
        return changed
