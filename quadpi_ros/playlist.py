# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What of a bag is played, in the order of its log times, and which of it the live nodes use."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, TransformStamped, TwistStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from quadpi.msg import Erpm, RotorSpeeds
from sensor_msgs.msg import Imu

from quadpi_core.errors import QuadpiError
from quadpi_core.flight import Stamps
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_inputs import find_inputs, named_inputs
from quadpi_core.logs.bag_topics import find_topic
from quadpi_core.messages.adapters import AdapterSettings, known_adapters
from quadpi_core.messages.payloads import Topic
from quadpi_core.messages.sensor_messages import unpack_stamps
from quadpi_core.messages.topics import MOCAP_TOPICS
from quadpi_core.paths import whole_output
from quadpi_ros.input_sources import AdapterError, message_class
from quadpi_ros.node_parameters import adapters_of
from quadpi_ros.playback import Playback

SENSOR_TYPES: dict[str, type] = {
    "imu": Imu,
    "rotor_speeds": RotorSpeeds,
    "erpm": Erpm,
    "mocap/pose": PoseStamped,
    "mocap/transform": TransformStamped,
    "mocap/odometry": Odometry,
    "mocap/twist": TwistStamped,
    "wind": Vector3Stamped,
}
# Standard topics that the messages of an adapter replace, by the kind of the adapter.
_STANDS_IN_FOR = {
    "imu": ("imu",),
    "rotor_speeds": ("rotor_speeds", "erpm"),
    "mocap": MOCAP_TOPICS,
    "odometry": MOCAP_TOPICS,
}


class PlayerError(QuadpiError):
    """A bag cannot be played."""


@dataclass(frozen=True)
class Sent:
    """What a player has published.

    Attributes:
        time_ns: (M,) last publication of each message, monotonic clock; 0 before the first.
        counts: messages by topic, over all loops.
    """

    time_ns: Stamps
    counts: list[int]


@dataclass(frozen=True)
class Playlist:
    """Messages of several topics in the order of their log times.

    Attributes:
        names: standard name of each topic, relative to the player's namespace, or name of an adapter.
        topics: messages of each.
        start_ns: log time of the first message.
        due_ns: (M,) time of each message since the first.
        topic: (M,) index of the topic of each message.
        message: (M,) index of each message within its topic.
    """

    names: tuple[str, ...]
    topics: tuple[Topic, ...]
    start_ns: int
    due_ns: Stamps
    topic: Stamps
    message: Stamps

    @classmethod
    def read(cls, path: Path, names: Sequence[str] = tuple(SENSOR_TYPES)) -> Playlist:
        """Read those of the named topics that the bag has, in any namespace.

        Args:
            path: of the bag.
            names: standard names, as in `imu` or `imu=/uav1/imu`, and names of adapters, whose topics are
                found by type.

        Raises:
            LogError: if the bag cannot be read.
            PlayerError: if it holds none of the topics, or several of an adapter's type.
        """
        with Bag(path) as bag:
            found = {plain(name): topic for name in names if (topic := _topic_of(bag, name))}
            by_name = bag.read(list(found.values()))
        if not found:
            raise PlayerError(f"{path}: holds none of the topics {', '.join(names)}")
        topics = tuple(by_name[topic] for topic in found.values())
        log_time_ns = np.concatenate([topic.log_time_ns for topic in topics])
        lengths = [len(topic.log_time_ns) for topic in topics]
        order = np.argsort(log_time_ns, kind="stable")
        return cls(
            names=tuple(found),
            topics=topics,
            start_ns=int(log_time_ns[order[0]]),
            due_ns=log_time_ns[order] - log_time_ns[order[0]],
            topic=np.repeat(np.arange(len(topics)), lengths)[order],
            message=np.concatenate([np.arange(length) for length in lengths])[order],
        )

    def by_name(self) -> dict[str, Topic]:
        """The topics by their standard names."""
        return dict(zip(self.names, self.topics, strict=True))

    def __len__(self) -> int:
        return len(self.due_ns)

    def play(
        self, publishers: Sequence[Callable[[bytes], None]], playback: Playback, start_ns: int, loop: bool
    ) -> Sent:
        """Publish every message when it is due.

        Args:
            publishers: one per topic.
            playback: the position, at `start_ns`.
            start_ns: where to begin, and to begin again.
            loop: whether to begin again at the end.

        Returns:
            What was published, at the end or at a shutdown of ROS.
        """
        payloads = [self.topics[t].payloads[m] for t, m in zip(self.topic, self.message, strict=True)]
        publish = [publishers[t] for t in self.topic]
        due_ns, topics = self.due_ns.tolist(), self.topic.tolist()
        first = int(np.searchsorted(self.due_ns, start_ns))
        sent = Sent(np.zeros(len(self), dtype=np.int64), [0] * len(self.topics))
        while True:
            for index in range(first, len(self)):
                if not playback.wait_until(due_ns[index], rclpy.ok):
                    return sent
                sent.time_ns[index] = time.monotonic_ns()
                publish[index](payloads[index])
                sent.counts[topics[index]] += 1
            if not loop:
                return sent
            playback.seek(start_ns)

    def save_sent(self, path: Path, sent_ns: Stamps) -> None:
        """Write stamp and publication time, (n, 2) nanoseconds per standard topic, to a .npz file.

        Args:
            path: of the file.
            sent_ns: (M,) publication of each message; 0: not published.
        """
        columns = {}
        for index, (name, topic) in enumerate(self.by_name().items()):
            if name not in SENSOR_TYPES:
                continue
            mine = (self.topic == index) & (sent_ns > 0)
            stamps = unpack_stamps(topic.payloads)[self.message[mine]]
            columns[name] = np.column_stack((stamps, sent_ns[mine]))
        with whole_output(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **columns)  # type: ignore[arg-type]  # no topic is called allow_pickle


