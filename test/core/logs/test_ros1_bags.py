# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One flight as a ROS 1 bag: compressed, out of order, damaged, long."""

import struct

import pytest
from rosbags import rosbag1
from rosbags.rosbag1 import reader
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from quadpi_core.errors import LogError
from quadpi_core.logs import identify_format
from quadpi_core.logs.bag_storages import Ros1File
from quadpi_core.logs.bags import open_recording, read_bag
from quadpi_core.messages.definitions import typestore
from quadpi_core.vehicle import Vehicle

from .bag_examples import assert_blocks_are_the_whole, topic_rows, write_folder, write_ros1


@pytest.mark.parametrize("compression", [None, *rosbag1.Writer.CompressionFormat])
def test_a_ros1_bag(tmp_path, sensor_topics, same_flight, compression):
    path = tmp_path / "flight.bag"
    write_ros1(path, sensor_topics, compression)
    assert identify_format(path).description.startswith("bag")
    same_flight(path)
    with open_recording(path, Vehicle.load("bebop2")) as recording:
        assert recording.sources["imu"] == "/imu"


def test_a_ros1_bag_whose_topics_were_written_one_after_the_other(tmp_path, sensor_topics, same_flight):
    """Messages in log-time order alternate between its chunks."""
    path = tmp_path / "flight.bag"
    write_ros1(path, sensor_topics, rosbag1.Writer.CompressionFormat.LZ4, one_after_the_other=True)
    same_flight(path)
    assert_blocks_are_the_whole(path, sensor_topics, 300)


def test_a_chunk_is_unpacked_once(tmp_path, sensor_topics, monkeypatch):
    path = tmp_path / "flight.bag"
    write_ros1(path, sensor_topics, rosbag1.Writer.CompressionFormat.LZ4, one_after_the_other=True)
    unpacked = []
    unpacker = reader.decompressors["lz4"]
    monkeypatch.setitem(reader.decompressors, "lz4", lambda data: unpacked.append(1) or unpacker(data))
    for _ in (bag := Ros1File(path)).batches(list(bag.connections), None):
        pass
    assert len(unpacked) == path.read_bytes().count(b"compression=lz4") > 1


def test_a_ros1_message_of_another_type_names_the_sample(tmp_path, sensor_topics):
    path = tmp_path / "flight.bag"
    imu = sensor_topics[0]
    message = bytes(typestore().cdr_to_ros1(imu.payloads[0], imu.type_name))
    with rosbag1.Writer(path) as writer:
        connection = writer.add_connection("/imu", imu.type_name, typestore=typestore())
        writer.write(connection, 1, message)
        writer.write(connection, 2, message[:-9])
    with pytest.raises(LogError, match=r"flight.bag: topic /imu: sample 1: its \d+ bytes are no sensor_msgs"):
        read_bag(path)


@pytest.mark.parametrize("fraction", [0.001, 0.3, 0.9])
@pytest.mark.parametrize("kind", ["flight.bag", "flight.db3"])
def test_cut_off_anywhere(tmp_path, sensor_topics, kind, fraction):
    if kind.endswith(".bag"):
        write_ros1(tmp_path / kind, sensor_topics)
        path = tmp_path / kind
    else:
        write_folder(tmp_path / "flight", sensor_topics, StoragePlugin.SQLITE3, CompressionMode.NONE)
        path = tmp_path / "flight" / kind
    whole = path.read_bytes()
    path.write_bytes(whole[: int(fraction * len(whole))])
    with pytest.raises(LogError, match=rf"{kind}: ") as caught:
        read_bag(path)
    assert "\n" not in str(caught.value)


def test_a_chunk_that_an_index_names_twice(tmp_path, sensor_topics):
    """Its messages would be read once for every time that it is named."""
    path = tmp_path / "flight.bag"
    write_ros1(path, [topic_rows(sensor_topics[0], slice(20))])
    data = path.read_bytes()
    # The entry of the only chunk is the last record; the count of chunks stands in the header.
    (index_start,) = struct.unpack_from("<Q", data, data.index(b"index_pos=") + 10)
    place = index_start
    for _ in range(2):  # header and data of the connection
        place += 4 + struct.unpack_from("<I", data, place)[0]
    count = data.index(b"chunk_count=") + 12
    path.write_bytes(data[:count] + struct.pack("<I", 2) + data[count + 4 :] + data[place:])
    with pytest.raises(LogError, match="damaged: its index names a chunk twice"):
        read_bag(path)
