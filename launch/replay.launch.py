# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Replay: the live monitor, and a bag played through it in real time."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, IncludeLaunchDescription, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from quadpi_ros.topics import SENSORS, argument_of


def generate_launch_description() -> LaunchDescription:
    """Arguments bag, vehicle and model are required; all of monitor.launch.py can be given as well."""
    monitor = Path(get_package_share_directory("quadpi")) / "launch" / "monitor.launch.py"
    player = Node(
        package="quadpi",
        executable="player",
        namespace=LaunchConfiguration("namespace"),
        arguments=[
            LaunchConfiguration("bag"),
            "--rate",
            LaunchConfiguration("rate"),
            "--nodes",
            "estimator",
            "monitor",
            # The first start on a machine compiles the kernels.
            "--wait",
            "300",
        ],
        # Declared by monitor.launch.py, which is included before this runs.
        remappings=[(topic, LaunchConfiguration(argument_of(topic))) for topic in SENSORS],
        output="screen",
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="bag with imu, mocap/pose and rotor_speeds or erpm"),
            DeclareLaunchArgument("rate", default_value="1.0", description="speed; 1 is real time"),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of nodes and topics"),
            # An include sees required arguments only where they are handed on.
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(str(monitor)),
                launch_arguments=[(name, LaunchConfiguration(name)) for name in ("vehicle", "model")],
            ),
            player,
            RegisterEventHandler(
                OnProcessExit(target_action=player, on_exit=[EmitEvent(event=Shutdown(reason="bag played"))])
            ),
        ]
    )
