# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages for `/diagnostics`: statuses of nodes and of their topics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.parameter import Parameter

from quadpi_core.monitor.health import TopicReport

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)

# A relative error of the rate moves the cut-off of a low-pass by as much.
_RATE_TOLERANCE = 0.1
# With fewer samples the rate of the stamps is too uncertain to judge.
_RATE_SAMPLES_MIN = 20


def array(node: Node, statuses: Sequence[DiagnosticStatus]) -> DiagnosticArray:
    """Message with the statuses of a node, stamped now.

    Sets their `hardware_id` to the node's namespace and the name of its vehicle file, as several vehicles may
    share a file.

    Args:
        node: its parameter `vehicle` is the file.
        statuses: to send.
    """
    vehicle = Path(node.get_parameter_or("vehicle", Parameter("vehicle", value="")).value).stem
    for one in statuses:
        one.hardware_id = f"{node.get_namespace()}/{vehicle}".lstrip("/")
    message = DiagnosticArray(status=list(statuses))
    message.header.stamp = node.get_clock().now().to_msg()
    return message


def full_name(node: Node, name: str) -> str:
    """Name of a status, preceded by that of its node."""
    return f"{node.get_fully_qualified_name().lstrip('/')}: {name}"


def type_name(message_type: Any) -> str:
    """Name of a message type in the ROS graph, such as `sensor_msgs/msg/Imu`."""
    return f"{message_type.__module__.partition('.')[0]}/msg/{message_type.__name__}"


def status(name: str, level: bytes, message: str, values: Mapping[str, Any]) -> DiagnosticStatus:
    """A status; floats are rounded to four digits."""
    return DiagnosticStatus(
        name=name,
        level=level,
        message=message,
        values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
    )


def topic_status(
    name: str,
    report: TopicReport,
    *,
    required: bool,
    rate_hz: float | None,
    mismatch: str | None,
    values: Mapping[str, Any],
) -> DiagnosticStatus:
    """Status of a subscribed topic.

    Args:
        name: of the status.
        report: health of the topic since the last status.
        required: whether silence is an error.
        rate_hz: nominal rate, if one is set.
        mismatch: why a publisher is incompatible.
        values: further values to report.
    """
    level, message = OK, f"{report.rate_hz:.0f} Hz"
    if report.samples == 0 and mismatch:
        level, message = ERROR, mismatch
    elif report.samples == 0 and report.refused_now == 0:
        level, message = (ERROR if required else OK), "nothing arrives"
    elif _other_rate(report, rate_hz):
        level = ERROR
        message = f"stamps say {report.stamp_rate_hz:.0f} Hz, imu_rate_hz is {rate_hz:g}: set it to 0"
    elif report.refused_now:
        level, message = WARN, f"{report.refused_now} samples refused in the last second"
    elif report.gaps:
        level, message = WARN, f"{report.gaps} gaps, the longest {report.longest_gap_s:.3f} s"
    topic: dict[str, Any] = {
        "samples": report.total,
        "rate_hz": report.rate_hz,
        "stamp_rate_hz": report.stamp_rate_hz,
        "gaps": report.gaps,
        "longest_gap_s": report.longest_gap_s,
        "refused": sum(report.refused.values()),
    }
    topic |= {f"refused: {reason}": count for reason, count in report.refused.items()}
    return status(name, level, message, topic | dict(values))


def _other_rate(report: TopicReport, rate_hz: float | None) -> bool:
    if rate_hz is None or report.stamp_rate_hz is None or report.samples < _RATE_SAMPLES_MIN:
        return False
    return abs(report.stamp_rate_hz / rate_hz - 1.0) > _RATE_TOLERANCE


def _text(value: Any) -> str:
    if value is None:
        return "unknown"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
