# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of MCAP files, chunk by chunk, as :mod:`quadpi_core.logs.bag_files` reads them.

rosbags goes by the index at the end of a file, which one that is cut off does not have, and takes three times
as long. Here the records are walked from the first on: where the file ends, and what is damaged, shows.

Source: the MCAP specification, version 0.
"""

from __future__ import annotations

import heapq
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from io import BytesIO
from itertools import islice
from operator import attrgetter
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import yaml
from backports import zstd
from lz4 import frame as lz4

from quadpi_core.core import compiled
from quadpi_core.errors import LogError, one_line
from quadpi_core.flight import Stamps
from quadpi_core.logs.sandbox import require_unpackable
from quadpi_core.messages.payloads import Bytes, Payloads
from quadpi_core.paths import scratch_folder
from quadpi_core.records import Records

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, STATISTICS, METADATA, DATA_END = (
    *(0x02, 0x03, 0x04, 0x05, 0x06, 0x07),
    *(0x0B, 0x0C, 0x0F),
)
# Opcode and length in front of each record.
_PREFIX = struct.Struct("<BQ")
RECORD_PREFIX = _PREFIX.size
# Of a message: channel, sequence, log time, time of publication. Of a chunk: times, unpacked size, checksum.
_MESSAGE_HEAD, _CHUNK_HEAD = struct.Struct("<HIQQ"), struct.Struct("<QQQI")
_MESSAGE_PLACE = np.dtype([(name, np.int64) for name in ("channel", "time_ns", "start", "length")])
# Of the statistics: bytes in front of the counts by channel, and one of these.
_STATISTICS_HEAD, _COUNT = 46, struct.Struct("<HQ")
_CHECKSUM = 4
_DESCRIBING = (SCHEMA, CHANNEL, STATISTICS, METADATA)
_UNPACKERS = {"zstd": zstd.decompress, "lz4": lz4.decompress, "": bytes}
_YamlLoader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_LATE = "damaged: a message was logged after the year 2262"
# Messages outside chunks that are read together.
_BATCH = 1000


class Connection(NamedTuple):
    """A topic of a bag.

    Attributes:
        topic: its name.
        msgtype: its type, such as `sensor_msgs/msg/Imu`.
        definition: of the type, as a .msg; empty where the bag does not hold it so.
        msgcount: number of its messages.
    """

    topic: str
    msgtype: str
    definition: str
    msgcount: int


class Batch(NamedTuple):
    """Messages that a container gives together.

    Attributes:
        start_ns: no message here or in a later batch of the container was logged before.
        messages: log times and messages by the number of the connection; of some that have none, nothing.
    """

    start_ns: int
    messages: dict[int, tuple[Stamps, Payloads]]

    @classmethod
    def listed(cls, start_ns: int, messages: Mapping[int, tuple[list[int], list[bytes]]]) -> Batch:
        """Of log times and messages one by one."""
        return cls(
            start_ns,
            {
                number: (np.array(times, dtype=np.int64), Payloads.join(payloads))
                for number, (times, payloads) in messages.items()
            },
        )


@dataclass
class _Chunk:
    """Where the content of a chunk is, when it begins, and the channels with messages in it."""

    start_ns: int
    place: int
    length: int
    channels: set[int] = field(default_factory=set)


class McapFile:
    """An open MCAP file.

    Attributes:
        connections: by the number of the channel.
        custom: what its writer noted of the bag; None where it does not say.

    Raises:
        LogError: if it is cut off (with the number of whole messages) or damaged.
    """

    def __init__(self, path: Path) -> None:
        self._stream = path.open("rb")
        self._size = path.stat().st_size
        self._chunks: list[_Chunk] = []
        # Log time, channel, place and length of each message outside chunks.
        self._loose: list[tuple[int, int, int, int]] = []
        # By the number of a schema, name and text of a type; by that of a channel, topic and schema.
        self._types: dict[int, tuple[str, str]] = {}
        self._channels: dict[int, tuple[str, int]] = {}
        self._notes: dict[str, dict[str, str]] = {}
        self._counts: Counter[int] | None = None
        self._walk()
        counts = self._unpack_all() if self._counts is None else self._counts
        self.connections = {channel: self._connection(channel, counts) for channel in self._channels}
        self.custom = self._custom()

    def _walk(self) -> None:
        """Find the chunks, and what describes the topics."""
        summary, stop, opcode = 0, len(MAGIC), 0
        for opcode, start, length in records_of(self._stream, self._size):
            stop = start + length
            if opcode == CHUNK:
                begin_ns, _, unpacked, _ = _CHUNK_HEAD.unpack(_read_at(self._stream, start, _CHUNK_HEAD.size))
                require_unpackable(self._size, unpacked)
                self._chunks.append(_Chunk(begin_ns, start, length))
            elif opcode == MESSAGE_INDEX and self._chunks:
                self._chunks[-1].channels.add(_number(_read_at(self._stream, start, 2)))
            elif opcode == MESSAGE:
                head = _read_at(self._stream, start, _MESSAGE_HEAD.size)
                channel, _, time_ns, _ = _MESSAGE_HEAD.unpack(head)
                self._loose.append((time_ns, channel, start, length))
            elif opcode == DATA_END:
                summary = stop
            elif opcode in _DESCRIBING:
                self._describe(opcode, _read_at(self._stream, start, length))
            elif opcode == FOOTER:
                break
        ends = _read_at(self._stream, max(self._size - len(MAGIC), stop), len(MAGIC)) == MAGIC
        if opcode != FOOTER or not ends:
            if ends:
                raise LogError(f"damaged: the record at byte {stop} runs beyond its section")
            raise LogError(
                f"cut off, it has no footer; {self._unpack_all().total()} whole messages can be read, "
                "`mcap recover` rebuilds the file"
            )
        content = _read_at(self._stream, summary, stop - summary)
        checksum = int.from_bytes(content[-_CHECKSUM:], "little")
        if summary and checksum and checksum != zlib.crc32(content[:-_CHECKSUM]):
            raise LogError("damaged: its summary does not match its checksum")

    def _describe(self, opcode: int, record: bytes) -> None:
        """Take a record that says something of topics, or of the bag."""
        if opcode == SCHEMA:
            name, encoding, text = islice(_texts(record, 2), 3)
            self._types[_number(record[:2])] = name, text if encoding == "ros2msg" else ""
        elif opcode == CHANNEL:
            self._channels[_number(record[:2])] = next(_texts(record, 4)), _number(record[2:4])
        elif opcode == STATISTICS:
            self._counts = Counter(dict(_COUNT.iter_unpack(record[_STATISTICS_HEAD:])))
        elif opcode == METADATA:
            name = next(_texts(record, 0))
            entries = list(_texts(record, 4 + len(name.encode()) + 4))
            self._notes[name] = dict(zip(entries[::2], entries[1::2], strict=True))

    def _unpack_all(self) -> Counter[int]:
        """Find the topics in the chunks of a file that has no statistics, and count their messages."""
        counts = Counter(channel for _, channel, _, _ in self._loose)
        for chunk in self._chunks:
            with suppress(LogError):  # said where its messages are read
                content = self._content(chunk)
                for opcode, start, length in records_of(BytesIO(content), len(content), 0):
                    if opcode == MESSAGE:
                        counts[_number(content[start : start + 2])] += 1
                    elif opcode in _DESCRIBING:
                        self._describe(opcode, content[start : start + length])
        return counts

    def _connection(self, channel: int, counts: Counter[int]) -> Connection:
        topic, schema = self._channels[channel]
        if schema not in self._types:
            raise LogError(f"damaged: topic {topic}: no record describes its type")
        return Connection(topic, *self._types[schema], counts[channel])

    def _custom(self) -> dict[str, str] | None:
        """What quadpi noted itself up to version 0.5, else by the record of rosbag2."""
        if "quadpi" in self._notes:
            return self._notes["quadpi"]
        found = yaml.load(self._notes.get("rosbag2", {}).get("serialized_metadata", ""), _YamlLoader)
        return found.get("custom_data") if isinstance(found, dict) else None

    def _content(self, chunk: _Chunk) -> bytes:
        """The records in a chunk, checked against its size and checksum."""
        record = _read_at(self._stream, chunk.place, chunk.length)
        where = f"the chunk at byte {chunk.place - RECORD_PREFIX}"
        _, _, size, checksum = _CHUNK_HEAD.unpack_from(record)
        compression = next(_texts(record, _CHUNK_HEAD.size))
        packed = memoryview(record)[_CHUNK_HEAD.size + 4 + len(compression) + 8 :]
        try:
            content: bytes = _UNPACKERS[compression](packed)
        except (zstd.ZstdError, RuntimeError, LookupError) as error:
            raise LogError(f"damaged: {where} cannot be unpacked: {one_line(error)}") from error
        if len(content) != size:
            raise LogError(f"damaged: {where} announces {size} bytes unpacked, holds {len(content)}")
        if checksum and zlib.crc32(content) != checksum:
            raise LogError(f"damaged: {where} does not match its checksum")
        return content

    def batches(self, wanted: Collection[int], _head: int | None) -> Iterator[Batch]:
        """The messages of some channels: those of a chunk together, in the order of their first log times."""
        parts = self._from_chunks(wanted), self._from_outside(wanted)
        yield from heapq.merge(*parts, key=attrgetter("start_ns"))

    def _from_chunks(self, wanted: Collection[int]) -> Iterator[Batch]:
        for chunk in sorted(self._chunks, key=attrgetter("start_ns")):
            # One without an index may hold any.
            if chunk.channels and chunk.channels.isdisjoint(wanted):
                continue
            content = np.frombuffer(self._content(chunk), dtype=np.uint8)
            found = _messages_in(content)
            messages = {}
            for channel in np.unique(found["channel"]).tolist():
                if channel in wanted:
                    own = found[found["channel"] == channel]
                    messages[channel] = own["time_ns"], Payloads(content, own["start"], own["length"])
                elif channel not in self._channels:
                    raise LogError(f"damaged: messages on channel {channel}, which no record describes")
            yield Batch(chunk.start_ns, messages)

    def _from_outside(self, wanted: Collection[int]) -> Iterator[Batch]:
        chosen = iter(sorted(message for message in self._loose if message[1] in wanted))
        while part := list(islice(chosen, _BATCH)):
            messages: dict[int, tuple[list[int], list[bytes]]] = {channel: ([], []) for channel in wanted}
            for time_ns, channel, start, length in part:
                messages[channel][0].append(time_ns)
                messages[channel][1].append(_read_at(self._stream, start, length)[_MESSAGE_HEAD.size :])
            if part[-1][0] >= 2**63:
                raise LogError(_LATE)
            yield Batch.listed(part[0][0], messages)


def _read_at(stream: BinaryIO, start: int, length: int) -> bytes:
    stream.seek(start)
    return stream.read(length)


def records_of(stream: BinaryIO, end: int, position: int = len(MAGIC)) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and length of the records of an MCAP file, up to the first that is not whole."""
    while position + RECORD_PREFIX <= end:
        opcode, length = _PREFIX.unpack(_read_at(stream, position, RECORD_PREFIX))
        position += RECORD_PREFIX
        if position + length > end:
            return
        yield opcode, position, length
        position += length


