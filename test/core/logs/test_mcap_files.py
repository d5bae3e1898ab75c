# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MCAP files of other writers, cut off, or with an index that says what is not there."""

from __future__ import annotations

import struct
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.core import compiled
from quadpi_core.errors import LogError
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_writer import mcap_writer, write_mcap
from quadpi_core.logs.mcap_files import CHUNK, MAGIC, is_cut_off, records_of, whole_part
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.paths import bags_directory

from .bag_examples import assert_blocks_are_the_whole, assert_holds


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
    late = body.replace(struct.pack("<QQ", 30, 30), struct.pack("<QQ", 2**63, 30))
    path.write_bytes(late)
    with Bag(path) as bag, pytest.raises(LogError, match=r"flat\.mcap: damaged: a message was logged after"):
        bag.read(["/rotor_speeds"])


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
    """Let every chunk of a bag give that time as the one of its first message."""
    data = bytearray(path.read_bytes())
    for opcode, start, _ in records_of(BytesIO(bytes(data)), len(data)):
        if opcode == CHUNK:
            data[start : start + 8] = struct.pack("<Q", time_ns)
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


def test_chunks_that_begin_before_they_say_are_refused_where_that_changes_the_order(tmp_path, topics):
    path = tmp_path / "bag.mcap"
    write_mcap(path, topics, {})
    say_where_chunks_begin(path, 20 * 10**9)
    assert_holds(path, topics)
    with Bag(path) as bag, pytest.raises(LogError, match=r"bag.mcap: damaged: its messages are not in the"):
        list(bag.blocks(["/wind"], messages=100))


@pytest.mark.parametrize(
    "rest",
    [
        b"\x05",
        record(0x05, b"less than a head"),
        record(0x0C, b"text")[:-1],
        struct.pack("<BQ", 5, 2**64 - 1),
    ],
    ids=["a piece of a prefix", "a short message", "a piece of a record", "a length beyond all memory"],
)
def test_messages_of_a_chunk_are_found_up_to_the_first_record_that_is_not_whole(rest: bytes) -> None:
    head = struct.pack("<HIQQ", 3, 0, 77, 78)
    whole = record(0x0C, b"text") + record(0x05, head + b"abc") + record(0x05, head)
    found = np.zeros((9, 4), dtype=np.int64)
    assert compiled.mcap_messages(np.frombuffer(whole + rest, dtype=np.uint8), found) == (2, len(whole))
    start = len(record(0x0C, b"text")) + 9 + len(head)
    assert found[:2].tolist() == [[3, 77, start, 3], [3, 77, start + 3 + 9 + len(head), 0]]
    assert not found[2:].any()


BAG = bags_directory() / "extrapolation.mcap"


def cut(target: Path, share: float) -> Path:
    content = BAG.read_bytes()
    target.write_bytes(content[: round(share * len(content))])
    return target


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.999])
def test_it_holds_the_first_messages_of_the_whole_one(tmp_path, share):
    bag = cut(tmp_path / "flight.mcap", share)
    with pytest.raises(LogError, match=r"cut off, it has no footer; \d+ whole messages"):
        Bag(bag)
    with whole_part(bag) as readable, Bag(readable) as part, Bag(BAG) as whole:
        found, full = (one.read(["/imu"])["/imu"] for one in (part, whole))
        count = len(found.payloads)
        assert 0.8 * share * len(full.payloads) - 2000 < count <= len(full.payloads)
        np.testing.assert_array_equal(found.log_time_ns, full.log_time_ns[:count])
        assert found.payloads[count - 1] == full.payloads[count - 1]
    assert not readable.exists()
    assert bag.stat().st_size == round(share * BAG.stat().st_size)


def test_a_whole_bag_is_itself(tmp_path):
    assert not is_cut_off(BAG)
    with whole_part(BAG) as readable:
        assert readable == BAG
    for other in (tmp_path / "absent.mcap", tmp_path):
        assert not is_cut_off(other)


def test_the_folder_of_a_recorder_that_was_killed(tmp_path):
    cut(tmp_path / "flight_0.mcap", 0.6)
    assert is_cut_off(tmp_path)
    with whole_part(tmp_path) as readable, Bag(readable) as bag:
        assert "/imu" in {connection.topic for connection in bag.connections}


def test_errors_name_the_bag_and_the_cut(tmp_path):
    bag = cut(tmp_path / "flight.mcap", 0.6)
    with pytest.raises(LogError) as told, whole_part(bag) as readable:
        raise LogError(f"{readable}: topic imu: damaged")
    assert str(told.value) == f"{bag}: topic imu: damaged (the file is cut off)"


def test_what_is_cut_within_its_first_records_is_refused(tmp_path):
    bag = tmp_path / "flight.mcap"
    bag.write_bytes(BAG.read_bytes()[:20])
    with pytest.raises(LogError, match=r"flight.mcap: .*cut off"), whole_part(bag) as readable:
        Bag(readable)
