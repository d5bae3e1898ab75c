# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Play the sensor topics of a bag in real time, messages and stamps as recorded.

Messages of other packages are played too if their package is installed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rclpy.parameter import Parameter
from rclpy.utilities import remove_ros_args

from quadpi_core.flight import MAX_JUMP_BACK_NS
from quadpi_core.messages.adapters import known_adapters
from quadpi_ros.callbacks import GuardedNode
from quadpi_ros.dds_profile import SENSOR_QOS, DiscoveryError, await_listeners
from quadpi_ros.input_sources import message_class
from quadpi_ros.playback import Playback
from quadpi_ros.playback_controls import KEYS_HELP, Controls
from quadpi_ros.playlist import SENSOR_TYPES, PlayerError, Playlist, checked_names, playable
from quadpi_ros.runtime import run

# Time for nodes to become active: the first start on a machine compiles the kernels.
START_TIMEOUT_S = 300.0
# Rate of /clock unless it is given, as of `ros2 bag play`.
CLOCK_HZ = 40.0
# Time for the last messages to be sent before the participant closes.
_FLUSH_S = 0.2

_MAY_MISS = "nodes that answer no parameter service, and so may miss the first messages"
_TOPICS_HELP = (
    "standard topics, also as in imu=/uav1/imu, and messages of other packages by the name of their adapter; "
    "without it, the standard topics, and adapters where those are missing"
)


def _announcement(name: str) -> tuple[type, str]:
    """Message type and topic to publish, relative to the player's namespace.

    Raises:
        AdapterError: if the package that defines the messages is not installed.
    """
    if name in SENSOR_TYPES:
        return SENSOR_TYPES[name], name
    return message_class(known_adapters()[name].type_name), known_adapters()[name].topic


def main() -> int:
    """Play the bag that the command line names."""
    return run(lambda: _play(parse_arguments(remove_ros_args(sys.argv)[1:])))


def parse_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    """Options of the command line; those that `ros2 bag play` has too are named as there."""
    parser = argparse.ArgumentParser(prog="player", description="Play the sensor topics of a bag.")
    parser.add_argument("bag", type=Path, help="bag to play")
    parser.add_argument("-r", "--rate", type=_positive, help="speed; default 1, real time")
    parser.add_argument("--topics", nargs="+", metavar="NAME", help=_TOPICS_HELP)
    parser.add_argument(
        "--clock",
        nargs="?",
        type=_positive,
        const=CLOCK_HZ,
        metavar="HZ",
        help=f"publish /clock at this rate; without a number {CLOCK_HZ:g} Hz",
    )
    parser.add_argument("-l", "--loop", action="store_true", help="begin again at the end")
    parser.add_argument(
        "--start-offset", type=float, default=0.0, metavar="S", help="begin so far into the bag"
    )
    parser.add_argument("-p", "--start-paused", action="store_true", help="begin paused")
    keys = KEYS_HELP.replace("%", "%%")
    parser.add_argument(
        "--disable-keyboard-controls", action="store_true", help=f"leave the keys alone ({keys})"
    )
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
    if not 0.0 <= options.start_offset < np.inf:
        parser.error(f"--start-offset must not be negative, found {options.start_offset:g}")
    if options.sent and options.loop:
        parser.error("--sent is of a bag that is played once, not of one with --loop")
    return options


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < np.inf:
        raise argparse.ArgumentTypeError(f"must be positive, found {text}")
    return value


def player_node(rate: float | None = None) -> GuardedNode:
    """A node without services: they are offered once something answers them, see :class:`Controls`.

    Args:
        rate: its parameter, if given.
    """
    given = [Parameter("start_type_description_service", value=False)]
    given += [] if rate is None else [Parameter("rate", value=rate)]
    return GuardedNode("player", start_parameter_services=False, parameter_overrides=given)


def start_of(playlist: Playlist, options: argparse.Namespace) -> int:
    """Position at which to begin, in nanoseconds since the first message.

    Raises:
        PlayerError: if the bag ends before, or what is left is too short to be played in a loop.
    """
    start_ns: int = round(1e9 * options.start_offset)
    end_ns = int(playlist.due_ns[-1])
    played = f"what is played lasts {1e-9 * end_ns:.3g} s"
    if start_ns > end_ns:
        raise PlayerError(f"{options.bag}: --start-offset {options.start_offset:g}: {played}")
    if options.loop and end_ns - start_ns <= MAX_JUMP_BACK_NS:
        raise PlayerError(
            f"{options.bag}: --loop: {1e-9 * (end_ns - start_ns):.3g} s are too short: "
            f"nodes begin again where stamps jump back by more than {1e-9 * MAX_JUMP_BACK_NS:g} s"
        )
    return start_ns


def _play(options: argparse.Namespace) -> None:
    named = checked_names(options.bag, options.topics or ())
    playlist = Playlist.read(options.bag, named or playable(options.bag) or tuple(SENSOR_TYPES))
    start_ns = start_of(playlist, options)
    node = player_node(options.rate)
    publishers = [node.create_publisher(*_announcement(name), SENSOR_QOS) for name in playlist.names]
    playback = Playback(options.start_paused, start_ns)
    keys = not options.disable_keyboard_controls
    controls = Controls(node, playback, playlist.start_ns, options.clock, keys)
    if options.wait > 0.0:
        try:
            silent = await_listeners(node, publishers, options.nodes, options.wait)
        except DiscoveryError as error:
            advice = "choose topics with --topics, or start at once with --wait 0"
            raise PlayerError(f"{error} ({options.wait:g} s); {advice}") from error
        if silent:
            # Best effort: a publisher is not told who does not know it yet.
            print(f"quadpi: {_MAY_MISS}: {', '.join(silent)}", file=sys.stderr, flush=True)
    playback.seek(start_ns)
    with controls:
        sent = playlist.play([one.publish for one in publishers], playback, start_ns, options.loop)
        time.sleep(_FLUSH_S)
    if options.sent:
        playlist.save_sent(options.sent, sent.time_ns)
    counts = ", ".join(f"{name} {count}" for name, count in zip(playlist.names, sent.counts, strict=True))
    print(f"{options.bag}: played {counts} messages at {playback.rate:g} x real time")


if __name__ == "__main__":
    raise SystemExit(main())
