# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Between ROS messages (REP-103: FLU body, ENU world) and the core's arrays (FRD, NED).

Bags and nodes share these functions: a bag passes all messages of a topic, a node one message at a
time, both as serialized bytes. Every `unpack_` raises SampleError, naming the sample, for bytes that are
no message of its type; values are not judged here (see `Recording.check`), except quaternions.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from quadpi_core.errors import SampleError
from quadpi_core.flight import (
    ImuStream,
    OdometryStream,
    PoseStream,
    RotorSpeedStream,
    Stamps,
    TwistStream,
    WindStream,
    WrenchStream,
)
from quadpi_core.frames import (
    Array,
    body_flu_to_frd,
    body_frd_to_flu,
    quaternion_frd_ned_to_flu_enu,
    world_enu_to_ned,
    world_ned_to_enu,
)
from quadpi_core.messages.cdr import header_stamps
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.values import (
    ODOMETRY_VALUES,
    attitude_values,
    odometry_values,
)
from quadpi_core.vehicle import Vehicle

IMU = "sensor_msgs/msg/Imu"
POSE = "geometry_msgs/msg/PoseStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
TWIST = "geometry_msgs/msg/TwistStamped"
WIND = "geometry_msgs/msg/Vector3Stamped"
ERPM = "quadpi/msg/Erpm"
ROTOR_SPEEDS = "quadpi/msg/RotorSpeeds"
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
_NANOSECONDS = 1_000_000_000
_ABSENT = -1.0
FLU_SIGNS: Array = np.tile(body_frd_to_flu(np.ones(3)), 2)
_XYZW = [1, 2, 3, 0]


def unpack_stamps(payloads: Payloads) -> Stamps:
    """Header stamps of messages of any type that begins with a std_msgs/Header.

    Only the first :data:`STAMP_END` bytes of each message are looked at.
    """
    return header_stamps(codec(TIME).decode(payloads.compact(STAMP_END)), "")


def unpack_imu(payloads: Payloads | bytes) -> ImuStream:
    """Decode sensor_msgs/Imu; its orientation is not used."""
    (time_ns, values), places = codec(IMU).decode_stamped(payloads), codec(IMU).places
    return ImuStream(
        time_ns=time_ns,
        angular_velocity=body_flu_to_frd(values[:, places["angular_velocity"]]),
        specific_force=body_flu_to_frd(values[:, places["linear_acceleration"]]),
    )


def pack_imu(stream: ImuStream, frame_id: str = BODY_FRAME) -> Payloads:
    """Encode as sensor_msgs/Imu with orientation marked absent and unknown (zero) covariances."""
    orientation_covariance = np.zeros(9)
    orientation_covariance[0] = _ABSENT
    return codec(IMU).encode(
        len(stream),
        {
            **header_columns(stream.time_ns, frame_id),
            "orientation": np.array([0.0, 0.0, 0.0, 1.0]),
            "orientation_covariance": orientation_covariance,
            "angular_velocity": body_frd_to_flu(stream.angular_velocity),
            "linear_acceleration": body_frd_to_flu(stream.specific_force),
        },
    )


def unpack_pose(payloads: Payloads | bytes) -> PoseStream:
    """Decode geometry_msgs/PoseStamped.

    Raises:
        SampleError: also for an orientation that is no unit quaternion.
    """
    (time_ns, values), places = codec(POSE).decode_stamped(payloads), codec(POSE).places
    return PoseStream(
        time_ns=time_ns,
        position=world_enu_to_ned(values[:, places["pose.position"]]),
        attitude=_attitude(values[:, places["pose.orientation"]]),
    )


def pack_pose(stream: PoseStream, frame_id: str = WORLD_FRAME) -> Payloads:
    """Encode as geometry_msgs/PoseStamped."""
    return codec(POSE).encode(
        len(stream),
        {
            **header_columns(stream.time_ns, frame_id),
            "pose.position": world_ned_to_enu(stream.position),
            "pose.orientation": quaternion_frd_ned_to_flu_enu(stream.attitude)[:, _XYZW],
        },
    )


