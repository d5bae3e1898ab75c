# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a user says of how a log is read; every command that reads logs takes it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import QuadpiError
from quadpi_core.flight import STREAM_KINDS, Recording, Stamps, Stream

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


# A block is a :class:`Recording` whose arrivals count from its own first IMU sample. The streams of the
# flight are in each of its blocks, possibly without samples.

# IMU samples in a block that is cut from a whole recording: 8 s at 500 Hz.
BLOCK_SAMPLES = 4096
_END_NS = 2**63 - 1
# From glibc's malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
# A column that is joined of parts has spare room of one part in this many, so that it rarely grows.
_ROOM_SHARE = 16


@cache
def keep_freed_memory() -> None:
    """Let this process keep up to 64 MiB of what it frees, where the C library is glibc.

    The arrays of a block are some MB each. Given back to the system and taken again with every block, they
    cost a tenth of the time of a replay.
    """
    import ctypes

    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(_M_TRIM_THRESHOLD, 2**26)
        library.mallopt(_M_MMAP_THRESHOLD, 2**25)


def join_blocks(blocks: Iterable[Recording]) -> Recording:
    """Join consecutive blocks to one recording; its `quality` is that of the last.

    Raises:
        ValueError: if there is no block.
    """
    last: Recording | None = None
    joined: dict[str, StreamParts] = {}
    arrivals: dict[str, Column] = {}
    before = 0
    for block in blocks:
        last = block
        for name, stream in all_by_field(block).items():
            joined.setdefault(name, StreamParts(type(stream))).extend(stream)
        for topic, counts in block.arrivals.items():
            arrivals.setdefault(topic, Column()).extend(before + counts)
        before += len(block.imu)
    if last is None:
        raise ValueError("a recording needs a block")
    streams: dict[str, Any] = {name: parts.whole() for name, parts in joined.items()}
    return replace(last, **streams, arrivals={topic: column.whole() for topic, column in arrivals.items()})


class StreamParts:
    """A stream that is joined of parts in place."""

    def __init__(self, kind: type[Stream]) -> None:
        self._kind = kind
        self._columns = {column.name: Column() for column in fields(kind)}

    def extend(self, part: Stream) -> None:
        """Append samples."""
        for name, column in self._columns.items():
            column.extend(getattr(part, name))

    def whole(self) -> Stream:
        """All samples; nothing can be appended after this."""
        return self._kind(*(column.whole() for column in self._columns.values()))


class Column:
    """An array that is joined of parts in place, with little more memory than the whole needs."""

    def __init__(self) -> None:
        self._values: npt.NDArray[Any] | None = None
        self._count = 0

    def extend(self, part: npt.NDArray[Any]) -> None:
        """Append rows; of no messages the number of columns may not be known."""
        if not len(part) and self._count:
            return
        count = self._count + len(part)
        if self._values is None or not self._count:
            self._values = np.array(part, order="C")
        elif count > len(self._values):
            # The memory can grow in place, as there is no other reference to the array.
            room = count + count // _ROOM_SHARE
            self._values.resize((room, *self._values.shape[1:]), refcheck=False)
        self._values[self._count : count] = part
        self._count = count

    def whole(self) -> npt.NDArray[Any]:
        """All rows; nothing can be appended after this."""
        assert self._values is not None  # there is a column where there is a part
        self._values.resize((self._count, *self._values.shape[1:]), refcheck=False)
        return self._values


def split_recording(recording: Recording) -> Iterator[Recording]:
    """Blocks of :data:`BLOCK_SAMPLES` IMU samples, as :func:`by_arrival` gives them."""
    arrived = _arrived(recording)
    orders = {name: np.argsort(own, kind="stable") for name, own in arrived.items()}
    in_order = {name: own[orders[name]] for name, own in arrived.items()}
    count = len(recording.imu)
    for start in [*range(0, count, BLOCK_SAMPLES), count]:
        # The last block holds the samples after the last IMU sample.
        stop = min(start + BLOCK_SAMPLES, count) if start < count else count + 1
        ends = {name: np.searchsorted(own, (start, stop)).tolist() for name, own in in_order.items()}
        rows = {name: orders[name][slice(*own)] for name, own in ends.items()}
        yield _part(recording, slice(start, stop), arrived, rows)


