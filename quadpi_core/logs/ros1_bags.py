# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""rosbags' reader of ROS 1 bags, made safe, chunk by chunk, with messages converted to CDR."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from functools import partial

from rosbags import rosbag1
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1.reader import Chunk, ChunkInfo, Header, IndexData, RecordType
from rosbags.rosbag2.metadata import ReaderMetadata
from rosbags.typesys import Stores, get_typestore

from quadpi_core.errors import LogError
from quadpi_core.logs.mcap_files import Message
from quadpi_core.logs.unpacking import require_unpackable, unbz2, unlz4
from quadpi_core.messages.definitions import parsed_definition

_CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
# Types that ROS 2 changed or made a message; definitions of ROS 1 refer to them by the same names.
_ROS2_OWN = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_UNPACKERS: dict[str, Callable[[bytes, int], bytes]] = {
    "none": lambda packed, _: packed,
    "lz4": unlz4,
    "bz2": unbz2,
}
_END_NS = 2**63 - 1


class Ros1Bag(rosbag1.Reader):
    """A ROS 1 bag whose messages and definitions are given as those of ROS 2.

    rosbags holds the whole index in memory, 150 bytes a message: 1.6 GB for two hours of three topics at
    500 Hz. Here the index of one chunk is held at a time, and read again with the messages of the chunk.
    """

    def open(self) -> None:
        """Open the file and count what its index announces; its types are registered with ROS 2's header."""
        self._size = self.path.stat().st_size
        self._unpacked_bytes = 0
        self._counts: Counter[int] = Counter()
        # By the place of a chunk: where its index is, and the log time of its first message.
        self._index_places: dict[int, int] = {}
        self._starts_ns: dict[int, int] = {}
        super().open()
        self._types = get_typestore(Stores.EMPTY)
        jazzy = get_typestore(Stores.ROS2_JAZZY).fielddefs
        self._types.register({name: jazzy[name] for name in _ROS2_OWN})
        self.connections = [self._as_in_ros2(connection) for connection in self.connections]

    def _as_in_ros2(self, connection: Connection) -> Connection:
        text = ""
        with suppress(Exception):  # the error comes when the topic is read: others may be all that is needed
            types = parsed_definition(connection.msgtype, connection.msgdef.data)
            new = {name: fields for name, fields in types.items() if name not in self._types.fielddefs}
            self._types.register(new)
            text = self._types.generate_msgdef(connection.msgtype, ros_version=2)[0]
        kind = MessageDefinitionFormat.MSG if text else MessageDefinitionFormat.NONE
        count = self._counts[connection.id]
        return connection._replace(msgdef=MessageDefinition(kind, text), digest="", msgcount=count)

    @property
    def metadata(self) -> ReaderMetadata:
        """Span and count, as files of ROS 2 give them."""
        count = sum(self._counts.values())
        return ReaderMetadata(self.duration, self.start_time, self.end_time, count, None, None, None, None)

    def read_chunk_info(self) -> ChunkInfo:
        """An entry of the list of chunks; an entry that is there twice would be read twice."""
        info = super().read_chunk_info()
        if info.pos in self._starts_ns:
            raise LogError(f"damaged: its index names the chunk at byte {info.pos} twice")
        self._starts_ns[info.pos] = _END_NS
        return info

    def read_chunk(self) -> Chunk:
        """Where a chunk is, and how it is unpacked: no further than to the size that it announces."""
        assert self.bio
        place = self.bio.tell()
        header = Header.read(self.bio, RecordType.CHUNK)
        self.bio.seek(place)
        chunk = super().read_chunk()
        if chunk.datapos + chunk.datasize > self._size:
            raise LogError(f"damaged: the chunk at byte {place} is not whole")
        size = header.get_uint32("size")
        self._unpacked_bytes += size
        require_unpackable(self._size, self._unpacked_bytes)
        return chunk._replace(decompressor=partial(_unpack, header.get_string("compression"), size))

    def read_index_data(self, pos: int, indexes: dict[int, list[IndexData]]) -> None:  # noqa: ARG002
        """Count the entries of a chunk's index and forget them."""
        assert self.bio
        self._index_places.setdefault(pos, self.bio.tell())
        found: dict[int, list[IndexData]] = defaultdict(list)
        super().read_index_data(pos, found)
        for connection, entries in found.items():
            self._counts[connection] += len(entries)
            self._starts_ns[pos] = min(self._starts_ns[pos], *(entry.time for entry in entries), _END_NS)

    def batches(
        self, connections: Collection[Connection], head: int | None
    ) -> Iterator[tuple[list[Message], int]]:
        """The messages of each chunk in log-time order, and a log time that no later chunk goes below.

        Args:
            connections: those wanted.
            head: bytes wanted of each message; only stamps of headers are right then. None for all.

        Raises:
            LogError: naming topic and sample, for bytes that are no message of the type.
        """
        assert self.bio
        if not connections:
            return
        counts: Counter[str] = Counter()
        infos = sorted(self.chunk_infos, key=lambda info: self._starts_ns[info.pos])
        limits_ns = [*(self._starts_ns[info.pos] for info in infos[1:]), _END_NS]
        for info, limit_ns in zip(infos, limits_ns, strict=True):
            entries: dict[int, list[IndexData]] = defaultdict(list)
            self.bio.seek(self._index_places.get(info.pos, 0))
            for _ in info.connection_counts:
                super().read_index_data(info.pos, entries)
            self.indexes = {connection.id: sorted(entries[connection.id]) for connection in connections}
            batch = []
            for connection, time_ns, raw in super().messages(connections):
                sample = counts[connection.topic]
                batch.append((connection, time_ns, self._as_cdr(connection, sample, raw, head)))
                counts[connection.topic] += 1
            yield batch, limit_ns

    def _as_cdr(self, connection: Connection, sample: int, raw: bytes, head: int | None) -> bytes:
        if head is not None:
            # The stamp of a header follows its sequence number, which ROS 2 does not have.
            return _CDR_LITTLE_ENDIAN + raw[4:head]
        try:
            return bytes(self._types.ros1_to_cdr(raw, connection.msgtype))
        except Exception as error:  # of many kinds, for damaged bytes
            where = f"topic {connection.topic}: sample {sample}"
            raise LogError(f"{where}: its {len(raw)} bytes are no {connection.msgtype} of ROS 1") from error


def _unpack(compression: str, size: int, packed: bytes) -> bytes:
    return _UNPACKERS[compression](packed, size)
