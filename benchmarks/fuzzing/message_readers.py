# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A valid message of every type that quadpi reads, and the function that reads it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.cdr import ANY
from quadpi_core.messages.definitions import codec
from quadpi_core.vehicle import ROTORS, Vehicle

_WITH_POLE_PAIRS = replace(Vehicle.load("neurobem"), pole_pairs=7)

UNPACKERS: dict[str, Callable[[Any], Any]] = {
    sensor_messages.IMU: sensor_messages.unpack_imu,
    sensor_messages.POSE: sensor_messages.unpack_pose,
    sensor_messages.ODOMETRY: sensor_messages.unpack_odometry,
    sensor_messages.TWIST: sensor_messages.unpack_twist,
    sensor_messages.WIND: sensor_messages.unpack_wind,
    sensor_messages.ROTOR_SPEEDS: sensor_messages.unpack_rotor_speeds,
    sensor_messages.ERPM: partial(sensor_messages.unpack_erpm, vehicle=_WITH_POLE_PAIRS),
    sensor_messages.PREDICTION: result_messages.unpack_predictions,
    sensor_messages.ALARM: result_messages.unpack_alarms,
    sensor_messages.EVENT: result_messages.unpack_events,
    sensor_messages.WRENCH: partial(sensor_messages.unpack_body_vectors, type_name=sensor_messages.WRENCH),
}
"""By name of the message type."""

_OF_FORMAT = {"string": "map", "strings": ("mu_x", "u")}


def sound_message(type_name: str) -> bytes:
    """A message with a frame, numbers and, where its type has them, texts."""
    columns: dict[str, Any] = {
        field.name: [0.0] * ROTORS if field.count == ANY else _OF_FORMAT.get(field.format, 0)
        for field in codec(type_name)._fields
    }
    if type_name in {sensor_messages.POSE, sensor_messages.ODOMETRY}:
        columns[next(name for name in columns if name.endswith("orientation"))] = [0.0, 0.0, 0.0, 1.0]
    return codec(type_name).encode(1, columns)[0]