def _arrived(block: Recording) -> dict[str, Stamps]:
    """Number of IMU samples that arrived before each sample (N,) of the others, by their fields."""
    return {name: block.arrivals_of(one) for name, one in all_by_field(block).items() if name != "imu"}


def _part(
    block: Recording, imu: slice, arrived: Mapping[str, Stamps], rows: Mapping[str, slice | Stamps]
) -> Recording:
    """Samples of the IMU, and rows of the others."""
    streams: dict[str, Any] = {name: getattr(block, name).take(own) for name, own in rows.items()}
    arrivals = {streams[name].topic: arrived[name][own] - imu.start for name, own in rows.items()}
    return replace(block, imu=block.imu.take(imu), **streams, arrivals=arrivals)


def split_by_stamp(recording: Recording) -> Iterator[tuple[Recording, int]]:
    """Parts of a recording that follow each other in time, of about :data:`BLOCK_SAMPLES` IMU samples each.

    Gives each part, and the stamp before which all of its samples are stamped, and none of a later part is.
    Samples of a stream come in the order of their stamps.
    """
    streams = {name: _in_order(stream) for name, stream in all_by_field(recording).items()}
    starts = dict.fromkeys(streams, 0)
    for end_ns in [*streams["imu"].time_ns[BLOCK_SAMPLES::BLOCK_SAMPLES].tolist(), _END_NS]:
        part: dict[str, Any] = {}
        for name, stream in streams.items():
            stop = int(np.searchsorted(stream.time_ns, end_ns))
            part[name] = stream.take(slice(starts[name], stop))
            starts[name] = stop
        yield replace(recording, **part, arrivals={}), end_ns


def _in_order(stream: Stream) -> Stream:
    """The stream sorted by its stamps, which it usually is already."""
    if np.any(stream.time_ns[1:] < stream.time_ns[:-1]):
        return stream.take(np.argsort(stream.time_ns, kind="stable"))
    return stream


def by_arrival(blocks: Iterable[Recording]) -> Iterator[Recording]:
    """The same flight in order of arrival: a block has all that arrived up to its last IMU sample.

    What came after it is in the next block, as if it had come with that; what came after the last IMU sample
    of all is in a block of its own.
    """
    carried: Recording | None = None
    for block in blocks:
        whole = block if carried is None else join_blocks((carried, block))
        due, carried = cut_block(whole, len(whole.imu))
        if len(due.imu):
            yield due
    if carried is not None:
        yield carried


def cut_block(block: Recording, count: int) -> tuple[Recording, Recording]:
    """Split a block into its first IMU samples with what arrived up to the last of them, and the rest."""
    arrived = _arrived(block)
    places = {name: int(np.searchsorted(own, count)) for name, own in arrived.items()}
    due = {name: slice(0, place) for name, place in places.items()}
    rest = {name: slice(place, None) for name, place in places.items()}
    return (
        _part(block, slice(0, count), arrived, due),
        _part(block, slice(count, None), arrived, rest),
    )


def streams_by_field(recording: Recording) -> dict[str, Stream]:
    """Streams of a recording that later steps use, by the names of their fields."""
    return {name: one for name, one in all_by_field(recording).items() if name in STREAM_KINDS}


def all_by_field(recording: Recording) -> dict[str, Stream]:
    """Streams of a recording by the names of their fields, with what rotor speeds may be made of."""
    return {
        column.name: stream
        for column in fields(recording)
        if isinstance(stream := getattr(recording, column.name), Stream)
    }
