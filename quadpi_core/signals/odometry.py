# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the EKF gives to the outside after an IMU sample: odometry with covariances, and the corrected IMU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.flight import ImuStream, OdometryStream
from quadpi_core.frames import Array
from quadpi_core.signals import rotations
from quadpi_core.signals.ekf_kernels import (
    ATTITUDE,
    ERROR_STATES,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    State,
)

# Order of a covariance in nav_msgs/Odometry: three linear components, then three angular ones.
_LINEAR = slice(0, 3)
_ANGULAR = slice(3, 6)


class FusedSample(NamedTuple):
    """One estimate, as streams of one sample.

    Attributes:
        odometry: at the stamp of the last IMU sample.
        imu: that sample less the estimated biases.
        pose_covariance: (1, 6, 6) of position and of rotations about the world's axes, m² and rad².
        twist_covariance: (1, 6, 6) of velocity and rates in body axes, (m/s)² and (rad/s)².
    """

    odometry: OdometryStream
    imu: ImuStream
    pose_covariance: Array
    twist_covariance: Array


def fused_sample(state: State, gyro_noise_rad_s: float) -> FusedSample:
    """The filter's state as odometry and corrected IMU; copies, so the state may go on.

    Args:
        state: of the filter, as :meth:`Ekf.predict` left it.
        gyro_noise_rad_s: standard deviation of a gyro sample, which adds to the covariance of the rates.
    """
    time_ns = state.imu_time_ns.copy()
    rates = (state.rates - state.gyro_bias)[None]
    specific_force = (state.specific_force - state.accelerometer_bias)[None]
    velocity = np.empty((1, 3))
    pose_covariance, twist_covariance = np.empty((1, 6, 6)), np.empty((1, 6, 6))
    _fill(state, gyro_noise_rad_s**2, velocity[0], pose_covariance[0], twist_covariance[0])
    odometry = OdometryStream(
        time_ns, state.position[None].copy(), state.attitude[None].copy(), velocity, rates
    )
    imu = ImuStream(time_ns, rates, specific_force)
    return FusedSample(odometry, imu, pose_covariance, twist_covariance)


@njit(cache=True)
def _fill(
    state: State, gyro_variance: float, velocity: Array, pose_covariance: Array, twist_covariance: Array
) -> None:
    """First-order propagation of the error state into pose and twist.

    With attitude error δθ in body axes, rotations about the world's axes are R δθ, and the velocity in body
    axes errs by Rᵀ δv + v × δθ.
    """
    to_world = rotations.matrix(state.attitude)
    to_body = np.ascontiguousarray(to_world.T)
    velocity[:] = to_body @ state.velocity

    pose = np.zeros((6, ERROR_STATES))
    pose[_LINEAR, POSITION] = np.eye(3)
    pose[_ANGULAR, ATTITUDE] = to_world
    pose_covariance[:] = pose @ state.covariance @ pose.T

    twist = np.zeros((6, ERROR_STATES))
    twist[_LINEAR, VELOCITY] = to_body
    twist[_LINEAR, ATTITUDE] = _cross_matrix(velocity)
    twist[_ANGULAR, GYRO_BIAS] = -np.eye(3)
    twist_covariance[:] = twist @ state.covariance @ twist.T
    for axis in range(3, 6):
        twist_covariance[axis, axis] += gyro_variance


@njit(cache=True)
def _cross_matrix(vector: Array) -> Array:
    """(3, 3) matrix whose product with u is vector × u."""
    x, y, z = vector[0], vector[1], vector[2]
    return np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
