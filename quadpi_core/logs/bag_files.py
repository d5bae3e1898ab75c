# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag as arrays, whole or block by block in log-time order.

Its files are read in another process, see :mod:`quadpi_core.logs.sandbox`. Memory is bounded by one chunk of
each file and one block, and a bag with fewer messages than its index announces is refused.
"""

from __future__ import annotations

import heapq
from collections.abc import Collection, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from itertools import chain, pairwise
from multiprocessing import Pipe
from multiprocessing.connection import Connection as Channel
from operator import itemgetter
from pathlib import Path, PurePath
from types import MappingProxyType, TracebackType
from typing import Any, NamedTuple

import numpy as np
from backports import zstd

from quadpi_core.errors import LogError, one_line
from quadpi_core.flight import Stamps
from quadpi_core.logs.bag_storages import (
    PACKED,
    ZSTD_MAGIC,
    DatabaseFile,
    Ros1File,
    bag_places,
    is_packed,
    unpack,
)
from quadpi_core.logs.mcap_files import MAGIC, Connection, McapFile
from quadpi_core.logs.sandbox import read_apart
from quadpi_core.messages.payloads import Payloads, Topic, join_topics
from quadpi_core.paths import scratch_folder

# Messages of all topics in one block: 10 s of a flight at 500 Hz, some MB.
BLOCK_MESSAGES = 12_000
_END_NS = 2**63 - 1
# Readers by the first bytes of a file, and what it is called.
_CONTAINERS: MappingProxyType[bytes, type[McapFile] | type[DatabaseFile] | type[Ros1File]] = MappingProxyType(
    {MAGIC: McapFile, b"SQLite format 3\0": DatabaseFile, b"#ROSBAG V": Ros1File}
)
_CALLED = MappingProxyType({".mcap": "MCAP file", ".db3": "database of rosbag2", ".bag": "ROS 1 bag"})


class _File(NamedTuple):
    """A file of a bag by the name that the user knows it by, and where it lies unpacked."""

    named: Path
    place: Path


class Bag:
    """An open bag: a .mcap, .db3 or ROS 1 .bag file, or a rosbag2 folder, also compressed by Zstandard.

    Messages of a ROS 1 bag are converted to CDR, and their definitions to those of ROS 2.

    Attributes:
        connections: its topics; one of several types is there for each.

    Raises:
        LogError: for a bag that is absent, empty, cut off or damaged, from any of its methods.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.exists():
            raise LogError(f"{path}: no such bag")
        with self._reading(), ExitStack() as opened:
            places = bag_places(path)
            self._files = [self._file(file, number, opened) for number, file in enumerate(places.files)]
            self._size = sum(file.stat().st_size for file in places.files)
            asked, self._asking = Pipe(duplex=False)
            with asked:
                opened.enter_context(self._asking)
                reader = read_apart(self._size, _contents_then_parts, self._files, asked, self._asking)
                self._waiting: Generator[Any, None, None] | None = opened.enter_context(closing(reader))
                self.connections: list[Connection]
                self.connections, custom = next(reader)
            custom = custom if places.custom is None else places.custom
            self._notes = {key: text for key, text in custom.items() if isinstance(text, str)}
            self._opened = opened.pop_all()

    def _file(self, file: Path, number: int, opened: ExitStack) -> _File:
        if not is_packed(file):
            return _File(file, file)
        place = opened.enter_context(scratch_folder()) / str(number)
        with _naming(file):
            unpack(file, place)
        return _File(file, place)

    def __enter__(self) -> Bag:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._waiting = None
        self._opened.close()

    @property
    def name(self) -> str:
        """Name of the recording: that of the file or folder, without the suffixes of its container."""
        name = self.path.stem
        return PurePath(name).stem if self.path.suffix == PACKED else name

    @property
    def metadata(self) -> dict[str, str]:
        """What quadpi wrote about the bag (vehicle, source, version); empty for bags of other programs."""
        return self._notes

    def read(self, names: Collection[str], head: int | None = None) -> dict[str, Topic]:
        """Read whole topics by their full names; with `head` only so many first bytes of each message."""
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
        # A bag that shows no topic at all is read, to say what is wrong with it.
        if not types and self.connections:
            return
        announced = dict.fromkeys(types, 0)
        for connection in self.connections:
            if connection.topic in types:
                announced[connection.topic] += connection.msgcount
        found = dict.fromkeys(types, 0)
        with self._reading(), closing(self._parts(types, head)) as parts:
            for topics in _in_log_order(parts, messages or BLOCK_MESSAGES):
                block = {}
                for name, type_name in types.items():
                    block[name] = topics.get(name) or Topic.empty(name, type_name)
                    found[name] += len(block[name].payloads)
                yield block
        for name, count in found.items():
            if count != announced[name]:
                raise LogError(
                    f"{self.path}: topic {name}: damaged: holds {count} messages, "
                    f"its index announces {announced[name]}"
                )

    def _parts(self, types: dict[str, str], head: int | None) -> Generator[_Part, None, None]:
        """From the reader that waits since the bag was opened, which spares a fork, or else from another."""
        reader, self._waiting = self._waiting, None
        if reader is None:
            return read_apart(self._size, _parts, self._files, types, head)
        self._asking.send((types, head))
        return reader

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Name the bag in every error, and make one of those of other libraries."""
        with _naming(self.path):
            try:
                yield
            except LogError:
                raise
            except Exception as error:
                raise LogError(f"cannot be read: {one_line(error) or type(error).__name__}") from error


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name a file in errors that do not name it, or a file in it, yet."""
    try:
        yield
    except LogError as error:
        if str(error).startswith(str(path)):
            raise
        raise LogError(f"{path}: {error}") from error


