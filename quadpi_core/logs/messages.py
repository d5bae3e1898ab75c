# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Between ROS messages (REP-103: FLU body, ENU world) and the core's arrays (FRD, NED).

Bags and nodes share these functions: a bag passes all messages of a topic, a node one message at a
time, both as serialized bytes. Every `unpack_` raises LogError, naming the sample, for bytes that are
no message of its type; values are not judged here (see `Recording.check`), except quaternions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError
from quadpi_core.flight import (
    AXES,
    ImuStream,
    OdometryStream,
    PoseStream,
    RotorSpeedStream,
    Stamps,
    WindStream,
)
from quadpi_core.frames import (
    Array,
    body_flu_to_frd,
    body_frd_to_flu,
    quaternion_flu_enu_to_frd_ned,
    quaternion_frd_ned_to_flu_enu,
    world_enu_to_ned,
    world_ned_to_enu,
)
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs.cdr import Columns
from quadpi_core.logs.definitions import codec
from quadpi_core.logs.payloads import Payloads
from quadpi_core.monitor.output import Alarms, Predictions
from quadpi_core.vehicle import Vehicle

IMU = "sensor_msgs/msg/Imu"
POSE = "geometry_msgs/msg/PoseStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
WIND = "geometry_msgs/msg/Vector3Stamped"
ERPM = "quadpi/msg/Erpm"
ROTOR_SPEEDS = "quadpi/msg/RotorSpeeds"
PREDICTION = "quadpi/msg/WrenchPrediction"
ALARM = "quadpi/msg/ExtrapolationAlarm"
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
_QUATERNION_NORM_TOLERANCE = 0.01
_ABSENT = -1.0
_FLU_SIGNS: Array = np.tile(body_frd_to_flu(np.ones(3)), 2)
_NED_TO_ENU = np.kron(np.eye(2), world_ned_to_enu(np.eye(3)).T).astype(np.float64)
_FRD_TO_FLU = np.kron(np.eye(2), body_frd_to_flu(np.eye(3)).T).astype(np.float64)
_WXYZ, _XYZW = [3, 0, 1, 2], [1, 2, 3, 0]


def unpack_stamps(payloads: Payloads) -> Stamps:
    """Header stamps of messages of any type that begins with a std_msgs/Header.

    Only the first :data:`STAMP_END` bytes of each message are looked at.
    """
    return _stamps(codec(TIME).decode(payloads.compact(STAMP_END)), "")


def unpack_imu(payloads: Payloads | bytes) -> ImuStream:
    """Decode sensor_msgs/Imu; its orientation is not used."""
    columns = codec(IMU).decode(payloads)
    return ImuStream(
        time_ns=_stamps(columns),
        angular_velocity=body_flu_to_frd(columns["angular_velocity"]),
        specific_force=body_flu_to_frd(columns["linear_acceleration"]),
    )


def pack_imu(stream: ImuStream, frame_id: str = BODY_FRAME) -> Payloads:
    """Encode as sensor_msgs/Imu with orientation marked absent and unknown (zero) covariances."""
    orientation_covariance = np.zeros(9)
    orientation_covariance[0] = _ABSENT
    return codec(IMU).encode(
        len(stream),
        {
            **_header(stream.time_ns, frame_id),
            "orientation": np.array([0.0, 0.0, 0.0, 1.0]),
            "orientation_covariance": orientation_covariance,
            "angular_velocity": body_frd_to_flu(stream.angular_velocity),
            "linear_acceleration": body_frd_to_flu(stream.specific_force),
        },
    )


def unpack_pose(payloads: Payloads | bytes) -> PoseStream:
    """Decode geometry_msgs/PoseStamped.

    Raises:
        LogError: also for an orientation that is no unit quaternion.
    """
    columns = codec(POSE).decode(payloads)
    return PoseStream(
        time_ns=_stamps(columns),
        position=world_enu_to_ned(columns["pose.position"]),
        attitude=_attitude(columns["pose.orientation"]),
    )


def pack_pose(stream: PoseStream, frame_id: str = WORLD_FRAME) -> Payloads:
    """Encode as geometry_msgs/PoseStamped."""
    return codec(POSE).encode(
        len(stream),
        {
            **_header(stream.time_ns, frame_id),
            "pose.position": world_ned_to_enu(stream.position),
            "pose.orientation": quaternion_frd_ned_to_flu_enu(stream.attitude)[:, _XYZW],
        },
    )


