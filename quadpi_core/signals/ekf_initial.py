# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The first state of the EKF, from the first second of IMU samples and poses; causal, so live can use it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from quadpi_core.flight import MAX_GAP_NS, Stamps
from quadpi_core.frames import Array
from quadpi_core.signals import rotations
from quadpi_core.signals.ekf_kernels import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    ERROR_STATES,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    State,
)
from quadpi_core.vehicle import SensorNoise

COLLECT_NS = 1_000_000_000
_VELOCITY_FIT_NS = 200_000_000
_MIN_POSES = 5
# The line fit is wrong by half the fit's span times the acceleration: 10 m/s² for a vehicle in flight.
_VELOCITY_STD_M_S = 1.0
_ACCELEROMETER_BIAS_STD_M_S2 = 0.3
_GYRO_BIAS_STD_RAD_S = 0.02


def initial_state(
    imu: Iterable[tuple[int, Array, Array]], poses: Iterable[tuple[int, Array, Array]], noise: SensorNoise
) -> State | None:
    """State at the last pose that is not later than the last IMU sample.

    Position and attitude are that pose, velocity the slope of a line through the last 0.2 s of poses, gyro
    bias the mean of the gyro minus the mean rate of the attitudes, accelerometer bias zero.

    Args:
        imu: stamp, rates (3,) rad/s and specific force (3,) m/s², oldest first.
        poses: stamp, position (3,) m world and attitude (4,), oldest first.
        noise: of the sensors, for the covariance.

    Returns:
        The state, or None if the poses are too few or too old.
    """
    imu_time_ns, gyro, specific_force = _columns(imu)
    poses = [pose for pose in poses if imu_time_ns[0] <= pose[0] <= imu_time_ns[-1]]
    if len(poses) < _MIN_POSES:
        return None
    pose_time_ns, position, attitude = _columns(poses)
    time_ns = int(pose_time_ns[-1])
    recent = pose_time_ns >= time_ns - _VELOCITY_FIT_NS
    spans = pose_time_ns[0] <= time_ns - _VELOCITY_FIT_NS
    if not spans or np.count_nonzero(recent) < _MIN_POSES or imu_time_ns[-1] - time_ns > MAX_GAP_NS:
        return None

    attitude = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
    steps = np.diff(pose_time_ns)
    attitude_rate = np.average(rotations.body_rates(pose_time_ns, attitude), axis=0, weights=steps)
    between_poses = (imu_time_ns >= pose_time_ns[0]) & (imu_time_ns <= time_ns)
    last_imu = np.searchsorted(imu_time_ns, time_ns, side="right") - 1
    span_s = 1e-9 * (time_ns - int(pose_time_ns[0]))

    std = np.empty(ERROR_STATES)
    std[POSITION] = noise.mocap_position_m
    std[VELOCITY] = _VELOCITY_STD_M_S
    std[ATTITUDE] = noise.mocap_attitude_rad
    std[GYRO_BIAS] = np.hypot(_GYRO_BIAS_STD_RAD_S, np.sqrt(2.0) * noise.mocap_attitude_rad / span_s)
    std[ACCELEROMETER_BIAS] = _ACCELEROMETER_BIAS_STD_M_S2
    return State(
        time_ns=np.array([time_ns]),
        position=position[-1].copy(),
        velocity=_velocity(pose_time_ns[recent], position[recent]),
        attitude=attitude[-1].copy(),
        gyro_bias=gyro[between_poses].mean(axis=0) - attitude_rate,
        accelerometer_bias=np.zeros(3),
        covariance=np.diag(std**2),
        imu_time_ns=imu_time_ns[last_imu : last_imu + 1].copy(),
        rates=gyro[last_imu].copy(),
        specific_force=specific_force[last_imu].copy(),
    )


def _columns(samples: Iterable[tuple[int, Array, Array]]) -> tuple[Stamps, Array, Array]:
    time_ns, first, second = zip(*samples, strict=True)
    return np.array(time_ns, dtype=np.int64), np.array(first), np.array(second)


def _velocity(time_ns: Stamps, position: Array) -> Array:
    """Slope (3,) m/s of the least-squares line through positions (N, 3) at stamps (N,)."""
    time = 1e-9 * (time_ns - time_ns[0]).astype(np.float64)
    centred = time - time.mean()
    slope: Array = centred @ position / (centred @ centred)
    return slope
