# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag by their names: which there are, when they were stamped, and what their messages hold."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from quadpi_core.errors import LogError, SampleError, VehicleError
from quadpi_core.findings import LeftOut
from quadpi_core.flight import Stamps, Stream
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.mcap_files import Connection
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.adapters.adapter_definition import Adapter
from quadpi_core.messages.adapters.adapter_registry import known_adapters
from quadpi_core.messages.adapters.adapter_settings import EXAMPLES, AdapterSettings
from quadpi_core.messages.definitions import definition_text, typestore
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.messages.topics import SENSOR_KINDS, TOPIC_TYPES
from quadpi_core.vehicle import Vehicle

_STARTS_WITH_HEADER = re.compile(
    r"(?:\s*(?:#[^\n]*|\w+\s+[A-Z_0-9]+\s*=[^\n]*)?\n)*\s*std_msgs/(?:msg/)?Header\s"
)

_Content = TypeVar("_Content")


def has_topic(path: Path | str, topic: str) -> bool:
    """Whether a bag holds messages on a standard topic, in any namespace."""
    with Bag(Path(path)) as bag:
        return find_topic(bag, topic) is not None


def bag_vehicle(path: Path | str) -> str:
    """Name of the vehicle that a bag says it is of; empty where it does not say."""
    with Bag(Path(path)) as bag:
        return bag.metadata.get("vehicle", "")


def topic_stamps(path: Path | str) -> dict[str, Stamps]:
    """Stamps (N,) of every topic of a bag, ordered by name: of headers, else times of logging."""
    with Bag(Path(path)) as bag:
        by_name = {connection.topic: connection for connection in bag.connections}
        found = {name: [np.empty(0, dtype=np.int64)] for name in sorted(by_name)}
        counts = dict.fromkeys(found, 0)
        for block in bag.blocks(found, head=sensor_messages.STAMP_END):
            for name, topic in block.items():
                unpack = sensor_messages.unpack_stamps
                stamps_ns = topic.log_time_ns
                if _has_header(by_name[name]):
                    stamps_ns = unpacked_topic(bag.path, topic, unpack, before=counts[name])
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
    """What `unpack` (see `sensor_messages`) makes of messages of a topic; so many came `before` them."""
    try:
        return unpack(topic.payloads)
    except (LogError, VehicleError) as error:
        said = error.after(before) if isinstance(error, SampleError) else error
        raise LogError(f"{path}: topic {topic.name}: {said}") from error


_log = logging.getLogger(__name__)

# Those that are used without being named, and refuse no bag.
MOTOR_INPUTS = ("motor_commands", "battery")
AIR_INPUTS = ("pressure", "temperature")
BESIDE_INPUTS = (*MOTOR_INPUTS, *AIR_INPUTS)
# Kinds of streams that messages of other packages give.
ADAPTED_KINDS = ("imu", "rotor_speeds", "mocap", "odometry", *BESIDE_INPUTS)
# In names of another pressure, or of a part that warms itself.
_NO_AIR = re.compile(r"diff|imu|motor|esc|batt|cpu|mag")


class AdaptedTopic(NamedTuple):
    """A topic of a bag, and how it is read."""

    adapter: Adapter
    connection: Connection

    @property
    def name(self) -> str:
        """Of the topic."""
        return self.connection.topic


def find_adapted(bag: Bag, settings: AdapterSettings, within: Collection[str]) -> dict[str, AdaptedTopic]:
    """Topics that the settings configure, by kind of stream, by their types; those not `within` by name.

    Raises:
        LogError: naming bag and topic, for a kind that no topic or several topics give.
    """
    found = {}
    for kind in ADAPTED_KINDS:
        own = getattr(settings, kind)
        if own is not None:
            chosen = [
                topic
                for topic in _candidates(bag, kind)
                if topic.name == own.topic
                or (own.topic is None and topic.name in within and not topic.adapter.common)
            ]
            found[kind] = _only(bag, kind, chosen, own.topic)
    return found


def unread(bag: Bag, present: Collection[str]) -> Iterator[str]:
    """A note for each topic that could be read if it were configured, of kinds that are not read already."""
    for kind in ADAPTED_KINDS:
        for topic in _candidates(bag, kind) if kind not in present else ():
            if not topic.adapter.common:
                how = f"`--topics {kind}={topic.name}` reads it"
                if kind in EXAMPLES:
                    how = f"--mapping must say how, with the key `{kind}`, as in `{EXAMPLES[kind]}`"
                yield f"topic {topic.name}: {topic.adapter.type_name} is not read: {how}"


