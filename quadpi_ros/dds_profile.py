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
from quadpi_core.messages import topics as qos

QOS_PREFIX = "qos_overrides."

# The policies that may be overridden, and the type of the value of each; None is a positive integer.
_VALUES: dict[QoSPolicyKind, type[HistoryPolicy | ReliabilityPolicy | DurabilityPolicy] | None] = {
    QoSPolicyKind.HISTORY: HistoryPolicy,
    QoSPolicyKind.DEPTH: None,
    QoSPolicyKind.RELIABILITY: ReliabilityPolicy,
    QoSPolicyKind.DURABILITY: DurabilityPolicy,
}
_NAME = re.compile(r"/[^.]+\.(?:publisher|subscription)\.(?P<policy>\w+)")

_POLL_S = 0.02
# When a publisher knows one subscriber, others may not have found each other yet: they do within this.
_MATCHED_S = 1.0
# A node that is being configured does not answer; after this time it is asked again.
_ANSWER_S = 1.0


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
    policies = {kind.name.lower(): values for kind, values in _VALUES.items()}
    # rclpy annotates values, but returns parameters.
    given: Mapping[str, Any] = node.get_parameters_by_prefix(QOS_PREFIX[:-1])
    for name, parameter in given.items():
        where, value = f"node {node.get_name()}: parameter `{QOS_PREFIX}{name}`", parameter.value
        match = _NAME.fullmatch(name)
        if match is None or match["policy"] not in policies:
            raise QosOverrideError(
                f"{where} is none of {QOS_PREFIX}/TOPIC.publisher.POLICY and "
                f"{QOS_PREFIX}/TOPIC.subscription.POLICY, where POLICY is {', '.join(policies)}"
            )
        values = policies[match["policy"]]
        if values is None:
            right, expected = type(value) is int and value > 0, "a positive integer"
        else:
            names = [item.lower() for item in values.__members__ if item != "UNKNOWN"]
            right, expected = value in names, f"one of {', '.join(names)}"
        if not right:
            raise QosOverrideError(f"{where} must be {expected}, found {value!r}")


def overriding_options(
    node: Node, topic: str, end: Literal["publisher", "subscription"]
) -> QoSOverridingOptions:
    """For creating an endpoint: those policies for which a parameter of the node has a value."""
    prefix = f"{QOS_PREFIX}{node.resolve_topic_name(topic)}.{end}"
    return QoSOverridingOptions(
        [kind for kind in _VALUES if node.has_parameter(f"{prefix}.{kind.name.lower()}")]
    )


class DiscoveryError(QuadpiError):
    """No subscriber was found in time."""


def await_listeners(
    node: Node, publishers: Sequence[Publisher], managed: Sequence[str], wait_s: float
) -> None:
    """Wait until the managed nodes are active and every publisher has a subscriber.

    Args:
        node: owns the publishers; on no executor.
        publishers: each needs at least one subscriber.
        managed: names of lifecycle nodes, relative to the namespace of `node`. They know the publishers.
        wait_s: timeout.

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
        if managed:
            time.sleep(_MATCHED_S)
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


def await_subscribers(node: Node, publishers: Sequence[Publisher], wait_s: float) -> None:
    """Wait until every publisher has a subscriber.

    Args:
        node: owns the publishers.
        publishers: to connect.
        wait_s: timeout.

    Raises:
        DiscoveryError: on timeout, naming the topics without a subscriber.
    """
    deadline = time.monotonic() + wait_s
    while node.context.ok():
        lonely = sorted(one.topic_name for one in publishers if one.get_subscription_count() == 0)
        if not lonely:
            return
        if time.monotonic() > deadline:
            raise DiscoveryError(f"nobody subscribed to {', '.join(lonely)} in time")
        time.sleep(_POLL_S)
