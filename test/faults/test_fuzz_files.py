# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Altered model folders of every kind: refused in one line that names the folder, or usable."""

import hashlib
import json
import re
import shutil
import struct
from io import BytesIO

import numpy as np
import pytest
from hypothesis import given
from rosbags.rosbag2 import StoragePlugin, Writer

from quadpi_core.errors import ModelError
from quadpi_core.flight import ImuStream, OdometryStream, PoseStream, Recording, RotorSpeedStream, WindStream
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bags import read_bag, write_bag
from quadpi_core.logs.mcap_files import CHUNK, records_of
from quadpi_core.messages.definitions import typestore
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_folder import ARRAYS_FILE, MODEL_FILE

from .damage import altered, bounded, damaged, refusing

EXAMPLES = 60


@pytest.fixture
def load_model(each_model, tmp_path):
    """load_model(JSON text, arrays): writes both into a folder, and uses the model if it loads."""
    folder = tmp_path / "model"
    folder.mkdir()
    inputs = np.zeros((2, len(INPUT_NAMES)))
    AerodynamicModel.load(each_model).evaluate(inputs)

    def load(text, arrays):
        (folder / MODEL_FILE).write_bytes(text)
        (folder / ARRAYS_FILE).write_bytes(arrays)
        with refusing(folder):
            model = AerodynamicModel.load(folder)
            model.evaluate(inputs)
            assert model.calibration()

    return load


def test_altered_model(each_model, load_model):
    arrays = (each_model / ARRAYS_FILE).read_bytes()
    content = json.loads((each_model / MODEL_FILE).read_text())

    @bounded(EXAMPLES)
    @given(altered(content))
    def check(data):
        load_model(json.dumps(data).encode(), arrays)

    check()


@pytest.mark.parametrize("confidence", [0.0, 1.0, -0.5])
def test_a_confidence_that_has_no_intervals_is_the_fault_of_the_file(each_model, tmp_path, confidence):
    folder = tmp_path / "model"
    shutil.copytree(each_model, folder)
    content = json.loads((folder / MODEL_FILE).read_text())
    (folder / MODEL_FILE).write_text(json.dumps({**content, "confidence": confidence}))
    with pytest.raises(ModelError, match=rf"{re.escape(str(folder))}: .*confidence"):
        AerodynamicModel.load(folder)


def test_damaged_model_file(each_model, load_model):
    arrays = (each_model / ARRAYS_FILE).read_bytes()
    text = (each_model / MODEL_FILE).read_bytes()

    @bounded(EXAMPLES)
    @given(damaged(text))
    def check(data):
        load_model(data, arrays)

    check()


def test_damaged_arrays_with_the_hash_put_right(each_model, load_model):
    arrays = (each_model / ARRAYS_FILE).read_bytes()
    content = json.loads((each_model / MODEL_FILE).read_text())
    header = int.from_bytes(arrays[:8], "little") + 8

    @bounded(EXAMPLES)
    @given(damaged(arrays[:header]).map(lambda head: head + arrays[header:]) | damaged(arrays))
    def check(data):
        right = {**content, "arrays_sha256": hashlib.sha256(data).hexdigest()}
        load_model(json.dumps(right).encode(), data)

    check()


# Bags whose lengths and sizes lie: one line that names the file, or a recording. Others: test_fuzzing.py.


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


@pytest.mark.slow
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


@pytest.mark.slow
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
