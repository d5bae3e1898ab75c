# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Replay: the live monitor, and a bag played through it in real time; it ends with the bag, unless looped."""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import EmitEvent, OpaqueFunction
from launch.events import Shutdown

from quadpi_core.errors import QuadpiError
from quadpi_ros.launching import SENSORS, LaunchError, Programs, argument, live_nodes, monitor_arguments
from quadpi_ros.parameters import CLOCK_HZ, START_TIMEOUT_S


def start(context: LaunchContext) -> list:
    """The live nodes and a player; which topics they use follows from the bag."""
    # Imported here, as it reads bags, which no other launch file does.
    from quadpi_ros.playlist import live_inputs

    programs = Programs(context, __file__)
    values = programs.values
    try:
        inputs = live_inputs(Path(values["bag"]), values["topics"].split())
    except QuadpiError as error:
        raise LaunchError(str(error)) from error
    values["rotor_topic"] = values["rotor_topic"] or inputs.rotor_topic
    values["mocap_topic"] = values["mocap_topic"] or inputs.mocap_topic
    clock_hz = values["clock"] or (str(CLOCK_HZ) if programs.is_on("use_sim_time") else "")
    player = programs.program(
        "player",
        then=lambda: [EmitEvent(event=Shutdown(reason="bag played"))],
        arguments=[
            *(values["bag"], "--rate", values["rate"], "--topics", *inputs.topics),
            *("--start-offset", values["start_offset"]),
            *(("--loop",) if programs.is_on("loop") else ()),
            *(("--clock", clock_hz) if clock_hz else ()),
            *("--nodes", "estimator", "monitor", "--wait", str(START_TIMEOUT_S)),
        ],
        remappings=programs.remappings(SENSORS),
    )
    return [*live_nodes(programs), *player]


def generate_launch_description() -> LaunchDescription:
    """Arguments bag, vehicle and model are required; all of monitor.launch.py can be given as well."""
    arguments = (
        argument("bag", "bag with imu, motion capture and rotor speeds, under whatever names"),
        argument("rate", "speed; 1 is real time", "1.0"),
        argument("loop", "begin again at the end", "false"),
        argument("start_offset", "seconds to skip at the beginning", "0.0"),
        argument("clock", f"rate of /clock [Hz]; default: {CLOCK_HZ:g} with use_sim_time, else none", ""),
        argument("topics", 'topics to play, as in "imu erpm"; default: those that the nodes listen to', ""),
        *monitor_arguments(respawn="false"),
    )
    return LaunchDescription([*arguments, OpaqueFunction(function=start)])
