# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MCAP files of other writers, and files whose index says what is not there."""

import struct

import numpy as np
import pytest
from backports import zstd

from quadpi_core.errors import LogError
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_writer import mcap_writer, write_mcap
from quadpi_core.logs.bags import read_bag
from quadpi_core.logs.mcap_files import MAGIC, McapFile, find_records
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.payloads import Payloads, Topic

from .bag_examples import assert_blocks_are_the_whole, assert_holds, messages_of

CHUNK_INDEX = 0x08


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def sized(content):
    return struct.pack("<I", len(content)) + content


def test_reads_messages_outside_chunks_without_a_summary(tmp_path, topics):
    few = topics[0].payloads.take(np.arange(3))
    body = MAGIC + record(0x01, sized(b"ros2") + sized(b"test"))
    schema = (
        struct.pack("<H", 5) + sized(sensor_messages.ROTOR_SPEEDS.encode()) + sized(b"ros2msg") + sized(b"")
    )
    body += record(0x03, schema)
    body += record(0x04, struct.pack("<HH", 9, 5) + sized(b"/rotor_speeds") + sized(b"cdr") + sized(b""))
    for time_ns in (30, 10, 20):
        body += record(0x05, struct.pack("<HIQQ", 9, 0, time_ns, time_ns) + few[time_ns // 10 - 1])
    body += record(0x0F, bytes(4)) + record(0x02, bytes(20)) + MAGIC
    path = tmp_path / "flat.mcap"
    path.write_bytes(body)
    ordered = Topic("/rotor_speeds", sensor_messages.ROTOR_SPEEDS, np.array([10, 20, 30]), few)
    assert_holds(path, [ordered])
    assert_blocks_are_the_whole(path, [ordered], 1)


def test_chunks_that_overlap_in_time_come_in_the_order_of_log_times(tmp_path, topics):
    """As where a recorder was slow with one topic, or its clock was set back."""
    path = tmp_path / "bag.mcap"
    early, late = topics[0].split(3000 * 1_000_000)
    with mcap_writer(path, {}) as writer:
        for topic in (topics[1], late, early):
            writer.add(topic)
            writer.flush()
    assert_holds(path, topics)
    assert_blocks_are_the_whole(path, topics, 500)


def say_where_chunks_begin(path, time_ns):
    """Let the index of a bag give every chunk that time as the one of its first message."""
    data = bytearray(path.read_bytes())
    (summary_start,) = struct.unpack_from("<Q", data, len(data) - 28)
    for start in find_records(np.frombuffer(data, np.uint8), summary_start).of(CHUNK_INDEX)[0].tolist():
        data[start : start + 8] = struct.pack("<Q", time_ns)
    data[-12:-8] = bytes(4)  # no checksum of the summary
    path.write_bytes(data)


def test_messages_are_cut_into_blocks_once(tmp_path, topics, monkeypatch):
    """The time would grow with the square of the flight where every chunk may hold the earliest message."""
    cut = []

    def counted(payloads, rows):
        cut.append(len(payloads.lengths[rows]))
        return cut_payloads(payloads, rows)

    cut_payloads = Payloads.cut
    path = tmp_path / "bag.mcap"
    write_mcap(path, [topics[1]], {})
    say_where_chunks_begin(path, 0)
    with Bag(path) as bag:
        monkeypatch.setattr(Payloads, "cut", counted)
        blocks = list(bag.blocks(["/wind"], messages=2))
    assert [len(block["/wind"].payloads) for block in blocks] == [2] * (len(topics[1].payloads) // 2)
    assert sum(cut) <= 4 * len(topics[1].payloads)


def test_a_chunk_that_begins_before_it_says_is_refused(tmp_path, topics):
    path = tmp_path / "bag.mcap"
    write_mcap(path, topics, {})
    say_where_chunks_begin(path, 10**9)
    with Bag(path) as bag, pytest.raises(LogError, match=r"bag.mcap: damaged: the chunk at byte \d+ holds"):
        bag.read(["/wind"])


def test_the_program_that_reads_with_rosbags_gets_the_same_messages(tmp_path, sensor_topics):
    """The checks of this module stand in rosbags' table of decompressors."""
    path = tmp_path / "flight.mcap"
    write_mcap(path, sensor_topics, {})
    reader = McapFile(path)
    reader.open()
    found = [
        (connection.topic, time_ns, bytes(data))
        for connection, time_ns, data in reader.messages(reader.connections)
    ]
    reader.close()
    assert found == [(topic.name, time_ns, payload) for time_ns, topic, payload in messages_of(sensor_topics)]


def test_records_of_a_chunk_count_with_150_bytes_each(tmp_path, monkeypatch):
    """What holds a message in memory beside its bytes, against a limit of one MiB."""
    monkeypatch.setenv("QUADPI_UNPACKED_MIB", "1")
    path = tmp_path / "many.mcap"
    for count, message in ((6990, "topic imu: missing"), (6991, "unpacks to 2 MiB or more, beyond")):
        content = record(0, b"") * count
        header = struct.pack("<QQQI", 0, 1, len(content), 0) + sized(b"zstd")
        packed = zstd.compress(content)
        chunk = record(0x06, header + struct.pack("<Q", len(packed)) + packed)
        start = MAGIC + record(0x01, sized(b"ros2") + sized(b"test"))
        path.write_bytes(start + chunk + record(0x0F, bytes(4)) + record(0x02, bytes(20)) + MAGIC)
        with pytest.raises(LogError, match=message):
            read_bag(path)


@pytest.mark.parametrize(("size", "known"), [(2**20 - 2**12, True), (2**20 + 2**12, False)])
def test_metadata_of_more_than_a_mib_are_not_read(tmp_path, size, known):
    """Those of rosbag2 hold the topics; a day's recording has less."""
    path = tmp_path / "bag.mcap"
    write_mcap(path, [], {"vehicle": "bebop2", "note": "x" * size})
    with Bag(path) as bag:
        assert bag.metadata.get("vehicle") == ("bebop2" if known else None)
