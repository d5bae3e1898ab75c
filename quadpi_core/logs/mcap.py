# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reading rosbag2 bags as arrays, whole or block by block in the order of log times.

rosbags opens and validates a bag and lists its topics. The messages of an MCAP bag are then found by a
compiled walk over its records instead of one by one in Python (https://mcap.dev/spec). A file is never held
in memory, only the chunks whose messages belong to one block.
"""

from __future__ import annotations

import heapq
import os
import re
import sqlite3
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from io import SEEK_CUR, BytesIO
from operator import itemgetter
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, BinaryIO, NamedTuple
from urllib.parse import quote

import numpy as np
import numpy.typing as npt
from backports import zstd
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader, read_string

from quadpi_core.bounded_files import read_bounded
from quadpi_core.compiled import njit
from quadpi_core.errors import LogError, one_line
from quadpi_core.flight import Stamps
from quadpi_core.logs.unpacking import (
    require_unpackable,
    unlz4,
    unpacked_limit,
    unzstd,
    unzstd_blocks,
    zstd_size,
)
from quadpi_core.messages.payloads import Bytes, Indices, Payloads
from quadpi_core.scratch import MADE, scratch_folder

if TYPE_CHECKING:
    from rosbags.rosbag2.reader import ReaderProtocol

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
_DATABASE_MAGIC = b"SQLite format 3\0"
# A frame, and those that are passed over.
_ZSTD_MAGICS = (b"\x28\xb5\x2f\xfd", *(bytes((0x50 + kind, 0x2A, 0x4D, 0x18)) for kind in range(16)))
_NO_RECORDS: Indices = np.empty((0, 3), dtype=np.int64)
# That of a recording of a day, split every minute, is smaller.
_METADATA_BYTES_MAX = 2**20
# So many messages of all topics make a block: 10 s of a flight at 500 Hz, a few MB in all that is made of it.
BLOCK_MESSAGES = 12_000
# Bytes of a file that are searched for records at once: the smaller where chunks are passed over unread.
_WINDOW, _WINDOW_MAX = 1 << 16, 1 << 20
_MESSAGES_AT_ONCE = 1000
_END_NS = 2**63 - 1
# What rosbags reads of a database.
_TABLES = ("schema", "metadata", "topics", "message_definitions", "messages")
_TABLE = re.compile(r"CREATE TABLE\b", re.IGNORECASE)


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


class _Section(NamedTuple):
    """Bytes of a file that are read at once: a chunk record, or message records side by side.

    Attributes:
        start, length: of the content of the chunk, or of the records.
        is_chunk: which of the two.
        first_ns: log time that none of its messages is before.
        unpacked: bytes of the records.
    """

    file: Path
    start: int
    length: int
    is_chunk: bool
    first_ns: int
    unpacked: int


class _Survey(NamedTuple):
    """Where an MCAP file holds messages and metadata.

    Attributes:
        sections: in the order of the file.
        metadata: start and length of the metadata records.
        stop: position after the last whole record.
    """

    sections: list[_Section]
    metadata: list[tuple[int, int]]
    stop: int


class _Part(NamedTuple):
    """Messages that were read, those of a topic in the order of their log times.

    Attributes:
        place: of the section; messages of one topic and log time come in the order of their places.
        limit_ns: all messages that are not read yet are logged then or later.
    """

    place: int
    topics: list[Topic]
    limit_ns: int


class Bag:
    """An open bag: a bare .mcap or .db3 file, or a rosbag2 folder of either.

    Raises:
        LogError: for a bag that is absent, empty, cut off or damaged, from any of its methods.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.exists():
            raise LogError(f"{path}: no such bag")
        self._surveys: dict[Path, _Survey] = {}
        for file in _files_of(path):
            survey = _check_file(file)
            if survey is not None:
                self._surveys[file] = survey
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
                file = Path(str(storage.path))
                for start, length in self._survey(storage).metadata:
                    with file.open("rb") as stream:
                        name, content = _parse_metadata(_read_at(stream, start, length))
                    if name == "quadpi":
                        entries |= content
        return entries

    def read(self, names: Collection[str], head: int | None = None) -> dict[str, Topic]:
        """Read topics by their full names.

        Args:
            names: topics of the bag.
            head: read only so many bytes of each message; whole messages where not given.
        """
        blocks = list(self.blocks(names, head=head))
        types = {connection.topic: connection.msgtype for connection in self.connections}
        return {
            name: join_topics([_empty(name, types[name]), *(block[name] for block in blocks)])
            for name in names
        }

    def blocks(
        self, names: Collection[str], *, messages: int | None = None, head: int | None = None
    ) -> Iterator[dict[str, Topic]]:
        """Read topics by their full names, block by block in the order of log times.

        What is logged at one instant is in one block. Blocks joined are what :meth:`read` gives.

        Args:
            names: topics of the bag; each is in every block, if need be without messages.
            messages: at most so many of all topics are in a block, but for those logged at one instant;
                :data:`BLOCK_MESSAGES` unless given.
            head: see :meth:`read`.
        """
        types = {
            connection.topic: connection.msgtype
            for connection in self.connections
            if connection.topic in names
        }
        found = dict.fromkeys(types, 0)
        with self._reading():
            storages = self._mcap_storages()
            if storages and self._reader.compression_mode != "message":
                parts = self._parts_of_sections(storages, types, head)
            else:
                parts = self._parts_one_by_one(types, head)
            for topics in _in_log_order(parts, messages or BLOCK_MESSAGES):
                for name, topic in topics.items():
                    found[name] += len(topic.payloads)
                yield {name: topics.get(name) or _empty(name, type_name) for name, type_name in types.items()}
        for name, count in found.items():
            announced = sum(
                connection.msgcount for connection in self.connections if connection.topic == name
            )
            if count != announced:
                raise LogError(
                    f"{self.path}: topic {name}: damaged: holds {count} messages, "
                    f"its index announces {announced}"
                )

    def _storages(self) -> list[ReaderProtocol]:
        storage = self._reader.storage
        return list(storage.storages) if isinstance(storage, DirectoryReader) else [storage]

    def _mcap_storages(self) -> list[McapReader]:
        return [storage for storage in self._storages() if isinstance(storage, McapReader)]

    def _survey(self, storage: McapReader) -> _Survey:
        """What lies where in a file, but for its summary."""
        file = Path(str(storage.path))
        if file not in self._surveys:  # of a file that was compressed as a whole, and lies elsewhere now
            self._surveys[file] = _survey_mcap(file)
        whole = self._surveys[file]
        return _Survey(
            [section for section in whole.sections if section.start < storage.data_end],
            [(start, length) for start, length in whole.metadata if start < storage.data_end],
            whole.stop,
        )

    def _parts_of_sections(
        self, storages: Sequence[McapReader], types: Mapping[str, str], head: int | None
    ) -> Iterator[_Part]:
        """The messages of MCAP files, section by section in the order of their first log times."""
        sections = [
            (section, storage)
            for storage in storages
            # Messages outside of chunks come first where log times are equal.
            for section in sorted(self._survey(storage).sections, key=lambda one: one.is_chunk)
        ]
        channels = {
            id(storage): {connection.id: connection for connection in storage.connections}
            for storage in storages
        }
        order = sorted(range(len(sections)), key=lambda place: sections[place][0].first_ns)
        limits = [*(sections[place][0].first_ns for place in order[1:]), _END_NS][: len(order)]
        with ExitStack() as stack:
            files = {
                file: _Sections(stack.enter_context(file.open("rb")))
                for file in {section.file for section, _ in sections}
            }
            for place, limit_ns in zip(order, limits, strict=True):
                section, storage = sections[place]
                data, records = files[section.file].read(section)
                _check_whole(records, data)
                topics = list(_split(data, records, channels[id(storage)], types, head))
                if any(topic.log_time_ns[0] < section.first_ns for topic in topics):
                    raise LogError(
                        f"damaged: the chunk at byte {section.start} holds messages from before the time "
                        "at which it says that it begins"
                    )
                yield _Part(place, topics, limit_ns)

    def _parts_one_by_one(self, types: Mapping[str, str], head: int | None) -> Iterator[_Part]:
        """The messages of files that only rosbags reads, some at a time."""
        compressed = self._reader.compression_mode == "message"
        packed_bytes = sum(file.stat().st_size for file in _files_of(self.path))
        unpacked_bytes = 0
        chosen = [
            (storage, [one for one in storage.connections if types.get(one.topic) == one.msgtype])
            for storage in self._storages()
        ]
        merged = heapq.merge(
            *(storage.messages(connections) for storage, connections in chosen if connections),
            key=itemgetter(1),
        )
        times: dict[str, list[int]] = {name: [] for name in types}
        payloads: dict[str, list[bytes]] = {name: [] for name in types}

        def part(place: int, limit_ns: int) -> _Part:
            topics = [
                Topic(name, types[name], np.array(times[name], dtype=np.int64), Payloads.join(payloads[name]))
                for name in types
                if times[name]
            ]
            for name in types:
                times[name], payloads[name] = [], []
            return _Part(place, topics, limit_ns)

        count = 0
        for count, (connection, time_ns, message) in enumerate(merged):
            if count and count % _MESSAGES_AT_ONCE == 0:
                yield part(count, time_ns)
            content = _unpacked_message(message) if compressed else message
            unpacked_bytes += _ENTRY_BYTES + len(content)
            require_unpackable(packed_bytes, unpacked_bytes)
            times[connection.topic].append(time_ns)
            payloads[connection.topic].append(content[:head])
        yield part(count + 1, _END_NS)

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


def _check_file(file: Path) -> _Survey | None:
    """Refuse a file of a bag that unpacks to too much, and an MCAP file that is damaged.

    That is one that is empty, cut off (saying how much is whole) or has a damaged summary. Gives what lies
    where in an MCAP file.
    """
    try:
        if not _begins_with(file, *_ZSTD_MAGICS):
            return _check_unpacked(file)
        _check_packed(file)
    except LogError as error:
        raise LogError(f"{file}: {error}") from None
    except OSError as error:
        raise LogError(f"{file}: cannot be read: {error.strerror or error}") from error
    except (sqlite3.Error, zstd.ZstdError, UnicodeDecodeError) as error:
        raise LogError(f"{file}: cannot be read: {one_line(error)}") from error
    return None


def _check_packed(file: Path) -> None:
    """Refuse what a file that is compressed as a whole unpacks to: rosbags opens that as it comes."""
    packed = file.read_bytes()
    size = 0
    with scratch_folder() as folder:
        unpacked = folder / MADE / file.stem
        with unpacked.open("wb") as stream:
            for block in unzstd_blocks(packed, unpacked_limit(len(packed))):
                size += stream.write(block)
        require_unpackable(len(packed), size)
        _check_unpacked(unpacked)


def _check_unpacked(file: Path) -> _Survey | None:
    # Whatever it is called: rosbags goes by what metadata.yaml says of it.
    if file.suffix == ".db3" or _begins_with(file, _DATABASE_MAGIC):
        _check_database(file)
    elif file.suffix == ".mcap" or _begins_with(file, MAGIC):
        return _survey_mcap(file)
    return None


def _begins_with(file: Path, *magics: bytes) -> bool:
    with file.open("rb") as stream:
        return stream.read(max(map(len, magics))).startswith(magics)


def _check_database(file: Path) -> None:
    """Refuse tables that make up their rows, or multiply them: what they yield has no bound."""
    place = f"file:{quote(str(file.absolute()))}?mode=ro&immutable=1"
    with closing(sqlite3.connect(place, uri=True)) as database:
        made = database.execute("SELECT lower(name), sql FROM sqlite_master").fetchall()
        for table in _TABLES:
            columns = database.execute(f"PRAGMA table_xinfo({table})").fetchall()
            is_plain = all(column[-1] == 0 for column in columns)
            # Not a view or virtual table, which says so where this says "TABLE".
            if not is_plain or any(not _TABLE.match(str(text)) for name, text in made if name == table):
                raise LogError(f"damaged: its table `{table}` computes what it holds")
        if any(name == "topics" for name, _ in made):
            total, different = database.execute("SELECT COUNT(*), COUNT(DISTINCT id) FROM topics").fetchone()
            if total != different:
                raise LogError("damaged: topics of the same number")


def _survey_mcap(file: Path) -> _Survey:
    size = file.stat().st_size
    if size == 0:
        raise LogError("is empty")
    with file.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise LogError("is no MCAP file")
        ending = _read_at(stream, max(size - _FOOTER.itemsize - len(MAGIC), 0), _FOOTER.itemsize + len(MAGIC))
        if size < _FOOTER.itemsize + 2 * len(MAGIC) or ending[-len(MAGIC) :] != MAGIC:
            raise LogError(
                f"cut off, it has no footer; {_whole_messages(file)} whole messages can be read, "
                "`mcap recover` rebuilds the file"
            )
        footer = np.frombuffer(ending, dtype=_FOOTER, count=1)[0]
        start, stop = int(footer["summary_start"]), size - footer["crc"].itemsize - len(MAGIC)
        summary = _read_at(stream, start, stop - start) if start < stop else b""
    if footer["crc"] and zlib.crc32(summary) != footer["crc"]:
        raise LogError("damaged: its summary does not match its checksum")
    survey = _find_sections(file, size - len(MAGIC))
    if survey.stop != size - len(MAGIC):
        raise LogError(f"damaged: the record at byte {survey.stop} runs beyond its section")
    require_unpackable(size, sum(section.unpacked for section in survey.sections if section.is_chunk))
    listed = find_records(np.frombuffer(summary, dtype=np.uint8))
    if start and listed.stop != len(summary) + footer["crc"].itemsize - RECORD_PREFIX - _FOOTER.itemsize:
        # rosbags would take any bytes for records, and memory for whatever lengths they say.
        raise LogError(f"damaged: its footer names byte {start} as the beginning of its summary")
    indexed = set(listed.opcodes.tolist())
    if not {SCHEMA, STATISTICS} <= indexed:
        # Without them rosbags unpacks every chunk, whatever its size.
        with file.open("rb") as stream:
            unread = _Sections(stream)
            for section in survey.sections:
                unread.read(section)
    return survey


def _whole_messages(file: Path) -> int:
    """Messages in a cut file that are whole, in chunks or not."""
    count = 0
    with file.open("rb") as stream:
        sections = _Sections(stream)
        for section in _find_sections(file, file.stat().st_size).sections:
            with suppress(Exception):  # a damaged chunk holds no whole message
                count += len(sections.read(section)[1].of(MESSAGE)[0])
    return count


class _Sections:
    """The sections of a file to read; all their records together are held against the limit of unpacking.

    A record of nothing takes nine bytes of a chunk, and many times as much where it is looked at.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._file_bytes = os.fstat(stream.fileno()).st_size
        self._records = 0

    def read(self, section: _Section) -> tuple[Bytes, Records]:
        """The message records of a section and what lies between them: their bytes, and where each is."""
        data = np.frombuffer(_read_at(self._stream, section.start, section.length), dtype=np.uint8)
        if section.is_chunk:
            data = _decompressed(data)
        self._records += _walk(data, 0, _NO_RECORDS)[0]
        require_unpackable(self._file_bytes, _ENTRY_BYTES * self._records)
        return data, find_records(data)


def _unpacked_message(message: bytes) -> bytes:
    """A message that is compressed by itself."""
    size = zstd_size(message, unpacked_limit(len(message)))
    require_unpackable(len(message), size)
    return unzstd(message, size)


def _find_sections(file: Path, end: int) -> _Survey:
    """Walk over the records of a file up to `end`, or the first that is not whole, reading little of it."""
    sections: list[_Section] = []
    metadata: list[tuple[int, int]] = []
    position, window = len(MAGIC), _WINDOW
    with file.open("rb") as stream:
        while position + RECORD_PREFIX <= end:
            data = np.frombuffer(_read_at(stream, position, min(window, end - position)), dtype=np.uint8)
            records = find_records(data)
            found = records if len(records.opcodes) else _first_record(data)
            if found.stop > end - position:
                break
            metadata += [
                (position + start, length) for start, length in zip(*found.of(METADATA), strict=True)
            ]
            sections += _messages_side_by_side(file, data, found, position)
            sections += _chunks(file, data, found, position)
            position += found.stop
            # Of a record that is passed over unread nothing was needed but its beginning.
            window = min(2 * window, _WINDOW_MAX) if found is records else _WINDOW
    sections.sort(key=lambda section: section.start)
    return _Survey(sections, metadata, position)


def _first_record(data: Bytes) -> Records:
    """The record that begins in `data` and ends beyond it."""
    length = int.from_bytes(data[1:RECORD_PREFIX].tobytes(), "little")
    one = np.ones(1, dtype=np.int64)
    if length > _END_NS - RECORD_PREFIX:
        return Records(one, one, one, _END_NS)
    return Records(one * data[0], one * RECORD_PREFIX, one * length, RECORD_PREFIX + length)


def _messages_side_by_side(file: Path, data: Bytes, found: Records, position: int) -> Iterator[_Section]:
    """A section from the first message record in `data` to the last; `position` is where that begins."""
    starts, lengths = found.of(MESSAGE)
    if len(starts) == 0:
        return
    if np.any(lengths < MESSAGE_HEADER.itemsize):
        raise LogError("damaged: a message record is shorter than its header")
    first_ns = int(_headers(data, starts)["log_time"].min())
    start = int(starts[0]) - RECORD_PREFIX
    length = int(starts[-1] + lengths[-1]) - start
    yield _Section(file, position + start, length, False, min(first_ns, _END_NS), length)


def _chunks(file: Path, data: Bytes, found: Records, position: int) -> Iterator[_Section]:
    """The chunks among records; see :func:`_messages_side_by_side`."""
    for start, length in zip(*(column.tolist() for column in found.of(CHUNK)), strict=True):
        header = _chunk_header(data[start : start + length])
        first_ns = min(int(header["start_time"]), _END_NS)
        yield _Section(file, position + start, length, True, first_ns, int(header["size"]))


def _read_at(stream: BinaryIO, start: int, length: int) -> bytes:
    stream.seek(start)
    return stream.read(length)


def _in_log_order(parts: Iterable[_Part], messages: int) -> Iterator[dict[str, Topic]]:
    """Blocks of topics: all that is logged before an instant, and is not in a block before."""
    waiting: list[tuple[int, Topic]] = []
    count = kept = 0
    for place, topics, limit_ns in parts:
        waiting += [(place, topic) for topic in topics]
        count += sum(len(topic.payloads) for topic in topics)
        # What had to wait is not gone through again for every little that comes.
        if count < max(messages, 2 * kept) and limit_ns < _END_NS:
            continue
        waiting.sort(key=itemgetter(0))
        due: dict[str, list[Topic]] = {}
        later: list[tuple[int, Topic]] = []
        for place_of, topic in waiting:
            before, after = (topic, None) if limit_ns == _END_NS else cut_topic(topic, limit_ns)
            if before is not None and len(before.payloads):
                due.setdefault(topic.name, []).append(before)
            if after is not None and len(after.payloads):
                later.append((place_of, after))
        waiting = later
        count = kept = sum(len(topic.payloads) for _, topic in waiting)
        yield from _in_blocks({name: join_topics(own) for name, own in due.items()}, messages)


def _in_blocks(topics: dict[str, Topic], messages: int) -> Iterator[dict[str, Topic]]:
    """The messages in blocks of that many; those of one instant stay together."""
    if not topics:
        return
    times = np.sort(np.concatenate([topic.log_time_ns for topic in topics.values()]))
    first = 0
    while first < len(times):
        stop = len(times)
        if first + messages < stop:
            stop = int(np.searchsorted(times, times[first + messages]))
            if stop == first:
                stop = int(np.searchsorted(times, times[first], side="right"))
        block = {}
        for name, topic in topics.items():
            begin = np.searchsorted(topic.log_time_ns, times[first])
            end = np.searchsorted(topic.log_time_ns, times[stop - 1], side="right")
            block[name] = _rows(topic, slice(int(begin), int(end)))
        yield block
        first = stop


def cut_topic(topic: Topic, limit_ns: int) -> tuple[Topic, Topic]:
    """Of messages in the order of their log times, those before an instant, and the rest."""
    place = int(np.searchsorted(topic.log_time_ns, limit_ns))
    return _rows(topic, slice(0, place)), _rows(topic, slice(place, None))


def _rows(topic: Topic, rows: slice) -> Topic:
    return Topic(topic.name, topic.type_name, topic.log_time_ns[rows], topic.payloads.cut(rows))


def _split(
    data: Bytes,
    records: Records,
    channels: Mapping[int, Connection],
    names: Collection[str],
    head: int | None,
) -> Iterator[Topic]:
    """Gather the messages among `records` topic by topic, each in the order of log times."""
    starts, lengths = records.of(MESSAGE)
    if len(starts) == 0:
        return
    if np.any(lengths < MESSAGE_HEADER.itemsize):
        raise LogError("damaged: a message record is shorter than its header")
    headers = _headers(data, starts)
    payloads = Payloads(data, starts + MESSAGE_HEADER.itemsize, lengths - MESSAGE_HEADER.itemsize)
    for channel in np.unique(headers["channel"]):
        connection = channels.get(int(channel))
        if connection is None:
            raise LogError(f"damaged: messages on channel {channel}, which no record describes")
        if connection.topic in names:
            chosen = np.flatnonzero(headers["channel"] == channel)
            log_time_ns = headers["log_time"][chosen].astype(np.int64)
            if np.any(log_time_ns[1:] < log_time_ns[:-1]):
                order = np.argsort(log_time_ns, kind="stable")
                chosen, log_time_ns = chosen[order], log_time_ns[order]
            own = payloads.take(chosen).compact(head)
            yield Topic(connection.topic, connection.msgtype, log_time_ns, own)


def _headers(data: Bytes, starts: Indices) -> npt.NDArray[np.void]:
    """Headers of the messages whose records have their contents at `starts`."""
    header_bytes = np.lib.stride_tricks.sliding_window_view(data, MESSAGE_HEADER.itemsize)[starts]
    return header_bytes.view(MESSAGE_HEADER)[:, 0]


def _empty(name: str, type_name: str) -> Topic:
    return Topic(name, type_name, np.empty(0, dtype=np.int64), Payloads.join([]))


def join_topics(parts: Sequence[Topic]) -> Topic:
    """One topic of its parts, in the order of log times."""
    log_time_ns, payloads = parts[0].log_time_ns, parts[0].payloads
    if len(parts) > 1:
        log_time_ns = np.concatenate([part.log_time_ns for part in parts])
        payloads = Payloads.concatenate([part.payloads for part in parts])
    if np.any(np.diff(log_time_ns) < 0):
        order = np.argsort(log_time_ns, kind="stable")
        log_time_ns, payloads = log_time_ns[order], payloads.take(order).compact()
    return Topic(parts[0].name, parts[0].type_name, log_time_ns, payloads)


def find_records(data: Bytes, start: int = 0) -> Records:
    """Walk over the records of `data` from `start` up to the first that is not whole."""
    records = np.empty((_walk(data, start, _NO_RECORDS)[0], 3), dtype=np.int64)
    _, stop = _walk(data, start, records)
    return Records(records[:, 0], records[:, 1], records[:, 2], stop)


@njit(cache=True)
def _walk(data: Bytes, start: int, records: Indices) -> tuple[int, int]:
    """Fill rows with opcode, start and length of each record, as many as there is room for.

    Returns:
        How many records there are, and the position after the last.
    """
    count, position = 0, start
    while position + RECORD_PREFIX <= len(data):
        length = 0
        for place in range(8):
            length |= int(data[position + 1 + place]) << (8 * place)
        if length < 0 or length > len(data) - position - RECORD_PREFIX:
            break
        if count < len(records):
            records[count, 0] = data[position]
            records[count, 1] = position + RECORD_PREFIX
            records[count, 2] = length
        count += 1
        position += RECORD_PREFIX + length
    return count, position


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


def _parse_metadata(record: bytes) -> tuple[str, dict[str, str]]:
    stream = BytesIO(record)
    name = read_string(stream)
    stream.seek(4, SEEK_CUR)
    entries = {}
    while stream.tell() < len(record):
        key = read_string(stream)
        entries[key] = read_string(stream)
    return name, entries
