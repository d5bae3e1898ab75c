# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fly a node for each kind of input; print as JSON what it published, and what was imported in flight.

In a process of its own no test before has imported anything.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rclpy

from quadpi_core.flight import (
    ImuStream,
    OdometryStream,
    PoseStream,
    RotorSpeedStream,
    TwistStream,
    WindStream,
)
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.topics import MOCAP_TOPICS
from quadpi_ros.estimator_node import EstimatorNode
from quadpi_ros.live_process import create_nodes
from quadpi_ros.monitor_node import MonitorNode
from quadpi_ros.runtime import ManagedNode, start
from quadpi_ros.sensor_node import SensorNode

MODEL = Path(__file__).parents[1] / "golden" / "model"
# Beyond the second after which the estimator starts, and the monitor knows the rate.
FLOWN_S, STEP_NS = 1.3, 2_000_000


def messages(time_ns: int) -> dict[str, bytes]:
    """One of each topic, of a vehicle that hovers; velocities in the axes of world and body in turn."""
    stamp, still = np.array([time_ns]), np.zeros((1, 3))
    level = np.array([[1.0, 0.0, 0.0, 0.0]])
    noise = 1e-3 * np.random.default_rng(time_ns).standard_normal((1, 3))
    in_body = np.array([time_ns // STEP_NS % 2 == 0])
    state = sensor_messages.pack_odometry(OdometryStream(stamp, noise, level, noise, still))
    return {
        "imu": sensor_messages.pack_imu(ImuStream(stamp, noise, np.array([[0.0, 0.0, -9.81]]) + noise))[0],
        "rotor_speeds": sensor_messages.pack_rotor_speeds(RotorSpeedStream(stamp, np.full((1, 4), 1100.0)))[
            0
        ],
        "mocap/pose": sensor_messages.pack_pose(PoseStream(stamp, noise, level))[0],
        "mocap/transform": codec(sensor_messages.TRANSFORM).encode(
            1,
            {
                **sensor_messages.header_columns(stamp, "map"),
                "child_frame_id": "base_link",
                "transform.translation": noise,
                "transform.rotation": np.array([[0.0, 0.0, 0.0, 1.0]]),
            },
        )[0],
        "mocap/odometry": state[0],
        "mocap/twist": sensor_messages.pack_twist(TwistStream(stamp, noise, in_body))[0],
        "odometry": state[0],
        "wind": sensor_messages.pack_wind(WindStream(stamp, noise))[0],
    }


def fly(nodes: Sequence[ManagedNode[Any]], sent: list[dict[str, bytes]]) -> None:
    """Give nodes what their subscriptions would."""
    take = {one.topic_name.lstrip("/"): one.callback for node in nodes for one in node.subscriptions}
    for payloads in sent:
        for topic in payloads.keys() & take.keys():
            take[topic](payloads[topic])


def flown(create: Callable[[], Sequence[ManagedNode[Any]]], parameter: str) -> dict[str, Any]:
    """What nodes with a parameter publish by topic, and which modules they import in flight."""
    rclpy.init(args=["--ros-args", "-p", "vehicle:=bebop2", "-p", parameter])
    published: Counter[str] = Counter()

    def announce(_: SensorNode[Any], __: type, topic: str, *___: Any, **____: Any) -> Callable[[bytes], None]:
        return lambda _: published.update([topic])

    SensorNode.announce = announce  # type: ignore[method-assign]
    nodes = create()
    start(nodes)
    sent = [messages(time_ns) for time_ns in range(0, round(1e9 * FLOWN_S), STEP_NS)]
    before = set(sys.modules)
    fly(nodes, sent)
    found = {
        "imported": sorted(set(sys.modules) - before),
        "published": published,
        "exceptions": sum(node.exceptions.counts.total() for node in nodes),
    }
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown()
    return found


def main() -> None:
    model = f"model:={MODEL}"
    found = {topic: flown(lambda: [EstimatorNode()], f"mocap_topic:={topic}") for topic in MOCAP_TOPICS}
    found |= {"monitor": flown(lambda: [MonitorNode()], model), "both": flown(create_nodes, model)}
    print(json.dumps(found))


if __name__ == "__main__":
    main()
