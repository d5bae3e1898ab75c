# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Live monitor: estimator and monitor in one process, or each in its own with separate:=true.

Both are lifecycle nodes. They come up by themselves unless autostart:=false, and then wait for
`ros2 lifecycle set NODE configure` and `activate`.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from quadpi_ros.topics import OUTPUTS, SENSORS, argument_of

# Every topic can be given another name, relative to the namespace or absolute.
TOPICS = SENSORS + OUTPUTS


def generate_launch_description() -> LaunchDescription:
    """Arguments vehicle and model are required; model takes a folder, or a list as in "[first, second]"."""
    defaults = Path(get_package_share_directory("quadpi")) / "config" / "nodes" / "monitor.yaml"
    arguments = [
        DeclareLaunchArgument("vehicle", description="vehicle file: a name in config/vehicles or a path"),
        DeclareLaunchArgument("model", description="model folder, or several as [first, second]"),
        DeclareLaunchArgument("parameters", default_value=str(defaults), description="parameter file"),
        DeclareLaunchArgument("namespace", default_value="", description="namespace of nodes and topics"),
        DeclareLaunchArgument("separate", default_value="false", description="one process per node"),
        DeclareLaunchArgument("autostart", default_value="true", description="configure and activate"),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="clock from /clock"),
    ]
    arguments += [
        DeclareLaunchArgument(
            argument_of(topic), default_value=topic, description=f"name of the topic {topic}"
        )
        for topic in TOPICS
    ]
    common = {
        "vehicle": ParameterValue(LaunchConfiguration("vehicle"), value_type=str),
        "autostart": ParameterValue(LaunchConfiguration("autostart"), value_type=bool),
        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool),
    }
    with_model = {**common, "model": LaunchConfiguration("model")}

    def node(executable: str, given: dict, condition: IfCondition) -> Node:
        return Node(
            package="quadpi",
            executable=executable,
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("parameters"), given],
            remappings=[(topic, LaunchConfiguration(argument_of(topic))) for topic in TOPICS],
            condition=condition,
            output="screen",
        )

    separate = LaunchConfiguration("separate")
    return LaunchDescription(
        [
            *arguments,
            node("live", with_model, UnlessCondition(separate)),
            node("estimator_node", common, IfCondition(separate)),
            node("monitor_node", with_model, IfCondition(separate)),
        ]
    )
