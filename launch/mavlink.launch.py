# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink bridge: an autopilot's sensors as the topics of the monitor."""

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction

from quadpi_ros.launching import Programs, argument, common_arguments


def start(context: LaunchContext) -> list:
    """The bridge; one that plays a log is not started again at its end."""
    # Imported here, as other launch files read no logs.
    from quadpi_ros.mavlink_link import is_replay

    programs = Programs(context, __file__)
    if is_replay(programs.values["connection"]):
        programs.values["respawn"] = "false"
    return programs.node("mavlink_bridge", ("connection", "vehicle"))


def generate_launch_description() -> LaunchDescription:
    """Arguments connection and vehicle are required."""
    connection = argument("connection", "such as udp:127.0.0.1:14550; see docs/mavlink.md")
    arguments = [connection, *common_arguments("mavlink.yaml", respawn="true")]
    return LaunchDescription([*arguments, OpaqueFunction(function=start)])
