# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Writing MCAP bags with rosbags, whole or as their messages come.

rosbags wants messages in log-time order: those of several topics are merged here. Equal messages give equal
bytes, in however many blocks they come.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, cast

import numpy as np
import numpy.typing as npt
from backports import zstd
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer, storage_mcap

from quadpi_core.core import compiled
from quadpi_core.errors import LogError
from quadpi_core.flight import Stamps
from quadpi_core.messages.definitions import definition_text, typestore
from quadpi_core.messages.payloads import Bytes, Indices, Payloads, Topic, join_topics
from quadpi_core.messages.topics import qos_of
from quadpi_core.paths import whole_output

if TYPE_CHECKING:
    from rosbags.rosbag2.writer import StorageWriter

# Version of the metadata of rosbag2. From 9 on, policies of quality of service are words, at which `ros2 bag
# play` of Humble and Iron stops; Jazzy and later tell words and numbers apart. Nothing in our bags needs 9.
_ROSBAG2_VERSION: Literal[8] = 8
# Seconds of a ROS stamp are signed 32-bit numbers.
_STAMP_END_NS = 2**31 * 10**9
_MESSAGE, _CHUNK, _MESSAGE_INDEX = 0x05, 0x06, 0x07
_RECORD_PREFIX = 9
_NEVER_NS = 2**63 - 1
_RECORD_HEADER = np.dtype(
    [
        *(("opcode", "u1"), ("length", "<u8")),
        *(("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")),
    ]
)
# Chunks of rosbags and of rosbag2 are about as long.
_CHUNK_BYTES = 2**20
# Levels of Zstandard. Of numbers, 1 makes as much of a chunk as the default level, in half the time; -3 makes
# 3 % more than 1, in half of that.
SMALL, FAST = 1, -3
# The last bytes of an MCAP file: the footer record, its checksum, and the magic bytes.
_FOOTER_CONTENT, _CHECKSUM, _MAGIC = 20, 4, 8


def write_mcap(path: Path, topics: Sequence[Topic], metadata: Mapping[str, str]) -> None:
    """Write a bag that appears whole or not at all.

    Args:
        path: file to write, replaced if it exists.
        topics: messages per topic, of types that `definitions` knows.
        metadata: entries of rosbag2's `custom_data`.

    Raises:
        LogError: if the path does not end in .mcap, and for log times that ROS stamps cannot hold.
        OutputError: if the file cannot be written.
    """
    with mcap_writer(path, metadata) as writer:
        writer.announce({topic.name: topic.type_name for topic in topics})
        for topic in topics:
            writer.add(topic)


@contextmanager
def mcap_writer(path: Path, metadata: Mapping[str, str], level: int = SMALL) -> Iterator[BagWriter]:
    """Open a bag to write as its messages come; it appears whole or not at all.

    Args:
        path: file to write, replaced if it exists.
        metadata: see :func:`write_mcap`.
        level: of its compression, SMALL or FAST.

    Raises:
        LogError: if the path does not end in .mcap.
        OutputError: if the file cannot be written.
    """
    if path.suffix != ".mcap":
        raise LogError(f"{path}: a bag is written to a file that ends in .mcap")
    with whole_output(path) as temporary:
        # rosbags writes a folder, whose name its file takes and holds; that file is a bag by itself.
        folder = temporary.with_name("bag")
        with _ChecksummedWriter(folder, version=_ROSBAG2_VERSION, storage_plugin=StoragePlugin.MCAP) as out:
            for key, text in metadata.items():
                out.set_custom_data(key, text)
            out.mcap.level = level
            writer = BagWriter(path, out)
            yield writer
            writer.flush()
        (folder / f"{folder.name}.mcap").rename(temporary)


