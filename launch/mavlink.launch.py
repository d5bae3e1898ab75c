# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink bridge: an autopilot's sensors as the topics of the monitor."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Arguments connection and vehicle are required."""
    defaults = Path(get_package_share_directory("quadpi")) / "config" / "nodes" / "mavlink.yaml"
    return LaunchDescription(
        [
            DeclareLaunchArgument("connection", description="such as udp:0.0.0.0:14550; see docs/mavlink.md"),
            DeclareLaunchArgument("vehicle", description="vehicle file: a name in config/vehicles or a path"),
            DeclareLaunchArgument("parameters", default_value=str(defaults), description="parameter file"),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of node and topics"),
            Node(
                package="quadpi",
                executable="mavlink_bridge",
                namespace=LaunchConfiguration("namespace"),
                parameters=[
                    LaunchConfiguration("parameters"),
                    {name: LaunchConfiguration(name) for name in ("connection", "vehicle")},
                ],
                output="screen",
            ),
        ]
    )
