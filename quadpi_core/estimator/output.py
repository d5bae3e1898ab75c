# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The output of the EKF after an IMU sample: odometry with covariances, and the corrected IMU."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import ImuStream, OdometryStream, Stamps
from quadpi_core.frames import Array
from quadpi_core.records import (
    RATE_MAX_RAD_S,
    SPECIFIC_FORCE_MAX_M_S2,
    Quaternion4,
    Records,
    Vector3,
    columns_of,
    record_dtype,
)


class Motion:
    """What the monitor needs of an estimate; velocity over ground, rates and specific force in body axes."""

    attitude: Quaternion4
    velocity: Vector3
    rates: Vector3
    specific_force: Vector3


class FusedSample:
    """One estimate: odometry, and the IMU sample less its biases."""

    time_ns: int
    position: Vector3
    motion: Motion
    pose_covariance: Annotated[Array, 6, 6]
    twist_covariance: Annotated[Array, 6, 6]


FUSED = record_dtype(FusedSample)
MOTION_ATTITUDE, MOTION_VELOCITY, MOTION_RATES, MOTION_FORCE = columns_of(Motion)
_MOTION = np.dtype((np.float64, MOTION_FORCE.stop))


class FusedSamples(NamedTuple):
    """K estimates: one live, all of a flight offline. Arrays are views of `rows`.

    Attributes:
        time_ns: (K,) stamps of IMU samples.
        rows: (K,) each :class:`FusedSample`.
        motion: (K, 13) each :class:`Motion` as a row of numbers.
        pose_covariance: (K, 6, 6) of position and of rotations about the world's axes, m² and rad².
        twist_covariance: (K, 6, 6) of velocity and rates in body axes, (m/s)² and (rad/s)².
    """

    time_ns: Stamps
    rows: Records
    motion: Array
    pose_covariance: Array
    twist_covariance: Array

    @classmethod
    def from_rows(cls, rows: Records) -> FusedSamples:
        """The estimates in records (K,)."""
        time_ns = np.ascontiguousarray(rows["time_ns"])
        motion: Array = rows["motion"].view(_MOTION)
        return cls(time_ns, rows, motion, rows["pose_covariance"], rows["twist_covariance"])

    @property
    def odometry(self) -> OdometryStream:
        """The states at those stamps."""
        motion = self.rows["motion"]
        return OdometryStream(
            self.time_ns, self.rows["position"], motion["attitude"], motion["velocity"], motion["rates"]
        )

    @property
    def imu(self) -> ImuStream:
        """The IMU samples less the estimated biases."""
        motion = self.rows["motion"]
        return ImuStream(self.time_ns, motion["rates"], motion["specific_force"])

    def where(self, chosen: npt.NDArray[np.bool_]) -> FusedSamples:
        """Those that a mask (K,) chooses; not copied where it chooses all."""
        return self if chosen.all() else FusedSamples.from_rows(self.rows[chosen])

    def part(self, rows: slice) -> FusedSamples:
        """Those of a range; views."""
        return FusedSamples.from_rows(self.rows[rows])


def with_gyro_faults(imu: ImuStream) -> ImuStream:
    """IMU samples (K) whose specific force shows an impossible gyro sample: not finite, or too large.

    The monitor takes the specific force from the IMU and the rates from the state, which a sample that the
    filter refuses does not change: by itself it would interpolate over a gyro that fails.
    """
    rates = imu.angular_velocity
    fails = ~(np.abs(rates) <= RATE_MAX_RAD_S).all(axis=1, keepdims=True)
    shown = rates * (SPECIFIC_FORCE_MAX_M_S2 / RATE_MAX_RAD_S)
    return ImuStream(imu.time_ns, rates, np.where(fails, shown, imu.specific_force))
