# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Writing MCAP bags from arrays (https://mcap.dev/spec, profile ros2), whole or as their messages come.

The place of every message is computed before anything is copied, so that there is no Python loop over
messages. Equal messages give equal bytes, in however many blocks they come.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
from lz4 import frame as lz4

from quadpi_core import __version__
from quadpi_core.errors import LogError
from quadpi_core.flight import Stamps
from quadpi_core.logs.mcap import (
    CHUNK,
    MAGIC,
    MESSAGE,
    MESSAGE_HEADER,
    METADATA,
    Topic,
    cut_topic,
    join_topics,
)
from quadpi_core.messages.definitions import definition_text, typestore
from quadpi_core.messages.payloads import Bytes, Indices, Payloads, copy_spans
from quadpi_core.messages.qos import qos_of
from quadpi_core.paths import whole_output

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE_INDEX = 0x01, 0x02, 0x03, 0x04, 0x07
_CHUNK_INDEX, _STATISTICS, _METADATA_INDEX, _SUMMARY_OFFSET, _DATA_END = 0x08, 0x0B, 0x0D, 0x0E, 0x0F
_RECORD_HEADER = np.dtype([("opcode", "u1"), ("length", "<u8"), *MESSAGE_HEADER.descr])
_INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
_FOOTER_LENGTH = 20
_CHUNK_BYTES = 1 << 20
_COMPRESSION = "lz4"
# Seconds of a ROS stamp are signed 32-bit numbers.
_STAMP_END_NS = 2**31 * 10**9


def write_mcap(path: Path, topics: Sequence[Topic], metadata: Mapping[str, str]) -> None:
    """Write a bag that appears whole or not at all.

    Args:
        path: file to write, replaced if it exists.
        topics: messages per topic, of types that `definitions` knows.
        metadata: entries of the metadata record "quadpi".

    Raises:
        LogError: if the path does not end in .mcap, and for log times that ROS stamps cannot hold.
        OutputError: if the file cannot be written.
    """
    with mcap_writer(path, metadata) as writer:
        writer.announce({topic.name: topic.type_name for topic in topics})
        for topic in topics:
            writer.add(topic)


@contextmanager
def mcap_writer(path: Path, metadata: Mapping[str, str]) -> Iterator[McapWriter]:
    """A bag to write while its messages come; it appears whole or not at all.

    Args:
        path: file to write, replaced if it exists.
        metadata: entries of the metadata record "quadpi".

    Raises:
        LogError: if the path does not end in .mcap.
        OutputError: if the file cannot be written.
    """
    if path.suffix != ".mcap":
        raise LogError(f"{path}: a bag is written to a file that ends in .mcap")
    with whole_output(path) as temporary, temporary.open("wb") as stream:
        writer = McapWriter(path, stream)
        yield writer
        writer.finish(metadata)


@dataclass
class _Channel:
    """A topic of the bag.

    Attributes:
        type_name: of its messages.
        described: whether the file says so already.
        written: how many messages are in the file, or in the chunk that comes next.
    """

    type_name: str
    described: bool = False
    written: int = 0
    waiting: list[Topic] = field(default_factory=list)


