# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One flight in every container that rosbags opens: sqlite3, split and compressed folders, ROS 1."""

import shutil
import struct
import tracemalloc
from dataclasses import fields
from itertools import chain

import lz4.frame
import numpy as np
import pytest
from rosbags import rosbag1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from ruamel.yaml import YAML

from quadpi_core.errors import LogError
from quadpi_core.logs import identify_format, read_recording
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_topics import bag_topics
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import open_recording, read_bag
from quadpi_core.logs.mcap_files import McapFile
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle

SENSORS = ("/imu", "/erpm", "/mocap/pose")
SECONDS = 2
# A topic of these seconds takes several chunks.
CHUNK_BYTES = 2**14


@pytest.fixture(scope="module")
def topics():
    """Sensors of the first seconds of a bundled bag."""
    with Bag(bags_directory() / "interpolation.mcap") as bag:
        found = bag.read(SENSORS)
    end_ns = min(topic.log_time_ns[0] for topic in found.values()) + SECONDS * 10**9
    return [topic.split(end_ns)[0] for topic in found.values()]


@pytest.fixture(scope="module")
def vehicle():
    return Vehicle.load("bebop2")


@pytest.fixture(scope="module")
def expected(topics, vehicle, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "flight.mcap"
    write_mcap(path, topics, {})
    return read_recording(path, vehicle)


def assert_same_flight(path, expected, vehicle):
    found = read_recording(path, vehicle)
    assert len(found.streams()) == len(expected.streams())
    for stream, of in zip(found.streams(), expected.streams(), strict=True):
        for column in fields(of):
            np.testing.assert_array_equal(getattr(stream, column.name), getattr(of, column.name))
    for topic, count in expected.arrivals.items():
        np.testing.assert_array_equal(found.arrivals[topic], count)


def messages_of(topics):
    found = [
        (time_ns, topic, payload)
        for topic in topics
        for time_ns, payload in zip(topic.log_time_ns.tolist(), topic.payloads, strict=True)
    ]
    return sorted(found, key=lambda one: one[0])


def write_folder(folder, topics, plugin, mode):
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic.name: writer.add_connection(topic.name, topic.type_name, typestore=typestore())
            for topic in topics
        }
        for time_ns, topic, payload in messages_of(topics):
            writer.write(connections[topic.name], time_ns, payload)


def write_ros1(path, topics, compression=None, *, one_after_the_other=False):
    store = typestore()
    writer = rosbag1.Writer(path)
    writer.chunk_threshold = CHUNK_BYTES
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connections = {
            topic.name: writer.add_connection(topic.name, topic.type_name, typestore=store)
            for topic in topics
        }
        parts = [[topic] for topic in topics] if one_after_the_other else [topics]
        for time_ns, topic, payload in chain.from_iterable(map(messages_of, parts)):
            message = store.cdr_to_ros1(payload, topic.type_name)
            writer.write(connections[topic.name], time_ns, bytes(message))


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.MESSAGE, CompressionMode.FILE])
@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_folder_of_either_storage_and_any_compression(tmp_path, topics, expected, vehicle, plugin, mode):
    write_folder(tmp_path / "flight", topics, plugin, mode)
    assert_same_flight(tmp_path / "flight", expected, vehicle)


