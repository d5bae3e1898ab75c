# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Play the sensor topics of a bag in real time, messages and stamps as recorded.

For what `ros2 bag play` does not do: it begins once the nodes listen, so that they miss nothing, finds the
sensors of a bag under whatever names, and needs no rosbag2, of which there is no wheel.
"""

from __future__ import annotations

import argparse
import heapq
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import rclpy
from rclpy.parameter import Parameter
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock

from quadpi_core.flight import MAX_JUMP_BACK_NS
from quadpi_core.messages.adapters import known_adapters
from quadpi_core.messages.sensor_messages import unpack_stamps
from quadpi_core.paths import whole_output
from quadpi_ros.callbacks import SENSOR_QOS, DiscoveryError, GuardedNode, await_listeners
from quadpi_ros.input_sources import message_class
from quadpi_ros.parameters import CLOCK_HZ
from quadpi_ros.playlist import SENSOR_TYPES, PlayerError, Playlist
from quadpi_ros.runtime import run

# Time for the last messages to be sent before the participant closes.
_FLUSH_S = 0.2
# Nothing wakes up who waits for the next message when ROS shuts down.
_GLANCE_S = 0.2

# A message, how to publish it, and when: so many nanoseconds after the first message of the bag.
_Due: TypeAlias = tuple[int, Callable[[Any], None], Any]
_TOPICS_HELP = (
    "standard topics, also as in imu=/uav1/imu, and messages of other packages by the name of their adapter; "
    "without it, the standard topics, and adapters where those are missing"
)


def main() -> int:
    """Play the bag that the command line names."""
    return run(lambda: _run(parse_arguments(remove_ros_args(sys.argv)[1:])))


def parse_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    """Options of the command line; those that `ros2 bag play` has too are named as there."""
    parser = argparse.ArgumentParser(prog="player", description="Play the sensor topics of a bag.")
    add = parser.add_argument
    add("bag", type=Path, help="bag to play")
    add("-r", "--rate", type=_positive, default=1.0, help="speed; default 1, real time")
    add("--topics", nargs="+", metavar="NAME", default=[], help=_TOPICS_HELP)
    clock = f"rate of /clock; without a number {CLOCK_HZ:g} Hz"
    add("--clock", nargs="?", type=_positive, const=CLOCK_HZ, metavar="HZ", help=clock)
    add("-l", "--loop", action="store_true", help="begin again at the end")
    add("--start-offset", type=float, default=0.0, metavar="S", help="begin so far into the bag")
    add("--wait", type=float, default=10.0, metavar="S", help="seconds to wait for subscribers; 0: do not")
    add("--nodes", nargs="+", metavar="NAME", default=[], help="managed nodes to wait for until active")
    add("--sent", type=Path, metavar="FILE", help="write stamp and publication of each message of imu (.npy)")
    options = parser.parse_args(arguments)
    if options.sent and options.loop:
        parser.error("--sent is of a bag that is played once, not of one with --loop")
    return options


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < np.inf:
        raise argparse.ArgumentTypeError(f"must be positive, found {text}")
    return value


def start_of(playlist: Playlist, options: argparse.Namespace) -> int:
    """Position at which to begin, in nanoseconds since the first message.

    Raises:
        PlayerError: if the bag has no such position, or what is left is too short to be played in a loop.
    """
    end_ns = int(playlist.due_ns[-1])
    if not 0.0 <= options.start_offset <= 1e-9 * end_ns:
        played = f"what is played lasts {1e-9 * end_ns:.3g} s"
        raise PlayerError(f"{options.bag}: --start-offset {options.start_offset:g}: {played}")
    start_ns: int = round(1e9 * options.start_offset)
    if options.loop and end_ns - start_ns <= MAX_JUMP_BACK_NS:
        raise PlayerError(
            f"{options.bag}: --loop: {1e-9 * (end_ns - start_ns):.3g} s are too short: "
            f"nodes begin again where stamps jump back by more than {1e-9 * MAX_JUMP_BACK_NS:g} s"
        )
    return start_ns


def _run(options: argparse.Namespace) -> None:
    playlist = Playlist.read(options.bag, options.topics)
    start_ns = start_of(playlist, options)
    # Without services, as it is on no executor that would answer.
    silent = Parameter("start_type_description_service", value=False)
    node = GuardedNode("player", start_parameter_services=False, parameter_overrides=[silent])
    publishers = [node.create_publisher(*_announcement(name), SENSOR_QOS) for name in playlist.topics]
    tell = node.create_publisher(Clock, "/clock", 10).publish if options.clock else None
    if options.wait > 0.0:
        try:
            await_listeners(node, publishers, options.nodes, options.wait)
        except DiscoveryError as error:
            advice = "choose topics with --topics, or start at once with --wait 0"
            raise PlayerError(f"{error} ({options.wait:g} s); {advice}") from error
    sent_ns: list[int] = []
    publish = [
        _noting(one.publish, sent_ns) if options.sent and name == "imu" else one.publish
        for name, one in zip(playlist.topics, publishers, strict=True)
    ]
    messages = _messages(playlist, publish, start_ns)
    while True:
        # At the same instant, the clock first.
        ticks = _ticks(playlist, start_ns, options.rate / options.clock, tell) if tell else ()
        whole = _play(heapq.merge(ticks, messages, key=itemgetter(0)), start_ns, options.rate)
        if not (whole and options.loop):
            break
    time.sleep(_FLUSH_S)
    if options.sent:
        _save_sent(options.sent, playlist, start_ns, sent_ns)
    if whole:
        names = ", ".join(playlist.topics)
        print(f"{options.bag}: played {len(messages)} messages of {names} at {options.rate:g} x real time")


def _announcement(name: str) -> tuple[type, str]:
    """Message type and topic to publish, relative to the player's namespace.

    Raises:
        AdapterError: if the package that defines the messages is not installed.
    """
    if name in SENSOR_TYPES:
        return SENSOR_TYPES[name], name
    return message_class(known_adapters()[name].type_name), known_adapters()[name].topic


def _noting(publish: Callable[[Any], None], times_ns: list[int]) -> Callable[[Any], None]:
    """A function that publishes, and appends the time by the monotonic clock."""

    def publish_and_note(message: Any) -> None:
        times_ns.append(time.monotonic_ns())
        publish(message)

    return publish_and_note


def _messages(playlist: Playlist, publish: Sequence[Callable[[Any], None]], start_ns: int) -> list[_Due]:
    topics = list(playlist.topics.values())
    return [
        (due_ns, publish[topic], topics[topic].payloads[message])
        for due_ns, topic, message in zip(
            playlist.due_ns.tolist(), playlist.topic, playlist.message, strict=True
        )
        if due_ns >= start_ns
    ]


def _ticks(
    playlist: Playlist, start_ns: int, period_s: float, publish: Callable[[Any], None]
) -> Iterator[_Due]:
    """Messages of `/clock`: the log time."""
    for at_ns in range(start_ns, int(playlist.due_ns[-1]) + 1, max(1, round(1e9 * period_s))):
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(playlist.start_ns + at_ns, 10**9)
        yield at_ns, publish, message


def _play(messages: Iterable[_Due], start_ns: int, rate: float) -> bool:
    """Publish every message when it is due; False where ROS shuts down before the last."""
    begun_ns = time.monotonic_ns()
    for at_ns, publish, message in messages:
        due_ns = begun_ns + round((at_ns - start_ns) / rate)
        while (left_s := 1e-9 * (due_ns - time.monotonic_ns())) > 0.0 and rclpy.ok():
            time.sleep(min(left_s, _GLANCE_S))
        if not rclpy.ok():
            return False
        publish(message)
    return True


def _save_sent(path: Path, playlist: Playlist, start_ns: int, sent_ns: Sequence[int]) -> None:
    """Write stamp and publication of the messages of `imu`, (N, 2) nanoseconds, to a .npy file."""
    stamps = np.zeros(0, dtype=np.int64)
    if (imu := playlist.topics.get("imu")) is not None:
        stamps = unpack_stamps(imu.payloads)[imu.log_time_ns - playlist.start_ns >= start_ns]
    with whole_output(path) as temporary, temporary.open("wb") as file:
        np.save(file, np.column_stack((stamps[: len(sent_ns)], np.array(sent_ns, dtype=np.int64))))


if __name__ == "__main__":
    raise SystemExit(main())
