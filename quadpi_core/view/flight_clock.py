# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Time of a page that never runs backwards: stamps that jump are put behind what came before."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import MAX_JUMP_BACK_NS, Stamps

# A step forward beyond this is not drawn: a pause between two flights, or a clock that was set.
LONGEST_GAP_NS = 60_000_000_000
# What is drawn in the place of a jump: enough to be seen on a page of 30 s.
PAUSE_NS = 1_000_000_000


class FlightClock:
    """Maps stamps to nanoseconds since the first one.

    Args:
        on_jump: called with the time of the page and the step in nanoseconds, for every jump.
    """

    def __init__(self, on_jump: Callable[[int, int], None]) -> None:
        self._on_jump = on_jump
        self._offset_ns: int | None = None
        self._last_ns = 0

    @property
    def started(self) -> bool:
        """Whether there was a stamp."""
        return self._offset_ns is not None

    def advance(self, time_ns: Stamps) -> Stamps:
        """Times (K,) of the stamps that lead: of the first model's predictions; jumps are found here."""
        if self._offset_ns is None:
            self._offset_ns, self._last_ns = -int(time_ns[0]), int(time_ns[0])
        steps = np.diff(time_ns, prepend=self._last_ns)
        jumps = (steps < -MAX_JUMP_BACK_NS) | (steps > LONGEST_GAP_NS)
        shifts = np.cumsum(np.where(jumps, PAUSE_NS - steps, 0))
        times: Stamps = time_ns + self._offset_ns + shifts
        for place in np.flatnonzero(jumps).tolist():
            self._on_jump(int(times[place]), int(steps[place]))
        self._offset_ns += int(shifts[-1])
        self._last_ns = int(time_ns[-1])
        return times

    def place(self, time_ns: Stamps) -> tuple[Stamps, npt.NDArray[np.bool_]]:
        """Times (K,) of other stamps, and which of them are near enough to the leading ones to be drawn."""
        if self._offset_ns is None:
            return time_ns, np.zeros(len(time_ns), dtype=np.bool_)
        near: npt.NDArray[np.bool_] = np.abs(time_ns - self._last_ns) <= LONGEST_GAP_NS
        return time_ns + self._offset_ns, near

    def time_of(self, stamp_ns: int) -> int:
        """Time of one stamp, however far from the leading ones."""
        return stamp_ns + (self._offset_ns or 0)
