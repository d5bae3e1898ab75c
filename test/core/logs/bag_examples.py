# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bags as other programs write them, and what must be read from any bag."""

from dataclasses import fields
from itertools import chain

import numpy as np
from rosbags import rosbag1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Writer

from quadpi_core.logs import read_recording
from quadpi_core.logs.bag_files import Bag
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.payloads import Topic, join_topics

# A topic of these seconds takes several chunks.
CHUNK_BYTES = 2**14


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


def topic_rows(topic, rows):
    order = np.arange(len(topic.log_time_ns))[rows]
    return Topic(topic.name, topic.type_name, topic.log_time_ns[order], topic.payloads.take(order))


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


def assert_same_flight(path, expected, vehicle):
    found = read_recording(path, vehicle)
    assert len(found.streams()) == len(expected.streams())
    for stream, of in zip(found.streams(), expected.streams(), strict=True):
        for column in fields(of):
            np.testing.assert_array_equal(getattr(stream, column.name), getattr(of, column.name))
    for topic, count in expected.arrivals.items():
        np.testing.assert_array_equal(found.arrivals[topic], count)


def assert_same_streams(actual, expected):
    assert [type(stream) for stream in actual.streams()] == [type(stream) for stream in expected.streams()]
    for one, other in zip(actual.streams(), expected.streams(), strict=True):
        for column in fields(other):
            np.testing.assert_allclose(
                getattr(one, column.name), getattr(other, column.name), rtol=1e-15, atol=1e-15
            )


def imu_topic(recording, name="/imu"):
    return Topic(name, sensor_messages.IMU, recording.imu.time_ns, sensor_messages.pack_imu(recording.imu))
