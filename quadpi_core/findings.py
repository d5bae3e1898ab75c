# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Problems found in the data of a flight: samples that were left out, and likely mistakes.

It goes along with the flight.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class LeftOut:
    """Samples of one topic that were left out, because no flight can have them.

    Attributes:
        topic: that they came on.
        limit: that they are beyond, in words.
        samples: how many were left out.
        of: how many the topic had.
        first: index of the first of them.
        first_s: its stamp, in seconds since the first IMU sample.
    """

    topic: str
    limit: str
    samples: int
    of: int
    first: int
    first_s: float

    def __str__(self) -> str:
        return (
            f"topic {self.topic}: left out {self.samples} of {self.of} samples {self.limit}; the first is "
            f"sample {self.first}, at {self.first_s:.3f} s"
        )


@dataclass(frozen=True)
class Reordered:
    """Samples of one topic that were stored out of order, and sorted by their stamps.

    Attributes are those of :class:`LeftOut`; `first` is the index as stored.
    """

    topic: str
    samples: int
    of: int
    first: int
    first_s: float

    def __str__(self) -> str:
        return (
            f"topic {self.topic}: sorted {self.samples} of {self.of} samples, which are stored after later "
            f"ones; the first is sample {self.first}, at {self.first_s:.3f} s"
        )


@dataclass(frozen=True)
class Break:
    """Where the samples of a topic do not go on: the clock falls or jumps, or the topic pauses.

    Attributes:
        topic: that breaks.
        kind: "the clock falls", "the clock jumps" or "pauses".
        times: how often it does so.
        sample: index of the first sample after the first break.
        from_s, to_s: stamps of the samples around it.
    """

    topic: str
    kind: str
    times: int
    sample: int
    from_s: float
    to_s: float

    def __str__(self) -> str:
        digits = 1 if self.kind != PAUSES else 3
        more = f", and {self.times - 1} times more" if self.times > 1 else ""
        name = "IMU sample" if self.topic == "imu" else "sample"
        return (
            f"topic {self.topic}: {self.kind} from {self.from_s:.{digits}f} to {self.to_s:.{digits}f} s at "
            f"{name} {self.sample}{more}"
        )


CLOCK_FALLS, CLOCK_JUMPS, PAUSES = "the clock falls", "the clock jumps", "pauses"


@dataclass(frozen=True)
class UsedPart:
    """The part of a log that was used, where it was not the whole.

    Attributes:
        from_s, to_s: its first and last IMU sample, in seconds since the first one of the log.
        imu_samples: in it.
        of_s: length of the log, all its runs together.
        reason: for the choice, in words.
    """

    from_s: float
    to_s: float
    imu_samples: int
    of_s: float
    reason: str

    def __str__(self) -> str:
        return (
            f"topic imu: used is {self.reason}, {self.to_s - self.from_s:.1f} of {self.of_s:.1f} s: from "
            f"{self.from_s:.3f} to {self.to_s:.3f} s, {self.imu_samples} samples; the rest is left out"
        )


@dataclass(frozen=True)
class Finding:
    """A contradiction within a recording, or between it and its vehicle.

    Attributes:
        mistake: that explains it best, by its name in docs/mistakes.md.
        topic: that it shows in.
        text: what it looks like and the remedy, with numbers.
        certain: whether nothing else can explain it.
        leave_out: whether no model should learn from a flight that has it.
    """

    mistake: str
    topic: str
    text: str
    certain: bool = False
    leave_out: bool = False

    def __str__(self) -> str:
        return f"topic {self.topic}: {self.text}"


@dataclass(frozen=True)
class DataQuality:
    """Problems found in the data of one flight."""

    left_out: tuple[LeftOut, ...] = ()
    reordered: tuple[Reordered, ...] = ()
    breaks: tuple[Break, ...] = ()
    used: tuple[UsedPart, ...] = ()
    findings: tuple[Finding, ...] = ()

    def joined(self, later: DataQuality) -> DataQuality:
        """These problems, and those that were found later."""
        both = {one.name: getattr(self, one.name) + getattr(later, one.name) for one in fields(self)}
        return DataQuality(**both)

    def sentences(self) -> Iterator[str]:
        """In plain words, the topic first."""
        yield from map(str, (*self.breaks, *self.used, *self.reordered, *self.left_out, *self.findings))

    @property
    def flaw(self) -> Finding | None:
        """The first finding for which a model should not learn from the flight; None without any."""
        return next((finding for finding in self.findings if finding.leave_out), None)

    def to_json(self) -> dict[str, Any]:
        """As JSON holds it."""
        return {one.name: list(map(asdict, getattr(self, one.name))) for one in fields(self)}


NOTHING_TO_SAY = DataQuality()


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
