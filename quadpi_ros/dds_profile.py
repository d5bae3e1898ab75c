# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""DDS as the nodes use it: qualities of service, parameters that override them, and waiting for discovery.

Discovery has two sides. A publisher that knows its subscriber may send, and the subscriber still drop what
comes because it does not know the publisher yet; on a busy machine that lasts for seconds. Each participant
tells the others of its endpoints in the order in which it made them, so a node that has answered a request
from a client made after the publishers knows them.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any, Literal

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.client import Client
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from quadpi_core.errors import QuadpiError
from quadpi_core.messages import qos

QOS_PREFIX = "qos_overrides."

# Policies that decide whether two endpoints match and how much waits between them, and the values of each.
_VALUES: dict[QoSPolicyKind, type[HistoryPolicy | ReliabilityPolicy | DurabilityPolicy] | None] = {
    QoSPolicyKind.HISTORY: HistoryPolicy,
    QoSPolicyKind.DEPTH: None,
    QoSPolicyKind.RELIABILITY: ReliabilityPolicy,
    QoSPolicyKind.DURABILITY: DurabilityPolicy,
}
_NAME = re.compile(r"qos_overrides\.(?P<topic>/[^.]+)\.(?P<end>publisher|subscription)\.(?P<policy>\w+)")
_UNKNOWN = "UNKNOWN"

_POLL_S = 0.02
# How long an answer may take until the node is asked again: a node that configures does not answer.
_ANSWER_S = 1.0
# The subscribers that are known must stay the same for so long.
_SETTLE_S = 0.2


def _profile(offered: qos.Qos) -> QoSProfile:
    return QoSProfile(
        depth=offered.depth,
        reliability=ReliabilityPolicy.RELIABLE if offered.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if offered.latched else DurabilityPolicy.VOLATILE,
    )


SENSOR_QOS, OUTPUT_QOS, LOG_QOS = (_profile(offered) for offered in (qos.SENSOR, qos.OUTPUT, qos.LOG))

# As tf2 offers and hears static transforms.
TRANSFORMS_QOS = QoSProfile(
    depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)


class QosOverrideError(QuadpiError):
    """A parameter `qos_overrides` names no policy, or gives it no value."""


def check_overrides(node: Node) -> None:
    """Refuse overrides that rclpy would stumble over, or pass over.

    Any topic may be named: a parameter file for several nodes holds those of the others too.

    Args:
        node: whose parameters are declared.

    Raises:
        QosOverrideError: naming the parameter.
    """
    # rclpy declares that it gives values; it gives parameters.
    given: Mapping[str, Any] = node.get_parameters_by_prefix(QOS_PREFIX[:-1])
    for name, parameter in given.items():
        _check(f"node {node.get_name()}: parameter `{QOS_PREFIX}{name}`", QOS_PREFIX + name, parameter.value)


def _check(where: str, name: str, value: Any) -> None:
    match = _NAME.fullmatch(name)
    kinds = {kind.name.lower(): kind for kind in _VALUES}
    if match is None or match["policy"] not in kinds:
        raise QosOverrideError(
            f"{where} is none of {QOS_PREFIX}/TOPIC.publisher.POLICY and "
            f"{QOS_PREFIX}/TOPIC.subscription.POLICY, where POLICY is {', '.join(kinds)}"
        )
    values = _VALUES[kinds[match["policy"]]]
    if values is None:
        if type(value) is not int or value < 1:
            raise QosOverrideError(f"{where} must be a positive integer, found {value!r}")
        return
    names = [item.lower() for item in values.__members__ if item != _UNKNOWN]
    if value not in names:
        raise QosOverrideError(f"{where} must be one of {', '.join(names)}, found {value!r}")


def overridden(
    node: Node,
    end: Literal["publisher", "subscription"],
    topic: str,
    default: QoSProfile | int,
    options: dict[str, Any],
) -> tuple[QoSProfile | int, dict[str, Any]]:
    """The quality of service to create an endpoint with, and further options, where parameters override it.

    Args:
        node: whose overrides :func:`check_overrides` has accepted.
        end: of the topic.
        topic: as it is given to rclpy.
        default: quality of service; left as it is.
        options: of the function that creates the endpoint.
    """
    prefix = f"{QOS_PREFIX}{node.resolve_topic_name(topic)}.{end}"
    kinds = [kind for kind in _VALUES if node.has_parameter(f"{prefix}.{kind.name.lower()}")]
    if not kinds:
        return default, options
    profile = QoSProfile(depth=default) if isinstance(default, int) else copy(default)
    return profile, {**options, "qos_overriding_options": QoSOverridingOptions(kinds)}


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
