# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a user says of how a log is read; every command that reads logs takes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from quadpi_core.time_range import WHOLE, TimeRange


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
