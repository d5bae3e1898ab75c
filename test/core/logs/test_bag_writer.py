# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The MCAP files that quadpi writes, by the rules of the format and of rosbag2."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import McapReader
from ruamel.yaml import YAML

from quadpi_core.errors import LogError
from quadpi_core.logs.bag_writer import mcap_writer, write_mcap
from quadpi_core.logs.bags import write_bag
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import definition_text
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.messages.topics import qos_of


@pytest.fixture
def flight_bag(tmp_path, fly):
    path = tmp_path / "flight.mcap"
    write_bag(path, fly(0))
    return path


def opened(path):
    reader = McapReader(path)
    reader.open()
    return reader


def test_a_bag_without_messages_begins_and_ends_at_zero(tmp_path):
    """As the specification of MCAP says; players show the span of a bag."""
    with mcap_writer(tmp_path / "empty.mcap", {}) as writer:
        writer.announce({"/imu": "sensor_msgs/msg/Imu"})
    reader = opened(tmp_path / "empty.mcap")
    assert (reader.statistics.start_time, reader.statistics.end_time) == (0, 0)
    assert [(chunk.message_start_time, chunk.message_end_time) for chunk in reader.chunks] == [(0, 0)]


def test_statistics_and_chunks_say_what_is_there(flight_bag, fly):
    reader, flight = opened(flight_bag), fly(0)
    logged_ns = np.sort(np.concatenate([stream.time_ns for stream in flight.streams()]))
    assert reader.statistics.message_count == len(logged_ns)
    assert (reader.statistics.start_time, reader.statistics.end_time) == (logged_ns[0], logged_ns[-1])
    counts = {connection.topic: connection.msgcount for connection in reader.connections}
    assert counts == {f"/{stream.topic}": len(stream) for stream in flight.streams()}
    assert sum(sum(chunk.channel_count.values()) for chunk in reader.chunks) == len(logged_ns)


def test_topics_are_described_with_definition_and_quality_of_service(flight_bag):
    for connection in opened(flight_bag).connections:
        assert connection.msgdef.data == definition_text(connection.msgtype)
        assert connection.ext.serialization_format == "cdr"
        topic = connection.topic.removeprefix("/")
        assert connection.ext.offered_qos_profiles == [qos_of(topic).profile()]


def test_rosbags_reads_every_message_in_order_from_embedded_definitions(tmp_path, topics):
    path = tmp_path / "bag.mcap"
    write_mcap(path, topics, {})
    times, speeds = [], []
    with AnyReader([path]) as reader:
        assert reader.message_count == 2 * 3000
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


@pytest.mark.parametrize("count", [1, 37, 1024])
def test_a_bag_written_in_blocks_has_the_bytes_of_one_written_whole(tmp_path, topics, count):
    whole, blocks = tmp_path / "whole.mcap", tmp_path / "blocks.mcap"
    topics = [Topic(t.name, t.type_name, t.log_time_ns[:999], t.payloads.cut(slice(0, 999))) for t in topics]
    write_mcap(whole, topics, {"vehicle": "v"})
    with mcap_writer(blocks, {"vehicle": "v"}) as writer:
        writer.announce({topic.name: topic.type_name for topic in topics})
        rest = topics
        for limit_ns in range(0, 3000 * 7_000_000, count * 7_000_000):
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


@pytest.mark.parametrize("shift_ns", [-7_000_000, 2**31 * 10**9])
def test_stamps_that_ros_cannot_hold_are_refused_and_nothing_written(tmp_path, topics, shift_ns):
    path = tmp_path / "bag.mcap"
    times = topics[1].log_time_ns + shift_ns
    early = Topic("/wind", sensor_messages.WIND, times, topics[1].payloads)
    with pytest.raises(LogError, match=r"bag\.mcap: topic /wind: sample 0: the stamp is before 1970 or"):
        write_mcap(path, [early], {})
    assert list(tmp_path.iterdir()) == []


def test_humble_can_read_the_quality_of_service(tmp_path):
    """As numbers of rmw: words, as of version 9 of the metadata, stop `ros2 bag play` of Humble and Iron."""
    path = tmp_path / "bag.mcap"
    with mcap_writer(path, {"vehicle": "v"}) as writer:
        writer.announce({"/imu": sensor_messages.IMU, "/alarm_log": sensor_messages.EVENT})
    found = {}
    for channel in opened(path).channels.values():
        text = channel.metadata.partition(b"- ")[2].decode()
        (found[channel.topic],) = YAML(typ="safe").load("- " + text)
    # rmw/types.h: keep last, automatic; best effort and volatile, reliable and transient local.
    assert {profile["history"] for profile in found.values()} == {1}
    assert {profile["liveliness"] for profile in found.values()} == {1}
    assert (found["/imu"]["reliability"], found["/imu"]["durability"]) == (2, 2)
    assert (found["/alarm_log"]["reliability"], found["/alarm_log"]["durability"]) == (1, 1)
    assert b"\nversion: 8" in path.read_bytes()
