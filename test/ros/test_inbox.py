# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages are taken when they are asked for, in order, each once."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from quadpi.msg import RotorSpeeds
from rclpy.node import Node

from quadpi_core.errors import SampleError
from quadpi_core.flight import RotorSpeedStream
from quadpi_core.messages.sensor_messages import pack_rotor_speeds, unpack_odometry, unpack_rotor_speeds
from quadpi_ros.callbacks import SENSOR_QOS, await_subscribers
from quadpi_ros.input_sources import Inbox

from .rig import wait_until


@pytest.fixture
def node(ros: None) -> Iterator[Node]:
    del ros
    node = Node("inbox")
    yield node
    node.destroy_node()


def test_what_came_is_taken_once_and_in_order(node):
    inbox = Inbox(node, RotorSpeeds, "/rotor_speeds")
    assert inbox.take() == []
    publisher = node.create_publisher(RotorSpeeds, "/rotor_speeds", SENSOR_QOS)
    await_subscribers(node, [publisher], 20.0)
    stamps = np.arange(1, 101, dtype=np.int64) * 2_000_000
    for payload in pack_rotor_speeds(RotorSpeedStream(stamps, np.full((100, 4), 700.0))):
        publisher.publish(payload)
    taken: list[int] = []

    def take() -> None:
        rotors = inbox.unpacked(unpack_rotor_speeds)
        taken.extend([] if rotors is None else rotors.time_ns.tolist())

    wait_until(lambda: len(taken) == 100, take, lambda: len(taken))
    assert taken == stamps.tolist()
    assert inbox.count == 100
    assert inbox.unpacked(unpack_rotor_speeds) is None


def test_bytes_of_another_type_are_refused(node):
    inbox = Inbox(node, RotorSpeeds, "/rotor_speeds")
    publisher = node.create_publisher(RotorSpeeds, "/rotor_speeds", SENSOR_QOS)
    await_subscribers(node, [publisher], 20.0)
    publisher.publish(RotorSpeeds())

    def refused() -> bool:
        try:
            return inbox.unpacked(unpack_odometry) is not None
        except SampleError:
            return True

    wait_until(refused)
    assert inbox.count == 1
