# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a log format declares of itself; docs/add-a-log-format.md shows how."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from quadpi_core.flight import Recording, Stamps
from quadpi_core.vehicle import Vehicle

# First bytes of a file by which its format is recognised: the longest that a format looks at has 18.
HEAD_BYTES = 64

_Settings = TypeVar("_Settings")


class OpenLog(Protocol):
    """A recording that is read in blocks, as often as needed.

    Attributes:
        streams: fields of :class:`Recording` that the blocks fill.
        sources: the topic in the log that each of these fields comes from.
    """

    name: str
    source: str
    vehicle: str
    streams: set[str]

    @property
    def sources(self) -> Mapping[str, str]: ...  # noqa: D102

    def blocks(self) -> Iterator[Recording]: ...  # noqa: D102


@dataclass(frozen=True)
class Container(Generic[_Settings]):
    """How a format is read that may be too large to hold whole, and need not hold an IMU.

    Attributes:
        open: the recording in a log; arguments as those of :attr:`LogFormat.read`.
        vehicle_name: the vehicle that a log says it is of; empty where it does not say.
        topic_stamps: stamps (N,) by topic, of a log without an IMU such as results; None for others.
    """

    open: Callable[[Path, Vehicle | None, _Settings | None], AbstractContextManager[OpenLog]]
    vehicle_name: Callable[[Path], str]
    topic_stamps: Callable[[Path], dict[str, Stamps] | None]


@dataclass(frozen=True)
class FlightsInFile(Generic[_Settings]):
    """How a format is read whose files may hold several flights.

    Attributes:
        numbers: of the flights in a file that can be read, from 1.
        read: gives one of them by its number; the other arguments as those of :attr:`LogFormat.read`.
    """

    numbers: Callable[[Path], Sequence[int]]
    read: Callable[[Path, int, Vehicle | None, _Settings | None], Recording]


@dataclass(frozen=True, kw_only=True)
class LogFormat(Generic[_Settings]):
    """A log format: how its files are recognised, and its reader.

    Libraries that only this format needs are imported when a log is read: others do not wait for them.

    Attributes:
        description: what a user would call it, for messages.
        read: gives the recording in a log, in SI, forward-right-down and north-east-down. Its arguments are
            the path, the vehicle that flew and what `load_mapping` gave; None where the user gave none.
        begins: whether a file with these first bytes, at most HEAD_BYTES, is of the format.
        suffixes: of files, in lower case; they count where no format knows the first bytes, so that its
            reader says what is wrong with a damaged file.
        sure_suffixes: those of them that count before first bytes which other formats know too: a table may
            repeat the header lines of the log that it was made of.
        is_folder: whether a folder is a log of the format.
        load_mapping: reads the file of `--mapping`, by path or name; None for a format that takes none.
        choose_topics: adds the values of `--topics` and `--namespace` to what `load_mapping` gave; None for a
            format that has no topics.
        container: for a format that is read in blocks.
        remedies: by topic, what makes the source record it more often.
        flights: for a format whose files may hold several flights; `read` gives one, and says which.
    """

    description: str
    read: Callable[[Path, Vehicle | None, _Settings | None], Recording]
    begins: Callable[[bytes], bool] = lambda _head: False
    suffixes: tuple[str, ...] = ()
    sure_suffixes: tuple[str, ...] = ()
    is_folder: Callable[[Path], bool] = lambda _folder: False
    load_mapping: Callable[[str | Path], _Settings] | None = None
    choose_topics: Callable[[_Settings | None, Mapping[str, str], str], _Settings] | None = None
    container: Container[_Settings] | None = None
    remedies: Mapping[str, str] = field(default_factory=dict)
    flights: FlightsInFile[_Settings] | None = None
