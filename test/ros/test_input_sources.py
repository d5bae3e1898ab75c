# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to messages of packages that quadpi does not need: absent, pretended, and really built."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any, cast

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from quadpi.msg import RotorSpeeds
from rclpy.node import Node
from rosbags.typesys import get_types_from_msg
from sensor_msgs.msg import Imu
from std_msgs.msg import Byte
from trajectory_msgs.msg import MultiDOFJointTrajectory

from quadpi_core.errors import LogError, SampleError
from quadpi_core.flight import BatteryStream, MotorCommandStream, RotorSpeedStream
from quadpi_core.messages.adapters import AdapterSettings
from quadpi_core.messages.adapters.adapter_settings import RotorSettings
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.sensor_messages import pack_rotor_speeds, unpack_odometry, unpack_rotor_speeds
from quadpi_core.monitor import Monitor
from quadpi_core.vehicle import Motors, Vehicle
from quadpi_ros.callbacks import SENSOR_QOS, await_subscribers
from quadpi_ros.input_sources import (
    AdaptedSources,
    AdapterError,
    CommandedRotors,
    Inbox,
    Source,
    adapted_source,
    command_sources,
    definition_of,
    message_class,
)

from ..core.messages.adapters.vendor_messages import DEFINITIONS, Messages
from .rig import wait_until

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


# Messages are taken when they are asked for, in order, each once.


@pytest.fixture
def node(ros: None) -> Iterator[Node]:
    del ros
    node = Node("inbox")
    yield node
    node.destroy_node()


def test_what_came_is_taken_once_and_in_order(node):
    inbox = Inbox(node, RotorSpeeds, "/rotor_speeds")
    assert inbox.take() == []
    publisher = node.create_publisher(RotorSpeeds, "/rotor_speeds", SENSOR_QOS)
    await_subscribers(node, [publisher], 20.0)
    stamps = np.arange(1, 101, dtype=np.int64) * 2_000_000
    for payload in pack_rotor_speeds(RotorSpeedStream(stamps, np.full((100, 4), 700.0))):
        publisher.publish(payload)
    taken: list[int] = []

    def take() -> None:
        rotors = inbox.unpacked(unpack_rotor_speeds)
        taken.extend([] if rotors is None else rotors.time_ns.tolist())

    wait_until(lambda: len(taken) == 100, take, lambda: len(taken))
    assert taken == stamps.tolist()
    assert inbox.count == 100
    assert inbox.unpacked(unpack_rotor_speeds) is None


def test_bytes_of_another_type_are_refused(node):
    inbox = Inbox(node, RotorSpeeds, "/rotor_speeds")
    publisher = node.create_publisher(RotorSpeeds, "/rotor_speeds", SENSOR_QOS)
    await_subscribers(node, [publisher], 20.0)
    publisher.publish(RotorSpeeds())

    def refused() -> bool:
        try:
            return inbox.unpacked(unpack_odometry) is not None
        except SampleError:
            return True

    wait_until(refused)
    assert inbox.count == 1


# Which rotor speeds count: by commands always, or while measured ones are silent.


MOTORS = Motors(source="px4_motors", coefficients=((0.0, 1000.0, 0.0, 10.0, 0.0),) * 4, lag_s=0.0, volts=15.0)
FALLBACK = cast("Monitor", object())


def commanded(seconds: float) -> MotorCommandStream:
    return MotorCommandStream(np.array([round(1e9 * seconds)]), np.full((1, 4), 0.5))


def measured(seconds: float) -> RotorSpeedStream:
    return RotorSpeedStream(np.array([round(1e9 * seconds)]), np.full((1, 4), 650.0))


def counting(rotors: CommandedRotors, begin: float, end: float, **given: bool) -> list[bool]:
    """Whether commands count, each 50 ms."""
    found = []
    for seconds in np.arange(begin, end, 0.05).tolist():
        if given.get("telemetry", True):
            rotors.take_measured(measured(seconds))
        rotors.take_commands(commanded(seconds + 0.01))
        found.append(rotors.counts)
    return found


def test_a_model_of_commands_flies_by_them_and_hears_the_battery() -> None:
    rotors = CommandedRotors(MOTORS)
    assert rotors.take_commands(commanded(1.0)).speeds[0, 0] == pytest.approx(650.0)
    rotors.take_battery(BatteryStream(np.array([10**9]), np.array([10.0])))
    assert rotors.take_commands(commanded(1.1)).speeds[0, 0] == pytest.approx(600.0)
    assert not rotors.take_measured(measured(1.2))
    assert rotors.counts


def test_a_fallback_counts_after_silence_until_telemetry_came_again_for_a_second() -> None:
    rotors = CommandedRotors(MOTORS, FALLBACK)
    assert not any(counting(rotors, 1.0, 2.0))
    silent = counting(rotors, 2.0, 3.0, telemetry=False)
    assert silent.index(True) == pytest.approx(6, abs=1)  # 0.3 s
    back = counting(rotors, 3.0, 5.0)
    assert back.index(False) == pytest.approx(20, abs=1)  # 1 s
    assert not any(back[back.index(False) :])


def test_a_fallback_counts_where_telemetry_never_came() -> None:
    assert counting(CommandedRotors(MOTORS, FALLBACK), 1.0, 2.0, telemetry=False)[-1]


def test_a_fallback_counts_as_soon_in_a_flight_that_is_played_again() -> None:
    rotors = CommandedRotors(MOTORS, FALLBACK)
    assert not any(counting(rotors, 100.0, 102.0))
    assert counting(rotors, 10.0, 11.0, telemetry=False).index(True) == pytest.approx(6, abs=1)
    back = counting(rotors, 1.0, 3.0)
    assert back.index(False) == pytest.approx(20, abs=1)


def test_commands_that_no_message_holds_ask_for_a_topic() -> None:
    adapted = AdaptedSources("monitor", "", Vehicle.load("neurobem"))
    other: Any = Motors(source="crazyflie pwm", coefficients=MOTORS.coefficients, lag_s=0.0)
    with pytest.raises(LogError, match=r"of crazyflie pwm, which no message holds: .* command_topic"):
        command_sources(adapted, other, "")
