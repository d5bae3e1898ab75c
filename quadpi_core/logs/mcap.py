# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reading rosbag2 bags topic by topic as arrays.

rosbags opens and validates a bag and lists its topics. The messages of an MCAP bag are then found by a
compiled walk over its records instead of one by one in Python (https://mcap.dev/spec).
"""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from io import SEEK_CUR, BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.parse import quote

import numpy as np
from backports import zstd
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader, read_string

from quadpi_core.compiled import njit
from quadpi_core.errors import LogError, one_line
from quadpi_core.flight import Stamps
from quadpi_core.logs.payloads import Bytes, Indices, Payloads
from quadpi_core.logs.unpacking import require_unpackable, unlz4, unpacked_limit, unzstd, zstd_size
from quadpi_core.reading import read_bounded

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, MESSAGE, CHUNK, STATISTICS, METADATA = 0x03, 0x05, 0x06, 0x0B, 0x0C
RECORD_PREFIX = 9
MESSAGE_HEADER = np.dtype(
    [("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")]
)
_CHUNK_HEADER = np.dtype(
    [("start_time", "<u8"), ("end_time", "<u8"), ("size", "<u8"), ("crc", "<u4"), ("name_length", "<u4")]
)
_FOOTER = np.dtype([("summary_start", "<u8"), ("offsets_start", "<u8"), ("crc", "<u4")])
_LENGTH_64 = np.dtype("<u8")
_METADATA_FILE = "metadata.yaml"
# What a message takes beside its bytes.
_ENTRY_BYTES = 100
# That of a recording of a day, split every minute, is smaller.
_METADATA_BYTES_MAX = 2**20


@dataclass(frozen=True)
class Topic:
    """The messages of one topic in the order of their log times."""

    name: str
    type_name: str
    log_time_ns: Stamps
    payloads: Payloads


@dataclass(frozen=True)
class Records:
    """Records found in a buffer: opcode, start of the content and its length; and where the walk stopped."""

    opcodes: Indices
    starts: Indices
    lengths: Indices
    stop: int

    def of(self, opcode: int) -> tuple[Indices, Indices]:
        """Starts and lengths of the records of one kind."""
        chosen = self.opcodes == opcode
        return self.starts[chosen], self.lengths[chosen]


class Bag:
    """An open bag: a bare .mcap or .db3 file, or a rosbag2 folder of either.

    Raises:
        LogError: for a bag that is absent, empty, cut off or damaged, from any of its methods.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.exists():
            raise LogError(f"{path}: no such bag")
        for file in _files_of(path):
            _check_file(file)
        with self._reading():
            self._reader = Reader(_with_metadata(path))
            self._reader.open()
            self._check_connections()

    def _check_connections(self) -> None:
        """Refuse what a damaged index or metadata.yaml holds in the place of names and counts."""
        for connection in self.connections:
            named = all(isinstance(text, str) for text in (connection.topic, connection.msgtype))
            if not named or not isinstance(connection.msgcount, int) or connection.msgcount < 0:
                self._reader.close()
                raise LogError(
                    f"damaged: topic {connection.topic} of type {connection.msgtype} is said to hold "
                    f"{connection.msgcount} messages"
                )

    def __enter__(self) -> Bag:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._reader.close()

    @property
    def connections(self) -> list[Connection]:
        """What rosbags knows of each topic: name, type, definition, count; a topic may come twice."""
        return self._reader.connections

    @cached_property
    def metadata(self) -> dict[str, str]:
        """Entries of the metadata record "quadpi"; empty where the bag has none."""
        entries: dict[str, str] = {}
        with self._reading():
            for storage in self._mcap_storages():
                data = _bytes_of(Path(str(storage.path)))[: storage.data_end]
                for start, length in zip(*find_records(data, storage.data_start).of(METADATA), strict=True):
                    name, content = _parse_metadata(data[start : start + length].tobytes())
                    if name == "quadpi":
                        entries |= content
        return entries

    def read(self, names: Collection[str], head: int | None = None) -> dict[str, Topic]:
        """Read topics by their full names.

        Args:
            names: topics of the bag.
            head: read only so many bytes of each message; whole messages where not given.
        """
        connections = [connection for connection in self.connections if connection.topic in names]
        with self._reading():
            storages = self._mcap_storages()
            if storages and self._reader.compression_mode != "message":
                parts = [part for storage in storages for part in _parts(storage, names, head)]
            else:
                parts = self._parts_one_by_one(connections)
            parts += [_no_messages(connection) for connection in connections]
        topics = {}
        for name in names:
            announced = sum(connection.msgcount for connection in connections if connection.topic == name)
            topics[name] = _join([part for part in parts if part.name == name])
            if len(topics[name].payloads) != announced:
                raise LogError(
                    f"{self.path}: topic {name}: damaged: holds {len(topics[name].payloads)} messages, "
                    f"its index announces {announced}"
                )
        return topics

    def _storages(self) -> list[Any]:
        storage = self._reader.storage
        return storage.storages if isinstance(storage, DirectoryReader) else [storage]

    def _mcap_storages(self) -> list[McapReader]:
        return [storage for storage in self._storages() if isinstance(storage, McapReader)]

    def _parts_one_by_one(self, connections: list[Connection]) -> list[Topic]:
        times: dict[int, list[int]] = {connection.id: [] for connection in connections}
        messages: dict[int, list[bytes]] = {connection.id: [] for connection in connections}
        packed_bytes = sum(file.stat().st_size for file in _files_of(self.path))
        unpacked_bytes = 0
        for connection, time_ns, message in self._messages(connections):
            unpacked_bytes += _ENTRY_BYTES + len(message)
            require_unpackable(packed_bytes, unpacked_bytes)
            times[connection.id].append(time_ns)
            messages[connection.id].append(message)
        return [
            Topic(
                connection.topic,
                connection.msgtype,
                np.array(times[connection.id], dtype=np.int64),
                Payloads.join(messages[connection.id]),
            )
            for connection in connections
        ]

    def _messages(self, connections: list[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages as rosbags orders them; it would unpack those that are packed one by one at any size."""
        if self._reader.compression_mode != "message":
            yield from self._reader.messages(connections)
            return
        by_name = {(connection.topic, connection.msgtype): connection for connection in connections}
        for storage in self._storages():
            own = [known for known in storage.connections if (known.topic, known.msgtype) in by_name]
            for known, time_ns, message in storage.messages(own) if own else ():
                size = zstd_size(message, unpacked_limit(len(message)))
                require_unpackable(len(message), size)
                yield by_name[known.topic, known.msgtype], time_ns, unzstd(message, size)

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Turn whatever a parser raises on damaged bytes into one LogError that names the bag."""
        try:
            yield
        except LogError as error:
            raise LogError(f"{self.path}: {error}") from error
        except Exception as error:  # rosbags and the decompressors raise many kinds on damaged bytes
            reason = str(error).splitlines() or [type(error).__name__]
            raise LogError(f"{self.path}: cannot be read: {reason[0]}") from error


def _files_of(path: Path) -> list[Path]:
    """The files of a bag that hold messages."""
    return sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]


def _with_metadata(folder: Path) -> Path:
    """The folder of a bag, or the one file in it where nothing describes the folder.

    Raises:
        LogError: if its metadata.yaml is too large, or absent and there is not one file.
        ValueError: if it is no file.
    """
    if not folder.is_dir():
        return folder
    if (folder / _METADATA_FILE).exists():
        read_bounded(folder / _METADATA_FILE, _METADATA_BYTES_MAX)
        return folder
    files = [file for file in _files_of(folder) if file.suffix in {".mcap", ".db3"}]
    if len(files) != 1:
        raise LogError(
            f"no {_METADATA_FILE}, and {len(files)} files of messages: `ros2 bag reindex` makes it, or name "
            "one of the files"
        )
    return files[0]


def _check_file(file: Path) -> None:
    """Refuse a file of a bag that unpacks to too much, and an MCAP file that is damaged.

    That is one that is empty, cut off (saying how much is whole) or has a damaged summary.
    """
    try:
        if file.suffix == ".zstd":
            packed = _bytes_of(file).data
            require_unpackable(len(packed), zstd_size(packed, unpacked_limit(len(packed))))
        elif file.suffix == ".db3":
            _check_database(file)
        elif file.suffix == ".mcap":
            _check_mcap(file)
    except LogError as error:
        raise LogError(f"{file}: {error}") from None
    except OSError as error:
        raise LogError(f"{file}: cannot be read: {error.strerror or error}") from error
    except (sqlite3.Error, zstd.ZstdError) as error:
        raise LogError(f"{file}: cannot be read: {one_line(error)}") from error


def _check_database(file: Path) -> None:
    """Refuse tables that make up their rows, or multiply them: what they yield has no bound."""
    place = f"file:{quote(str(file.absolute()))}?mode=ro&immutable=1"
    with closing(sqlite3.connect(place, uri=True)) as database:
        for table in ("topics", "messages"):
            made = database.execute("SELECT sql FROM sqlite_master WHERE name = ?", (table,)).fetchall()
            columns = database.execute(f"PRAGMA table_xinfo({table})").fetchall()
            is_plain = all(column[-1] == 0 for column in columns)
            if not is_plain or any("VIRTUAL" in str(text).upper() for (text,) in made):
                raise LogError(f"damaged: its table `{table}` computes what it holds")
        if made:
            total, different = database.execute("SELECT COUNT(*), COUNT(DISTINCT id) FROM topics").fetchone()
            if total != different:
                raise LogError("damaged: topics of the same number")


def _check_mcap(file: Path) -> None:
    data = _bytes_of(file)
    if len(data) == 0:
        raise LogError("is empty")
    if data[: len(MAGIC)].tobytes() != MAGIC:
        raise LogError("is no MCAP file")
    if len(data) < _FOOTER.itemsize + 2 * len(MAGIC) or data[-len(MAGIC) :].tobytes() != MAGIC:
        raise LogError(
            f"cut off, it has no footer; {_whole_messages(data)} whole messages can be read, "
            "`mcap recover` rebuilds the file"
        )
    footer = data[-_FOOTER.itemsize - len(MAGIC) : -len(MAGIC)].view(_FOOTER)[0]
    summary = data[int(footer["summary_start"]) : -footer["crc"].itemsize - len(MAGIC)]
    if footer["crc"] and zlib.crc32(summary.data) != footer["crc"]:
        raise LogError("damaged: its summary does not match its checksum")
    records = find_records(data, len(MAGIC))
    _check_whole(records, data[: -len(MAGIC)])
    chunks = [data[start : start + length] for start, length in zip(*records.of(CHUNK), strict=True)]
    require_unpackable(len(data), sum(_unpacked_size(chunk) for chunk in chunks))
    summary_start = int(footer["summary_start"]) or len(data)
    if not {SCHEMA, STATISTICS} <= set(records.opcodes[records.starts > summary_start].tolist()):
        # Without them rosbags unpacks every chunk, whatever its size.
        for chunk in chunks:
            _decompressed(chunk)


def _whole_messages(data: Bytes) -> int:
    """Messages in a cut file that are whole, in chunks or not."""
    records = find_records(data, len(MAGIC))
    count = len(records.of(MESSAGE)[0])
    for start, length in zip(*records.of(CHUNK), strict=True):
        with suppress(Exception):  # a damaged chunk holds no whole message
            count += len(find_records(_decompressed(data[start : start + length])).of(MESSAGE)[0])
    return count


def _parts(storage: McapReader, names: Collection[str], head: int | None) -> Iterator[Topic]:
    """The messages of each topic, chunk by chunk of one file."""
    channels = {connection.id: connection for connection in storage.connections}
    data = _bytes_of(Path(str(storage.path)))[: storage.data_end]
    records = find_records(data, storage.data_start)
    _check_whole(records, data)
    yield from _split(data, records, channels, names, head)
    for start, length in zip(*records.of(CHUNK), strict=True):
        chunk = _decompressed(data[start : start + length])
        in_chunk = find_records(chunk)
        _check_whole(in_chunk, chunk)
        yield from _split(chunk, in_chunk, channels, names, head)


def _split(
    data: Bytes, records: Records, channels: dict[int, Connection], names: Collection[str], head: int | None
) -> Iterator[Topic]:
    """Gather the messages among `records` topic by topic."""
    starts, lengths = records.of(MESSAGE)
    if len(starts) == 0:
        return
    if np.any(lengths < MESSAGE_HEADER.itemsize):
        raise LogError("damaged: a message record is shorter than its header")
    header_bytes = np.lib.stride_tricks.sliding_window_view(data, MESSAGE_HEADER.itemsize)[starts]
    headers = header_bytes.view(MESSAGE_HEADER)[:, 0]
    payloads = Payloads(data, starts + MESSAGE_HEADER.itemsize, lengths - MESSAGE_HEADER.itemsize)
    for channel in np.unique(headers["channel"]):
        connection = channels.get(int(channel))
        if connection is None:
            raise LogError(f"damaged: messages on channel {channel}, which no record describes")
        if connection.topic in names:
            chosen = headers["channel"] == channel
            log_time_ns = headers["log_time"][chosen].astype(np.int64)
            own = payloads.take(chosen).compact(head)
            yield Topic(connection.topic, connection.msgtype, log_time_ns, own)


def _no_messages(connection: Connection) -> Topic:
    return Topic(connection.topic, connection.msgtype, np.empty(0, dtype=np.int64), Payloads.join([]))


def _join(parts: Sequence[Topic]) -> Topic:
    """One topic of its parts, in the order of log times."""
    log_time_ns = np.concatenate([part.log_time_ns for part in parts])
    payloads = Payloads.concatenate([part.payloads for part in parts])
    if np.any(np.diff(log_time_ns) < 0):
        order = np.argsort(log_time_ns, kind="stable")
        log_time_ns, payloads = log_time_ns[order], payloads.take(order)
    return Topic(parts[0].name, parts[0].type_name, log_time_ns, payloads)


def find_records(data: Bytes, start: int = 0) -> Records:
    """Walk over the records of `data` from `start` up to the first that is not whole."""
    records, stop = _walk(data, start)
    return Records(records[:, 0], records[:, 1], records[:, 2], stop)


@njit(cache=True)
def _walk(data: Bytes, start: int) -> tuple[Indices, int]:
    """Opcode, start and length of each record, and the position after the last."""
    records = np.empty((256, 3), dtype=np.int64)
    count, position = 0, start
    while position + RECORD_PREFIX <= len(data):
        length = 0
        for place in range(8):
            length |= int(data[position + 1 + place]) << (8 * place)
        if length < 0 or length > len(data) - position - RECORD_PREFIX:
            break
        if count == len(records):
            longer = np.empty((2 * count, 3), dtype=np.int64)
            longer[:count] = records
            records = longer
        records[count, 0] = data[position]
        records[count, 1] = position + RECORD_PREFIX
        records[count, 2] = length
        count += 1
        position += RECORD_PREFIX + length
    return records[:count], position


def _check_whole(records: Records, data: Bytes) -> None:
    if records.stop != len(data):
        raise LogError(f"damaged: the record at byte {records.stop} runs beyond its section")


def _decompressed(record: Bytes) -> Bytes:
    """The records in a chunk record.

    Raises:
        Exception: of whatever kind, if the bytes are damaged.
    """
    header = _chunk_header(record)
    size, name_end = int(header["size"]), _CHUNK_HEADER.itemsize + int(header["name_length"])
    compression = record[_CHUNK_HEADER.itemsize : name_end].tobytes()
    content = record[name_end + _LENGTH_64.itemsize :].tobytes()
    match compression:
        case b"lz4":
            whole = unlz4(content, size)
        case b"zstd":
            whole = unzstd(content, size)
        case b"" if len(content) == size:
            whole = content
        case _:
            raise LogError(f"damaged: a chunk of {size} bytes, compressed by {compression[:8]!r}")
    if header["crc"] and zlib.crc32(whole) != header["crc"]:
        raise LogError("damaged: a chunk does not match its checksum")
    return np.frombuffer(whole, dtype=np.uint8)


def _chunk_header(record: Bytes) -> np.void:
    if len(record) < _CHUNK_HEADER.itemsize:
        raise LogError("damaged: a chunk is shorter than its header")
    header: np.void = record[: _CHUNK_HEADER.itemsize].view(_CHUNK_HEADER)[0]
    return header


def _unpacked_size(chunk: Bytes) -> int:
    return int(_chunk_header(chunk)["size"])


def _parse_metadata(record: bytes) -> tuple[str, dict[str, str]]:
    stream = BytesIO(record)
    name = read_string(stream)
    stream.seek(4, SEEK_CUR)
    entries = {}
    while stream.tell() < len(record):
        key = read_string(stream)
        entries[key] = read_string(stream)
    return name, entries


def _bytes_of(path: Path) -> Bytes:
    if path.stat().st_size == 0:
        return np.empty(0, dtype=np.uint8)
    return np.asarray(np.memmap(path, dtype=np.uint8, mode="r"))
