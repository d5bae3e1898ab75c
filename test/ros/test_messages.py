# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The generated messages: every field survives serialisation and the way over DDS."""

from __future__ import annotations

from array import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3, Wrench
from quadpi import msg as quadpi_msg
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header

from .rig import wait_until

MESSAGES = ("AlarmEvent", "Erpm", "ExtrapolationAlarm", "RotorSpeeds", "WrenchPrediction")


def filled(message_type: type) -> Any:
    """A message with another value in every field."""
    rng = np.random.default_rng(4)
    values = {
        "std_msgs/Header": lambda: Header(stamp=Time(sec=7, nanosec=123), frame_id="base_link"),
        "double": lambda: float(rng.normal()),
        "double[3]": lambda: rng.normal(size=3),
        "sequence<double>": lambda: array("d", rng.normal(size=6)),
        "geometry_msgs/Wrench": lambda: Wrench(
            force=Vector3(x=rng.normal(), y=rng.normal(), z=rng.normal()),
            torque=Vector3(x=rng.normal(), y=rng.normal(), z=rng.normal()),
        ),
        "double[6]": lambda: rng.normal(size=6),
        "string": lambda: "bebop2-0123456789ab",
        "sequence<string>": lambda: ["mu_x", "omega_avg"],
        "builtin_interfaces/Time": lambda: Time(sec=8, nanosec=9),
        "uint32": lambda: int(rng.integers(1, 64)),
        "uint8": lambda: int(rng.integers(1, 64)),
        "uint8[3]": lambda: rng.integers(1, 4, size=3, dtype=np.uint8),
    }
    return message_type(
        **{name: values[kind]() for name, kind in message_type.get_fields_and_field_types().items()}
    )


@pytest.mark.parametrize("name", MESSAGES)
def test_serialisation_keeps_every_field(name: str) -> None:
    message_type = getattr(quadpi_msg, name)
    message = filled(message_type)
    assert message != message_type()
    assert deserialize_message(serialize_message(message), message_type) == message


@pytest.mark.parametrize("name", MESSAGES)
@pytest.mark.usefixtures("ros")
def test_dds_delivers_what_was_published(name: str) -> None:
    message_type = getattr(quadpi_msg, name)
    message = filled(message_type)
    received: list[Any] = []
    node = rclpy.create_node("roundtrip")
    try:
        node.create_subscription(message_type, "topic", received.append, qos_profile_sensor_data)
        publisher = node.create_publisher(message_type, "topic", 10)

        def turn() -> None:
            publisher.publish(message)
            rclpy.spin_once(node, timeout_sec=0.05)

        wait_until(lambda: received, turn)
    finally:
        node.destroy_node()
    assert received[0] == message


def test_alarm_constants_are_distinct_bits() -> None:
    alarm = quadpi_msg.ExtrapolationAlarm
    assert (alarm.EXTRAPOLATION, alarm.MISCOVERAGE, alarm.BAD_DATA) == (1, 2, 4)
    assert (alarm.LEVEL_OK, alarm.LEVEL_WARNING, alarm.LEVEL_ALARM) == (0, 1, 2)


def test_every_definition_is_built() -> None:
    definitions = Path(__file__).parents[2] / "msg"
    assert {path.stem for path in definitions.glob("*.msg")} == set(MESSAGES)
    assert all(hasattr(quadpi_msg, name) for name in MESSAGES)


@pytest.mark.parametrize("name", MESSAGES)
def test_every_number_names_its_unit(name: str) -> None:
    definition = (Path(__file__).parents[2] / "msg" / f"{name}.msg").read_text()
    fields = [
        line for line in definition.splitlines() if line.startswith(("float64", "uint8", "geometry_msgs"))
    ]
    values = [line for line in fields if "=" not in line.split("#")[0]]
    assert values
    assert all(line.rstrip().endswith("]") for line in values)