class _ChecksummedStorage(storage_mcap.McapWriter):
    """rosbags' MCAP writer with the checksums that it leaves out: unnoticed damage reads as other values."""

    def __init__(self, path: Path, _compression: CompressionMode) -> None:
        super().__init__(path, CompressionMode.STORAGE)
        # Of the open chunk, by channel: parts (N, 2) of log times and places in it.
        self._index: defaultdict[int, list[npt.NDArray[np.uint64]]] = defaultdict(list)
        self.level = SMALL

    def close_chunk(self) -> None:
        """Write the chunk and its index, in 1 ms; rosbags packs each number of an index by itself, in 3.

        The index is in the order of the channels: that of first use would depend on the blocks.
        """
        end_ns, size = self.chunk.message_end_time, self.chunk.bio.tell()
        # Of a chunk with topics alone, which rosbags lets begin in the year 2262; the specification says 0.
        times = struct.pack("<QQ", min(self.chunk.message_start_time, end_ns), end_ns)
        options = {
            int(zstd.CompressionParameter.checksum_flag): 1,
            int(zstd.CompressionParameter.compression_level): self.level,
        }
        packed = zstd.compress(self.chunk.bio.getbuffer(), options=options)
        named = struct.pack(f"<I{len(self.compression)}s", len(self.compression), self.compression.encode())
        start = self.bio.tell()
        no_checksum = 0  # Zstandard has its own
        head = times + struct.pack("<QI", size, no_checksum) + named + struct.pack("<Q", len(packed))
        self._write_record(_CHUNK, head, packed)
        indexed_from = self.bio.tell()
        places = b""
        for channel, parts in sorted(self._index.items()):
            places += struct.pack("<HQ", channel, self.bio.tell())
            index = np.concatenate(parts).astype("<u8", copy=False)
            self._write_record(_MESSAGE_INDEX, struct.pack("<HI", channel, index.nbytes), index.tobytes())
        summary = times + struct.pack("<QQI", start, indexed_from - start, len(places)) + places
        summary += struct.pack("<Q", self.bio.tell() - indexed_from) + named
        self.chunks.append(BytesIO(summary + struct.pack("<QQ", len(packed), size)))
        self.chunks[-1].seek(0, SEEK_END)
        self.chunk = storage_mcap.PendingChunk(_NEVER_NS, 0, BytesIO(), {})
        self._index.clear()

    def _write_record(self, opcode: int, head: bytes, content: bytes) -> None:
        self.bio.write(struct.pack("<BQ", opcode, len(head) + len(content)) + head)
        self.bio.write(content)

    def close(self, version: int, metadata: str) -> None:
        """Write index and footer, and the checksum of the summary into the footer."""
        self.message_start_time = min(self.message_start_time, self.message_end_time)
        super().close(version, metadata)
        with self.path.open("rb+") as stream:
            checksum_at = stream.seek(-_CHECKSUM - _MAGIC, 2)
            stream.seek(checksum_at + _CHECKSUM - _FOOTER_CONTENT)
            start = int.from_bytes(stream.read(8), "little")
            stream.seek(start)
            checksum = zlib.crc32(stream.read(checksum_at - start))
            stream.seek(checksum_at)
            stream.write(checksum.to_bytes(_CHECKSUM, "little"))

    def write_all(self, messages: _Framed) -> None:
        """Write many messages as `write` does each, but 1 µs a message instead of 3.5.

        A replay at 100 times real time has 20 µs for a sample and its three messages.
        """
        ends = messages.starts + messages.lengths
        first = 0
        while first < len(ends):
            chunk = self.chunk
            begin = int(messages.starts[first])
            # A chunk is closed by the message that makes it longer.
            room = _CHUNK_BYTES - chunk.bio.tell() + begin
            rows = slice(first, min(int(np.searchsorted(ends, room, side="right")) + 1, len(ends)))
            times_ns, channels = messages.log_time_ns[rows], messages.channels[rows]
            offsets = messages.starts[rows] - begin + chunk.bio.tell()
            chunk.bio.write(messages.data[begin : ends[rows.stop - 1]].data)
            index = np.stack((times_ns, offsets), axis=1).astype(np.uint64)
            for channel in np.unique(channels).tolist():
                self._index[channel].append(index[channels == channel])
                self.channel_stats[channel] += len(self._index[channel][-1])
            earliest, latest = int(times_ns.min()), int(times_ns.max())
            chunk.message_start_time = min(earliest, chunk.message_start_time)
            chunk.message_end_time = max(latest, chunk.message_end_time)
            self.message_start_time = min(earliest, self.message_start_time)
            self.message_end_time = max(latest, self.message_end_time)
            if chunk.bio.tell() > _CHUNK_BYTES:
                self.close_chunk()
            first = rows.stop


class _ChecksummedWriter(Writer):
    STORAGE_PLUGINS: Mapping[StoragePlugin, type[StorageWriter]] = {StoragePlugin.MCAP: _ChecksummedStorage}

    @property
    def mcap(self) -> _ChecksummedStorage:
        """The open file."""
        return cast("_ChecksummedStorage", self.storage)

    def write_all(self, messages: _Framed) -> None:
        """Write many messages."""
        self.mcap.write_all(messages)
        for channel, count in zip(*np.unique(messages.channels, return_counts=True), strict=True):
            self.counts[int(channel)] += int(count)
        self.min_timestamp = min(self.min_timestamp, int(messages.log_time_ns.min()))
        self.max_timestamp = max(self.max_timestamp, int(messages.log_time_ns.max()))


