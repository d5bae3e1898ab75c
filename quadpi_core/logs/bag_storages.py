# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where the parts of a bag lie, and storages beside MCAP: databases of rosbag2, and bags of ROS 1."""

from __future__ import annotations

import sqlite3
from collections import defaultdict
from collections.abc import Collection, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path, PurePath
from typing import Any, NamedTuple
from urllib.parse import quote

import yaml
from backports import zstd
from rosbags import rosbag1
from rosbags.interfaces import Connection as Ros1Connection
from rosbags.rosbag1.reader import IndexData
from rosbags.typesys import Stores, get_typestore

from quadpi_core.errors import LogError, one_line
from quadpi_core.logs.mcap_files import Batch, Connection
from quadpi_core.logs.sandbox import read_apart, require_unpackable
from quadpi_core.messages.definitions import parsed_definition
from quadpi_core.paths import read_bounded

# `ros2 bag reindex` of Humble leaves the storage identifier empty; users rename files, and compress or unpack
# them by hand.

PACKED = ".zstd"
_SUFFIXES = (".mcap", ".db3")
METADATA_FILE = "metadata.yaml"
# The metadata.yaml of a day's recording, split every minute, is smaller.
_METADATA_BYTES_MAX = 2**20
# A frame of Zstandard, and the frames that decompressors skip.
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_ZSTD_MAGICS = (ZSTD_MAGIC, *(bytes((0x50 + kind, 0x2A, 0x4D, 0x18)) for kind in range(16)))
_READ_AT_ONCE = 2**20


class BagPlaces(NamedTuple):
    """Files of messages, possibly compressed, and what the writer noted in metadata.yaml; None if nothing."""

    files: list[Path]
    custom: dict[str, Any] | None = None


def bag_places(path: Path) -> BagPlaces:
    """The files of a bag that is a file or a folder.

    Raises:
        LogError: if metadata.yaml is too large or names files that are not there, or is absent or unreadable
            and there is not exactly one file.
    """
    if not path.is_dir():
        return BagPlaces([path])
    if not (path / METADATA_FILE).exists():
        return BagPlaces([_single_file(path, f"no {METADATA_FILE}")])
    text = read_bounded(path / METADATA_FILE, _METADATA_BYTES_MAX)
    try:
        information = yaml.safe_load(text)["rosbag2_bagfile_information"]
        named = [PurePath(name).name for name in information["relative_file_paths"]]
        custom = information.get("custom_data")
    except (yaml.YAMLError, RecursionError, LookupError, TypeError, ValueError, AttributeError):
        # Emptied when the power went, or damaged.
        return BagPlaces([_single_file(path, f"{METADATA_FILE} cannot be read")])
    return BagPlaces(_present(path, named), custom)


def _files_of_messages(folder: Path) -> list[Path]:
    return sorted(
        file
        for file in folder.iterdir()
        if file.is_file() and (file.stem if file.suffix == PACKED else file.name).endswith(_SUFFIXES)
    )


def _single_file(folder: Path, why: str) -> Path:
    """The file of messages in a folder whose metadata tell nothing; refused if there is not exactly one."""
    files = _files_of_messages(folder)
    if len(files) != 1:
        raise LogError(
            f"{why}, and {len(files)} files of messages: `ros2 bag reindex` makes it, or name one of the "
            "files"
        )
    return files[0]


def _present(folder: Path, named: list[str]) -> list[Path]:
    """The files that metadata.yaml names; where some were renamed, the others in their places."""
    missing = [name for name in named if not (folder / name).is_file()]
    others = [file for file in _files_of_messages(folder) if file.name not in named]
    if missing and len(missing) != len(others):
        raise LogError(
            f"{METADATA_FILE} names {', '.join(missing)}, which is not there; there are "
            f"{', '.join(file.name for file in others) or 'no other files of messages'}: `ros2 bag reindex` "
            "renews it"
        )
    return [folder / name for name in named if name not in missing] + (others if missing else [])


def is_packed(file: Path) -> bool:
    """Whether a file is compressed by Zstandard."""
    with file.open("rb") as stream:
        return stream.read(4).startswith(_ZSTD_MAGICS)


def unpack(file: Path, target: Path) -> None:
    """Unpack a file that is compressed by Zstandard.

    Raises:
        LogError: if it is damaged, or unpacks to too much.
    """
    size = file.stat().st_size
    for _ in read_apart(size, _unpack, file, target, size):
        pass


def _unpack(file: Path, target: Path, size: int) -> Iterator[None]:
    written = 0
    try:
        with zstd.open(file) as packed, target.open("xb") as copy:
            while part := packed.read(_READ_AT_ONCE):
                written += len(part)
                require_unpackable(size, written)
                copy.write(part)
    except (zstd.ZstdError, EOFError) as error:
        raise LogError(f"cannot be read: {one_line(error)}") from error
    yield


_BATCH = 1000


class DatabaseFile:
    """An open .db3 file; its attributes are those of :class:`.McapFile`.

    Raises:
        LogError: if it is damaged, or has a view in the place of a table: that may have no end.
    """

    def __init__(self, path: Path) -> None:
        self._database = sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1", uri=True)
        made = dict(self._rows("SELECT lower(name), type FROM sqlite_master"))
        if computed := [name for name, kind in made.items() if kind == "view"]:
            raise LogError(f"damaged: its table `{computed[0]}` computes what it holds")
        query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
        query += " WHERE encoding = 'ros2msg'"
        definitions = dict(self._rows(query) if "message_definitions" in made else ())
        counts = dict(self._rows("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
        self.connections: dict[int, Connection] = {}
        for number, topic, type_name in self._rows("SELECT id, name, type FROM topics"):
            if not isinstance(topic, str) or not isinstance(type_name, str):
                raise LogError(f"damaged: topic {topic} is of type {type_name}")
            if number in self.connections:
                raise LogError("damaged: topics of the same number")
            connection = Connection(topic, type_name, definitions.get(type_name, ""), counts.get(number, 0))
            self.connections[number] = connection
        self.custom: dict[str, str] | None = None
        for (text,) in self._rows("SELECT metadata FROM metadata") if "metadata" in made else ():
            self.custom = (yaml.safe_load(text) or {}).get("custom_data")

    def _rows(self, query: str) -> Iterator[Any]:
        try:
            yield from self._database.execute(query)
        except sqlite3.Error as error:
            reason = one_line(error)
            if "malformed" in reason:
                reason += "; `sqlite3 FILE .recover | sqlite3 whole.db3` rebuilds what is whole of it"
            raise LogError(f"cannot be read: {reason}") from error

    def batches(self, wanted: Collection[int], _head: int | None) -> Iterator[Batch]:
        """The messages of some topics, in the order of their log times."""
        numbers = ", ".join(str(int(number)) for number in wanted)
        rows = self._rows(
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({numbers}) ORDER BY timestamp"
        )
        while part := list(islice(rows, _BATCH)):
            messages: dict[int, tuple[list[int], list[bytes]]] = {number: ([], []) for number in wanted}
            for number, time_ns, data in part:
                if not isinstance(time_ns, int) or not isinstance(data, bytes):
                    raise LogError(f"damaged: a message of topic {self.connections[number].topic} is none")
                messages[number][0].append(time_ns)
                messages[number][1].append(data)
            yield Batch.listed(part[0][1], messages)


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
        """The messages of some topics, or their first bytes, of which the stamp of a header alone is right.

        Chunk by chunk in the order of their first log times: rosbags unpacks a chunk again for each message
        where those of two alternate in time.

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
