# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bag to recording, and recording to bag, against a loop over messages with rosbags."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from benchmarks import Result, interleaved_seconds
from quadpi_core.flight import ImuStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.logs.bags import read_bag, write_bag
from quadpi_core.messages.definitions import typestore
from quadpi_core.vehicle import Vehicle

NAMES = ("bag_read_vs_rosbags", "bag_write_vs_rosbags")

DURATION_S = 60
SENSOR_HZ = 500
MOCAP_HZ = 120
MEGABYTE = 1e6


def run() -> list[Result]:
    vehicle = Vehicle.load("bebop2")
    recording = hovering(vehicle)
    with tempfile.TemporaryDirectory() as folder:
        bag, rewritten, folder_bag = (Path(folder, name) for name in ("bag.mcap", "again.mcap", "rosbags"))
        write_bag(bag, recording)
        read, rosbags_read = interleaved_seconds(
            [lambda: read_bag(bag, vehicle), lambda: sum(1 for _ in rosbags_messages(bag))]
        ).T
        # Only now: this many objects in memory would slow the measurements above.
        loaded = list(rosbags_messages(bag))
        write, rosbags_wrote = interleaved_seconds(
            [lambda: write_bag(rewritten, recording), lambda: rosbags_write(folder_bag, loaded)]
        ).T
        size = bag.stat().st_size / MEGABYTE
    reading = f"rosbags deserialising loop: {np.median(rosbags_read):.3f} s for {size:.1f} MB"
    writing = f"rosbags serialising loop: {np.median(rosbags_wrote):.3f} s"
    return [
        Result(NAMES[0], float(np.median(rosbags_read / read)), "times faster", reading, goal=4.0),
        Result(NAMES[1], float(np.median(rosbags_wrote / write)), "times faster", writing),
    ]


def hovering(vehicle: Vehicle) -> Recording:
    """A minute in hover, with sensor noise."""
    rng = np.random.default_rng(20)
    time_ns = np.arange(DURATION_S * SENSOR_HZ) * (10**9 // SENSOR_HZ)
    pose_time_ns = np.arange(DURATION_S * MOCAP_HZ) * (10**9 // MOCAP_HZ)
    noise = vehicle.noise
    rates = rng.normal(scale=noise.gyro_noise_rad_s, size=(len(time_ns), 3))
    force = rng.normal(scale=noise.accelerometer_noise_m_s2, size=(len(time_ns), 3))
    force[:, 2] -= vehicle.gravity_m_s2
    position = rng.normal(scale=noise.mocap_position_m, size=(len(pose_time_ns), 3))
    attitude = np.tile([1.0, 0.0, 0.0, 0.0], (len(pose_time_ns), 1))
    return Recording(
        name="hover",
        vehicle=vehicle.name,
        source="",
        imu=ImuStream(time_ns, rates, force),
        rotor_speeds=RotorSpeedStream(time_ns, rng.normal(600.0, 5.0, size=(len(time_ns), 4))),
        pose=PoseStream(pose_time_ns, position, attitude),
    )


def rosbags_messages(bag: Path) -> Iterator[tuple[str, str, int, object]]:
    """Topic, type, log time and deserialised message of each message of a bag."""
    with AnyReader([bag]) as reader:
        for connection, time_ns, data in reader.messages():
            yield connection.topic, connection.msgtype, time_ns, reader.deserialize(data, connection.msgtype)


def rosbags_write(folder: Path, messages: Iterable[tuple[str, str, int, object]]) -> None:
    """Serialise and write messages one by one."""
    shutil.rmtree(folder, ignore_errors=True)
    store = typestore()
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, type_name, time_ns, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type_name, typestore=store)
            writer.write(connections[topic], time_ns, store.serialize_cdr(message, type_name))
