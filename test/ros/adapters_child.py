# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Publish px4_msgs/EscStatus, hear it by a node that reads it as a file says, print the speeds as JSON.

Takes the name of the file; 60 s at most.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass

import rclpy
from px4_msgs.msg import EscReport, EscStatus

from quadpi_core.vehicle import Vehicle
from quadpi_ros.dds_profile import SENSOR_QOS
from quadpi_ros.input_sources import AdaptedSources
from quadpi_ros.node_parameters import parameter
from quadpi_ros.runtime import start
from quadpi_ros.sensor_node import SensorNode

WANTED = 5


@dataclass(frozen=True)
class Parameters:
    """As the nodes have them."""

    autostart: bool = parameter(True, "at the start")


class Hearing(SensorNode[Parameters]):
    """Keeps the rotor speeds that it hears."""

    def configure(self) -> None:
        """Find the messages."""
        self.found = []
        self.source = AdaptedSources("hearing", sys.argv[1], Vehicle.load("neurobem")).named("px4_status")

    def activate(self) -> None:
        """Listen to them."""
        self.listen(*self.source, self.found.append)


def main() -> None:
    rclpy.init()
    node = Hearing("hearing", Parameters)
    start([node])
    publisher = node.create_publisher(EscStatus, node.source.topic, SENSOR_QOS)
    deadline = time.monotonic() + 60.0
    stamp = 1_000_000
    while len(node.found) < WANTED and time.monotonic() < deadline:
        stamp += 10_000
        message = EscStatus(timestamp=stamp, esc_online_flags=15)
        for place, motor in enumerate((4, 2, 1, 3)):
            message.esc[place] = EscReport(
                timestamp=stamp, esc_rpm=60 * motor, actuator_function=100 + motor, esc_voltage=12.5
            )
        publisher.publish(message)
        rclpy.spin_once(node, timeout_sec=0.05)
    print(json.dumps([list(one.speeds[0]) for one in node.found]))
    rclpy.shutdown()


if __name__ == "__main__":
    main()
