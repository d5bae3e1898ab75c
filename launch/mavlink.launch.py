# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink bridge: an autopilot's sensors as the topics of the monitor."""

from launch import LaunchDescription

from quadpi_ros.launching import Argument, bridge, common_arguments, description


def generate_launch_description() -> LaunchDescription:
    """Arguments connection and vehicle are required."""
    connection = Argument("connection", "such as udp:127.0.0.1:14550; see docs/mavlink.md")
    return description(__file__, (connection, *common_arguments("mavlink.yaml", respawn=True)), bridge)
