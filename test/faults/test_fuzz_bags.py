# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bags whose lengths and sizes lie: one line that names the file, or a recording. Others: test_fuzzing.py."""

import struct
from io import BytesIO

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from quadpi_core.flight import ImuStream, OdometryStream, PoseStream, Recording, RotorSpeedStream, WindStream
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bags import read_bag, write_bag
from quadpi_core.logs.mcap_files import CHUNK, records_of
from quadpi_core.messages.definitions import typestore

from .damage import refusing

N = 12


def small_bag(path):
    rng = np.random.default_rng(4)
    time_ns = 1_700_000_000_000_000_000 + np.arange(N) * 2_000_000
    level = np.tile([1.0, 0.0, 0.0, 0.0], (N, 1))
    three = rng.normal(size=(N, 3))
    recording = Recording(
        name="flight",
        vehicle="bebop2",
        source="",
        imu=ImuStream(time_ns, three, three),
        rotor_speeds=RotorSpeedStream(time_ns, rng.uniform(0, 900, size=(N, 4))),
        pose=PoseStream(time_ns, three, level),
        odometry=OdometryStream(time_ns, three, level, three, three),
        wind=WindStream(time_ns, three),
    )
    write_bag(path, recording)


def without_checksums(path):
    """The bag as rosbags alone writes it: damage reaches the parsers behind the checksums."""
    with Bag(path) as bag:
        topics = bag.read([connection.topic for connection in bag.connections])
    folder = path.with_suffix("")
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic in topics.values():
            connection = writer.add_connection(topic.name, topic.type_name, typestore=typestore())
            for time_ns, payload in zip(topic.log_time_ns.tolist(), topic.payloads, strict=True):
                writer.write(connection, time_ns, payload)
    return (folder / f"{folder.name}.mcap").read_bytes()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("bags")


@pytest.fixture(scope="module")
def unchecked(folder):
    small_bag(folder / "sound.mcap")
    return without_checksums(folder / "sound.mcap")


def test_lengths_of_records_that_lie(folder, unchecked):
    """Every length of every record in turn: nothing, one more, and far too much."""
    path = folder / "lying.mcap"
    for _, start, length in records_of(BytesIO(unchecked), len(unchecked)):
        for lie in (0, length + 1, 2**64 - 1):
            data = bytearray(unchecked)
            data[start - 8 : start] = struct.pack("<Q", max(lie, 0))
            path.write_bytes(data)
            with refusing(path):
                read_bag(path)


def test_sizes_of_chunks_that_lie(folder, unchecked):
    """The uncompressed size is what a reader would allocate."""
    path = folder / "sizes.mcap"
    for start in (at for opcode, at, _ in records_of(BytesIO(unchecked), len(unchecked)) if opcode == CHUNK):
        for offset in (16, 28, 32, 35, 40):
            for lie in (0, 1, 2**20, 2**31 - 1, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1):
                data = bytearray(unchecked)
                data[start + offset : start + offset + 8] = struct.pack("<Q", lie)
                path.write_bytes(data)
                with refusing(path):
                    read_bag(path)
