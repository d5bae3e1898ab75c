# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a user says of a log that the log does not say of itself; every command that reads logs takes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias


@dataclass(frozen=True)
class ReadingOptions:
    """How a log is to be read.

    Attributes:
        mapping: a file, or its name, with what the log does not say of itself.
        topics: of a bag, the topics to read, by standard names such as `imu` and `mocap/pose`.
        namespace: of a bag, the vehicle's: only topics that have it in their names are looked for.
    """

    mapping: Path | str | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    namespace: str = ""


# Options, or a mapping file alone.
MappingOrOptions: TypeAlias = ReadingOptions | Path | str | None


def reading_options(given: MappingOrOptions) -> ReadingOptions:
    """The options that were given, or those of a mapping file alone."""
    return given if isinstance(given, ReadingOptions) else ReadingOptions(given)