def _messages_in(content: Bytes) -> Records:
    """The messages (N,) in a chunk: channel, log time, and where the message lies."""
    found = np.empty(len(content) // (RECORD_PREFIX + _MESSAGE_HEAD.size), _MESSAGE_PLACE)
    count, stop = compiled.mcap_messages(content, found)
    if stop < len(content):
        raise LogError(f"damaged: the record at byte {stop} runs beyond its section")
    if (found["time_ns"][:count] < 0).any():
        raise LogError(_LATE)
    return found[:count]


def _number(pair: bytes) -> int:
    return int.from_bytes(pair, "little")


def _texts(record: bytes, position: int) -> Iterator[str]:
    """Texts one behind the other, each with its length in front."""
    while position < len(record):
        start = position + 4
        position = start + int.from_bytes(record[position:start], "little")
        yield record[start:position].decode()


# The end of a file without a summary (MCAP specification): a data end without checksum, a footer, the magic.
_ENDING = struct.pack("<BQI", DATA_END, 4, 0) + struct.pack("<BQQQI", FOOTER, 20, 0, 0, 0) + MAGIC
_COPIED_BYTES = 1 << 24


def is_cut_off(bag: Path) -> bool:
    """Whether a file, or the only one in a folder, begins as an MCAP file and does not end as one."""
    file = _mcap_file(bag)
    if file is None:
        return False
    with file.open("rb") as stream:
        begins = stream.read(len(MAGIC)) == MAGIC
        stream.seek(0, 2)
        stream.seek(max(0, stream.tell() - len(MAGIC)))
        return begins and stream.read() != MAGIC


@contextmanager
def whole_part(bag: Path) -> Iterator[Path]:
    """A bag that can be read: the same, or of one that is cut off a copy of its whole records.

    The last chunk of messages is lost where the cut is in it. Errors within the block name `bag`.
    """
    if not is_cut_off(bag):
        yield bag
        return
    file = _mcap_file(bag)
    assert file is not None
    with scratch_folder() as folder:
        copy = folder / file.name
        try:
            _copy_whole_records(file, copy)
            yield copy
        except LogError as error:
            raise LogError(f"{str(error).replace(str(copy), str(bag))} (the file is cut off)") from error


def _mcap_file(bag: Path) -> Path | None:
    """The file with the messages; None where there are several, or it is of another container."""
    if bag.is_dir():
        # A recorder that was killed has not written metadata.yaml.
        files = [] if (bag / "metadata.yaml").exists() else list(bag.glob("*.mcap"))
        return files[0] if len(files) == 1 else None
    return bag if bag.is_file() and bag.suffix == ".mcap" else None


def _copy_whole_records(source: Path, target: Path) -> None:
    end = len(MAGIC)
    with source.open("rb") as stream, target.open("xb") as copy:
        for opcode, start, length in records_of(stream, source.stat().st_size):
            if opcode == DATA_END:
                # The data are whole, only their summary is not.
                end = start - RECORD_PREFIX
                break
            end = start + length
        if end == len(MAGIC):
            raise LogError(f"{target}: cut off within its first record")
        stream.seek(0)
        while end > 0 and (part := stream.read(min(end, _COPIED_BYTES))):
            copy.write(part)
            end -= len(part)
        copy.write(_ENDING)
