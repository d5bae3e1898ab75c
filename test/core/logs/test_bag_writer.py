# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The MCAP files that quadpi writes, by the rules of the format and of rosbag2."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.rosbag2.storage_mcap import McapReader

from quadpi_core.logs.bag_writer import mcap_writer
from quadpi_core.logs.bags import write_bag
from quadpi_core.messages.definitions import definition_text
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
