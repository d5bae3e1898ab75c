# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bags as autopilots' users record them: motor commands and battery, but no rotor speeds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from quadpi_core.flight import Recording
from quadpi_core.frames import Array
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import typestore
from quadpi_core.vehicle import Vehicle

from .messages.adapters.vendor_messages import Messages, motor_commands, voltage

LAG_S = 0.03
# Corners of motors 1 to 4 of a quad X.
_CORNERS = [(1, 1), (-1, -1), (1, -1), (-1, 1)]


def commands_for(recording: Recording, seed: int = 1) -> tuple[Array, Array]:
    """Commands (N, 4) and voltages (N,) that make the rotor speeds of a recording, with a gain of its own.

    n settles at 100 + 110 u V rad/s, behind a lag; the motors differ by 1 %.
    """
    rng = np.random.default_rng(seed)
    speeds, time = recording.rotor_speeds.speeds, 1e-9 * recording.rotor_speeds.time_ns
    volts = 11.5 - 0.01 * (time - time[0]) - 0.3 * rng.random()
    settled = speeds + LAG_S * np.gradient(speeds, time, axis=0)
    each = np.array([1.0, 1.01, 0.99, 1.005]) * (1.0 + 0.005 * rng.standard_normal())
    return (settled / each - 100.0) / (110.0 * volts[:, np.newaxis]), volts


def write_bag(
    path: Path,
    messages: Messages,
    recording: Recording,
    adapter: str,
    *,
    measured: bool = False,
    commanded_s: float = np.inf,
) -> Path:
    """A bag of IMU, motion capture, motor commands by an adapter and battery; of rotor speeds if measured.

    Commands end after some seconds.
    """
    seed = sum(map(ord, recording.name))
    shares, volts = commands_for(recording, seed)
    rotors = [tuple(np.sign(position[:2])) for position in Vehicle.load(recording.vehicle).rotor_positions]
    by_motor = shares[:, [rotors.index(corner) for corner in _CORNERS]]
    values = 1000.0 + 1000.0 * by_motor if adapter == "mavros_rc_out" else by_motor
    rows = slice(None, None, 2)  # 250 Hz
    stamps = recording.rotor_speeds.time_ns[rows]
    made = [
        motor_commands(messages, adapter, int(time_ns), np.rint(row) if adapter == "mavros_rc_out" else row)
        for time_ns, row in zip(stamps, values[rows], strict=True)
        if time_ns < stamps[0] + 1e9 * commanded_s
    ]
    slow = slice(None, None, 500)
    battery_of = {"px4_motors": "px4_battery", "mavros_rc_out": "battery_state"}[adapter]
    at = recording.rotor_speeds.time_ns[slow]
    told = [
        voltage(messages, battery_of, int(time_ns), one) for time_ns, one in zip(at, volts[slow], strict=True)
    ]
    names = {
        "px4_motors": ("/fmu/out/actuator_motors", "px4_msgs/msg/ActuatorMotors"),
        "mavros_rc_out": ("/mavros/rc/out", "mavros_msgs/msg/RCOut"),
        "px4_battery": ("/fmu/out/battery_status", "px4_msgs/msg/BatteryStatus"),
        "battery_state": ("/mavros/battery", "sensor_msgs/msg/BatteryState"),
    }
    topics: list[tuple[str, str, Any, Any]] = [
        ("/imu", sensor_messages.IMU, recording.imu.time_ns, sensor_messages.pack_imu(recording.imu)),
        (
            "/mocap/pose",
            sensor_messages.POSE,
            recording.pose.time_ns,
            sensor_messages.pack_pose(recording.pose),
        ),
        (*names[adapter], stamps[: len(made)], made),
        (*names[battery_of], at, told),
    ]
    if measured:
        speeds = recording.rotor_speeds
        topics.append(
            (
                "/rotor_speeds",
                sensor_messages.ROTOR_SPEEDS,
                speeds.time_ns,
                sensor_messages.pack_rotor_speeds(speeds),
            )
        )
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        stores = [
            messages.store if kind in messages.store.fielddefs else typestore() for _, kind, *_ in topics
        ]
        connections = [
            writer.add_connection(name, kind, typestore=store)
            for (name, kind, *_), store in zip(topics, stores, strict=True)
        ]
        logged = [
            (int(time_ns), place, payload)
            for place, (_, _, times, payloads) in enumerate(topics)
            for time_ns, payload in zip(times, payloads, strict=True)
        ]
        for time_ns, place, payload in sorted(logged, key=lambda one: one[:2]):
            writer.write(connections[place], time_ns, payload)
    return path
