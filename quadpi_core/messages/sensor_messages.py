# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion between ROS messages (REP-103: FLU body, ENU world) and the core's arrays (FRD, NED).

Bags and nodes share these functions: a bag passes all messages of a topic, a node one message at a
time, both as serialized bytes. Every `unpack_` raises SampleError, naming the sample, for bytes that are
no message of its type; values are not judged here (see `Recording.check`), except quaternions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Generic, TypeVar

import numpy as np

from quadpi_core import flight
from quadpi_core.core import compiled
from quadpi_core.errors import SampleError
from quadpi_core.frames import (
    Array,
    body_flu_to_frd,
    body_frd_to_flu,
    quaternion_flu_enu_to_frd_ned,
    quaternion_frd_ned_to_flu_enu,
    world_enu_to_ned,
    world_ned_to_enu,
)
from quadpi_core.messages.cdr import NANOSECONDS, header_stamps
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.payloads import ODOMETRY_VALUES, Payloads
from quadpi_core.records import NORM_TOLERANCE, Records
from quadpi_core.vehicle import FILLED_IN, SensorNoise, Vehicle

IMU = "sensor_msgs/msg/Imu"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
TWIST = "geometry_msgs/msg/TwistStamped"
WIND = "geometry_msgs/msg/Vector3Stamped"
ERPM = "quadpi/msg/Erpm"
ROTOR_SPEEDS = "quadpi/msg/RotorSpeeds"
MOTOR_COMMANDS = "quadpi/msg/MotorCommands"
BATTERY = "sensor_msgs/msg/BatteryState"
PRESSURE = "sensor_msgs/msg/FluidPressure"
TEMPERATURE = "sensor_msgs/msg/Temperature"
PREDICTION = "quadpi/msg/WrenchPrediction"
ALARM = "quadpi/msg/ExtrapolationAlarm"
EVENT = "quadpi/msg/AlarmEvent"
WRENCH = "geometry_msgs/msg/WrenchStamped"
ACCELERATION = "geometry_msgs/msg/AccelStamped"

TIME = "builtin_interfaces/msg/Time"
STAMP_END = 12

BODY_FRAME = "base_link"
WORLD_FRAME = "map"

_BODY_VECTORS = {
    WRENCH: ("wrench.force", "wrench.torque"),
    ACCELERATION: ("accel.linear", "accel.angular"),
}
_ABSENT = -1.0
FLU_SIGNS: Array = np.tile(body_frd_to_flu(np.ones(3)), 2)
_XYZW = [1, 2, 3, 0]

SomeStream = TypeVar("SomeStream", bound=flight.Stream)


def unpack_stamps(payloads: Payloads) -> flight.Stamps:
    """Header stamps of messages of any type that begins with a std_msgs/Header.

    Only the first :data:`STAMP_END` bytes of each message are looked at.
    """
    return header_stamps(codec(TIME).decode(payloads.compact(STAMP_END)), "")


@dataclass(frozen=True)
class SampleKind(Generic[SomeStream]):
    """How messages of a stamp, frames and float64 fields become samples.

    Attributes:
        type_name: of the messages.
        room: gives a stream of stamps (N,) for messages of the given frames; the rest is to be filled.
        fill: fills them from the float64 fields (N, K) that end the messages; gives the first sample whose
            orientation is no unit quaternion, -1 without one, or None where there are no orientations.
        texts: how many names follow the stamp: 2 where there is a child frame.
        counts: how many numbers each sequence of numbers must hold, by name.
    """

    type_name: str
    room: Callable[[flight.Stamps, tuple[str, ...]], SomeStream]
    fill: Callable[[Array, SomeStream], int | None]
    texts: int = 1
    counts: Mapping[str, int] = field(default_factory=dict)

    def unpack(self, payloads: Payloads | bytes, *, strict: bool = True) -> SomeStream:
        """The samples of N messages whose frames do not matter.

        Args:
            payloads: the messages, or one.
            strict: else orientations that are no unit quaternion come as they are, for the reader to judge.

        Raises:
            SampleError: also for an orientation that is no unit quaternion.
        """
        time_ns, values = codec(self.type_name).decode_stamped(payloads, self.counts)
        stream = self.room(time_ns, ())
        wrong = self.fill(values, stream)
        if strict:
            require_rotations(wrong, values)
        return stream

    def unpack_logged(self, payloads: Payloads | bytes) -> SomeStream:
        """:meth:`unpack`, with orientations that are no unit quaternion as they are."""
        return self.unpack(payloads, strict=False)


