# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of every container, whole, in blocks or damaged, whatever names and metadata.yaml say."""

import os
import shutil
import sqlite3
import struct
from contextlib import closing

import numpy as np
import pytest
from backports import zstd
from rosbags import rosbag1
from rosbags.rosbag1 import reader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from ruamel.yaml import YAML

from quadpi_core.errors import LogError
from quadpi_core.logs import decode_recording, identify_format, is_log_folder, read_recording
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_storages import Ros1File
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import open_recording, read_bag
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.paths import LIMIT_VARIABLE
from quadpi_core.vehicle import Vehicle

from .bag_examples import assert_blocks_are_the_whole, assert_holds, topic_rows, write_folder, write_ros1


def test_round_trip(tmp_path, topics):
    path = tmp_path / "bag.mcap"
    write_mcap(path, topics, {"vehicle": "bebop2"})
    assert_holds(path, topics)
    with Bag(path) as bag:
        assert bag.metadata == {"vehicle": "bebop2"}


@pytest.mark.parametrize(
    ("plugin", "mode"),
    [
        (StoragePlugin.MCAP, CompressionMode.NONE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.STORAGE),
        (StoragePlugin.SQLITE3, CompressionMode.NONE),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    ],
)
def test_reads_what_other_writers_write(tmp_path, topics, plugin, mode):
    path = tmp_path / "folder"
    writer = Writer(path, version=9, storage_plugin=plugin)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        for topic in topics:
            connection = writer.add_connection(topic.name, topic.type_name, typestore=typestore())
            for time_ns, payload in zip(topic.log_time_ns.tolist(), topic.payloads, strict=True):
                writer.write(connection, time_ns, payload)
    assert_holds(path, topics)
    assert_blocks_are_the_whole(path, topics, 700)
    if mode != CompressionMode.MESSAGE:
        (file,) = [file for file in path.iterdir() if file.suffix in {".mcap", ".db3"}]
        assert_holds(file, topics)


@pytest.mark.parametrize("messages", [1, 7, 1000, 10**6])
def test_blocks_are_the_whole(tmp_path, topics, messages):
    path = tmp_path / "bag.mcap"
    short = [Topic(t.name, t.type_name, t.log_time_ns[:400], t.payloads.cut(slice(0, 400))) for t in topics]
    write_mcap(path, short if messages < 100 else topics, {})
    assert_blocks_are_the_whole(path, short if messages < 100 else topics, messages)


def test_what_is_logged_at_one_instant_is_in_one_block(tmp_path, topics):
    path = tmp_path / "bag.mcap"
    times = np.repeat(np.array([10, 10**9, 2 * 10**9]), 1000)
    write_mcap(path, [Topic(topic.name, topic.type_name, times, topic.payloads) for topic in topics], {})
    with Bag(path) as bag:
        blocks = list(bag.blocks([topic.name for topic in topics], messages=30))
    assert [len(block["/wind"].payloads) for block in blocks] == [1000] * 3


def test_head_reads_only_the_first_bytes(tmp_path, topics):
    path = tmp_path / "bag.mcap"
    write_mcap(path, topics, {})
    with Bag(path) as bag:
        heads = bag.read(["/wind"], head=12)["/wind"].payloads
    assert list(heads) == [payload[:12] for payload in topics[1].payloads]


def test_one_process_opens_a_bag_and_reads_it(tmp_path, topics, monkeypatch):
    fork, forks = os.fork, []
    monkeypatch.setattr(os, "fork", lambda: forks.append(1) or fork())
    write_mcap(tmp_path / "flight.mcap", topics, {})
    with Bag(tmp_path / "flight.mcap") as bag:
        assert bag.read([]) == {}
        first = bag.read(["/wind"])
        assert len(forks) == 1
        again = bag.read(["/wind"])
    np.testing.assert_array_equal(first["/wind"].log_time_ns, again["/wind"].log_time_ns)
    assert len(first["/wind"].payloads) == len(again["/wind"].payloads) > 0


def test_topic_without_messages(tmp_path):
    path = tmp_path / "empty.mcap"
    nothing = Topic("/wind", sensor_messages.WIND, np.empty(0, np.int64), Payloads.join([]))
    write_mcap(path, [nothing], {})
    assert_holds(path, [nothing])


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.MESSAGE, CompressionMode.FILE])
@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_folder_of_either_storage_and_any_compression(tmp_path, sensor_topics, same_flight, plugin, mode):
    write_folder(tmp_path / "flight", sensor_topics, plugin, mode)
    same_flight(tmp_path / "flight")


def test_a_database_by_itself(tmp_path, sensor_topics, same_flight):
    write_folder(tmp_path / "flight", sensor_topics, StoragePlugin.SQLITE3, CompressionMode.NONE)
    same_flight(tmp_path / "flight" / "flight.db3")


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("overlap", [False, True])
def test_a_folder_of_files_that_were_split(tmp_path, sensor_topics, same_flight, plugin, overlap):
    """One after the other in time, as rosbag2 splits, and with every other message in the second file."""
    halves = [[], []]
    for topic in sensor_topics:
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
    same_flight(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("UPDATE topics SET type = x'00' WHERE id = 1", "damaged: topic /[a-z/]+ is of type b"),
        ("UPDATE messages SET data = 7 WHERE id = 5", "damaged: a message of topic /[a-z/]+ is none"),
        ("UPDATE messages SET timestamp = 'x' WHERE id = 5", "damaged: a message of topic /[a-z/]+ is none"),
        ("DROP TABLE messages", "cannot be read: no such table: messages"),
        (
            "ALTER TABLE topics RENAME TO t; CREATE VIEW topics AS SELECT * FROM t",
            ".* computes what it holds",
        ),
    ],
)
def test_values_that_are_none(tmp_path, sensor_topics, change, message):
    write_folder(tmp_path / "flight", sensor_topics, StoragePlugin.SQLITE3, CompressionMode.NONE)
    path = tmp_path / "flight" / "flight.db3"
    with closing(sqlite3.connect(path)) as database:
        database.executescript(change)
        database.commit()
    with pytest.raises(LogError, match=rf"flight.db3: {message}"), Bag(path) as bag:
        bag.read([topic.name for topic in sensor_topics])