@dataclass
class _Channel:
    """A topic of the bag, the number of its messages written so far, and those that wait."""

    type_name: str
    connection: Connection | None = None
    written: int = 0
    waiting: list[Topic] = field(default_factory=list)


class BagWriter:
    """Merges the messages of topics by log time, as they come.

    Messages wait until :meth:`flush` says that none will come that belongs before them. Those with equal log
    times are written in the order in which their topics were announced.
    """

    def __init__(self, path: Path, out: _ChecksummedWriter) -> None:
        self._path = path
        self._out = out
        self._channels: dict[str, _Channel] = {}

    def announce(self, topics: Mapping[str, str]) -> None:
        """Describe topics by name and type now; they are in the bag even if no message comes.

        Other topics are described in front of their first message.
        """
        for name, type_name in topics.items():
            self._connection(name, self._channels.setdefault(name, _Channel(type_name)))

    def _connection(self, name: str, channel: _Channel) -> Connection:
        if channel.connection is None:
            channel.connection = self._out.add_connection(
                name,
                channel.type_name,
                msgdef=definition_text(channel.type_name),
                rihs01=_type_hash(channel.type_name),
                offered_qos_profiles=[qos_of(name.removeprefix("/")).profile()],
            )
        return channel.connection

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
        """Write the messages logged until then, as no earlier one is still to come.

        Without a time all waiting messages are written, and later ones follow them even if logged earlier.
        """
        new = {
            int(channel.waiting[0].log_time_ns[0])
            for channel in self._channels.values()
            if channel.connection is None and channel.waiting
        }
        # A topic is described in front of its first message, in however many blocks the messages come.
        for first_ns in sorted(first_ns for first_ns in new if first_ns <= until_ns):
            self._write(first_ns)
            for name, channel in self._channels.items():
                if channel.waiting and channel.waiting[0].log_time_ns[0] == first_ns:
                    self._connection(name, channel)
        self._write(until_ns + 1)

    def _write(self, end_ns: int) -> None:
        """Write the messages logged before an instant."""
        due: list[tuple[int, Topic]] = []
        for name, channel in self._channels.items():
            parts = [topic.split(end_ns) for topic in channel.waiting]
            channel.waiting = [later for _, later in parts if len(later.payloads)]
            for now in (now for now, _ in parts if len(now.payloads)):
                due.append((self._connection(name, channel).id, now))
                channel.written += len(now.payloads)
        if due:
            self._out.write_all(_framed(due))


class _Framed(NamedTuple):
    """Message records side by side, in log-time order.

    Attributes:
        data: their bytes.
        starts, lengths: (N,) of each record in `data`.
        channels: (N,) ids of their connections.
        log_time_ns: (N,).
    """

    data: Bytes
    starts: Indices
    lengths: Indices
    channels: Indices
    log_time_ns: Stamps


def _framed(due: Sequence[tuple[int, Topic]]) -> _Framed:
    """Merge messages by log time; those with equal log times keep the order of `due` (channel, messages)."""
    log_time_ns = np.concatenate([topic.log_time_ns for _, topic in due])
    channels = np.repeat([channel for channel, _ in due], [len(topic.payloads) for _, topic in due])
    order = np.argsort(log_time_ns, kind="stable")
    lengths = np.concatenate([topic.payloads.lengths for _, topic in due]) + _RECORD_HEADER.itemsize
    starts = np.empty_like(lengths)
    starts[order] = np.cumsum(lengths[order]) - lengths[order]

    headers = np.zeros(len(order), dtype=_RECORD_HEADER)
    headers["opcode"] = _MESSAGE
    headers["length"] = lengths - _RECORD_PREFIX
    headers["channel"] = channels
    headers["log_time"] = headers["publish_time"] = log_time_ns

    data = np.empty(int(lengths.sum()), dtype=np.uint8)
    rows = Payloads.from_rows(headers.view(np.uint8).reshape(len(headers), -1))
    compiled.copy_spans(rows.data, rows.starts, data, starts, rows.lengths)
    first = 0
    for _, topic in due:
        own = starts[first : first + len(topic.payloads)] + _RECORD_HEADER.itemsize
        compiled.copy_spans(topic.payloads.data, topic.payloads.starts, data, own, topic.payloads.lengths)
        first += len(own)
    return _Framed(data, starts[order], lengths[order], channels[order], log_time_ns[order])


@cache
def _type_hash(type_name: str) -> str:
    return typestore().hash_rihs01(type_name)