def unpack_orientation(payloads: Payloads | bytes) -> tuple[flight.Stamps, Array, Array]:
    """Stamps, attitudes (M, 4) and their deviations (M,) rad of IMU messages that have an orientation.

    A deviation is 0 where the message does not say it, or is filled in. The axes are those of the IMU.
    """
    columns = codec(IMU).decode(payloads)
    quaternion, covariance = columns["orientation"], columns["orientation_covariance"]
    norm = np.linalg.norm(quaternion, axis=1)
    told = (covariance[:, 0] != _ABSENT) & (np.abs(norm - 1.0) <= NORM_TOLERANCE)
    wxyz = quaternion[told][:, [3, 0, 1, 2]] / norm[told, np.newaxis]
    mean = np.mean(covariance[told][:, [0, 4, 8]], axis=1)
    deviation = np.sqrt(np.where((mean > 0.0) & (mean < FILLED_IN**2), mean, 0.0))
    return header_stamps(columns)[told], quaternion_flu_enu_to_frd_ned(wxyz), deviation


def require_rotations(wrong: int | None, values: Array) -> None:
    """Refuse orientations (the numbers after the position) by what :attr:`SampleKind.fill` gives.

    Raises:
        SampleError: naming the sample and the norm of its quaternion.
    """
    if wrong is not None and wrong >= 0:
        norm = math.hypot(*values[wrong, 3:7])
        raise SampleError(wrong, f"the orientation is no unit quaternion (norm {norm:.3g})")


def _room(
    stream: Callable[..., SomeStream], *widths: int
) -> Callable[[flight.Stamps, tuple[str, ...]], SomeStream]:
    """`SampleKind.room` of a stream whose fields have these numbers per sample."""
    return lambda time_ns, _: stream(time_ns, *(np.empty((len(time_ns), width)) for width in widths))


IMU_SAMPLES = SampleKind(
    IMU,
    _room(flight.ImuStream, 3, 3),
    lambda values, imu: compiled.imu_values(values, imu.angular_velocity, imu.specific_force),
)
POSE_SAMPLES = SampleKind(
    POSE,
    _room(flight.PoseStream, 3, 4),
    lambda values, pose: compiled.pose_values(values, pose.position, pose.attitude),
)
# The same numbers, of a transform from the world, its frame, to the body, its child frame.
TRANSFORM_SAMPLES = replace(POSE_SAMPLES, type_name=TRANSFORM, texts=2)
ODOMETRY_SAMPLES = SampleKind(
    ODOMETRY,
    _room(flight.OdometryStream, 3, 4, 3, 3),
    lambda values, state: compiled.state_values(
        values, state.position, state.attitude, state.velocity, state.rates, state.deviation
    ),
    texts=2,
)
WIND_SAMPLES = SampleKind(
    WIND, _room(flight.WindStream, 3), lambda values, wind: compiled.wind_values(values, wind.velocity)
)
# Samples of N messages, or one: see SampleKind.unpack. The orientation of an IMU is not used; the twist of an
# odometry is in its child (body) frame.
unpack_imu = IMU_SAMPLES.unpack
unpack_pose = POSE_SAMPLES.unpack
unpack_odometry = ODOMETRY_SAMPLES.unpack
unpack_wind = WIND_SAMPLES.unpack


def rotor_speed_samples(rotors: int) -> SampleKind[flight.RotorSpeedStream]:
    """Messages of quadpi/RotorSpeeds of a vehicle with this number of rotors."""
    return SampleKind(
        ROTOR_SPEEDS,
        _room(flight.RotorSpeedStream, rotors),
        lambda values, sample: np.copyto(sample.speeds, values),
        counts={"rotor_speeds": rotors},
    )


