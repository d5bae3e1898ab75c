# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Waiting for subscribers and managed nodes: what is missing is named."""

from __future__ import annotations

import threading
from contextlib import contextmanager

import pytest
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu

from quadpi_ros.callbacks import SENSOR_QOS, DiscoveryError, await_listeners, await_subscribers

pytestmark = pytest.mark.usefixtures("ros")
# Long enough that discovery has settled, with nothing to find.
SHORT_S = 0.5
LONG_S = 60.0


@contextmanager
def spun(node):
    """A node that a thread of its own serves."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join()
        node.destroy_node()


@pytest.fixture
def node():
    with_publishers = Node("sender")
    yield with_publishers
    with_publishers.destroy_node()


def test_topics_without_a_subscriber_are_named(node):
    node.create_subscription(Imu, "heard", lambda _: None, SENSOR_QOS)
    publishers = [node.create_publisher(Imu, name, SENSOR_QOS) for name in ("heard", "unheard", "neither")]
    await_subscribers(node, publishers[:1], LONG_S)
    with pytest.raises(DiscoveryError, match=r"^nobody subscribed to /neither, /unheard in time$"):
        await_subscribers(node, publishers, SHORT_S)


def test_a_node_that_does_not_run_is_named(node):
    with pytest.raises(DiscoveryError, match=r"^node estimator does not run, or is not active$"):
        await_listeners(node, [], ["estimator"], SHORT_S)


@pytest.mark.parametrize("state", [State.PRIMARY_STATE_INACTIVE, State.PRIMARY_STATE_ACTIVE])
def test_a_node_that_runs_must_be_active(node, state):
    """The one that is asked is served by a thread of its own."""
    managed = Node("managed")

    def answer(_, response):
        response.current_state.id = state
        return response

    managed.create_service(GetState, "estimator/get_state", answer)
    managed.create_subscription(Imu, "imu", lambda _: None, SENSOR_QOS)
    with spun(managed):
        publisher = node.create_publisher(Imu, "imu", SENSOR_QOS)
        if state == State.PRIMARY_STATE_ACTIVE:
            await_listeners(node, [publisher], ["estimator"], LONG_S)
            assert publisher.get_subscription_count() == 1
        else:
            with pytest.raises(DiscoveryError, match="node estimator does not run, or is not active"):
                await_listeners(node, [publisher], ["estimator"], 3.0 * SHORT_S)
