# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Batches hold the messages of a node as they are, and are sent where somebody listens."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import MultiArrayDimension, MultiArrayLayout, UInt8MultiArray

from quadpi_core.errors import LogError
from quadpi_core.messages.payloads import Payloads
from quadpi_ros.inbox import Inbox
from quadpi_ros.message_batches import BATCH_QOS, ROWS, OutgoingBatch, batch_of, parts_of, unpack_rows

from .rig import wait_until


@pytest.fixture
def node(ros: None) -> Iterator[Node]:
    del ros
    node = Node("batching", namespace="/uav")
    yield node
    node.destroy_node()


def test_messages_of_a_batch_are_those_that_went_in():
    sent = {"/a some/Type": [b"one", b"two", b"three"], "/b some/Type": [b"x"]}
    parts = list(parts_of(batch_of(sent)))
    assert [(part.topic, part.type_name, list(part.payloads)) for part in parts] == [
        ("/a", "some/Type", [b"one", b"two"]),
        ("/a", "some/Type", [b"three"]),
        ("/b", "some/Type", [b"x"]),
    ]


@pytest.mark.parametrize(("size", "stride"), [(3, 2), (2**32 - 1, 2**32 - 1), (0, 4), (4, 0)])
def test_a_layout_that_the_bytes_do_not_follow_is_refused(size, stride):
    layout = MultiArrayLayout(dim=[MultiArrayDimension(label="/a b", size=size, stride=stride)])
    with pytest.raises(LogError, match="a batch of 4 bytes holds no"):
        list(parts_of(UInt8MultiArray(layout=layout, data=b"four")))


def test_rows_of_another_width_are_refused():
    with pytest.raises(LogError, match="rows of a batch have 16 bytes, not 24"):
        unpack_rows(Payloads.join([bytes(16)]), 2)


def test_nothing_is_sent_until_somebody_listens(node):
    batch = OutgoingBatch(node)
    add, add_rows = batch.adding("/uav/prediction", "some/Type"), batch.adding_rows("inputs")
    add(b"unheard")
    inbox = Inbox(node, UInt8MultiArray, "/uav/batching/batch", BATCH_QOS, raw=False)
    number, came = 0, []

    def turn() -> None:
        nonlocal number
        number += 1
        add(f"{number:8d}".encode())
        add_rows(np.array([number]), np.array([[0.5 * number, -1.0]]))
        batch.send()
        for message in inbox.take():
            came.extend(parts_of(message))

    wait_until(lambda: len(came) >= 4, turn)
    messages = [payload for part in came if part.type_name != ROWS for payload in part.payloads]
    numbers = [int(message) for message in messages]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    rows = [unpack_rows(part.payloads, 2) for part in came if part.type_name == ROWS]
    assert {part.topic for part in came} == {"/uav/prediction", "inputs"}
    for time_ns, values in rows:
        np.testing.assert_array_equal(values, [[0.5 * time_ns[0], -1.0]])
    batch.destroy()


def test_it_notes_who_comes_and_goes_without_being_asked(node):
    """And keeps nothing of the last listener for the next."""
    batch = OutgoingBatch(node)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    assert not batch.heard
    inbox = Inbox(node, UInt8MultiArray, "/uav/batching/batch", BATCH_QOS, raw=False)
    wait_until(lambda: batch.heard, lambda: executor.spin_once(timeout_sec=0.01))
    add = batch.adding("/uav/prediction", "some/Type")
    batch.send()
    add(b"of the last listener")
    inbox.close(node)
    wait_until(lambda: not batch.heard, lambda: executor.spin_once(timeout_sec=0.01))
    inbox, came = Inbox(node, UInt8MultiArray, "/uav/batching/batch", BATCH_QOS, raw=False), []
    wait_until(lambda: batch.heard, lambda: executor.spin_once(timeout_sec=0.01))

    def turn() -> None:
        add(b"new")
        batch.send()
        for message in inbox.take():
            came.extend(payload for part in parts_of(message) for payload in part.payloads)

    wait_until(lambda: len(came) >= 2, turn)
    assert set(came) == {b"new"}
    inbox.close(node)
    executor.remove_node(node)
    executor.shutdown()
    batch.destroy()