def erpm_samples(vehicle: Vehicle) -> SampleKind[flight.RotorSpeedStream]:
    """Messages of quadpi/Erpm; the vehicle's pole pairs turn electrical into mechanical speed.

    Raises:
        VehicleError: if the vehicle file does not give the pole pairs.
    """

    def fill(erpm: Array, rotors: flight.RotorSpeedStream) -> None:
        rotors.speeds[:] = vehicle.rotor_speeds_from_erpm(erpm)

    rotors = vehicle.rotor_count
    vehicle.rotor_speeds_from_erpm(np.zeros(rotors))
    return SampleKind(ERPM, _room(flight.RotorSpeedStream, rotors), fill, counts={"erpm": rotors})


def twist_samples(body_frame: str) -> SampleKind[flight.TwistStream]:
    """Messages of geometry_msgs/TwistStamped that have one frame; see :func:`unpack_twist`."""

    def room(time_ns: flight.Stamps, frames: tuple[str, ...]) -> flight.TwistStream:
        in_body = without_namespace(frames[0]) == without_namespace(body_frame)
        return flight.TwistStream(time_ns, np.empty((len(time_ns), 3)), np.full(len(time_ns), in_body))

    def fill(values: Array, twist: flight.TwistStream) -> None:
        compiled.twist_values(values, bool(twist.in_body.all()), twist.velocity)

    return SampleKind(TWIST, room, fill)


def _packer(
    type_name: str,
    columns: Mapping[str, Callable[[Any], Any]],
    constants: Mapping[str, Any] = MappingProxyType({}),
    frame: str = BODY_FRAME,
) -> Callable[..., Payloads]:
    """A function that encodes a stream, by default of a frame, as messages of these columns and constants."""

    def pack(stream: flight.Stream, frame_id: str = frame) -> Payloads:
        values = {name: column(stream) for name, column in columns.items()}
        header = header_columns(stream.time_ns, frame_id)
        return codec(type_name).encode(len(stream), {**header, **constants, **values})

    return pack


# The orientation of an IMU is marked absent, and its covariances are unknown: zero.
pack_imu = _packer(
    IMU,
    {
        "angular_velocity": lambda imu: body_frd_to_flu(imu.angular_velocity),
        "linear_acceleration": lambda imu: body_frd_to_flu(imu.specific_force),
    },
    {
        "orientation": np.array([0.0, 0.0, 0.0, 1.0]),
        "orientation_covariance": np.array([_ABSENT, *[0.0] * 8]),
    },
)
pack_pose = _packer(
    POSE,
    {
        "pose.position": lambda pose: world_ned_to_enu(pose.position),
        "pose.orientation": lambda pose: quaternion_frd_ned_to_flu_enu(pose.attitude)[:, _XYZW],
    },
    frame=WORLD_FRAME,
)
pack_wind = _packer(WIND, {"vector": lambda wind: world_ned_to_enu(wind.velocity)}, frame=WORLD_FRAME)
pack_rotor_speeds = _packer(ROTOR_SPEEDS, {"rotor_speeds": attrgetter("speeds")})
pack_motor_commands = _packer(MOTOR_COMMANDS, {"commands": attrgetter("commands")})
pack_pressure = _packer(PRESSURE, {"fluid_pressure": attrgetter("pressure")})
pack_temperature = _packer(TEMPERATURE, {"temperature": attrgetter("celsius")})
# The voltage alone.
_UNKNOWN = ("temperature", "current", "charge", "capacity", "design_capacity", "percentage")
pack_battery = _packer(
    BATTERY, {"voltage": attrgetter("voltage")}, {**dict.fromkeys(_UNKNOWN, np.nan), "present": True}
)