def test_a_database_by_itself(tmp_path, topics, expected, vehicle):
    write_folder(tmp_path / "flight", topics, StoragePlugin.SQLITE3, CompressionMode.NONE)
    assert_same_flight(tmp_path / "flight" / "flight.db3", expected, vehicle)


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("overlap", [False, True])
def test_a_folder_of_files_that_were_split(tmp_path, topics, expected, vehicle, plugin, overlap):
    """One after the other in time, as rosbag2 splits, and with every other message in the second file."""
    halves = [[], []]
    for topic in topics:
        if overlap:
            halves[0].append(topic_rows(topic, slice(0, None, 2)))
            halves[1].append(topic_rows(topic, slice(1, None, 2)))
        else:
            for half, part in zip(halves, topic.split(int(topic.log_time_ns[0]) + 10**9), strict=True):
                half.append(part)
    folder = tmp_path / "flight"
    yaml = YAML(typ="safe")
    for number, half in enumerate(halves):
        made = tmp_path / f"flight_{number}"
        write_folder(made, half, plugin, CompressionMode.NONE)
        folder.mkdir(exist_ok=True)
        (file,) = [file for file in made.iterdir() if file.suffix != ".yaml"]
        shutil.move(file, folder / file.name)
        metadata = yaml.load((made / "metadata.yaml").read_text())
        if number == 0:
            whole = metadata
            continue
        information, second = (one["rosbag2_bagfile_information"] for one in (whole, metadata))
        information["relative_file_paths"] += second["relative_file_paths"]
        for own, other in zip(
            information["topics_with_message_count"], second["topics_with_message_count"], strict=True
        ):
            own["message_count"] += other["message_count"]
    with (folder / "metadata.yaml").open("w") as stream:
        yaml.dump(whole, stream)
    assert_same_flight(folder, expected, vehicle)


def topic_rows(topic, rows):
    order = np.arange(len(topic.log_time_ns))[rows]
    return Topic(topic.name, topic.type_name, topic.log_time_ns[order], topic.payloads.take(order))


@pytest.mark.parametrize("compression", [None, *rosbag1.Writer.CompressionFormat])
def test_a_ros1_bag(tmp_path, topics, expected, vehicle, compression):
    path = tmp_path / "flight.bag"
    write_ros1(path, topics, compression)
    assert identify_format(path).description.startswith("bag")
    assert_same_flight(path, expected, vehicle)
    with open_recording(path, vehicle) as recording:
        assert recording.sources["imu"] == "/imu"


def test_a_ros1_bag_whose_topics_were_written_one_after_the_other(
    tmp_path, topics, expected, vehicle, monkeypatch
):
    """Messages in log-time order alternate between its chunks: each is unpacked once all the same."""
    path = tmp_path / "flight.bag"
    write_ros1(path, topics, rosbag1.Writer.CompressionFormat.LZ4, one_after_the_other=True)
    assert_same_flight(path, expected, vehicle)
    unpacked = []
    unpacker = lz4.frame.LZ4FrameDecompressor
    monkeypatch.setattr(lz4.frame, "LZ4FrameDecompressor", lambda: unpacked.append(1) or unpacker())
    with Bag(path) as bag:
        bag.read(SENSORS)
    assert len(unpacked) == path.read_bytes().count(b"compression=lz4") > 1


def test_the_index_of_a_ros1_bag_takes_no_memory_for_each_message(tmp_path, topics):
    """rosbags takes 150 bytes for each, of a bag of any length."""
    imu = topics[0]
    message = bytes(typestore().cdr_to_ros1(imu.payloads[0], imu.type_name))

    def peak(count: int) -> int:
        path = tmp_path / f"{count}.bag"
        writer = rosbag1.Writer(path)
        writer.chunk_threshold = 100 * len(message)
        with writer:
            connection = writer.add_connection("/imu", imu.type_name, typestore=typestore())
            for number in range(count):
                writer.write(connection, number + 1, message)
        tracemalloc.start()
        with Bag(path) as bag:
            assert sum(len(block["/imu"].payloads) for block in bag.blocks(["/imu"], messages=100)) == count
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    peak(100)  # what the first bag leaves behind
    assert peak(8000) - peak(2000) < 6000 * 50


def test_topics_of_a_ros1_bag_have_their_header_stamps(tmp_path, topics):
    path = tmp_path / "flight.bag"
    write_ros1(path, topics)
    write_mcap(tmp_path / "flight.mcap", topics, {})
    for own, of in zip(bag_topics(path), bag_topics(tmp_path / "flight.mcap"), strict=True):
        assert (own.name, own.type_name, own.has_header) == (of.name, of.type_name, True)
        np.testing.assert_array_equal(own.stamps_ns, of.stamps_ns)


