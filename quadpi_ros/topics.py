# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Names of the topics, and of the launch arguments that give them others, for the launch files."""

SENSORS = ("imu", "rotor_speeds", "erpm", "mocap/pose", "mocap/odometry", "mocap/twist", "wind")
OUTPUTS = ("odometry", "prediction", "extrapolation_alarm", "alarm_log")


def argument_of(topic: str) -> str:
    """Name of the launch argument of a topic."""
    return f"{topic.replace('/', '_')}_topic"
