# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a user says of how a log is read; every command that reads logs takes it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from quadpi_core.errors import QuadpiError

_LONGEST_NS = 2**62


@dataclass(frozen=True)
class TimeRange:
    """From when to when, in seconds since the first IMU sample; both ends belong to it.

    Raises:
        QuadpiError: for a range that is empty, inverted or holds no number.
    """

    from_s: float = 0.0
    to_s: float = math.inf

    def __post_init__(self) -> None:
        if not 0.0 <= self.from_s < self.to_s:
            raise QuadpiError(
                f"--from {self.from_s:g} --to {self.to_s:g}: no range of seconds since the first IMU sample"
            )

    @property
    def is_whole(self) -> bool:
        """Whether it leaves nothing out."""
        return self == WHOLE

    def stamps(self, start_ns: int) -> tuple[int, int]:
        """First and last stamp [ns] of a flight whose first IMU sample has the stamp `start_ns`."""
        first, last = (
            start_ns + (round(1e9 * seconds) if seconds < 1e-9 * _LONGEST_NS else _LONGEST_NS)
            for seconds in (self.from_s, self.to_s)
        )
        return (-_LONGEST_NS if self.from_s == 0.0 else first), last

    def __str__(self) -> str:
        end = "its end" if math.isinf(self.to_s) else f"{self.to_s:g} s"
        return f"from {self.from_s:g} s to {end}"


WHOLE = TimeRange()


@dataclass(frozen=True)
class ReadingOptions:
    """How a log is to be read.

    Attributes:
        mapping: a file, or its name, with what the log does not say of itself.
        topics: of a bag, the topics to read, by standard names such as `imu` and `mocap/pose`.
        namespace: of a bag, the vehicle's: only topics that have it in their names are looked for.
        part: of the flight that is used; times count from the first IMU sample.
        all_parts: of a flight that pauses, take every part that is long enough instead of the longest.
    """

    mapping: Path | str | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    namespace: str = ""
    part: TimeRange = WHOLE
    all_parts: bool = False


# Options, or a mapping file alone.
MappingOrOptions: TypeAlias = ReadingOptions | Path | str | None


def reading_options(given: MappingOrOptions) -> ReadingOptions:
    """The options that were given, or those of a mapping file alone."""
    return given if isinstance(given, ReadingOptions) else ReadingOptions(given)