@dataclass(frozen=True)
class _Framed:
    """Message records side by side, in the order of the file.

    Attributes:
        records: their bytes.
        channel: (N,) of each.
        log_time_ns: (N,).
        starts: (N,) where each begins, in bytes of all message records of the bag.
    """

    records: Bytes
    channel: npt.NDArray[np.uint16]
    log_time_ns: Stamps
    starts: Indices

    @classmethod
    def join(cls, parts: Sequence[_Framed]) -> _Framed:
        """Those of all parts, which follow each other."""
        if len(parts) == 1:
            return parts[0]
        return cls(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(cls)))

    def split(self) -> Iterator[_Framed]:
        """Those that begin in the same `_CHUNK_BYTES` of the bag."""
        cuts = [0, *(np.flatnonzero(np.diff(self.starts // _CHUNK_BYTES)) + 1).tolist(), len(self.starts)]
        edges = [*(self.starts - self.starts[0])[cuts[:-1]].tolist(), len(self.records)]
        for rows, span in zip(pairwise(cuts), pairwise(edges), strict=True):
            own = slice(*rows)
            yield _Framed(
                self.records[slice(*span)], self.channel[own], self.log_time_ns[own], self.starts[own]
            )


class McapWriter:
    """Merges the messages of topics by log time into chunks, while they come.

    Messages wait until :meth:`flush` says that none will come that belongs before them. Those of one log time
    come in the order in which their topics were announced.

    Args:
        path: for errors.
        stream: file to write.
    """

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self._path = path
        self._stream = stream
        self._schemas: dict[str, bytes] = {}
        self._described: list[bytes] = []
        self._channels: dict[str, _Channel] = {}
        self._chunk_index: list[bytes] = []
        self._open: list[_Framed] = []
        self._framed_bytes = 0
        self._span_ns: tuple[int, int] | None = None
        stream.write(MAGIC + _record(_HEADER, _string("ros2") + _string(f"quadpi {__version__}")))

    def announce(self, topics: Mapping[str, str]) -> None:
        """Describe topics by name and type now; they are in the bag even if no message comes.

        Others are described before the chunk that holds their first message.
        """
        for name, type_name in topics.items():
            self._channels.setdefault(name, _Channel(type_name))
        self._describe(topics)

    def _describe(self, names: Collection[str]) -> None:
        """Write what the file does not say yet of topics: their schemas, then their channels."""
        new = [name for name in self._channels if name in names and not self._channels[name].described]
        before = len(self._schemas)
        for type_name in (self._channels[name].type_name for name in new):
            if type_name not in self._schemas:
                self._schemas[type_name] = _schema(len(self._schemas) + 1, type_name)
        numbers, types = list(self._channels), list(self._schemas)
        described = []
        for name in new:
            channel = self._channels[name]
            channel.described = True
            described.append(
                _channel(numbers.index(name), types.index(channel.type_name) + 1, name, channel.type_name)
            )
        self._described += described
        self._stream.write(b"".join([*list(self._schemas.values())[before:], *described]))

    def add(self, topic: Topic) -> None:
        """Take messages of a topic, announced or not.

        Raises:
            LogError: naming topic and sample, for log times that ROS stamps cannot hold.
        """
        if len(topic.payloads) == 0:
            return
        channel = self._channels.setdefault(topic.name, _Channel(topic.type_name))
        foreign = (topic.log_time_ns < 0) | (topic.log_time_ns >= _STAMP_END_NS)
        if np.any(foreign):
            sample = channel.written + sum(len(part.payloads) for part in channel.waiting)
            sample += int(np.argmax(foreign))
            reason = "the stamp is before 1970 or after 2038"
            raise LogError(f"{self._path}: topic {topic.name}: sample {sample}: {reason}")
        unsorted = np.any(topic.log_time_ns[1:] < topic.log_time_ns[:-1])
        channel.waiting.append(join_topics([topic]) if unsorted else topic)

    def flush(self, until_ns: int = _STAMP_END_NS) -> None:
        """Write the messages logged at that time or before, as none is still to come that belongs there.

        Without a time all that wait are written: what comes later follows them, whenever it was logged.
        """
        due = []
        for number, channel in enumerate(self._channels.values()):
            parts = [cut_topic(topic, until_ns + 1) for topic in channel.waiting]
            channel.waiting = [later for _, later in parts if len(later.payloads)]
            for now in (now for now, _ in parts if len(now.payloads)):
                due.append((number, channel.written, now))
                channel.written += len(now.payloads)
        if not due:
            return
        framed = _framed(due, self._framed_bytes)
        self._framed_bytes += len(framed.records)
        first_ns, last_ns = int(framed.log_time_ns.min()), int(framed.log_time_ns.max())
        if self._span_ns is not None:
            first_ns, last_ns = min(first_ns, self._span_ns[0]), max(last_ns, self._span_ns[1])
        self._span_ns = first_ns, last_ns
        for part in framed.split():
            if self._open and self._open[0].starts[0] // _CHUNK_BYTES != part.starts[0] // _CHUNK_BYTES:
                self._close_chunk()
            self._open.append(part)

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Write what waits, the metadata record "quadpi" and the summary."""
        self.flush()
        self._close_chunk()
        stream = self._stream
        metadata_start = stream.tell()
        metadata_record = _record(METADATA, _string("quadpi") + _string_map(metadata))
        stream.write(metadata_record)
        stream.write(_record(_DATA_END, struct.pack("<I", 0)))
        metadata_place = struct.pack("<QQ", metadata_start, len(metadata_record))
        groups = {
            _SCHEMA: b"".join(self._schemas.values()),
            _CHANNEL: b"".join(self._described),
            _CHUNK_INDEX: b"".join(self._chunk_index),
            _METADATA_INDEX: _record(_METADATA_INDEX, metadata_place + _string("quadpi")),
            _STATISTICS: self._statistics(),
        }
        stream.write(_summary(groups, start=stream.tell()) + MAGIC)

    def _close_chunk(self) -> None:
        if not self._open:
            return
        chunk = _Framed.join(self._open)
        names = list(self._channels)
        self._describe([names[number] for number in np.unique(chunk.channel)])
        self._chunk_index.append(_write_chunk(self._stream, chunk))
        self._open = []

    def _statistics(self) -> bytes:
        counts = [channel.written for channel in self._channels.values()]
        totals = struct.pack(
            "<QHIIIIQQ",
            *(sum(counts), len(self._schemas), len(counts), 0, 1, len(self._chunk_index)),
            *(self._span_ns or (0, 0)),
        )
        per_channel = b"".join(struct.pack("<HQ", channel, count) for channel, count in enumerate(counts))
        return _record(_STATISTICS, totals + _sized(per_channel))


def _summary(groups: Mapping[int, bytes], start: int) -> bytes:
    """Summary section, offsets of its groups and footer; `start` is where it stands in the file."""
    offsets = b""
    position = start
    for opcode, group in groups.items():
        if group:
            offsets += _record(_SUMMARY_OFFSET, struct.pack("<BQQ", opcode, position, len(group)))
        position += len(group)
    checked = b"".join(groups.values()) + offsets
    checked += struct.pack("<BQQQ", _FOOTER, _FOOTER_LENGTH, start, position)
    return checked + struct.pack("<I", zlib.crc32(checked))


def _framed(due: Sequence[tuple[int, int, Topic]], begin: int) -> _Framed:
    """Merge messages by log time, each as a record.

    Args:
        due: channel, number of messages written before, and messages in the order of their log times.
        begin: where the first record begins, see :class:`_Framed`.
    """
    counts = [len(topic.payloads) for _, _, topic in due]
    log_time_ns = np.concatenate([topic.log_time_ns for _, _, topic in due])
    order = np.argsort(log_time_ns, kind="stable")
    lengths = np.concatenate([topic.payloads.lengths for _, _, topic in due])
    sizes = lengths[order] + _RECORD_HEADER.itemsize
    starts = np.empty_like(sizes)
    starts[order] = np.cumsum(sizes) - sizes

    headers = np.zeros(len(order), dtype=_RECORD_HEADER)
    headers["opcode"] = MESSAGE
    headers["length"] = lengths + MESSAGE_HEADER.itemsize
    headers["channel"] = np.repeat([channel for channel, _, _ in due], counts)
    headers["sequence"] = np.concatenate(
        [np.arange(before, before + count) for (_, before, _), count in zip(due, counts, strict=True)]
    )
    headers["log_time"] = headers["publish_time"] = log_time_ns

    data = np.empty(int(sizes.sum()), dtype=np.uint8)
    framed = Payloads.from_rows(headers.view(np.uint8).reshape(len(headers), -1))
    copy_spans(framed.data, framed.starts, data, starts, framed.lengths)
    payload_starts = starts + _RECORD_HEADER.itemsize
    first = 0
    for _, _, topic in due:
        own = slice(first, first + len(topic.payloads))
        copy_spans(
            topic.payloads.data, topic.payloads.starts, data, payload_starts[own], topic.payloads.lengths
        )
        first = own.stop
    return _Framed(data, headers["channel"][order], log_time_ns[order], begin + starts[order])


def _write_chunk(stream: BinaryIO, chunk: _Framed) -> bytes:
    """Write a chunk and its message indexes; return its record for the chunk index."""
    compressed = lz4.compress(chunk.records, store_size=False)
    # Where a clock was set back, the first message is not the earliest.
    span = struct.pack("<QQ", chunk.log_time_ns.min(), chunk.log_time_ns.max())
    checksum = struct.pack("<QI", len(chunk.records), zlib.crc32(chunk.records.data))
    content = struct.pack("<Q", len(compressed)) + compressed
    start = stream.tell()
    stream.write(_record(CHUNK, span + checksum + _string(_COMPRESSION) + content))
    length = stream.tell() - start
    offsets = chunk.starts - chunk.starts[0]
    index_offsets = b""
    for channel in np.unique(chunk.channel):
        own = chunk.channel == channel
        entries = np.empty(int(own.sum()), dtype=_INDEX_ENTRY)
        entries["log_time"], entries["offset"] = chunk.log_time_ns[own], offsets[own]
        index_offsets += struct.pack("<HQ", channel, stream.tell())
        stream.write(_record(_MESSAGE_INDEX, struct.pack("<H", channel) + _sized(entries.tobytes())))
    index_length = stream.tell() - start - length
    return _record(
        _CHUNK_INDEX,
        span
        + struct.pack("<QQ", start, length)
        + _sized(index_offsets)
        + struct.pack("<Q", index_length)
        + _string(_COMPRESSION)
        + struct.pack("<QQ", len(compressed), len(chunk.records)),
    )


def _schema(number: int, type_name: str) -> bytes:
    text = definition_text(type_name).encode()
    return _record(
        _SCHEMA, struct.pack("<H", number) + _string(type_name) + _string("ros2msg") + _sized(text)
    )


def _channel(number: int, schema: int, name: str, type_name: str) -> bytes:
    metadata = {
        "offered_qos_profiles": qos_of(name.removeprefix("/")).in_bag(),
        "topic_type_hash": typestore().hash_rihs01(type_name),
    }
    numbers = struct.pack("<HH", number, schema)
    return _record(_CHANNEL, numbers + _string(name) + _string("cdr") + _string_map(metadata))


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _string_map(entries: Mapping[str, str]) -> bytes:
    return _sized(b"".join(_string(key) + _string(value) for key, value in entries.items()))


def _string(text: str) -> bytes:
    return _sized(text.encode())


def _sized(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content
