# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the EKF gives to the outside after an IMU sample: odometry with covariances, and the corrected IMU."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.estimator.propagate import Row, covariance_of
from quadpi_core.flight import (
    ImuStream,
    OdometryStream,
    Stamps,
)
from quadpi_core.frames import Array
from quadpi_core.sample_limits import RATE_MAX_RAD_S, SPECIFIC_FORCE_MAX_M_S2
from quadpi_core.signals import rotations

if TYPE_CHECKING:
    from quadpi_core.estimator.ekf import State

_RATES, _FORCE, _POSITION, _VELOCITY = Row.RATES, Row.FORCE, Row.POSITION, Row.VELOCITY
_ATTITUDE, _GYRO_BIAS, _ACCELEROMETER_BIAS = Row.ATTITUDE, Row.GYRO_BIAS, Row.ACCELEROMETER_BIAS
# Where the numbers of a fused sample lie: one array, filled by one kernel.
_OUT_POSITION, _OUT_ATTITUDE, _OUT_VELOCITY = slice(0, 3), slice(3, 7), slice(7, 10)
_OUT_RATES, _OUT_FORCE = slice(10, 13), slice(13, 16)
_OUT_POSE, _OUT_TWIST = slice(16, 52), slice(52, 88)
FUSED = 88


class FusedSamples(NamedTuple):
    """K estimates: one live, all of a flight offline.

    Attributes:
        time_ns: (K,) stamps of IMU samples.
        rows: (K, 88) all of them; the properties are views.
    """

    time_ns: Stamps
    rows: Array

    @property
    def odometry(self) -> OdometryStream:
        """The states at those stamps."""
        rows = self.rows
        return OdometryStream(
            self.time_ns,
            rows[:, _OUT_POSITION],
            rows[:, _OUT_ATTITUDE],
            rows[:, _OUT_VELOCITY],
            rows[:, _OUT_RATES],
        )

    @property
    def imu(self) -> ImuStream:
        """The IMU samples less the estimated biases."""
        return ImuStream(self.time_ns, self.rows[:, _OUT_RATES], self.rows[:, _OUT_FORCE])

    @property
    def motion(self) -> Array:
        """(K, 13) attitude, velocity and rates in body axes, specific force."""
        return self.rows[:, _OUT_ATTITUDE.start : _OUT_FORCE.stop]

    @property
    def pose_covariance(self) -> Array:
        """(K, 6, 6) of position and of rotations about the world's axes, m² and rad²."""
        return self.rows[:, _OUT_POSE].reshape(-1, 6, 6)

    @property
    def twist_covariance(self) -> Array:
        """(K, 6, 6) of velocity and rates in body axes, (m/s)² and (rad/s)²."""
        return self.rows[:, _OUT_TWIST].reshape(-1, 6, 6)

    def where(self, chosen: npt.NDArray[np.bool_]) -> FusedSamples:
        """Those that a mask (K,) chooses; not copied where it chooses all."""
        return self if chosen.all() else FusedSamples(self.time_ns[chosen], self.rows[chosen])

    def part(self, rows: slice) -> FusedSamples:
        """Those of a range; views."""
        return FusedSamples(self.time_ns[rows], self.rows[rows])


def fused_sample(state: State, gyro_noise_rad_s: float) -> FusedSamples:
    """The filter's state as odometry and corrected IMU; copies, so the state may go on.

    Args:
        state: of the filter, as :meth:`Ekf.predict` left it.
        gyro_noise_rad_s: standard deviation of a gyro sample, which adds to the covariance of the rates.
    """
    out = np.empty((1, FUSED))
    fill_fused(state.row, gyro_noise_rad_s**2, out[0])
    return FusedSamples(state.time_ns.copy(), out)


def with_gyro_faults(imu: ImuStream) -> ImuStream:
    """IMU samples (K) whose specific force shows a gyro that cannot be: not finite or too large, as that is.

    The monitor takes the specific force from the IMU and the rates from the state, which a sample that the
    filter refuses does not change: by itself it would interpolate over a gyro that fails.
    """
    rates = imu.angular_velocity
    fails = ~(np.abs(rates) <= RATE_MAX_RAD_S).all(axis=1, keepdims=True)
    shown = rates * (SPECIFIC_FORCE_MAX_M_S2 / RATE_MAX_RAD_S)
    return ImuStream(imu.time_ns, rates, np.where(fails, shown, imu.specific_force))


@njit(cache=True)
def fill_fused(row: Array, gyro_variance: float, out: Array) -> None:
    """Fill `out` (88,): state, and first-order propagation of the error state into pose and twist.

    With attitude error δθ in body axes, rotations about the world's axes are R δθ, and the velocity in body
    axes errs by Rᵀ δv + v × δθ.
    """
    to_world = rotations.matrix(row[_ATTITUDE])
    velocity = row[_VELOCITY]
    out[_OUT_POSITION] = row[_POSITION]
    out[_OUT_ATTITUDE] = row[_ATTITUDE]
    for axis in range(3):
        in_body = 0.0
        for other in range(3):
            in_body += to_world[other, axis] * velocity[other]
        out[_OUT_VELOCITY.start + axis] = in_body
        out[_OUT_RATES.start + axis] = row[_RATES.start + axis] - row[_GYRO_BIAS.start + axis]
        out[_OUT_FORCE.start + axis] = row[_FORCE.start + axis] - row[_ACCELEROMETER_BIAS.start + axis]
    u, v, w = out[_OUT_VELOCITY.start], out[_OUT_VELOCITY.start + 1], out[_OUT_VELOCITY.start + 2]

    # Rows of the two Jacobians over position, velocity, attitude and gyro bias.
    pose, twist = np.zeros((6, 12)), np.zeros((6, 12))
    for axis in range(3):
        pose[axis, axis] = 1.0
        twist[3 + axis, 9 + axis] = -1.0
        for other in range(3):
            pose[3 + axis, 6 + other] = to_world[axis, other]
            twist[axis, 3 + other] = to_world[other, axis]
    twist[0, 7], twist[0, 8] = -w, v
    twist[1, 6], twist[1, 8] = w, -u
    twist[2, 6], twist[2, 7] = -v, u
    covariance = covariance_of(row)
    _sandwich(pose, covariance, out[_OUT_POSE])
    _sandwich(twist, covariance, out[_OUT_TWIST])
    for axis in range(3, 6):
        out[_OUT_TWIST.start + 7 * axis] += gyro_variance


@njit(cache=True)
def _sandwich(by: Array, covariance: Array, out: Array) -> None:
    """J P Jᵀ into `out` (36,), of the first columns of P."""
    columns = by.shape[1]
    projected = np.zeros((6, columns))
    for row in range(6):
        for inner in range(columns):
            factor = by[row, inner]
            if factor != 0.0:
                for column in range(columns):
                    projected[row, column] += factor * covariance[inner, column]
    for row in range(6):
        for other in range(row + 1):
            total = 0.0
            for column in range(columns):
                total += projected[row, column] * by[other, column]
            out[6 * row + other] = total
            out[6 * other + row] = total
