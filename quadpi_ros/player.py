# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Play the sensor topics of a bag in real time: serialized messages as recorded, header stamps untouched."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from quadpi.msg import Erpm, RotorSpeeds
from rclpy.node import Node
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import Imu

from quadpi_core.errors import QuadpiError
from quadpi_core.flight import Stamps
from quadpi_core.logs.bags import find_topic
from quadpi_core.logs.mcap import Bag, Topic
from quadpi_core.logs.messages import unpack_stamps
from quadpi_core.paths import whole_output
from quadpi_ros.discovery import await_listeners
from quadpi_ros.runtime import SENSOR_QOS, run

SENSOR_TYPES: dict[str, type] = {
    "imu": Imu,
    "rotor_speeds": RotorSpeeds,
    "erpm": Erpm,
    "mocap/pose": PoseStamped,
    "mocap/odometry": Odometry,
    "mocap/twist": TwistStamped,
    "wind": Vector3Stamped,
}

# Time for the last messages to leave before the participant closes.
_FLUSH_S = 0.2


class PlayerError(QuadpiError):
    """A bag cannot be played."""


@dataclass(frozen=True)
class Playlist:
    """Messages of several topics in the order of their log times.

    Attributes:
        names: standard name of each topic, relative to the player's namespace.
        topics: their messages.
        due_ns: (M,) when each message is due, since the first.
        topic: (M,) index of the topic of each message.
        message: (M,) its index within that topic.
    """

    names: tuple[str, ...]
    topics: tuple[Topic, ...]
    due_ns: Stamps
    topic: Stamps
    message: Stamps

    @classmethod
    def read(cls, path: Path, names: Sequence[str] = tuple(SENSOR_TYPES)) -> Playlist:
        """Read those of the named topics that the bag holds, in whatever namespace.

        Raises:
            LogError: if the bag cannot be read.
            PlayerError: if it holds none of the topics.
        """
        with Bag(path) as bag:
            found = {name: connection.topic for name in names if (connection := find_topic(bag, name))}
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
            due_ns=log_time_ns[order] - log_time_ns[order[0]],
            topic=np.repeat(np.arange(len(topics)), lengths)[order],
            message=np.concatenate([np.arange(length) for length in lengths])[order],
        )

    def by_name(self) -> dict[str, Topic]:
        """The topics by their standard names."""
        return dict(zip(self.names, self.topics, strict=True))

    def __len__(self) -> int:
        return len(self.due_ns)

    def play(self, publishers: Sequence[Callable[[bytes], None]], rate: float) -> Stamps:
        """Publish every message when it is due; late ones at once.

        Args:
            publishers: one per topic.
            rate: speed, 1 is real time.

        Returns:
            (M,) when each message was published, by the monotonic clock; fewer after a shutdown.
        """
        payloads = [self.topics[t].payloads[m] for t, m in zip(self.topic, self.message, strict=True)]
        publish = [publishers[t] for t in self.topic]
        sent_ns = np.zeros(len(self), dtype=np.int64)
        due_ns = time.monotonic_ns() + np.rint(self.due_ns / rate).astype(np.int64)
        for index, due in enumerate(due_ns.tolist()):
            wait_ns = due - time.monotonic_ns()
            if wait_ns > 0:
                time.sleep(1e-9 * wait_ns)
            if not rclpy.ok():
                return sent_ns[:index]
            sent_ns[index] = time.monotonic_ns()
            publish[index](payloads[index])
        return sent_ns

    def save_sent(self, path: Path, sent_ns: Stamps) -> None:
        """Write a .npz with one array per topic: stamp and publication time, (n, 2) nanoseconds."""
        published = self.topic[: len(sent_ns)], self.message[: len(sent_ns)]
        columns = {}
        for index, (name, topic) in enumerate(self.by_name().items()):
            mine = published[0] == index
            stamps = unpack_stamps(topic.payloads)[published[1][mine]]
            columns[name] = np.column_stack((stamps, sent_ns[mine]))
        with whole_output(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **columns)


def main() -> int:
    """Play the bag that the command line names."""
    options = parse_arguments(remove_ros_args(sys.argv)[1:])
    return run(lambda: _play(options))


def parse_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(prog="player", description="Play the sensor topics of a bag.")
    parser.add_argument("bag", type=Path, help="bag to play")
    parser.add_argument("--rate", type=float, default=1.0, help="speed; 1 is real time")
    parser.add_argument("--topics", nargs="+", choices=SENSOR_TYPES, default=list(SENSOR_TYPES))
    parser.add_argument(
        "--wait", type=float, default=10.0, metavar="S", help="seconds to wait for subscribers; 0: do not"
    )
    parser.add_argument(
        "--nodes",
        nargs="+",
        metavar="NAME",
        default=[],
        help="managed nodes to wait for until they are active",
    )
    parser.add_argument("--sent", type=Path, metavar="FILE", help="write when each message was published")
    options = parser.parse_args(arguments)
    if not 0.0 < options.rate < np.inf:
        parser.error(f"--rate must be positive, found {options.rate:g}")
    return options


def _play(options: argparse.Namespace) -> None:
    playlist = Playlist.read(options.bag, options.topics)
    node = Node("player", start_parameter_services=False)
    publishers = [node.create_publisher(SENSOR_TYPES[name], name, SENSOR_QOS) for name in playlist.names]
    if options.wait > 0.0:
        await_listeners(node, publishers, options.nodes, options.wait)
    sent_ns = playlist.play([publisher.publish for publisher in publishers], options.rate)
    time.sleep(_FLUSH_S)
    if options.sent:
        playlist.save_sent(options.sent, sent_ns)
    played = playlist.topic[: len(sent_ns)]
    counts = ", ".join(f"{name} {np.sum(played == index)}" for index, name in enumerate(playlist.names))
    print(f"{options.bag}: played {counts} messages at {options.rate:g} x real time")


if __name__ == "__main__":
    raise SystemExit(main())
