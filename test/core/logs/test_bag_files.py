# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of every container, whole and in blocks: folders, databases, split and compressed files."""

import os
import shutil

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from ruamel.yaml import YAML

from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.payloads import Payloads, Topic

from .bag_examples import assert_blocks_are_the_whole, assert_holds, topic_rows, write_folder


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
