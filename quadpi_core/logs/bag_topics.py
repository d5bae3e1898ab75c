# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag by their names: which there are, when they were stamped, and what their messages hold."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from quadpi_core.errors import LogError, SampleError, VehicleError
from quadpi_core.flight import Stamps
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.mcap_files import Connection
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.messages.topics import TOPIC_TYPES

_STARTS_WITH_HEADER = re.compile(
    r"(?:\s*(?:#[^\n]*|\w+\s+[A-Z_0-9]+\s*=[^\n]*)?\n)*\s*std_msgs/(?:msg/)?Header\s"
)

_Content = TypeVar("_Content")


class TopicSummary(NamedTuple):
    """What a bag holds on one topic.

    Attributes:
        stamps_ns: (N,) header stamps, or log times for messages without a header.
        has_header: whether they are header stamps.
    """

    name: str
    type_name: str
    stamps_ns: Stamps
    has_header: bool


def has_topic(path: Path | str, topic: str) -> bool:
    """Whether a bag holds messages on a standard topic, in any namespace.

    Raises:
        LogError: as :func:`read_bag`.
    """
    with Bag(Path(path)) as bag:
        return find_topic(bag, topic) is not None


def bag_vehicle(path: Path | str) -> str:
    """Name of the vehicle that a bag says it is of; empty where it does not say.

    Raises:
        LogError: for a bag that cannot be read.
    """
    with Bag(Path(path)) as bag:
        return bag.metadata.get("vehicle", "")


def bag_topics(path: Path | str) -> list[TopicSummary]:
    """Summarise every topic of a bag, of any type, ordered by name.

    Raises:
        LogError: for a bag that cannot be read.
    """
    with Bag(Path(path)) as bag:
        by_name = {connection.topic: connection for connection in bag.connections}
        stamps = _stamps(bag, sorted(by_name))
    return [
        TopicSummary(name, by_name[name].msgtype, stamps_ns, _has_header(by_name[name]))
        for name, stamps_ns in stamps.items()
    ]


def _stamps(bag: Bag, names: Sequence[str]) -> dict[str, Stamps]:
    """By topic (N,): header stamps, or log times where messages have no header."""
    with_header = {connection.topic for connection in bag.connections if _has_header(connection)}
    found: dict[str, list[Stamps]] = {name: [np.empty(0, dtype=np.int64)] for name in names}
    counts = dict.fromkeys(names, 0)
    for block in bag.blocks(names, head=sensor_messages.STAMP_END):
        for name, topic in block.items():
            stamps_ns = topic.log_time_ns
            if name in with_header:
                stamps_ns = unpacked_topic(
                    bag.path, topic, sensor_messages.unpack_stamps, before=counts[name]
                )
            found[name].append(stamps_ns)
            counts[name] += len(stamps_ns)
    return {name: np.concatenate(parts) for name, parts in found.items()}


def _has_header(connection: Connection) -> bool:
    if connection.definition:
        return _STARTS_WITH_HEADER.match(connection.definition) is not None
    _, fields = typestore().fielddefs.get(connection.msgtype, ([], []))
    return bool(fields) and fields[0][1][1] == "std_msgs/msg/Header"


def find_topic(bag: Bag, topic: str) -> Connection | None:
    """The topic of that name in any namespace, or None if it is absent or holds no messages.

    Topics below a namespace `truth` are passed over: a simulation computed them, no sensor measured them.
    """
    candidates = {
        connection.topic: connection
        for connection in bag.connections
        if connection.msgcount and is_named(connection.topic, topic)
    }
    if len(candidates) > 1:
        raise LogError(f"{bag.path}: topic {topic}: ambiguous between {', '.join(sorted(candidates))}")
    for connection in candidates.values():
        require_type(bag, connection.topic, topic)
        return connection
    return None


def require_type(bag: Bag, name: str, topic: str) -> None:
    """Refuse a topic of a bag that has not the type of a standard topic, with a LogError."""
    types = {connection.msgtype for connection in bag.connections if connection.topic == name}
    if types != {TOPIC_TYPES[topic]}:
        found = ", ".join(sorted(types))
        raise LogError(f"{bag.path}: topic {name}: type {found}, expected {TOPIC_TYPES[topic]}")


def is_named(name: str, topic: str) -> bool:
    """Whether a topic of a bag has a standard name, in any namespace but that of a simulation's truth."""
    whole = f"/{name}"
    namespace = whole.removesuffix(f"/{topic}")
    parts = namespace.split("/")
    # What motion capture sends is no state that an estimator fused.
    return namespace != whole and "truth" not in parts and not (topic == "odometry" and parts[-1] == "mocap")


def is_truth(name: str) -> bool:
    """Whether a simulation computed what is on a topic: a level of its namespace is `truth`."""
    return "truth" in name.split("/")[:-1]


def unpacked_topic(
    path: Path, topic: Topic, unpack: Callable[[Payloads], _Content], *, before: int = 0
) -> _Content:
    """What `unpack` makes of the messages of a topic.

    Args:
        path: of the bag.
        topic: its messages, or some of them.
        unpack: see :mod:`quadpi_core.messages.sensor_messages`.
        before: how many messages of the topic came before these.

    Raises:
        LogError: as `unpack` does, naming bag and topic.
    """
    try:
        return unpack(topic.payloads)
    except SampleError as error:
        raise LogError(f"{path}: topic {topic.name}: {error.after(before)}") from error
    except (LogError, VehicleError) as error:
        raise LogError(f"{path}: topic {topic.name}: {error}") from error
