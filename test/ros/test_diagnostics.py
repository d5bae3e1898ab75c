# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Statuses for /diagnostics: what is said of a topic, and of which vehicle."""

from __future__ import annotations

from typing import Any

import pytest
from sensor_msgs.msg import Imu

from quadpi_core.monitor.health import TopicReport
from quadpi_ros import callbacks
from quadpi_ros.callbacks import ERROR, OK, WARN
from quadpi_ros.estimator_node import EstimatorNode

from .rig import started, values_of

SOUND = {
    "samples": 500,
    "total": 4000,
    "rate_hz": 499.6,
    "stamp_rate_hz": 500.0,
    "gaps": 0,
    "longest_gap_s": 0.0,
    "newest_ns": 7,
    "refused_now": 0,
    "refused": {},
}
REFUSED = {"refused_now": 3, "refused": {"no unit quaternion": 3, "stamp jumped": 2}}


def status_of(report: dict[str, Any], **given: Any) -> Any:
    """The status of a topic that is required, whose nominal rate is 500 Hz."""
    settings: dict[str, Any] = {"required": True, "rate_hz": 500.0, "mismatch": None, "values": {}}
    return callbacks.topic_status("imu", TopicReport(**SOUND | report), **settings | given)


@pytest.mark.parametrize(
    ("report", "given", "level", "message"),
    [
        ({}, {}, OK, "500 Hz"),
        ({"samples": 0}, {}, ERROR, "nothing arrives"),
        ({"samples": 0}, {"required": False}, OK, "nothing arrives"),
        ({"samples": 0}, {"mismatch": "other type"}, ERROR, "other type"),
        # One that is heard by now is no mismatch any more.
        ({}, {"mismatch": "other type"}, OK, "500 Hz"),
        ({"stamp_rate_hz": 400.0}, {}, ERROR, "stamps say 400 Hz, imu_rate_hz is 500: set it to 0"),
        ({"stamp_rate_hz": 400.0}, {"rate_hz": None}, OK, "500 Hz"),
        (REFUSED, {}, WARN, "3 samples refused in the last second"),
        ({"samples": 0, **REFUSED}, {}, WARN, "3 samples refused in the last second"),
        ({"gaps": 2, "longest_gap_s": 0.25}, {}, WARN, "2 gaps, the longest 0.250 s"),
        # The worst is said.
        ({"gaps": 2, **REFUSED}, {}, WARN, "3 samples refused in the last second"),
    ],
)
def test_what_is_wrong_with_a_topic_is_said(
    report: dict[str, Any], given: dict[str, Any], level: bytes, message: str
) -> None:
    status = status_of(report, **given)
    assert (status.level, status.message) == (level, message)


@pytest.mark.parametrize(
    ("rate_hz", "samples", "differs"),
    [(545.0, 500, False), (555.0, 500, True), (445.0, 500, True), (700.0, 20, True), (700.0, 19, False)],
)
def test_stamps_of_another_rate_differ_by_a_tenth_in_twenty_samples(
    rate_hz: float, samples: int, differs: bool
) -> None:
    status = status_of({"stamp_rate_hz": rate_hz, "samples": samples})
    assert (status.level == ERROR) == differs


def test_values_are_short_and_name_every_refusal() -> None:
    given = {"stamp_age_s": 0.123456, "publishers": 2, "unknown": None}
    values = values_of(status_of({"stamp_rate_hz": None, **REFUSED}, values=given))
    assert values["samples"] == "4000"
    assert values["stamp_rate_hz"] == "unknown"
    assert (values["refused"], values["refused: stamp jumped"]) == ("5", "2")
    assert (values["stamp_age_s"], values["publishers"]) == ("0.1235", "2")


def test_a_message_type_is_named_as_in_the_graph() -> None:
    assert callbacks.type_name(Imu) == "sensor_msgs/msg/Imu"


def test_diagnostics_name_the_vehicle_and_whose_it_is(ros_domain: int) -> None:
    given = ("-p", "autostart:=false", "-p", "vehicle:=some/my-quad.yaml")
    with started(ros_domain, "-r", "__ns:=/uav1", *given):
        node = EstimatorNode()
        status = callbacks.status(callbacks.full_name(node, "state"), callbacks.OK, "", {})
        (told,) = callbacks.array(node, [status]).status
        node.destroy_node()
    assert (told.name, told.hardware_id) == ("uav1/estimator: state", "uav1/my-quad")
