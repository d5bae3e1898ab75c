# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag as arrays, whole or block by block in log-time order.

rosbags opens every container, with checks in front of it that it lacks. Memory is bounded by
one chunk of each file and one block, and a bag with fewer messages than its index announces is refused.
"""

from __future__ import annotations

import heapq
import re
import sqlite3
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from functools import cached_property
from pathlib import Path, PurePath
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple, cast
from urllib.parse import quote

import numpy as np
from rosbags import rosbag2
from rosbags.interfaces import Connection
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from quadpi_core.errors import LogError, one_line
from quadpi_core.flight import Stamps
from quadpi_core.logs.bag_places import PACKED, files_of, place_to_open
from quadpi_core.logs.mcap_files import McapFile, Message, batches_of, log_time
from quadpi_core.logs.ros1_bags import Ros1Bag
from quadpi_core.logs.unpacking import MESSAGE_BYTES, require_unpackable, unpacked_limit, unzstd, zstd_size
from quadpi_core.messages.earlier_definitions import is_earlier, rewritten
from quadpi_core.messages.payloads import Payloads, Topic, join_topics

if TYPE_CHECKING:
    from rosbags.rosbag2.reader import ReaderProtocol

# Tables of a database that rosbags reads.
_TABLES = ("schema", "metadata", "topics", "message_definitions", "messages")
_TABLE = re.compile(r"CREATE TABLE\b", re.IGNORECASE)
# Messages of all topics in one block: 10 s of a flight at 500 Hz, some MB.
BLOCK_MESSAGES = 12_000
_END_NS = 2**63 - 1


class Bag:
    """An open bag: a .mcap, .db3 or ROS 1 .bag file, or a rosbag2 folder.

    Messages of a ROS 1 bag are converted to CDR, and their definitions to those of ROS 2. Messages of earlier
    versions of quadpi are rewritten as they are defined now.

    Raises:
        LogError: for a bag that is absent, empty, cut off or damaged, from any of its methods.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.exists():
            raise LogError(f"{path}: no such bag")
        self._opened, self._place = ExitStack(), path
        with self._reading(), ExitStack() as opened:
            self._place = opened.enter_context(place_to_open(path))
            self._reader = _Reader(self._place)
            self._reader.open()
            self._check_connections()
            self._opened = opened.pop_all()

    def _check_connections(self) -> None:
        """Refuse a damaged index or metadata.yaml with other values in the place of names and counts."""
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
        with self._opened:
            self._reader.close()

    @property
    def name(self) -> str:
        """Name of the recording: that of the file or folder, without the suffixes of its container."""
        name = self.path.stem
        return PurePath(name).stem if self.path.suffix == PACKED else name

    @property
    def connections(self) -> list[Connection]:
        """Name, type, definition and count of each topic; a topic may have several connections."""
        return self._reader.connections

    @cached_property
    def metadata(self) -> dict[str, str]:
        """What quadpi wrote about the bag (vehicle, source, version); empty for bags of other programs."""
        with self._reading():
            entries = self._reader.storage.metadata.custom
            for storage in self._storages():
                if entries is None and isinstance(storage, McapFile):
                    entries = storage.custom_data()
            if entries is None:
                return {}
            return {key: text for key, text in entries.items() if isinstance(text, str)}

    def read(self, names: Collection[str], head: int | None = None) -> dict[str, Topic]:
        """Read whole topics by their full names.

        Args:
            names: topics of the bag.
            head: read only the first bytes of each message, this many.
        """
        blocks = list(self.blocks(names, head=head))
        types = {connection.topic: connection.msgtype for connection in self.connections}
        return {
            name: join_topics([Topic.empty(name, types[name]), *(block[name] for block in blocks)])
            for name in names
        }

    def blocks(
        self, names: Collection[str], *, messages: int | None = None, head: int | None = None
    ) -> Iterator[dict[str, Topic]]:
        """Read topics by their full names in blocks, in log-time order.

        Messages with equal log times are in the same block. The blocks joined equal what :meth:`read` gives.

        Args:
            names: topics of the bag; every block has all of them, possibly without messages.
            messages: the most messages of all topics in a block (more only where their log times are equal);
                :data:`BLOCK_MESSAGES` unless given.
            head: see :meth:`read`.
        """
        types = {one.topic: one.msgtype for one in self.connections if one.topic in names}
        announced = dict.fromkeys(types, 0)
        for connection in self.connections:
            if connection.topic in types:
                announced[connection.topic] += connection.msgcount
        found = dict.fromkeys(types, 0)
        with self._reading():
            for topics in _in_log_order(self._parts(types, head), messages or BLOCK_MESSAGES):
                block = {}
                for name, type_name in types.items():
                    topic = topics.get(name) or Topic.empty(name, type_name)
                    rewrite = name in self._earlier and not head
                    block[name] = rewritten(topic, found[name]) if rewrite else topic
                    found[name] += len(topic.payloads)
                yield block
        for name, count in found.items():
            if count != announced[name]:
                raise LogError(
                    f"{self.path}: topic {name}: damaged: holds {count} messages, "
                    f"its index announces {announced[name]}"
                )

    @cached_property
    def _earlier(self) -> set[str]:
        """Topics whose messages have an earlier definition of their type."""
        return {one.topic for one in self.connections if is_earlier(one.msgtype, one.msgdef.data)}

    def _storages(self) -> list[ReaderProtocol]:
        storage = self._reader.storage
        return list(storage.storages) if isinstance(storage, DirectoryReader) else [storage]

    def _parts(self, types: Mapping[str, str], head: int | None) -> Iterator[_Part]:
        """The messages of all files, in parts."""
        storages = self._storages()
        chosen = [
            [one for one in storage.connections if types.get(one.topic) == one.msgtype]
            for storage in storages
        ]
        files = [storage for storage in storages if isinstance(storage, McapFile)]
        if self._reader.compression_mode != "message" and len(files) == len(storages):
            if all(file.chunks for file in files):
                return _chunks_in_order(list(zip(files, chosen, strict=True)), head)
            if len(files) == 1:
                return _batched(files[0].scanned(chosen[0]), head)
        if isinstance(storages[0], Ros1Bag):
            return _batched(storages[0].batches(chosen[0], head), head)
        messages: Iterator[Message] = heapq.merge(
            *(
                storage.messages(connections)
                for storage, connections in zip(storages, chosen, strict=True)
                if connections
            ),
            key=log_time,
        )
        if self._reader.compression_mode == "message":
            messages = self._unpacked(messages)
        return (_Part(_by_topic(batch, head), log_time(batch[-1])) for batch in batches_of(messages))

    def _unpacked(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Messages that are each compressed by themselves."""
        packed_bytes = sum(file.stat().st_size for file in files_of(self.path))
        unpacked_bytes = 0
        for connection, time_ns, packed in messages:
            size = zstd_size(packed, unpacked_limit(len(packed)))
            require_unpackable(len(packed), size)
            unpacked_bytes += size + MESSAGE_BYTES
            require_unpackable(packed_bytes, unpacked_bytes)
            yield connection, time_ns, unzstd(packed, size)

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Turn any error of a parser on damaged bytes into one LogError that names the bag."""
        try:
            yield
        except LogError as error:
            # Errors of a file in a folder name it, and so the bag.
            text = str(error).replace(str(self._place), str(self.path))
            raise LogError(text if text.startswith(str(self.path)) else f"{self.path}: {text}") from error
        except Exception as error:  # rosbags and the decompressors raise many kinds on damaged bytes
            reason = (one_line(error) or type(error).__name__).replace(str(self._place), str(self.path))
            raise LogError(f"{self.path}: cannot be read: {reason}") from error


# Containers


class _Database(Sqlite3Reader):
    """A .db3 file, checked before rosbags reads from its tables."""

    def open(self) -> None:
        """Open the file.

        Raises:
            LogError: naming the file, for tables that compute or multiply their rows: these may have no end.
        """
        place = f"file:{quote(str(Path(str(self.path)).absolute()))}?mode=ro&immutable=1"
        try:
            with closing(sqlite3.connect(place, uri=True)) as database:
                _check_tables(database)
        except (LogError, sqlite3.Error, UnicodeDecodeError) as error:
            reason = str(error) if isinstance(error, LogError) else f"cannot be read: {one_line(error)}"
            if "malformed" in reason:
                reason += "; `sqlite3 FILE .recover | sqlite3 whole.db3` rebuilds what is whole of it"
            raise LogError(f"{self.path}: {reason}") from error
        super().open()


def _check_tables(database: sqlite3.Connection) -> None:
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


class _Directory(DirectoryReader):
    STORAGE_PLUGINS: Mapping[str, type[ReaderProtocol]] = {"mcap": McapFile, "sqlite3": _Database}


class _Reader(rosbag2.Reader):
    """The reader of rosbags for every container, with these checks."""

    STORAGE_PLUGINS: Mapping[str, type[ReaderProtocol]] = {
        "dir": _Directory,
        ".mcap": McapFile,
        ".db3": _Database,
        ".bag": cast("type[ReaderProtocol]", Ros1Bag),
    }


# Order of messages


class _Part(NamedTuple):
    """Messages that were read, those of a topic in log-time order.

    Attributes:
        limit_ns: no message of a later part is logged before it.
    """

    topics: list[Topic]
    limit_ns: int


def _chunks_in_order(
    files: Sequence[tuple[McapFile, Sequence[Connection]]], head: int | None
) -> Iterator[_Part]:
    """The chunks of MCAP files with wanted messages, in the order of their first log times."""
    chunks = [
        (chunk, file, connections)
        for file, connections in files
        for chunk in file.chunks
        # A chunk without an index of its messages may hold any.
        if not chunk.channel_count or any(one.id in chunk.channel_count for one in connections)
    ]
    chunks.sort(key=lambda one: one[0].message_start_time)
    limits = [*(chunk.message_start_time for chunk, *_ in chunks[1:]), _END_NS]
    for (chunk, file, connections), limit_ns in zip(chunks, limits, strict=False):
        yield _Part(file.chunk_topics(chunk, connections, head), min(limit_ns, _END_NS))


def _batched(batches: Iterable[tuple[list[Message], int]], head: int | None) -> Iterator[_Part]:
    return (_Part(_by_topic(batch, head), limit_ns) for batch, limit_ns in batches)


def _by_topic(messages: Iterable[Message], head: int | None) -> list[Topic]:
    times: dict[tuple[str, str], list[int]] = {}
    payloads: dict[tuple[str, str], list[bytes]] = {}
    for connection, time_ns, message in messages:
        key = connection.topic, connection.msgtype
        times.setdefault(key, []).append(time_ns)
        payloads.setdefault(key, []).append(message[:head])
    return [
        join_topics([Topic(*key, np.array(times[key], dtype=np.int64), Payloads.join(payloads[key]))])
        for key in times
    ]


def _in_log_order(parts: Iterable[_Part], block_messages: int) -> Iterator[dict[str, Topic]]:
    """Blocks of topics in log-time order."""
    waiting: list[Topic] = []
    count = kept = 0
    limit_ns = -_END_NS
    for topics, next_limit_ns in parts:
        if any(topic.log_time_ns[0] < limit_ns for topic in topics):
            raise LogError("damaged: its messages are not in the order that its index announces")
        waiting += topics
        count += sum(len(topic.payloads) for topic in topics)
        # Sorting for every small part would take a time that grows with the square of what waits.
        if count >= max(block_messages, 2 * kept):
            limit_ns = next_limit_ns
            due, waiting = _split_all(waiting, limit_ns)
            count = kept = sum(len(topic.payloads) for topic in waiting)
            yield from _in_blocks(due, block_messages)
    yield from _in_blocks(waiting, block_messages)


def _split_all(topics: Iterable[Topic], limit_ns: int) -> tuple[list[Topic], list[Topic]]:
    parts = [topic.split(limit_ns) for topic in topics]
    return [one for one, _ in parts if len(one.payloads)], [one for _, one in parts if len(one.payloads)]


def _in_blocks(parts: Iterable[Topic], block_messages: int) -> Iterator[dict[str, Topic]]:
    """Cut messages into blocks, not between equal log times."""
    by_name: dict[str, list[Topic]] = {}
    for part in parts:
        by_name.setdefault(part.name, []).append(part)
    topics = {name: join_topics(own) for name, own in by_name.items()}
    times = np.sort(np.concatenate([_NO_TIMES, *(topic.log_time_ns for topic in topics.values())]))
    first = 0
    while first < len(times):
        stop = len(times)
        if first + block_messages < stop:
            stop = int(np.searchsorted(times, times[first + block_messages]))
            if stop == first:
                stop = int(np.searchsorted(times, times[first], side="right"))
        block = {}
        for name, topic in topics.items():
            begin = np.searchsorted(topic.log_time_ns, times[first])
            end = np.searchsorted(topic.log_time_ns, times[stop - 1], side="right")
            block[name] = topic.rows(slice(int(begin), int(end)))
        yield block
        first = stop


_NO_TIMES: Stamps = np.empty(0, dtype=np.int64)
