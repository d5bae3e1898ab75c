# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Replay: the live monitor, and a bag played through it in real time; it ends with the bag, unless looped."""

from launch import LaunchDescription

from quadpi_ros.launching import Argument, description, monitor_arguments, replay
from quadpi_ros.player import CLOCK_HZ


def generate_launch_description() -> LaunchDescription:
    """Arguments bag, vehicle and model are required; all of monitor.launch.py can be given as well."""
    arguments = (
        Argument("bag", "bag with imu, motion capture and rotor speeds, under whatever names"),
        Argument("rate", "speed; 1 is real time", "1.0"),
        Argument("loop", "begin again at the end", "false"),
        Argument("start_offset", "seconds to skip at the beginning", "0.0"),
        Argument("start_paused", "begin paused; `ros2 service call /player/resume …` goes on", "false"),
        Argument("clock", f"rate of /clock [Hz]; default: {CLOCK_HZ:g} with use_sim_time, else none", ""),
        Argument("topics", 'topics to play, as in "imu erpm"; default: those that the nodes listen to', ""),
        *monitor_arguments(respawn=False),
    )
    return description(__file__, arguments, replay)
