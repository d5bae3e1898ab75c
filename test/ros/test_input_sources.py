# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to messages of packages that quadpi does not need: absent, pretended, and really built."""

import sys
from types import ModuleType

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rosbags.typesys import get_types_from_msg
from sensor_msgs.msg import Imu
from std_msgs.msg import Byte
from trajectory_msgs.msg import MultiDOFJointTrajectory

from quadpi_core.errors import LogError
from quadpi_core.messages.adapters import AdapterSettings
from quadpi_core.messages.adapters.adapter_settings import RotorSettings
from quadpi_core.messages.definitions import typestore
from quadpi_core.vehicle import Vehicle
from quadpi_ros.input_sources import (
    AdaptedSources,
    AdapterError,
    Source,
    adapted_source,
    definition_of,
    message_class,
)

from ..core.messages.adapters.vendor_messages import DEFINITIONS, Messages

STATUS, REPORT = "px4_msgs/msg/EscStatus", "px4_msgs/msg/EscReport"
SETTINGS = AdapterSettings(rotor_speeds=RotorSettings((1, 2, 3, 4), "rpm"))


@pytest.mark.parametrize("kind", [DiagnosticArray, Odometry, Imu, Byte, MultiDOFJointTrajectory])
def test_definition_of_an_installed_message_is_that_of_its_package(kind):
    package = kind.__module__.partition(".")[0]
    found = get_types_from_msg(definition_of(kind), f"{package}/msg/{kind.__name__}")
    assert found
    for name, (_, fields) in found.items():
        assert fields == typestore().fielddefs[name][1]


def test_package_or_message_that_is_not_installed():
    with pytest.raises(AdapterError, match=r"px4_msgs/msg/EscStatus: the package px4_msgs .* not installed"):
        adapted_source("px4_status", SETTINGS, None)
    with pytest.raises(AdapterError, match="std_msgs/msg/Nothing"):
        message_class("std_msgs/msg/Nothing")


@pytest.fixture
def messages(monkeypatch):
    """px4_msgs as if it were installed: classes that name their fields as generated ones do."""
    found = Messages(DEFINITIONS)
    fields = {
        REPORT: {"timestamp": "uint64", "esc_errorcount": "uint32", "esc_rpm": "int32"}
        | dict.fromkeys(("esc_voltage", "esc_current", "esc_temperature"), "float")
        | dict.fromkeys(("esc_address", "esc_cmdcount", "esc_state", "actuator_function"), "uint8")
        | {"failures": "uint16", "esc_power": "int8"},
        STATUS: {"timestamp": "uint64", "counter": "uint16"}
        | dict.fromkeys(("esc_count", "esc_connectiontype", "esc_online_flags", "esc_armed_flags"), "uint8")
        | {"esc": "px4_msgs/EscReport[8]"},
    }
    module = ModuleType("px4_msgs.msg")
    for name, columns in fields.items():
        stem = name.rpartition("/")[2]
        kind = type(stem, (), {"get_fields_and_field_types": classmethod(lambda _, columns=columns: columns)})
        setattr(module, stem, kind)
    monkeypatch.setitem(sys.modules, "px4_msgs", ModuleType("px4_msgs"))
    monkeypatch.setitem(sys.modules, "px4_msgs.msg", module)
    return found


def esc_status(messages, stamp_us, rpm):
    reports = [messages.make(REPORT)] * 8
    for motor, value in enumerate(rpm, start=1):
        reports[motor] = messages.make(
            REPORT, timestamp=stamp_us, esc_rpm=value, actuator_function=100 + motor
        )
    status = messages.make(STATUS, timestamp=stamp_us, esc_online_flags=255, esc=reports)
    return messages.bytes(status)


def test_message_by_message_and_why_one_is_no_sample(messages):
    subscription = adapted_source("px4_status", SETTINGS, None)
    assert subscription.message_type is sys.modules["px4_msgs.msg"].EscStatus
    assert subscription.topic == "fmu/out/esc_status"
    stream = subscription.unpack(esc_status(messages, 1000, [60, 120, 180, 240]))
    np.testing.assert_allclose(stream.speeds[0], 2.0 * np.pi * np.arange(1, 5))
    for _ in range(2):
        with pytest.raises(LogError, match=r"^no report is new$"):
            subscription.unpack(esc_status(messages, 1000, [60, 120, 180, 240]))
    with pytest.raises(LogError, match=r"^no report is of a motor that `rotors` names$"):
        subscription.unpack(esc_status(messages, 3000, [60, 120, 180]))
    with pytest.raises(LogError, match="sample 0: its 4 bytes are no px4_msgs/msg/EscStatus"):
        subscription.unpack(b"\x00\x00\x00\x00")


def test_a_standard_topic_in_the_file_is_given_as_a_launch_argument(tmp_path):
    """Nothing tells a node the type of a topic: messages of PX4 would be expected on it."""
    file = tmp_path / "field.yaml"
    file.write_text("imu: {topic: /mavros/imu/data}\n")
    sources = AdaptedSources("monitor", str(file), Vehicle.load("bebop2"))
    with pytest.raises(AdapterError, match=r"`imu`: topic /mavros/imu/data: .*imu_topic:=/mavros/imu/data"):
        sources.instead_of(Source(Imu, "imu", bytes), "imu")