def pack_odometry(
    stream: flight.OdometryStream,
    pose_covariance: Array | None = None,
    twist_covariance: Array | None = None,
    frame_id: str = WORLD_FRAME,
    child_frame_id: str = BODY_FRAME,
) -> Payloads:
    """Encode as nav_msgs/Odometry.

    Args:
        stream: N states.
        pose_covariance: (N, 6, 6) of position [m²] and of rotations about the world's axes [rad²], NED; of
            the stream's deviations where not given.
        twist_covariance: (N, 6, 6) of velocity and rates in body axes FRD, alike.
        frame_id: the world.
        child_frame_id: the body.
    """
    count = len(stream.time_ns)
    stated = np.where(stream.deviation < 0.0, compiled.UNKNOWN_VARIANCE, np.square(stream.deviation))
    pose, twist = np.zeros((2, count, 6, 6))
    for covariance, first, part in ((pose, 0, 0), (pose, 3, 1), (twist, 0, 2)):
        for axis in range(first, first + 3):
            covariance[:, axis, axis] = stated[:, part]
    values = np.empty((count, ODOMETRY_VALUES))
    compiled.odometry_values(
        np.ascontiguousarray(stream.position),
        np.ascontiguousarray(stream.attitude),
        np.ascontiguousarray(stream.velocity),
        np.ascontiguousarray(stream.rates),
        np.ascontiguousarray(pose if pose_covariance is None else pose_covariance),
        np.ascontiguousarray(twist if twist_covariance is None else twist_covariance),
        values,
    )
    texts = odometry_constants(frame_id, child_frame_id)
    return codec(ODOMETRY).encode_stamped(stream.time_ns, values, texts)


def pack_fused(
    time_ns: flight.Stamps,
    samples: Records,
    frame_id: str = WORLD_FRAME,
    child_frame_id: str = BODY_FRAME,
) -> Payloads:
    """Encode estimates (N,), records `estimator.filter_run.FusedSample`, as nav_msgs/Odometry."""
    values = np.empty((len(time_ns), ODOMETRY_VALUES))
    compiled.fill_odometry(samples, values)
    return codec(ODOMETRY).encode_stamped(time_ns, values, odometry_constants(frame_id, child_frame_id))


def odometry_constants(frame_id: str, child_frame_id: str) -> tuple[tuple[str, str | float], ...]:
    """The fields of nav_msgs/Odometry that stay the same."""
    return ("header.frame_id", frame_id), ("child_frame_id", child_frame_id)


def unpack_twist(payloads: Payloads | bytes, body_frame: str = BODY_FRAME) -> flight.TwistStream:
    """Decode geometry_msgs/TwistStamped: in body axes where its frame is `body_frame`, else in the world.

    A namespace in front of a frame does not count: a bag may come from a vehicle in another one.
    """
    columns = codec(TWIST).decode(payloads)
    linear = columns["twist.linear"]
    frames = columns["header.frame_id"]
    body = without_namespace(body_frame)
    in_body = np.array(
        [without_namespace(frame.decode(errors="replace")) == body for frame in frames], dtype=bool
    )
    velocity = np.where(in_body[:, np.newaxis], body_flu_to_frd(linear), world_enu_to_ned(linear))
    return flight.TwistStream(header_stamps(columns), velocity, in_body)


def without_namespace(frame: str) -> str:
    """The last part of the name of a frame."""
    return frame.rpartition("/")[2]


def pack_twist(
    stream: flight.TwistStream, body_frame: str = BODY_FRAME, world_frame: str = WORLD_FRAME
) -> Payloads:
    """Encode as geometry_msgs/TwistStamped without rotation; the frame_id names the axes."""
    parts = []
    for in_body, frame in ((True, body_frame), (False, world_frame)):
        rows = np.flatnonzero(stream.in_body == in_body)
        if len(rows):
            velocity = stream.velocity[rows]
            linear = body_frd_to_flu(velocity) if in_body else world_ned_to_enu(velocity)
            columns = {**header_columns(stream.time_ns[rows], frame), "twist.linear": linear}
            parts.append((rows, codec(TWIST).encode(len(rows), columns)))
    return Payloads.merge(parts)