def test_what_the_writer_noted_of_a_database_by_itself(tmp_path, sensor_topics):
    write_folder(tmp_path / "flight", sensor_topics, StoragePlugin.SQLITE3, CompressionMode.NONE)
    path = tmp_path / "flight" / "flight.db3"
    note = "version: 9\ncustom_data:\n  vehicle: bebop2\n"
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE metadata SET metadata = ?", [note])
        database.commit()
    with Bag(path) as bag:
        assert bag.metadata == {"vehicle": "bebop2"}


PLUGINS = [StoragePlugin.MCAP, StoragePlugin.SQLITE3]


@pytest.fixture(params=PLUGINS)
def bag(tmp_path, sensor_topics, request):
    """The folder of a bag, and its file."""
    folder = tmp_path / "recorded"
    write_folder(folder, sensor_topics, request.param, CompressionMode.NONE)
    (file,) = (file for file in folder.iterdir() if file.suffix != ".yaml")
    return folder, file


def pack(file):
    packed = file.with_name(f"{file.name}.zstd")
    packed.write_bytes(zstd.compress(file.read_bytes()))
    file.unlink()
    return packed


def with_metadata(folder, **changes):
    path, yaml = folder / "metadata.yaml", YAML(typ="safe")
    metadata = yaml.load(path.read_text())
    metadata["rosbag2_bagfile_information"] |= changes
    with path.open("w") as stream:
        yaml.dump(metadata, stream)


@pytest.mark.parametrize("identifier", ["", None, "mcap", "sqlite3", "of another program"])
def test_the_storage_is_told_by_the_file(bag, same_flight, identifier):
    with_metadata(bag[0], storage_identifier=identifier)
    same_flight(bag[0])


@pytest.mark.parametrize("content", ["", "rosbag2_bagfile_information: [", "\0" * 100])
def test_metadata_that_were_lost_when_the_power_went(bag, same_flight, content):
    folder, file = bag
    (folder / "metadata.yaml").write_text(content)
    same_flight(folder)
    shutil.copy(file, folder / f"second{file.suffix}")
    with pytest.raises(LogError, match=r"metadata.yaml cannot be read, and 2 files of messages: `ros2 bag"):
        Bag(folder)


@pytest.mark.parametrize("name", ["of_monday", "of_monday.zstd", "recorded.zstd"])
def test_a_file_that_was_renamed_or_compressed_by_hand(bag, same_flight, name):
    folder, file = bag
    renamed = file.rename(folder / f"{name.removesuffix('.zstd')}{file.suffix}")
    if name.endswith(".zstd"):
        pack(renamed)
    same_flight(folder)


def test_a_compressed_file_that_was_unpacked_by_hand(bag, same_flight):
    folder, file = bag
    names = [f"{file.name}.zstd"]
    with_metadata(folder, compression_mode="FILE", compression_format="zstd", relative_file_paths=names)
    same_flight(folder)


def test_a_compressed_file_by_itself_and_in_a_folder_without_metadata(bag, same_flight):
    folder, file = bag
    (folder / "metadata.yaml").unlink()
    packed = pack(file)
    assert is_log_folder(folder)
    same_flight(packed)
    same_flight(folder)
    assert decode_recording(packed, Vehicle.load("bebop2")).name == file.stem


def test_a_file_whose_name_says_another_container_or_none(bag, same_flight):
    folder, file = bag
    for name in (f"{file.name}.active", "flight", f"flight{'.db3' if file.suffix == '.mcap' else '.mcap'}"):
        shutil.copy(file, folder.parent / name)
        same_flight(folder.parent / name)


def test_files_that_are_not_there_are_named(bag):
    folder, file = bag
    with_metadata(folder, relative_file_paths=[file.name, "second", "third"])
    expected = "recorded: metadata.yaml names second, third, .* there are no other .* `ros2 bag reindex`"
    with pytest.raises(LogError, match=expected):
        Bag(folder)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (zstd.compress(b"\x89MCAP0\r\n" + bytes(10**7), 1), "unpacks to more than the limit"),
        (zstd.compress(b"time,ax,ay\n" * 20), "what it holds compressed is no bag; `zstd -d`"),
        (zstd.compress(b"\x89MCAP0\r\n" + bytes(500)), "flight.mcap.zstd: .*cut off"),
        (zstd.compress(b"\x89MCAP0\r\n" + bytes(500))[:20], "flight.mcap.zstd"),
        (b"time,ax,ay\n" * 20, "flight.mcap.zstd"),
    ],
    ids=["bomb", "table", "short", "cut", "text"],
)
def test_what_is_compressed_and_no_bag_is_refused(tmp_path, content, message, monkeypatch):
    monkeypatch.setenv(LIMIT_VARIABLE, "8")
    path = tmp_path / "flight.mcap.zstd"
    path.write_bytes(content)
    with pytest.raises(LogError, match=message) as refused:
        read_recording(path, None)
    assert "\n" not in str(refused.value)
    assert ".quadpi." not in str(refused.value)


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
