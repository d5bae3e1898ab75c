# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What of a bag is played, in the order of its log times, and which of it the live nodes use."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quadpi_core.errors import QuadpiError
from quadpi_core.flight import Stamps
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_inputs import find_inputs, named_inputs
from quadpi_core.logs.bag_topics import BESIDE_INPUTS, find_topic
from quadpi_core.messages.adapters import AdapterSettings, known_adapters
from quadpi_core.messages.payloads import Topic
from quadpi_core.messages.topics import LIVE_SENSORS, MOCAP_TOPICS, TOPIC_TYPES
from quadpi_ros.input_sources import AdapterError, message_class
from quadpi_ros.parameters import adapters_of

# Message classes of the standard topics that are played.
SENSOR_TYPES: dict[str, type] = {name: message_class(TOPIC_TYPES[name]) for name in LIVE_SENSORS}
# Standard topics that the messages of an adapter replace, by the kind of the adapter.
_STANDS_IN_FOR = {
    "imu": ("imu",),
    "rotor_speeds": ("rotor_speeds", "erpm"),
    "mocap": MOCAP_TOPICS,
    "odometry": MOCAP_TOPICS,
    **dict.fromkeys(BESIDE_INPUTS, ()),
}


class PlayerError(QuadpiError):
    """A bag cannot be played."""


@dataclass(frozen=True)
class Playlist:
    """Messages of several topics in the order of their log times.

    Attributes:
        topics: messages by standard name, relative to the player's namespace, or by name of an adapter.
        start_ns: log time of the first message.
        due_ns: (M,) time of each message since the first.
        topic: (M,) index of the topic of each message.
        message: (M,) index of each message within its topic.
    """

    topics: dict[str, Topic]
    start_ns: int
    due_ns: Stamps
    topic: Stamps
    message: Stamps

    @classmethod
    def read(cls, path: Path, names: Sequence[str] = ()) -> Playlist:
        """Read topics of a bag.

        Args:
            path: of the bag.
            names: see :func:`find_topics`.

        Raises:
            LogError: if the bag cannot be read.
            PlayerError: see :func:`find_topics`; if it holds nothing to play.
        """
        with Bag(path) as bag:
            topics_by_name = find_topics(bag, names)
            if not topics_by_name:
                raise PlayerError(f"{path}: holds none of the topics {', '.join(SENSOR_TYPES)}")
            by_name = bag.read(list(topics_by_name.values()))
        topics = {plain(name): by_name[topic] for name, topic in topics_by_name.items()}
        log_time_ns = np.concatenate([topic.log_time_ns for topic in topics.values()])
        lengths = [len(topic.log_time_ns) for topic in topics.values()]
        order = np.argsort(log_time_ns, kind="stable")
        return cls(
            topics=topics,
            start_ns=int(log_time_ns[order[0]]),
            due_ns=log_time_ns[order] - log_time_ns[order[0]],
            topic=np.repeat(np.arange(len(topics)), lengths)[order],
            message=np.concatenate([np.arange(length) for length in lengths])[order],
        )


def find_topics(bag: Bag, names: Sequence[str] = ()) -> dict[str, str]:
    """Topics of a bag, by the names that they are asked for by.

    Args:
        bag: open.
        names: standard names, as in `imu` or `imu=/uav1/imu`, and names of adapters, whose topics are found
            by type. Without any, the standard topics that the bag has, and adapters for inputs that no
            standard topic gives; messages whose package is not installed are left out, and named on stderr.

    Raises:
        PlayerError: for a name that is not known or not in the bag, or an adapter whose messages are on
            several topics.
    """
    topics = {}
    for name in names:
        if plain(name) not in SENSOR_TYPES and name not in known_adapters():
            known = ", ".join((*SENSOR_TYPES, *known_adapters()))
            raise PlayerError(f"{bag.path}: topic {name}: not known; known: {known}")
        topic = _topic_of(bag, name)
        if topic is None:
            raise PlayerError(f"{bag.path}: topic {name}: the bag does not hold it")
        topics[name] = topic
    if names:
        return topics
    standard = {name: topic for name in SENSOR_TYPES if (topic := _topic_of(bag, name))}
    for name, adapter in known_adapters().items():
        if set(_STANDS_IN_FOR[adapter.kind]) & set(standard) or not (topic := _topic_of(bag, name)):
            continue
        try:
            message_class(adapter.type_name)
            topics[name] = topic
        except AdapterError as error:
            print(f"quadpi: {bag.path}: cannot be played: {error}", file=sys.stderr)
    return standard | topics


@dataclass(frozen=True)
class LiveInputs:
    """Topics of a bag that the live nodes use.

    Attributes:
        rotor_topic, mocap_topic: parameters of the nodes.
        topics: to play, by the player's names.
    """

    rotor_topic: str
    mocap_topic: str
    topics: tuple[str, ...]


def live_inputs(path: Path, topics: Sequence[str] = ()) -> LiveInputs:
    """Choose the topics of a bag for the live nodes: the first of each kind of input.

    Args:
        path: of the bag.
        topics: to choose from, see :func:`find_topics`.

    Raises:
        LogError: if the bag cannot be read.
        PlayerError: see :func:`find_topics`; if the bag lacks a kind of input.
    """
    with Bag(path) as bag:
        names = {plain(name): name for name in find_topics(bag, topics)}

    def first_of(kind: str) -> str:
        candidates = (*_STANDS_IN_FOR[kind], *adapters_of(kind))
        first = next((name for name in candidates if name in names), None)
        if first is None:
            raise PlayerError(
                f"{path}: topic {candidates[0]}: the live nodes need it or one of "
                f"{', '.join(candidates[1:])}; the bag does not hold it"
            )
        return first

    imu, mocap = first_of("imu"), first_of("mocap")
    beside = [name for kind in BESIDE_INPUTS for name in adapters_of(kind) if name in names]
    commands = {*adapters_of("motor_commands")} & names.keys()
    measured = (*_STANDS_IN_FOR["rotor_speeds"], *adapters_of("rotor_speeds"))
    # A model that was identified on commands needs no rotor speeds.
    needed = not commands or not names.keys().isdisjoint(measured)
    rotors = first_of("rotor_speeds") if needed else measured[0]
    played = (imu, *([rotors] if needed else []), mocap, *beside, *(["wind"] if "wind" in names else []))
    return LiveInputs(rotors, mocap, tuple(names[name] for name in played))


def plain(name: str) -> str:
    """The standard name in `imu=/uav1/imu`."""
    return name.partition("=")[0]


def _topic_of(bag: Bag, name: str) -> str | None:
    """Full name in the bag of a topic given by its standard name or its adapter; None if it is missing.

    One that has no standard name is found as commands do that read bags.
    """
    standard, _, topic = name.partition("=")
    if topic:
        return named_inputs(bag, {standard: topic}).get(standard)
    if name in SENSOR_TYPES:
        connection = find_topic(bag, name)
        return connection.topic if connection else find_inputs(bag, AdapterSettings()).names.get(name)
    type_name = known_adapters()[name].type_name
    topics = sorted({one.topic for one in bag.connections if one.msgcount and one.msgtype == type_name})
    if len(topics) > 1:
        raise PlayerError(
            f"{bag.path}: {type_name} on several topics, {', '.join(topics)}: choose others with --topics"
        )
    return topics[0] if topics else None
