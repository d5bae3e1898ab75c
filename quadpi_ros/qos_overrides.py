# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The standard parameters `qos_overrides.TOPIC.publisher.POLICY` and `….subscription.POLICY` of a node.

rclpy leaves them to nodes that ask for them, reads a wrong one as an exception deep inside, and a misspelt
one not at all.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from copy import copy
from typing import Any, Literal

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from quadpi_core.errors import QuadpiError

PREFIX = "qos_overrides."

# Policies that decide whether two endpoints match and how much waits between them, and the values of each.
_VALUES: dict[QoSPolicyKind, type[HistoryPolicy | ReliabilityPolicy | DurabilityPolicy] | None] = {
    QoSPolicyKind.HISTORY: HistoryPolicy,
    QoSPolicyKind.DEPTH: None,
    QoSPolicyKind.RELIABILITY: ReliabilityPolicy,
    QoSPolicyKind.DURABILITY: DurabilityPolicy,
}
_NAME = re.compile(r"qos_overrides\.(?P<topic>/[^.]+)\.(?P<end>publisher|subscription)\.(?P<policy>\w+)")
_UNKNOWN = "UNKNOWN"


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
    given: Mapping[str, Any] = node.get_parameters_by_prefix(PREFIX[:-1])
    for name, parameter in given.items():
        _check(f"node {node.get_name()}: parameter `{PREFIX}{name}`", PREFIX + name, parameter.value)


def _check(where: str, name: str, value: Any) -> None:
    match = _NAME.fullmatch(name)
    kinds = {kind.name.lower(): kind for kind in _VALUES}
    if match is None or match["policy"] not in kinds:
        raise QosOverrideError(
            f"{where} is none of {PREFIX}/TOPIC.publisher.POLICY and {PREFIX}/TOPIC.subscription.POLICY, "
            f"where POLICY is {', '.join(kinds)}"
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
    qos: QoSProfile | int,
    options: dict[str, Any],
) -> tuple[QoSProfile | int, dict[str, Any]]:
    """The quality of service to create an endpoint with, and further options, where parameters override it.

    Args:
        node: whose overrides :func:`check_overrides` has accepted.
        end: of the topic.
        topic: as it is given to rclpy.
        qos: by default; left as it is.
        options: of the function that creates the endpoint.
    """
    prefix = f"{PREFIX}{node.resolve_topic_name(topic)}.{end}"
    kinds = [kind for kind in _VALUES if node.has_parameter(f"{prefix}.{kind.name.lower()}")]
    if not kinds:
        return qos, options
    profile = QoSProfile(depth=qos) if isinstance(qos, int) else copy(qos)
    return profile, {**options, "qos_overriding_options": QoSOverridingOptions(kinds)}
