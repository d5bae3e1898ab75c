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

from quadpi_core.messages.adapters import known_adapters
from quadpi_ros.callbacks import GuardedNode
from quadpi_ros.dds_profile import SENSOR_QOS, DiscoveryError, await_listeners
from quadpi_ros.input_sources import message_class
from quadpi_ros.playlist import SENSOR_TYPES, PlayerError, Playlist, checked_names, playable
from quadpi_ros.runtime import run

# Time for nodes to become active: the first start on a machine compiles the kernels.
START_TIMEOUT_S = 300.0
# Time for the last messages to be sent before the participant closes.
_FLUSH_S = 0.2

_TOPICS_HELP = (
    "standard topics, and messages of other packages by the name of their adapter; "
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
    """Options of the command line."""
    parser = argparse.ArgumentParser(prog="player", description="Play the sensor topics of a bag.")
    parser.add_argument("bag", type=Path, help="bag to play")
    parser.add_argument("--rate", type=float, default=1.0, help="speed; 1 is real time")
    parser.add_argument("--topics", nargs="+", choices=[*SENSOR_TYPES, *known_adapters()], help=_TOPICS_HELP)
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


def player_node() -> GuardedNode:
    """A node without services, as nothing would answer them while the player publishes."""
    silent = Parameter("start_type_description_service", value=False)
    return GuardedNode("player", start_parameter_services=False, parameter_overrides=[silent])


def _play(options: argparse.Namespace) -> None:
    named = checked_names(options.bag, options.topics or ())
    playlist = Playlist.read(options.bag, named or playable(options.bag) or tuple(SENSOR_TYPES))
    node = player_node()
    publishers = [node.create_publisher(*_announcement(name), SENSOR_QOS) for name in playlist.names]
    if options.wait > 0.0:
        try:
            await_listeners(node, publishers, options.nodes, options.wait)
        except DiscoveryError as error:
            advice = "choose topics with --topics, or start at once with --wait 0"
            raise PlayerError(f"{error} ({options.wait:g} s); {advice}") from error
    sent_ns = playlist.play([publisher.publish for publisher in publishers], options.rate)
    time.sleep(_FLUSH_S)
    if options.sent:
        playlist.save_sent(options.sent, sent_ns)
    played = playlist.topic[: len(sent_ns)]
    counts = ", ".join(f"{name} {np.sum(played == index)}" for index, name in enumerate(playlist.names))
    print(f"{options.bag}: played {counts} messages at {options.rate:g} x real time")


if __name__ == "__main__":
    raise SystemExit(main())
