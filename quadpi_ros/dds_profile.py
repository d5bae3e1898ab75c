# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""DDS as the nodes use it: qualities of service, parameters that override them, and waiting for discovery.

Discovery has two sides: a publisher may already know a subscriber that does not know the publisher yet and
drops its messages, on a busy machine for seconds. A participant announces its endpoints in the order of their
creation. So a node that has answered a request of a client created after the publishers knows the publishers.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any, Literal

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from quadpi_core.errors import QuadpiError
from quadpi_core.messages import topics as qos

QOS_PREFIX = "qos_overrides."

# The policies that may be overridden, and the type of the value of each; None is a positive integer.
_VALUES: dict[QoSPolicyKind, type[HistoryPolicy | ReliabilityPolicy | DurabilityPolicy] | None] = {
    QoSPolicyKind.HISTORY: HistoryPolicy,
    QoSPolicyKind.DEPTH: None,
    QoSPolicyKind.RELIABILITY: ReliabilityPolicy,
    QoSPolicyKind.DURABILITY: DurabilityPolicy,
}
_NAME = re.compile(r"qos_overrides\.(?P<topic>/[^.]+)\.(?P<end>publisher|subscription)\.(?P<policy>\w+)")
_UNKNOWN = "UNKNOWN"

_POLL_S = 0.02
# A node that is being configured does not answer; after this time it is asked again.
_ANSWER_S = 1.0
# Discovery is taken as finished when the known subscribers have not changed for this time.
_SETTLE_S = 0.2
# A node that subscribes may take this long to answer; one whose parameter services are not found in a second
# has none, as a node announces them before its subscriptions.
_ANSWERS_S = 10.0
_SERVICES_S = 1.0


def _profile(offered: qos.Qos) -> QoSProfile:
    return QoSProfile(
        depth=offered.depth,
        reliability=ReliabilityPolicy.RELIABLE if offered.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if offered.latched else DurabilityPolicy.VOLATILE,
    )


SENSOR_QOS, OUTPUT_QOS, LOG_QOS = (_profile(offered) for offered in (qos.SENSOR, qos.OUTPUT, qos.LOG))

# Whoever subscribes late gets the present one.
DESCRIPTION_QOS = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)

# Quality of service of static transforms in tf2.
TRANSFORMS_QOS = QoSProfile(
    depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)


class QosOverrideError(QuadpiError):
    """A `qos_overrides` parameter has an unknown name or an invalid value."""


def check_overrides(node: Node) -> None:
    """Refuse invalid `qos_overrides`: rclpy raises deep inside for a wrong value and ignores a wrong name.

    Any topic is accepted, as a parameter file for several nodes names the topics of all of them.

    Args:
        node: its parameters are declared.

    Raises:
        QosOverrideError: naming the parameter.
    """
    # rclpy annotates values, but returns parameters.
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
    """Quality of service and options for creating an endpoint, with the overrides of its topic applied.

    Args:
        node: its overrides were accepted by :func:`check_overrides`.
        end: kind of the endpoint.
        topic: name as given to rclpy.
        default: quality of service without overrides.
        options: of the function that creates the endpoint.
    """
    prefix = f"{QOS_PREFIX}{node.resolve_topic_name(topic)}.{end}"
    kinds = [kind for kind in _VALUES if node.has_parameter(f"{prefix}.{kind.name.lower()}")]
    if not kinds:
        return default, options
    profile = QoSProfile(depth=default) if isinstance(default, int) else copy(default)
    return profile, {**options, "qos_overriding_options": QoSOverridingOptions(kinds)}


class DiscoveryError(QuadpiError):
    """No subscriber was found in time."""


def await_listeners(
    node: Node, publishers: Sequence[Publisher], managed: Sequence[str], wait_s: float
) -> list[str]:
    """Wait until the managed nodes are active and every publisher is connected to all its subscribers.

    Connected is a subscriber whose node has answered; a node that does not answer is waited for
    :data:`_ANSWERS_S` at most.

    Args:
        node: owns the publishers; on no executor.
        publishers: each needs at least one subscriber.
        managed: names of lifecycle nodes, relative to the namespace of `node`.
        wait_s: timeout.

    Returns:
        Full names of subscribing nodes that did not answer: they may miss the first messages.

    Raises:
        DiscoveryError: on timeout, naming what is missing.
    """
    deadline = time.monotonic() + wait_s
    executor = EventsExecutor(context=node.context)
    executor.add_node(node)
    try:
        for name in managed:
            client = node.create_client(GetState, f"{name}/get_state")
            _await_active(node, executor, client, name, deadline)
            node.destroy_client(client)
        await_subscribers(node, publishers, deadline - time.monotonic())
        return _await_answers(node, executor, publishers, deadline)
    finally:
        executor.remove_node(node)
        executor.shutdown()


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


def _await_answers(
    node: Node, executor: EventsExecutor, publishers: Sequence[Publisher], deadline: float
) -> list[str]:
    """Ask every node that subscribes for no parameters, and give the names of those that do not answer."""
    own = node.get_fully_qualified_name()
    names = {
        f"{one.node_namespace.rstrip('/')}/{one.node_name}"
        for publisher in publishers
        for one in node.get_subscriptions_info_by_topic(publisher.topic_name)
    }
    clients = {name: node.create_client(GetParameters, f"{name}/get_parameters") for name in names - {own}}
    begun_s, silent = time.monotonic(), sorted(clients)
    while silent and node.context.ok() and time.monotonic() < min(deadline, begun_s + _ANSWERS_S):
        ready = [name for name in silent if clients[name].service_is_ready()]
        if not ready and time.monotonic() > begun_s + _SERVICES_S:
            break
        for name in ready:
            # An answer is lost where the server does not know this client yet: then it is asked again.
            answer = clients[name].call_async(GetParameters.Request())
            executor.spin_until_future_complete(answer, timeout_sec=_ANSWER_S / len(ready))
            clients[name].remove_pending_request(answer)
            if answer.done():
                silent.remove(name)
        time.sleep(_POLL_S)
    for client in clients.values():
        node.destroy_client(client)
    return silent


def await_subscribers(node: Node, publishers: Sequence[Publisher], wait_s: float) -> None:
    """Wait until every publisher is connected to all its known subscribers, and to at least one.

    Args:
        node: owns the publishers.
        publishers: to connect.
        wait_s: timeout.

    Raises:
        DiscoveryError: on timeout, naming the topics without a subscriber.
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
    """Connected and known subscribers of each publisher."""
    return [
        (publisher.get_subscription_count(), node.count_subscribers(publisher.topic_name))
        for publisher in publishers
    ]