def playable(path: Path) -> list[str]:
    """The standard topics of a bag, and adapters for inputs without a standard topic.

    Warns on stderr of messages whose package is not installed.

    Raises:
        LogError: if the bag cannot be read.
        PlayerError: see :meth:`Playlist.read`.
    """
    with Bag(path) as bag:
        standard = [name for name in SENSOR_TYPES if _topic_of(bag, name)]
        candidates = [
            name
            for name, adapter in known_adapters().items()
            if not set(_STANDS_IN_FOR[adapter.kind]) & set(standard) and _topic_of(bag, name)
        ]
    adapted = []
    for name in candidates:
        try:
            message_class(known_adapters()[name].type_name)
            adapted.append(name)
        except AdapterError as error:
            print(f"quadpi: {path}: cannot be played: {error}", file=sys.stderr)
    return standard + adapted


def checked_names(path: Path, names: Sequence[str]) -> list[str]:
    """Check that a bag has all named topics, and return the names.

    Raises:
        LogError: if the bag cannot be read.
        PlayerError: for an unknown name or a missing topic; see also :meth:`Playlist.read`.
    """
    with Bag(path) as bag:
        for name in names:
            if plain(name) not in SENSOR_TYPES and name not in known_adapters():
                known = ", ".join((*SENSOR_TYPES, *known_adapters()))
                raise PlayerError(f"{path}: topic {name}: not known; known: {known}")
            if _topic_of(bag, name) is None:
                raise PlayerError(f"{path}: topic {name}: the bag does not hold it")
    return list(names)


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
        topics: standard names and names of adapters to choose from; by default all that can be played.

    Raises:
        LogError: if the bag cannot be read.
        PlayerError: see :func:`checked_names`; if the bag lacks a kind of input.
    """
    names = checked_names(path, topics) or playable(path)

    def first_of(standard: Sequence[str], kind: str) -> str:
        candidates = (*standard, *adapters_of(kind))
        found = next((name for wanted in candidates for name in names if plain(name) == wanted), None)
        if found is None:
            raise PlayerError(
                f"{path}: topic {standard[0]}: the live nodes need it or one of {', '.join(candidates[1:])}; "
                f"the bag does not hold it"
            )
        return found

    imu = first_of(_STANDS_IN_FOR["imu"], "imu")
    rotors = first_of(_STANDS_IN_FOR["rotor_speeds"], "rotor_speeds")
    mocap = first_of(_STANDS_IN_FOR["mocap"], "mocap")
    optional = [name for name in names if plain(name) == "wind"]
    return LiveInputs(plain(rotors), plain(mocap), (imu, rotors, mocap, *optional))


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
