# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import struct

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from quadpi_core.errors import LogError
from quadpi_core.flight import RotorSpeedStream, WindStream
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_writer import mcap_writer, write_mcap
from quadpi_core.logs.mcap_files import MAGIC, find_records
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.payloads import Payloads, Topic, join_topics

N = 3000
CHUNK_INDEX = 0x08


@pytest.fixture
def topics():
    """Two topics on clocks that interleave; 3000 samples need more than one chunk."""
    rng = np.random.default_rng(3)
    rotor_time, wind_time = np.arange(N) * 2_000_000 + 10, np.arange(N) * 7_000_000
    rotors = RotorSpeedStream(rotor_time, rng.uniform(0, 900, size=(N, 4)))
    wind = WindStream(wind_time, rng.normal(size=(N, 3)))
    big_wind_frame = sensor_messages.pack_wind(wind, frame_id="w" * 400)
    return [
        Topic(
            "/rotor_speeds",
            sensor_messages.ROTOR_SPEEDS,
            rotor_time,
            sensor_messages.pack_rotor_speeds(rotors),
        ),
        Topic("/wind", sensor_messages.WIND, wind_time, big_wind_frame),
    ]


def assert_holds(path, topics):
    with Bag(path) as bag:
        found = bag.read([topic.name for topic in topics])
    for topic in topics:
        assert found[topic.name].type_name == topic.type_name
        np.testing.assert_array_equal(found[topic.name].log_time_ns, topic.log_time_ns)
        assert list(found[topic.name].payloads) == list(topic.payloads)


def assert_blocks_are_the_whole(path, topics, messages):
    names = [topic.name for topic in topics]
    with Bag(path) as bag:
        blocks = list(bag.blocks(names, messages=messages))
    last_ns = -1
    for block in blocks:
        assert sum(len(topic.payloads) for topic in block.values()) <= messages
        times = np.concatenate([topic.log_time_ns for topic in block.values()])
        assert times.min() > last_ns
        last_ns = times.max()
    for topic in topics:
        joined = join_topics([block[topic.name] for block in blocks])
        np.testing.assert_array_equal(joined.log_time_ns, topic.log_time_ns)
        assert list(joined.payloads) == list(topic.payloads)


def test_round_trip(tmp_path, topics):
    path = tmp_path / "bag.mcap"
    write_mcap(path, topics, {"vehicle": "bebop2"})
    assert_holds(path, topics)
    with Bag(path) as bag:
        assert bag.metadata == {"vehicle": "bebop2"}


def test_rosbags_reads_every_message_in_order_from_embedded_definitions(tmp_path, topics):
    path = tmp_path / "bag.mcap"
    write_mcap(path, topics, {})
    times, speeds = [], []
    with AnyReader([path]) as reader:
        assert reader.message_count == 2 * N
        for connection, time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            times.append(time_ns)
            if connection.topic == "/rotor_speeds":
                speeds.append(message.rotor_speeds)
    assert times == sorted(times)
    unpacked = sensor_messages.unpack_rotor_speeds(topics[0].payloads)
    np.testing.assert_array_equal(speeds, unpacked.speeds)


def test_equal_input_gives_equal_bytes(tmp_path, topics):
    write_mcap(tmp_path / "a.mcap", topics, {"vehicle": "v"})
    write_mcap(tmp_path / "b.mcap", topics, {"vehicle": "v"})
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


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


def test_reads_messages_outside_chunks_without_a_summary(tmp_path, topics):
    def record(opcode, content):
        return struct.pack("<BQ", opcode, len(content)) + content

    def sized(content):
        return struct.pack("<I", len(content)) + content

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