def unpack_logged_mocap_odometry(
    payloads: Payloads | bytes, noise: SensorNoise | None = None
) -> tuple[flight.PoseStream, flight.TwistStream]:
    """Decode nav_msgs/Odometry of motion capture as the pose and the velocity that it holds.

    With the noise of a vehicle file deviations are those that `SensorNoise.of_odometry` gives.
    Beside an orientation that is no unit quaternion, which stays of its length, the velocity is not a number.
    """
    odometry = ODOMETRY_SAMPLES.unpack_logged(payloads)
    with np.errstate(over="ignore", invalid="ignore"):
        wrong = np.abs(np.linalg.norm(odometry.attitude, axis=1) - 1.0) > NORM_TOLERANCE
    odometry.velocity[wrong] = np.nan
    deviation = odometry.deviation if noise is None else noise.of_odometry(odometry.deviation)
    in_body = np.ones(len(odometry), dtype=bool)
    return (
        flight.PoseStream(odometry.time_ns, odometry.position, odometry.attitude, deviation[:, :2]),
        flight.TwistStream(odometry.time_ns, odometry.velocity, in_body, deviation[:, 2]),
    )


def unpack_rotor_speeds(payloads: Payloads | bytes, rotors: int | None = None) -> flight.RotorSpeedStream:
    """Decode quadpi/RotorSpeeds of so many rotors; None for any number, the same in all messages.

    Raises:
        SampleError: also for another number of rotors.
    """
    if rotors is not None:
        return rotor_speed_samples(rotors).unpack(payloads)
    columns = codec(ROTOR_SPEEDS).decode(payloads)
    return flight.RotorSpeedStream(header_stamps(columns), columns["rotor_speeds"])


def unpack_erpm(payloads: Payloads | bytes, vehicle: Vehicle) -> flight.RotorSpeedStream:
    """Decode quadpi/Erpm; the vehicle's pole pairs turn electrical into mechanical speed.

    Raises:
        SampleError: also for another number of rotors than the vehicle's.
        VehicleError: if the vehicle file does not give the pole pairs.
    """
    return erpm_samples(vehicle).unpack(payloads)


def pack_erpm(time_ns: flight.Stamps, erpm: Array, frame_id: str = BODY_FRAME) -> Payloads:
    """Encode electrical speeds (N, rotors) in rev/min as quadpi/Erpm."""
    return codec(ERPM).encode(len(time_ns), {**header_columns(time_ns, frame_id), "erpm": erpm})


def unpack_body_vectors(payloads: Payloads | bytes, type_name: str) -> tuple[flight.Stamps, Array]:
    """Decode :data:`WRENCH` or :data:`ACCELERATION` in body axes: stamps and (N, 6), linear then angular."""
    columns = codec(type_name).decode(payloads)
    linear, angular = (columns[field] for field in _BODY_VECTORS[type_name])
    return header_stamps(columns), mirrored(np.concatenate((linear, angular), axis=1))


def pack_body_vectors(
    time_ns: flight.Stamps, vectors: Array, type_name: str, frame_id: str = BODY_FRAME
) -> Payloads:
    """Encode vectors (N, 6) of body axes, linear then angular, as :data:`WRENCH` or :data:`ACCELERATION`."""
    linear, angular = _BODY_VECTORS[type_name]
    in_flu = mirrored(vectors)
    columns = {**header_columns(time_ns, frame_id), linear: in_flu[:, :3], angular: in_flu[:, 3:]}
    return codec(type_name).encode(len(time_ns), columns)


def header_columns(time_ns: flight.Stamps, frame_id: str) -> dict[str, Any]:
    """Columns of a std_msgs/Header, for :meth:`quadpi_core.messages.cdr.Codec.encode`."""
    return {**stamp_columns(time_ns), "header.frame_id": frame_id}


def stamp_columns(time_ns: flight.Stamps, name: str = "header.stamp") -> dict[str, Any]:
    """Columns of a builtin_interfaces/Time."""
    seconds, nanoseconds = np.divmod(time_ns, NANOSECONDS)
    return {f"{name}.sec": seconds, f"{name}.nanosec": nanoseconds}


def mirrored(wrench: Array) -> Array:
    """Pairs of body vectors (N, 6) between FRD and FLU; adding zero keeps -0.0 out of the messages."""
    return wrench * FLU_SIGNS + 0.0