def unpack_odometry(payloads: Payloads | bytes) -> OdometryStream:
    """Decode nav_msgs/Odometry, whose twist is in the child (body) frame.

    Raises:
        SampleError: also for an orientation that is no unit quaternion.
    """
    (time_ns, values), places = codec(ODOMETRY).decode_stamped(payloads), codec(ODOMETRY).places
    return OdometryStream(
        time_ns=time_ns,
        position=world_enu_to_ned(values[:, places["pose.pose.position"]]),
        attitude=_attitude(values[:, places["pose.pose.orientation"]]),
        velocity=body_flu_to_frd(values[:, places["twist.twist.linear"]]),
        rates=body_flu_to_frd(values[:, places["twist.twist.angular"]]),
    )


def pack_odometry(
    stream: OdometryStream,
    pose_covariance: Array | None = None,
    twist_covariance: Array | None = None,
    frame_id: str = WORLD_FRAME,
    child_frame_id: str = BODY_FRAME,
) -> Payloads:
    """Encode as nav_msgs/Odometry.

    Args:
        stream: N states.
        pose_covariance: (N, 6, 6) of position [m²] and of rotations about the world's axes [rad²], NED;
            zero (unknown) where not given.
        twist_covariance: (N, 6, 6) of velocity and rates in body axes FRD; zero where not given.
        frame_id: the world.
        child_frame_id: the body.
    """
    count = len(stream.time_ns)
    unknown = np.zeros((count, 6, 6))
    values = np.empty((count, ODOMETRY_VALUES))
    odometry_values(
        stream.position,
        stream.attitude,
        stream.velocity,
        stream.rates,
        unknown if pose_covariance is None else pose_covariance,
        unknown if twist_covariance is None else twist_covariance,
        values,
    )
    texts = (("header.frame_id", frame_id), ("child_frame_id", child_frame_id))
    return codec(ODOMETRY).encode_stamped(stream.time_ns, values, texts)


def unpack_twist(payloads: Payloads | bytes, body_frame: str = BODY_FRAME) -> TwistStream:
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
    return TwistStream(header_stamps(columns), velocity, in_body)


def without_namespace(frame: str) -> str:
    """The last part of the name of a frame."""
    return frame.rpartition("/")[2]


def pack_twist(stream: TwistStream, body_frame: str = BODY_FRAME, world_frame: str = WORLD_FRAME) -> Payloads:
    """Encode as geometry_msgs/TwistStamped without rotation; the frame_id names the axes."""
    parts, orders = [], []
    for in_body, frame in ((True, body_frame), (False, world_frame)):
        rows = np.flatnonzero(stream.in_body == in_body)
        if len(rows):
            velocity = stream.velocity[rows]
            linear = body_frd_to_flu(velocity) if in_body else world_ned_to_enu(velocity)
            columns = {**header_columns(stream.time_ns[rows], frame), "twist.linear": linear}
            parts.append(codec(TWIST).encode(len(rows), columns))
            orders.append(rows)
    return Payloads.concatenate(parts).take(np.argsort(np.concatenate(orders)))


def unpack_mocap_odometry(payloads: Payloads | bytes) -> tuple[PoseStream, TwistStream]:
    """Decode nav_msgs/Odometry of motion capture as the pose and the velocity that it holds."""
    odometry = unpack_odometry(payloads)
    return (
        PoseStream(odometry.time_ns, odometry.position, odometry.attitude),
        TwistStream(odometry.time_ns, odometry.velocity, np.ones(len(odometry), dtype=bool)),
    )


def unpack_wind(payloads: Payloads | bytes) -> WindStream:
    """Decode geometry_msgs/Vector3Stamped as wind velocity, ENU."""
    time_ns, vector = codec(WIND).decode_stamped(payloads)
    return WindStream(time_ns=time_ns, velocity=world_enu_to_ned(vector))


