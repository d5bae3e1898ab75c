# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Live monitor: estimator and monitor in one process, or each in its own with separate:=true.

Both are lifecycle nodes. They come up by themselves unless autostart:=false, and then wait for
`ros2 lifecycle set NODE configure` and `activate`.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction

from quadpi_ros.launching import Programs, live_nodes, monitor_arguments


def start(context: LaunchContext) -> list:
    """The live nodes."""
    return live_nodes(Programs(context, __file__))


def generate_launch_description() -> LaunchDescription:
    """Arguments vehicle and model are required; model takes a folder, or a list as in "[first, second]"."""
    return LaunchDescription([*monitor_arguments(respawn="true"), OpaqueFunction(function=start)])
