# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What makes a reading of rotor speeds unusable: one record for messages, log readers and screening.

What reports say of themselves is a :class:`Verdict`, counted by :class:`UnusableReports`;
:mod:`quadpi_core.screening.rotor_readings` finds the rest in any stream: a rotor that reads 0 in flight, and
speeds of a slow source that are held. Out of range is what the vehicle file says
(:attr:`quadpi_core.vehicle.Vehicle.rotor_speed_spike_rad_s`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from quadpi_core.findings import LeftOut


class Verdict(IntEnum):
    """Whether reports of speed controllers form a sample, or the reason why not."""

    SAMPLE = 0
    NONE_ANNOUNCED = 1
    TOO_FEW = 2
    MOTOR_MISSING = 3
    MOTOR_TWICE = 4
    OFFLINE = 5
    NEVER_REPORTED = 6
    SILENT = 7
    REPEATED = 8
    MORE_ROTORS = 9


REASONS = {
    Verdict.NONE_ANNOUNCED: "no ESC is announced yet",
    Verdict.TOO_FEW: "fewer ESCs report than `rotors` names",
    Verdict.MOTOR_MISSING: "no report is of a motor that `rotors` names",
    Verdict.MOTOR_TWICE: "two reports are of one motor",
    Verdict.OFFLINE: "an ESC is offline",
    Verdict.NEVER_REPORTED: "an ESC has not reported yet",
    Verdict.SILENT: "an ESC has fallen silent",
    Verdict.REPEATED: "no report is new",
    Verdict.MORE_ROTORS: "more ESCs turn than the vehicle has rotors",
}


class UnusableReports:
    """Counts reports of speed controllers that form no sample, by the reason, as they come.

    Attributes:
        of: number of all reports so far.
    """

    def __init__(self) -> None:
        self.of = 0
        self._counts: Counter[Verdict] = Counter()
        # Index and stamp of the first one.
        self._first: dict[Verdict, tuple[int, int]] = {}

    @property
    def by_reason(self) -> Counter[str]:
        """How many, by the reason in words."""
        return Counter({REASONS[verdict]: count for verdict, count in self._counts.items()})

    def add(self, time_ns: npt.NDArray[np.int64], verdict: npt.NDArray[np.uint8]) -> None:
        """Take the next reports: stamps (N,), and the :class:`Verdict` on each (N,)."""
        for value in np.unique(verdict[verdict != Verdict.SAMPLE]).tolist() if verdict.any() else ():
            rows = np.flatnonzero(verdict == value)
            self._counts[Verdict(value)] += len(rows)
            self._first.setdefault(Verdict(value), (self.of + int(rows[0]), int(time_ns[rows[0]])))
        self.of += len(verdict)

    def left_out(self, topic: str, start_ns: int) -> Iterator[LeftOut]:
        """What is left out of a topic, for its `quality`; times count from a stamp."""
        for verdict, count in self._counts.items():
            first, first_ns = self._first[verdict]
            words = f"in which {REASONS[verdict]}"
            yield LeftOut(topic, words, count, self.of, first, (first_ns - start_ns) * 1e-9)


READS_ZERO = "a rotor reads 0 in flight"
HELD = "no rotor speed is new"