def pack_wind(stream: WindStream, frame_id: str = WORLD_FRAME) -> Payloads:
    """Encode as geometry_msgs/Vector3Stamped."""
    columns = {**header_columns(stream.time_ns, frame_id), "vector": world_ned_to_enu(stream.velocity)}
    return codec(WIND).encode(len(stream), columns)


def unpack_rotor_speeds(payloads: Payloads | bytes) -> RotorSpeedStream:
    """Decode quadpi/RotorSpeeds."""
    return RotorSpeedStream(*codec(ROTOR_SPEEDS).decode_stamped(payloads))


def pack_rotor_speeds(stream: RotorSpeedStream, frame_id: str = BODY_FRAME) -> Payloads:
    """Encode as quadpi/RotorSpeeds."""
    columns = {**header_columns(stream.time_ns, frame_id), "rotor_speeds": stream.speeds}
    return codec(ROTOR_SPEEDS).encode(len(stream), columns)


def unpack_erpm(payloads: Payloads | bytes, vehicle: Vehicle) -> RotorSpeedStream:
    """Decode quadpi/Erpm; the vehicle's pole pairs turn electrical into mechanical speed.

    Raises:
        VehicleError: if the vehicle file does not give the pole pairs.
    """
    time_ns, erpm = codec(ERPM).decode_stamped(payloads)
    return RotorSpeedStream(time_ns=time_ns, speeds=vehicle.rotor_speeds_from_erpm(erpm))


def pack_erpm(time_ns: Stamps, erpm: Array, frame_id: str = BODY_FRAME) -> Payloads:
    """Encode electrical speeds (N, 4) in rev/min as quadpi/Erpm."""
    return codec(ERPM).encode(len(time_ns), {**header_columns(time_ns, frame_id), "erpm": erpm})


def unpack_body_vectors(payloads: Payloads | bytes, type_name: str) -> tuple[Stamps, Array]:
    """Decode :data:`WRENCH` or :data:`ACCELERATION` in body axes: stamps and (N, 6), linear then angular."""
    columns = codec(type_name).decode(payloads)
    linear, angular = (columns[field] for field in _BODY_VECTORS[type_name])
    return header_stamps(columns), mirrored(np.concatenate((linear, angular), axis=1))


def unpack_simulated(payloads: Payloads | bytes) -> WrenchStream:
    """Decode the wrench of a simulation, :data:`WRENCH`."""
    return WrenchStream(*unpack_body_vectors(payloads, WRENCH))


def pack_body_vectors(
    time_ns: Stamps, vectors: Array, type_name: str, frame_id: str = BODY_FRAME
) -> Payloads:
    """Encode vectors (N, 6) of body axes, linear then angular, as :data:`WRENCH` or :data:`ACCELERATION`."""
    linear, angular = _BODY_VECTORS[type_name]
    in_flu = mirrored(vectors)
    columns = {**header_columns(time_ns, frame_id), linear: in_flu[:, :3], angular: in_flu[:, 3:]}
    return codec(type_name).encode(len(time_ns), columns)


def header_columns(time_ns: Stamps, frame_id: str) -> dict[str, Any]:
    """Columns of a std_msgs/Header, for :meth:`quadpi_core.messages.cdr.Codec.encode`."""
    seconds, nanoseconds = np.divmod(time_ns, _NANOSECONDS)
    return {"header.stamp.sec": seconds, "header.stamp.nanosec": nanoseconds, "header.frame_id": frame_id}


def _attitude(orientation_xyzw: Array) -> Array:
    attitude = np.empty(orientation_xyzw.shape)
    sample = attitude_values(orientation_xyzw, attitude)
    if sample >= 0:
        norm = math.hypot(*orientation_xyzw[sample])
        raise SampleError(sample, f"the orientation is no unit quaternion (norm {norm:.3g})")
    return attitude


def mirrored(wrench: Array) -> Array:
    """Pairs of body vectors (N, 6) between FRD and FLU; adding zero keeps -0.0 out of the messages."""
    return wrench * FLU_SIGNS + 0.0