def unpack_odometry(payloads: Payloads | bytes) -> OdometryStream:
    """Decode nav_msgs/Odometry, whose twist is in the child (body) frame.

    Raises:
        LogError: also for an orientation that is no unit quaternion.
    """
    columns = codec(ODOMETRY).decode(payloads)
    return OdometryStream(
        time_ns=_stamps(columns),
        position=world_enu_to_ned(columns["pose.pose.position"]),
        attitude=_attitude(columns["pose.pose.orientation"]),
        velocity=body_flu_to_frd(columns["twist.twist.linear"]),
        rates=body_flu_to_frd(columns["twist.twist.angular"]),
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
    columns = {
        **_header(stream.time_ns, frame_id),
        "child_frame_id": child_frame_id,
        "pose.pose.position": world_ned_to_enu(stream.position),
        "pose.pose.orientation": quaternion_frd_ned_to_flu_enu(stream.attitude)[:, _XYZW],
        "twist.twist.linear": body_frd_to_flu(stream.velocity),
        "twist.twist.angular": body_frd_to_flu(stream.rates),
    }
    if pose_covariance is not None:
        columns["pose.covariance"] = _rotated(pose_covariance, _NED_TO_ENU)
    if twist_covariance is not None:
        columns["twist.covariance"] = _rotated(twist_covariance, _FRD_TO_FLU)
    return codec(ODOMETRY).encode(len(stream), columns)


def unpack_wind(payloads: Payloads | bytes) -> WindStream:
    """Decode geometry_msgs/Vector3Stamped as wind velocity, ENU."""
    columns = codec(WIND).decode(payloads)
    return WindStream(time_ns=_stamps(columns), velocity=world_enu_to_ned(columns["vector"]))


def pack_wind(stream: WindStream, frame_id: str = WORLD_FRAME) -> Payloads:
    """Encode as geometry_msgs/Vector3Stamped."""
    columns = {**_header(stream.time_ns, frame_id), "vector": world_ned_to_enu(stream.velocity)}
    return codec(WIND).encode(len(stream), columns)


def unpack_rotor_speeds(payloads: Payloads | bytes) -> RotorSpeedStream:
    """Decode quadpi/RotorSpeeds."""
    columns = codec(ROTOR_SPEEDS).decode(payloads)
    return RotorSpeedStream(time_ns=_stamps(columns), speeds=columns["rotor_speeds"].astype(np.float64))


def pack_rotor_speeds(stream: RotorSpeedStream, frame_id: str = BODY_FRAME) -> Payloads:
    """Encode as quadpi/RotorSpeeds."""
    columns = {**_header(stream.time_ns, frame_id), "rotor_speeds": stream.speeds}
    return codec(ROTOR_SPEEDS).encode(len(stream), columns)


def unpack_erpm(payloads: Payloads | bytes, vehicle: Vehicle) -> RotorSpeedStream:
    """Decode quadpi/Erpm; the vehicle's pole pairs turn electrical into mechanical speed.

    Raises:
        VehicleError: if the vehicle file does not give the pole pairs.
    """
    columns = codec(ERPM).decode(payloads)
    return RotorSpeedStream(time_ns=_stamps(columns), speeds=vehicle.rotor_speeds_from_erpm(columns["erpm"]))


def pack_erpm(time_ns: Stamps, erpm: Array, frame_id: str = BODY_FRAME) -> Payloads:
    """Encode electrical speeds (N, 4) in rev/min as quadpi/Erpm."""
    return codec(ERPM).encode(len(time_ns), {**_header(time_ns, frame_id), "erpm": erpm})


def unpack_body_vectors(payloads: Payloads | bytes, type_name: str) -> tuple[Stamps, Array]:
    """Decode :data:`WRENCH` or :data:`ACCELERATION` in body axes: stamps and (N, 6), linear then angular."""
    columns = codec(type_name).decode(payloads)
    linear, angular = (columns[field] for field in _BODY_VECTORS[type_name])
    return _stamps(columns), _mirrored(np.concatenate((linear, angular), axis=1))


def pack_body_vectors(
    time_ns: Stamps, vectors: Array, type_name: str, frame_id: str = BODY_FRAME
) -> Payloads:
    """Encode vectors (N, 6) of body axes, linear then angular, as :data:`WRENCH` or :data:`ACCELERATION`."""
    linear, angular = _BODY_VECTORS[type_name]
    in_flu = _mirrored(vectors)
    columns = {**_header(time_ns, frame_id), linear: in_flu[:, :3], angular: in_flu[:, 3:]}
    return codec(type_name).encode(len(time_ns), columns)


def unpack_predictions(payloads: Payloads | bytes) -> Predictions:
    """Decode quadpi/WrenchPrediction."""
    columns = codec(PREDICTION).decode(payloads)
    lower, upper = _mirrored_bounds(columns["lower"], columns["upper"])
    return Predictions(
        time_ns=_stamps(columns),
        predicted=_mirrored(columns["predicted"]),
        lower=lower,
        upper=upper,
        measured=_mirrored(columns["measured"]),
        relative_width=columns["relative_width"].astype(np.float64),
    )


def pack_predictions(
    predictions: Predictions,
    *,
    model: str,
    confidence: float,
    axes: Sequence[str],
    frame_id: str = BODY_FRAME,
) -> Payloads:
    """Encode as quadpi/WrenchPrediction.

    Args:
        predictions: N rows.
        model: identity of the model.
        confidence: nominal coverage of the interval.
        axes: names of the axes that the model holds.
        frame_id: body frame.
    """
    lower, upper = _mirrored_bounds(predictions.lower, predictions.upper)
    return codec(PREDICTION).encode(
        len(predictions.time_ns),
        {
            **_header(predictions.time_ns, frame_id),
            "model": model,
            "confidence": confidence,
            "axes": sum(1 << AXES.index(axis) for axis in axes),
            "predicted": _mirrored(predictions.predicted),
            "lower": lower,
            "upper": upper,
            "measured": _mirrored(predictions.measured),
            "relative_width": predictions.relative_width,
        },
    )


@dataclass(frozen=True)
class ReportedAlarms:
    """What alarm messages say; one row per message (see `monitor.output.Alarms`).

    Attributes:
        envelope_distance: (M,) how far the worst input lies outside its training range.
        inputs_outside: names of the inputs outside the envelope, the farthest first, per message.
    """

    time_ns: Stamps
    level: npt.NDArray[np.uint8]
    causes: npt.NDArray[np.uint8]
    leverage: Array
    width: Array
    envelope_distance: Array
    inputs_outside: list[tuple[str, ...]]


def unpack_alarms(payloads: Payloads | bytes) -> ReportedAlarms:
    """Decode quadpi/ExtrapolationAlarm."""
    columns = codec(ALARM).decode(payloads)
    return ReportedAlarms(
        time_ns=_stamps(columns),
        level=columns["level"].copy(),
        causes=columns["causes"].copy(),
        leverage=columns["leverage"].astype(np.float64),
        width=columns["width"].astype(np.float64),
        envelope_distance=columns["envelope_distance"].astype(np.float64),
        inputs_outside=[
            tuple(name.decode(errors="replace") for name in names) for names in columns["inputs_outside"]
        ],
    )


def pack_alarms(alarms: Alarms, frame_id: str = BODY_FRAME) -> Payloads:
    """Encode as quadpi/ExtrapolationAlarm; the inputs outside the envelope are named farthest first."""
    farthest_first = np.argsort(-alarms.input_excess, axis=1, kind="stable")
    outside = np.take_along_axis(alarms.input_excess, farthest_first, axis=1) > 0.0
    rankings, membership = np.unique(np.where(outside, farthest_first, -1), axis=0, return_inverse=True)
    parts, orders = [], []
    for number, ranking in enumerate(rankings):
        rows = np.flatnonzero(membership.reshape(-1) == number)
        columns = {
            **_header(alarms.time_ns[rows], frame_id),
            "level": alarms.level[rows],
            "causes": alarms.causes[rows],
            "leverage": alarms.leverage[rows],
            "width": alarms.width[rows],
            "envelope_distance": alarms.input_excess[rows].max(axis=1),
            "inputs_outside": tuple(INPUT_NAMES[index] for index in ranking if index >= 0),
        }
        parts.append(codec(ALARM).encode(len(rows), columns))
        orders.append(rows)
    return Payloads.concatenate(parts).take(np.argsort(np.concatenate(orders)))


def _stamps(columns: Columns, prefix: str = "header.stamp.") -> Stamps:
    seconds, nanoseconds = columns[f"{prefix}sec"], columns[f"{prefix}nanosec"]
    beyond = nanoseconds >= _NANOSECONDS
    if beyond.any():
        sample = int(np.argmax(beyond))
        raise LogError(f"sample {sample}: the stamp has {nanoseconds[sample]} ns beyond its second")
    stamps: Stamps = seconds.astype(np.int64) * _NANOSECONDS + nanoseconds
    return stamps


def _header(time_ns: Stamps, frame_id: str) -> dict[str, Any]:
    seconds, nanoseconds = np.divmod(time_ns, _NANOSECONDS)
    return {"header.stamp.sec": seconds, "header.stamp.nanosec": nanoseconds, "header.frame_id": frame_id}


def _attitude(orientation_xyzw: Array) -> Array:
    norm = np.sqrt(np.einsum("ni,ni->n", orientation_xyzw, orientation_xyzw))
    wrong = np.abs(norm - 1.0) > _QUATERNION_NORM_TOLERANCE
    if wrong.any():
        sample = int(np.argmax(wrong))
        raise LogError(f"sample {sample}: the orientation is no unit quaternion (norm {norm[sample]:.3g})")
    return quaternion_flu_enu_to_frd_ned(orientation_xyzw[:, _WXYZ] / norm[:, None])


def _rotated(covariance: Array, rotation: Array) -> Array:
    """Row-major (N, 36) of a covariance (N, 6, 6) turned by `rotation` (6, 6)."""
    rotated: Array = (rotation @ covariance @ rotation.T).reshape(-1, 36)
    return rotated


def _mirrored(wrench: Array) -> Array:
    """Pairs of body vectors (N, 6) between FRD and FLU; adding zero keeps -0.0 out of the messages."""
    return wrench * _FLU_SIGNS + 0.0


def _mirrored_bounds(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Bounds (N, 6) between FRD and FLU: they swap on an axis that changes sign."""
    one, other = _mirrored(lower), _mirrored(upper)
    swapped = _FLU_SIGNS < 0.0
    return np.where(swapped, other, one), np.where(swapped, one, other)