def adapter_of(kind: str, type_name: str) -> Adapter | None:
    """The adapter that makes a kind of stream of messages of a type."""
    known = known_adapters().values()
    return next((one for one in known if (one.kind, one.type_name) == (kind, type_name)), None)


def _candidates(bag: Bag, kind: str) -> list[AdaptedTopic]:
    topics = {
        connection.topic: AdaptedTopic(adapter, connection)
        for connection in bag.connections
        if connection.msgcount and (adapter := adapter_of(kind, connection.msgtype))
    }
    return [topics[name] for name in sorted(topics)]


def unnamed(bag: Bag, kind: str, within: Collection[str], known: str = "") -> list[AdaptedTopic]:
    """Topics of messages that say all of themselves, which may be taken without being named.

    The adapter that is `known`, as a vehicle's motors are, comes first; what the autopilot sends before what
    is sent to it; of equals all, of which the user has to choose.
    """
    order = [adapter.type_name for adapter in known_adapters().values() if adapter.kind == kind]
    found = [
        ((one.adapter.name != known, order.index(one.adapter.type_name), "/in/" in one.name), one)
        for one in _candidates(bag, kind)
        if one.name in within
        and not one.adapter.common
        and not (kind in AIR_INPUTS and _is_of_a_part(one.name.lower()))
    ]
    return [one for rank, one in found if rank == min(rank for rank, _ in found)]


def _is_of_a_part(name: str) -> bool:
    """Whether a topic tells another pressure or temperature than that of the air, as `/imu/temperature`."""
    *_, before, last = ("", *name.split("/"))
    return bool(_NO_AIR.search(f"{before}/{last}" if last == "temperature" else last))


def _only(bag: Bag, kind: str, chosen: list[AdaptedTopic], asked: str | None) -> AdaptedTopic:
    if len(chosen) > 1:
        names = ", ".join(topic.name for topic in chosen)
        raise LogError(f"{bag.path}: `{kind}` could be any of {names}: the mapping must name its `topic`")
    if not chosen:
        known = [adapter.type_name for adapter in known_adapters().values() if adapter.kind == kind]
        if asked:
            known += [TOPIC_TYPES[word] for word, own in SENSOR_KINDS.items() if own == kind]
        types = ", ".join(known)
        raise LogError(f"{bag.path}: {f'topic {asked}' if asked else f'`{kind}`'}: no messages of {types}")
    return chosen[0]


class AdaptedReading:
    """Unpacks the messages of a topic in parts, and counts the samples.

    Raises:
        LogError: naming bag and topic, if the bag holds no definition that can be used.
    """

    def __init__(
        self, bag: Path, topic: AdaptedTopic, settings: AdapterSettings, vehicle: Vehicle | None
    ) -> None:
        self.name, self._kind, self._bag = topic.name, topic.adapter.kind, bag
        self._where = f"{bag}: topic {topic.name}"
        self._samples = 0
        text, type_name = topic.connection.definition, topic.adapter.type_name
        if type_name in typestore().fielddefs:
            # ROS defines it, and not every bag does.
            text = definition_text(type_name)
        if not text:
            raise LogError(
                f"{self._where}: the bag does not hold the definition of {type_name} as a .msg; "
                "`ros2 bag convert` to MCAP adds it, where the package is installed"
            )
        try:
            self._unpacker = topic.adapter.open(text, settings, vehicle)
        except (LogError, VehicleError) as error:
            raise LogError(f"{self._where}: {error}") from error

    def unpack(self, topic: Topic, before: int) -> Stream | None:
        """The samples in the next messages, after so many `before` them; None without messages.

        Raises:
            LogError: naming bag, topic and sample, for messages that cannot be read.
        """
        if len(topic.payloads) == 0:
            return None
        stream = unpacked_topic(self._bag, topic, self._unpacker.unpack, before=before)
        self._samples += len(stream)
        return stream

    def finish(self, count: int, start_ns: int) -> Iterator[LeftOut]:
        """How many of all `count` messages were dropped, times from `start_ns` on; some only warn.

        Raises:
            LogError: if all were dropped.
        """
        dropped = "; ".join(f"{number}: {reason}" for reason, number in self._unpacker.dropped.most_common())
        if self._samples == 0 and self._kind not in BESIDE_INPUTS:
            raise LogError(f"{self._where}: none of {count} messages gives a sample ({dropped})")
        if self._unpacker.left_out is not None:
            yield from self._unpacker.left_out(self._kind, start_ns)
        elif dropped:
            _log.warning("%s: dropped messages of %d: %s", self._where, count, dropped)