def test_chunks_that_overlap_in_time_come_in_the_order_of_log_times(tmp_path, topics):
    """As where a recorder was slow with one topic, or its clock was set back."""
    path = tmp_path / "bag.mcap"
    early, late = topics[0].split(N * 1_000_000)
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
    assert [len(block["/wind"].payloads) for block in blocks] == [2] * (N // 2)
    assert sum(cut) <= 4 * N


def test_a_chunk_that_begins_before_it_says_is_refused(tmp_path, topics):
    path = tmp_path / "bag.mcap"
    write_mcap(path, topics, {})
    say_where_chunks_begin(path, 10**9)
    with Bag(path) as bag, pytest.raises(LogError, match=r"bag.mcap: damaged: the chunk at byte \d+ holds"):
        bag.read(["/wind"])


@pytest.mark.parametrize("count", [1, 37, 1024])
def test_a_bag_written_in_blocks_has_the_bytes_of_one_written_whole(tmp_path, topics, count):
    whole, blocks = tmp_path / "whole.mcap", tmp_path / "blocks.mcap"
    topics = [Topic(t.name, t.type_name, t.log_time_ns[:999], t.payloads.cut(slice(0, 999))) for t in topics]
    write_mcap(whole, topics, {"vehicle": "v"})
    with mcap_writer(blocks, {"vehicle": "v"}) as writer:
        writer.announce({topic.name: topic.type_name for topic in topics})
        rest = topics
        for limit_ns in range(0, N * 7_000_000, count * 7_000_000):
            due, rest = zip(*(topic.split(limit_ns) for topic in rest), strict=True)
            for topic in due:
                writer.add(topic)
            # What waits is not written before its turn.
            writer.flush(limit_ns - 10_000_000)
    assert blocks.read_bytes() == whole.read_bytes()


def test_rosbags_reads_the_quality_of_service_that_the_nodes_offer(tmp_path):
    path = tmp_path / "bag.mcap"
    nothing = {
        name: Topic(name, kind, np.empty(0, np.int64), Payloads.join([]))
        for name, kind in (
            ("/imu", sensor_messages.IMU),
            ("/prediction", sensor_messages.PREDICTION),
            ("/alarm_log", sensor_messages.EVENT),
        )
    }
    write_mcap(path, list(nothing.values()), {})
    with Reader(path) as reader:
        (imu,), (prediction,), (log,) = (one.ext.offered_qos_profiles for one in reader.connections)
    assert (imu.reliability, imu.durability) == (QosReliability.BEST_EFFORT, QosDurability.VOLATILE)
    assert (prediction.reliability, prediction.durability) == (
        QosReliability.RELIABLE,
        QosDurability.VOLATILE,
    )
    assert (log.reliability, log.durability) == (QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL)
    assert (imu.depth, prediction.depth, log.depth) == (1000, 200, 64)
    for profile in (imu, prediction, log):
        assert profile.history == QosHistory.KEEP_LAST
        assert profile.liveliness == QosLiveliness.AUTOMATIC
        assert {profile.deadline, profile.lifespan, profile.liveliness_lease_duration} == {
            QosTime(9223372036, 854775807)
        }


def test_head_reads_only_the_first_bytes(tmp_path, topics):
    path = tmp_path / "bag.mcap"
    write_mcap(path, topics, {})
    with Bag(path) as bag:
        heads = bag.read(["/wind"], head=12)["/wind"].payloads
    assert list(heads) == [payload[:12] for payload in topics[1].payloads]


def test_topic_without_messages(tmp_path):
    path = tmp_path / "empty.mcap"
    nothing = Topic("/wind", sensor_messages.WIND, np.empty(0, np.int64), Payloads.join([]))
    write_mcap(path, [nothing], {})
    assert_holds(path, [nothing])


@pytest.mark.parametrize("shift_ns", [-7_000_000, 2**31 * 10**9])
def test_stamps_that_ros_cannot_hold_are_refused_and_nothing_written(tmp_path, topics, shift_ns):
    path = tmp_path / "bag.mcap"
    times = topics[1].log_time_ns + shift_ns
    early = Topic("/wind", sensor_messages.WIND, times, topics[1].payloads)
    with pytest.raises(LogError, match=r"bag\.mcap: topic /wind: sample 0: the stamp is before 1970 or"):
        write_mcap(path, [early], {})
    assert list(tmp_path.iterdir()) == []
