# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What is taken for a bag, and what a bag says before it is read whole."""

import sqlite3
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from rosbags import rosbag1
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import output_topic, write_bag
from quadpi_core.logs.formats.ros_bags import FORMAT
from quadpi_core.logs.log_format import HEAD_BYTES
from quadpi_core.messages import sensor_messages

from ..bag_examples import write_folder


def head(path):
    return path.read_bytes()[:HEAD_BYTES]


def test_files_of_every_container_begin_as_bags(tmp_path):
    write_mcap(tmp_path / "a.mcap", [], {})
    (tmp_path / "a.mcap").rename(tmp_path / "a")
    with rosbag1.Writer(tmp_path / "b"):
        pass
    with closing(sqlite3.connect(tmp_path / "c")) as database:
        database.execute("CREATE TABLE t (x)")
        database.commit()
    assert [FORMAT.begins(head(tmp_path / name)) for name in "abc"] == [True] * 3
    assert not FORMAT.begins(b"ULog\x01\x12\x35")
    assert not FORMAT.begins(b"")


@pytest.mark.parametrize("name", ["metadata.yaml", "flight_0.mcap", "flight_0.DB3", "flight.bag"])
def test_a_folder_with_a_bag_or_its_metadata_is_one(tmp_path, name):
    (tmp_path / "notes.txt").touch()
    (tmp_path / "bag.mcap").mkdir()
    assert not FORMAT.is_folder(tmp_path)
    (tmp_path / name).touch()
    assert FORMAT.is_folder(tmp_path)


def test_the_folder_that_rosbag2_writes_is_one(tmp_path, sensor_topics):
    write_folder(tmp_path / "flight", sensor_topics[:1], StoragePlugin.SQLITE3, CompressionMode.NONE)
    assert FORMAT.is_folder(tmp_path / "flight")


def test_a_bag_names_its_vehicle(tmp_path, recording):
    write_bag(tmp_path / "a.mcap", recording)
    write_bag(tmp_path / "b.mcap", replace(recording, vehicle=""))
    assert FORMAT.container.vehicle_name(tmp_path / "a.mcap") == "bebop2"
    assert FORMAT.container.vehicle_name(tmp_path / "b.mcap") == ""


def test_stamps_stand_for_a_bag_of_results_without_an_imu(tmp_path, recording):
    wind = recording.wind
    topic = output_topic("wind", wind.time_ns, sensor_messages.pack_wind(wind))
    write_mcap(tmp_path / "results.mcap", [topic], {})
    write_bag(tmp_path / "flight.mcap", recording)
    stamps = FORMAT.container.topic_stamps(tmp_path / "results.mcap")
    assert list(stamps) == ["/wind"]
    np.testing.assert_array_equal(stamps["/wind"], wind.time_ns)
    assert FORMAT.container.topic_stamps(tmp_path / "flight.mcap") is None