def test_a_ros1_message_of_another_type_names_the_sample(tmp_path, topics):
    path = tmp_path / "flight.bag"
    imu = topics[0]
    message = bytes(typestore().cdr_to_ros1(imu.payloads[0], imu.type_name))
    with rosbag1.Writer(path) as writer:
        connection = writer.add_connection("/imu", imu.type_name, typestore=typestore())
        writer.write(connection, 1, message)
        writer.write(connection, 2, message[:-9])
    with pytest.raises(LogError, match=r"flight.bag: topic /imu: sample 1: its \d+ bytes are no sensor_msgs"):
        read_bag(path)


@pytest.mark.parametrize("fraction", [0.001, 0.3, 0.9])
@pytest.mark.parametrize("kind", ["flight.bag", "flight.db3"])
def test_cut_off_anywhere(tmp_path, topics, kind, fraction):
    if kind.endswith(".bag"):
        write_ros1(tmp_path / kind, topics)
        path = tmp_path / kind
    else:
        write_folder(tmp_path / "flight", topics, StoragePlugin.SQLITE3, CompressionMode.NONE)
        path = tmp_path / "flight" / kind
    whole = path.read_bytes()
    path.write_bytes(whole[: int(fraction * len(whole))])
    with pytest.raises(LogError, match=rf"{kind}: ") as caught:
        read_bag(path)
    assert "\n" not in str(caught.value)


def test_a_chunk_of_a_ros1_bag_that_unpacks_to_too_much(tmp_path, topics):
    path = tmp_path / "flight.bag"
    zeros = Topic("/imu", topics[0].type_name, np.arange(2), Payloads.join([topics[0].payloads[0]] * 2))
    write_ros1(path, [zeros], rosbag1.Writer.CompressionFormat.BZ2)
    data = path.read_bytes()
    place = data.index(b"size=") + 5
    path.write_bytes(data[:place] + struct.pack("<I", 2**31) + data[place + 4 :])
    with pytest.raises(LogError, match="unpacks to 2048 MiB or more, beyond the limit of 256 MiB"):
        read_bag(path)
    path.write_bytes(data[:place] + struct.pack("<I", 7) + data[place + 4 :])
    with pytest.raises(LogError, match="damaged: announces 7 bytes unpacked, holds more"):
        read_bag(path)


def test_a_chunk_that_an_index_names_twice(tmp_path, topics):
    """Its messages would be read once for every time that it is named."""
    path = tmp_path / "flight.bag"
    write_ros1(path, [topic_rows(topics[0], slice(20))])
    data = path.read_bytes()
    # The entry of the only chunk is the last record; the count of chunks stands in the header.
    (index_start,) = struct.unpack_from("<Q", data, data.index(b"index_pos=") + 10)
    place = index_start
    for _ in range(2):  # header and data of the connection
        place += 4 + struct.unpack_from("<I", data, place)[0]
    count = data.index(b"chunk_count=") + 12
    path.write_bytes(data[:count] + struct.pack("<I", 2) + data[count + 4 :] + data[place:])
    with pytest.raises(LogError, match=r"damaged: its index names the chunk at byte \d+ twice"):
        read_bag(path)


def test_the_program_that_reads_with_rosbags_gets_the_same_messages(tmp_path, topics):
    """The checks of this module stand in rosbags' table of decompressors."""
    path = tmp_path / "flight.mcap"
    write_mcap(path, topics, {})
    reader = McapFile(path)
    reader.open()
    found = [
        (connection.topic, time_ns, bytes(data))
        for connection, time_ns, data in reader.messages(reader.connections)
    ]
    reader.close()
    assert found == [(topic.name, time_ns, payload) for time_ns, topic, payload in messages_of(topics)]