# In the other process


def _open(file: _File) -> McapFile | DatabaseFile | Ros1File:
    with file.place.open("rb") as stream:
        head = stream.read(max(map(len, _CONTAINERS)))
    for magic, container in _CONTAINERS.items():
        if head.startswith(magic):
            return container(file.place)
    if not head:
        raise LogError("is empty")
    if file.named != file.place:
        raise LogError("what it holds compressed is no bag; `zstd -d` unpacks it")
    raise LogError(f"is no {_CALLED.get(file.named.suffix, 'bag')}")


def _contents_then_parts(files: Sequence[_File], asked: Channel, asking: Channel) -> Iterator[Any]:
    """The contents, then those messages that are asked for: see :func:`_contents` and :func:`_parts`."""
    # Else this would wait for ever where the process that asks has been killed.
    asking.close()
    yield _contents(files)
    yield from _parts(files, *asked.recv())


def _contents(files: Sequence[_File]) -> tuple[list[Connection], dict[str, Any]]:
    """The connections of all files by name and type, and the notes of their writer."""
    connections: dict[tuple[str, str], Connection] = {}
    custom: dict[str, Any] = {}
    for file in files:
        with _naming(file.named):
            opened = _open(file)
        for one in opened.connections.values():
            known = connections.get((one.topic, one.msgtype))
            count = one.msgcount + (known.msgcount if known else 0)
            connections[one.topic, one.msgtype] = (known or one)._replace(msgcount=count)
        custom |= opened.custom or {}
    return list(connections.values()), custom


def _parts(files: Sequence[_File], types: dict[str, str], head: int | None) -> Iterator[_Part]:
    """The messages of all files in parts, in the order of their first log times."""
    parts = heapq.merge(*(_parts_of(file, types, head) for file in files), key=itemgetter(0))
    for (_, topics), (limit_ns, _) in pairwise(chain(parts, [(_END_NS, [])])):
        yield _Part(topics, limit_ns)


def _parts_of(file: _File, types: dict[str, str], head: int | None) -> Iterator[tuple[int, list[Topic]]]:
    with _naming(file.named):
        opened = _open(file)
        wanted = {
            number: one for number, one in opened.connections.items() if types.get(one.topic) == one.msgtype
        }
        for start_ns, messages in opened.batches(wanted, head):
            yield (
                min(start_ns, _END_NS),
                [_topic(wanted[number], *of, head) for number, of in messages.items() if len(of[0])],
            )


def _topic(connection: Connection, log_time_ns: Stamps, payloads: Payloads, head: int | None) -> Topic:
    """Messages of a topic that were read together, in log-time order."""
    # Messages that are compressed by themselves; those that are not begin with a zero.
    if payloads[0].startswith(ZSTD_MAGIC):
        try:
            payloads = Payloads.join([zstd.decompress(payload) for payload in payloads])
        except zstd.ZstdError as error:
            raise LogError(f"topic {connection.topic}: damaged: {one_line(error)}") from error
    order = np.argsort(log_time_ns, kind="stable")
    in_order = payloads.take(order).compact(head)
    return Topic(connection.topic, connection.msgtype, log_time_ns[order], in_order)


# In this one


class _Part(NamedTuple):
    """Messages that were read, those of a topic in log-time order.

    Attributes:
        limit_ns: no message of a later part is logged before it.
    """

    topics: list[Topic]
    limit_ns: int


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
            split = [topic.split(limit_ns) for topic in waiting]
            due, waiting = ([one for one in side if len(one.payloads)] for side in zip(*split, strict=True))
            count = kept = sum(len(topic.payloads) for topic in waiting)
            yield from _in_blocks(due, block_messages)
    yield from _in_blocks(waiting, block_messages)


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
