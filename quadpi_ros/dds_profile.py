# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Wait until those who shall hear a publisher hear it.

Discovery has two sides. A publisher that knows its subscriber may send, and the subscriber still drop what
comes because it does not know the publisher yet; on a busy machine that lasts for seconds. Each participant
tells the others of its endpoints in the order in which it made them, so a node that has answered a request
from a client made after the publishers knows them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.client import Client
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher

from quadpi_core.errors import QuadpiError

_POLL_S = 0.02
# How long an answer may take until the node is asked again: a node that configures does not answer.
_ANSWER_S = 1.0
# The subscribers that are known must stay the same for so long.
_SETTLE_S = 0.2


class DiscoveryError(QuadpiError):
    """Nobody listens."""


def await_listeners(
    node: Node, publishers: Sequence[Publisher], managed: Sequence[str], wait_s: float
) -> None:
    """Wait until the managed nodes are active and every publisher is connected to all its subscribers.

    Args:
        node: of the publishers; on no executor.
        publishers: each needs a subscriber.
        managed: names of lifecycle nodes, relative to the namespace of `node`.
        wait_s: how long to wait.

    Raises:
        DiscoveryError: naming what is missing when the time is over.
    """
    deadline = time.monotonic() + wait_s
    executor = EventsExecutor(context=node.context)
    executor.add_node(node)
    try:
        for name in managed:
            client = node.create_client(GetState, f"{name}/get_state")
            _await_active(node, executor, client, name, deadline)
            node.destroy_client(client)
    finally:
        executor.remove_node(node)
        executor.shutdown()
    await_subscribers(node, publishers, deadline - time.monotonic())


def _await_active(node: Node, executor: EventsExecutor, client: Client, name: str, deadline: float) -> None:
    while node.context.ok():
        if time.monotonic() > deadline:
            raise DiscoveryError(f"node {name} does not run, or is not active")
        if client.service_is_ready():
            answer = client.call_async(GetState.Request())
            executor.spin_until_future_complete(answer, timeout_sec=_ANSWER_S)
            if answer.done() and answer.result().current_state.id == State.PRIMARY_STATE_ACTIVE:
                return
            client.remove_pending_request(answer)
        time.sleep(_POLL_S)


def await_subscribers(node: Node, publishers: Sequence[Publisher], wait_s: float) -> None:
    """Wait until every publisher is connected to all its subscribers, of which each needs one.

    Args:
        node: of the publishers.
        publishers: to be heard.
        wait_s: how long to wait.

    Raises:
        DiscoveryError: naming the topics that nobody hears when the time is over.
    """
    settled_s, before = time.monotonic(), _connections(node, publishers)
    deadline = settled_s + wait_s
    while node.context.ok():
        now_s = time.monotonic()
        connections = _connections(node, publishers)
        if connections != before or any(not 0 < heard == known for heard, known in connections):
            settled_s, before = now_s, connections
        if now_s - settled_s >= _SETTLE_S:
            return
        if now_s > deadline:
            lonely = [
                publisher.topic_name
                for publisher, (heard, known) in zip(publishers, connections, strict=True)
                if not 0 < heard == known
            ]
            raise DiscoveryError(f"nobody subscribed to {', '.join(sorted(lonely))} in time")
        time.sleep(_POLL_S)


def _connections(node: Node, publishers: Sequence[Publisher]) -> list[tuple[int, int]]:
    """Per publisher, how many subscribers it is connected to and how many are known."""
    return [
        (publisher.get_subscription_count(), node.count_subscribers(publisher.topic_name))
        for publisher in publishers
    ]
