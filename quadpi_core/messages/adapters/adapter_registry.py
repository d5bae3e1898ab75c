# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Registry of the messages of other packages that are understood, and their conversion to streams."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from quadpi_core.errors import LogError
from quadpi_core.flight import Stream
from quadpi_core.messages.adapters import rotor_messages
from quadpi_core.messages.adapters.adapter_settings import AdapterSettings, BodySettings, RotorSettings
from quadpi_core.messages.adapters.px4_messages import OdometryReader, read_sensor_combined
from quadpi_core.messages.adapters.rigid_bodies import BodyReader
from quadpi_core.messages.adapters.rotor_messages import EscReports, RotorReader
from quadpi_core.messages.cdr import Columns, header_stamps
from quadpi_core.messages.foreign_messages import ForeignCodec, Items, foreign_codec
from quadpi_core.messages.payloads import Indices, Payloads
from quadpi_core.vehicle import Vehicle


class _Reading(NamedTuple):
    """Converts decoded messages to a stream, and counts dropped ones."""

    read: Callable[[Columns, dict[str, Items]], Stream]
    dropped: Callable[[], Counter[str]]


@dataclass(frozen=True)
class Adapter:
    """A message type of another package.

    Attributes:
        type_name: such as `px4_msgs/msg/EscStatus`.
        topic: where its package publishes it by default.
        kind: the stream that it gives, and the field of AdapterSettings that configures it: "rotor_speeds",
            "mocap", "odometry" or "imu".
        columns: that the messages must have, those of items of arrays included: how many numbers each has per
            row, 0 for text.
    """

    type_name: str
    topic: str
    kind: str
    columns: dict[str, int]
    start: Callable[[Any, Vehicle | None], _Reading]

    def open(self, definition: str, settings: AdapterSettings, vehicle: Vehicle | None) -> Unpacker:
        """Unpacker of the messages of this type on one topic.

        Args:
            definition: of the type and all that it contains (`ros2msg`), in the version that was sent.
            settings: must have those of this kind.
            vehicle: needed for electrical rotor speeds.

        Raises:
            LogError: for settings that are missing, and a version of the type that lacks a field.
            VehicleError: if the pole pairs are needed and not known.
        """
        own = getattr(settings, self.kind)
        if own is None:
            raise LogError(f"{self.type_name} needs settings for `{self.kind}`")
        codec = foreign_codec(self.type_name, definition, tuple(self.columns.items()))
        return Unpacker(codec, self.start(own, vehicle))


class Unpacker:
    """Unpacks the messages of one topic in their order: all at once or one by one."""

    def __init__(self, codec: ForeignCodec, reading: _Reading) -> None:
        self._codec = codec
        self._reading = reading

    @property
    def dropped(self) -> Counter[str]:
        """Number of dropped messages by reason."""
        return self._reading.dropped()

    def unpack(self, payloads: Payloads | bytes) -> Stream:
        """The samples in N messages or one; fewer than N where messages hold none that can be used.

        Raises:
            LogError: naming the sample, for bytes that are no message of this type, or values that
                contradict each other.
        """
        columns, items = self._codec.decode(payloads)
        return self._reading.read(columns, items)


def _rotors(
    reports: Callable[[Columns, dict[str, Items], Indices], EscReports],
) -> Callable[[RotorSettings, Vehicle | None], _Reading]:
    def start(settings: RotorSettings, vehicle: Vehicle | None) -> _Reading:
        order = settings.order(vehicle)
        numbers, reader = np.array(order.controllers), RotorReader(order, vehicle)
        return _Reading(
            lambda columns, items: reader.read(reports(columns, items, numbers)), lambda: reader.dropped
        )

    return start


def _bodies(array: str, name: str) -> Callable[[BodySettings, Vehicle | None], _Reading]:
    def start(settings: BodySettings, _vehicle: Vehicle | None) -> _Reading:
        reader = BodyReader(settings)
        return _Reading(
            lambda columns, items: reader.read(header_stamps(columns), items[array], name),
            lambda: reader.dropped,
        )

    return start


def _px4_odometry(_settings: object, _vehicle: Vehicle | None) -> _Reading:
    reader = OdometryReader()
    return _Reading(lambda columns, _: reader.read(columns), lambda: reader.dropped)


def _px4_imu(_settings: object, _vehicle: Vehicle | None) -> _Reading:
    return _Reading(lambda columns, _: read_sensor_combined(columns), Counter)


_STAMP = {"header.stamp.sec": 1, "header.stamp.nanosec": 1}
_POSE = {"pose.position": 3, "pose.orientation": 4}


def _items(array: str, **members: int) -> dict[str, int]:
    return {f"{array}.{member}": width for member, width in members.items()}


ADAPTERS = {
    "mavros_status": Adapter(
        type_name="mavros_msgs/msg/ESCStatus",
        topic="mavros/esc_status/status",
        kind="rotor_speeds",
        columns=_STAMP | _items("esc_status", **_STAMP, rpm=1),
        start=_rotors(rotor_messages.mavros_status),
    ),
    "mavros_telemetry": Adapter(
        type_name="mavros_msgs/msg/ESCTelemetry",
        topic="mavros/esc_telemetry/telemetry",
        kind="rotor_speeds",
        columns=_STAMP | _items("esc_telemetry", rpm=1, count=1),
        start=_rotors(rotor_messages.mavros_telemetry),
    ),
    "px4_status": Adapter(
        type_name="px4_msgs/msg/EscStatus",
        topic="fmu/out/esc_status",
        kind="rotor_speeds",
        columns={"timestamp": 1, "esc_online_flags": 1}
        | _items("esc", timestamp=1, esc_rpm=1, actuator_function=1),
        start=_rotors(rotor_messages.px4_status),
    ),
    "px4_odometry": Adapter(
        type_name="px4_msgs/msg/VehicleOdometry",
        topic="fmu/out/vehicle_odometry",
        kind="odometry",
        columns={
            **{"timestamp": 1, "timestamp_sample": 1, "pose_frame": 1, "velocity_frame": 1},
            **{"position": 3, "q": 4, "velocity": 3, "angular_velocity": 3},
        },
        start=_px4_odometry,
    ),
    "px4_imu": Adapter(
        type_name="px4_msgs/msg/SensorCombined",
        topic="fmu/out/sensor_combined",
        kind="imu",
        columns={"timestamp": 1, "gyro_rad": 3, "accelerometer_m_s2": 3},
        start=_px4_imu,
    ),
    "mocap4r2": Adapter(
        type_name="mocap4r2_msgs/msg/RigidBodies",
        topic="rigid_bodies",
        kind="mocap",
        columns=_STAMP | _items("rigidbodies", rigid_body_name=0, **_POSE),
        start=_bodies("rigidbodies", "rigid_body_name"),
    ),
    "named_poses": Adapter(
        type_name="motion_capture_tracking_interfaces/msg/NamedPoseArray",
        topic="poses",
        kind="mocap",
        columns=_STAMP | _items("poses", name=0, **_POSE),
        start=_bodies("poses", "name"),
    ),
}
