# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Live monitor: estimator and monitor in one process, or each in its own with separate:=true."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Arguments vehicle and model are required."""
    defaults = Path(get_package_share_directory("quadpi")) / "config" / "nodes" / "monitor.yaml"
    arguments = [
        DeclareLaunchArgument("vehicle", description="vehicle file: a name in config/vehicles or a path"),
        DeclareLaunchArgument("model", description="model folder, as `quadpi identify` writes it"),
        DeclareLaunchArgument("parameters", default_value=str(defaults), description="parameter file"),
        DeclareLaunchArgument("namespace", default_value="", description="namespace of nodes and topics"),
        DeclareLaunchArgument("separate", default_value="false", description="one process per node"),
    ]
    vehicle = {"vehicle": LaunchConfiguration("vehicle")}
    vehicle_and_model = {**vehicle, "model": LaunchConfiguration("model")}

    def node(executable: str, given: dict, condition: IfCondition) -> Node:
        return Node(
            package="quadpi",
            executable=executable,
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("parameters"), given],
            condition=condition,
            output="screen",
        )

    separate = LaunchConfiguration("separate")
    return LaunchDescription(
        [
            *arguments,
            node("live", vehicle_and_model, UnlessCondition(separate)),
            node("estimator_node", vehicle, IfCondition(separate)),
            node("monitor_node", vehicle_and_model, IfCondition(separate)),
        ]
    )
