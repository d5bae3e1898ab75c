# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Publish px4_msgs/EscStatus, subscribe through the adapter, print what comes out as JSON; 20 s at most."""

from __future__ import annotations

import json
import time

import rclpy
from px4_msgs.msg import EscReport, EscStatus

from quadpi_core.logs.adapters import AdapterSettings
from quadpi_core.logs.adapters.settings import RotorSettings
from quadpi_ros.adapters import adapted
from quadpi_ros.runtime import SENSOR_QOS

WANTED = 5


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("adapted")
    subscription = adapted(
        "px4_status", AdapterSettings(rotor_speeds=RotorSettings((1, 2, 3, 4), "rpm")), None
    )
    found = []
    node.create_subscription(
        subscription.message_type,
        subscription.topic,
        lambda payload: found.append(subscription.unpack(payload)),
        SENSOR_QOS,
        raw=True,
    )
    publisher = node.create_publisher(EscStatus, subscription.topic, SENSOR_QOS)
    deadline = time.monotonic() + 20.0
    stamp = 1_000_000
    while len(found) < WANTED and time.monotonic() < deadline:
        stamp += 10_000
        message = EscStatus(timestamp=stamp, esc_online_flags=15)
        for place, motor in enumerate((4, 2, 1, 3)):
            message.esc[place] = EscReport(
                timestamp=stamp, esc_rpm=60 * motor, actuator_function=100 + motor, esc_voltage=12.5
            )
        publisher.publish(message)
        rclpy.spin_once(node, timeout_sec=0.05)
    print(json.dumps([list(one.speeds[0]) for one in found]))
    rclpy.shutdown()


if __name__ == "__main__":
    main()
