# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of ROS 1 bags by rosbags, converted to CDR, as :mod:`quadpi_core.logs.bag_files` reads them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path

from rosbags import rosbag1
from rosbags.interfaces import Connection as Ros1Connection
from rosbags.rosbag1.reader import IndexData
from rosbags.typesys import Stores, get_typestore

from quadpi_core.errors import LogError
from quadpi_core.logs.mcap_files import Batch, Connection
from quadpi_core.messages.definitions import parsed_definition

_CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
# Types that ROS 2 changed or made a message; definitions of ROS 1 refer to them by the same names.
_ROS2_OWN = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


class Ros1File:
    """An open ROS 1 bag, its messages and definitions as those of ROS 2; see :class:`.McapFile`.

    Raises:
        LogError: if its index names a chunk twice.
    """

    custom = None

    def __init__(self, path: Path) -> None:
        self._reader = rosbag1.Reader(path)
        self._reader.open()
        if len(self._reader.chunks) < len(self._reader.chunk_infos):
            raise LogError("damaged: its index names a chunk twice")
        self._types = get_typestore(Stores.EMPTY)
        jazzy = get_typestore(Stores.ROS2_JAZZY).fielddefs
        self._types.register({name: jazzy[name] for name in _ROS2_OWN})
        self.connections = {one.id: self._as_in_ros2(one) for one in self._reader.connections}

    def _as_in_ros2(self, one: Ros1Connection) -> Connection:
        text = ""
        with suppress(Exception):  # the error comes when the topic is read: others may be all that is needed
            types = parsed_definition(one.msgtype, one.msgdef.data)
            new = {name: fields for name, fields in types.items() if name not in self._types.fielddefs}
            self._types.register(new)
            text = self._types.generate_msgdef(one.msgtype, ros_version=2)[0]
        return Connection(one.topic, one.msgtype, text, one.msgcount)

    def batches(self, wanted: Collection[int], head: int | None) -> Iterator[Batch]:
        """The messages of some topics, chunk by chunk in the order of their first log times.

        rosbags unpacks a chunk again for each message where those of two alternate in time.

        Args:
            wanted: numbers of the connections.
            head: bytes wanted of each message; only stamps of headers are right then. None for all.

        Raises:
            LogError: naming topic and sample, for bytes that are no message of the type.
        """
        chunks: dict[int, dict[int, list[IndexData]]] = defaultdict(lambda: defaultdict(list))
        for number in wanted:
            for entry in self._reader.indexes[number]:
                chunks[entry.chunk_pos][number].append(entry)
        samples = dict.fromkeys(wanted, 0)
        for indexes in sorted(chunks.values(), key=_start_ns):
            messages: dict[int, tuple[list[int], list[bytes]]] = {number: ([], []) for number in indexes}
            self._reader.indexes = indexes
            connections = [one for one in self._reader.connections if one.id in indexes]
            for connection, time_ns, raw in self._reader.messages(connections):
                times, payloads = messages[connection.id]
                times.append(time_ns)
                payloads.append(self._as_cdr(connection, samples[connection.id], raw, head))
                samples[connection.id] += 1
            yield Batch.listed(_start_ns(indexes), messages)

    def _as_cdr(self, connection: Ros1Connection, sample: int, raw: bytes, head: int | None) -> bytes:
        if head is not None:
            # The stamp of a header follows its sequence number, which ROS 2 does not have.
            return _CDR_LITTLE_ENDIAN + raw[4:head]
        try:
            return bytes(self._types.ros1_to_cdr(raw, connection.msgtype))
        except Exception as error:  # of many kinds, for damaged bytes
            where = f"topic {connection.topic}: sample {sample}"
            raise LogError(f"{where}: its {len(raw)} bytes are no {connection.msgtype} of ROS 1") from error


def _start_ns(indexes: dict[int, list[IndexData]]) -> int:
    return min(entries[0].time for entries in indexes.values())
