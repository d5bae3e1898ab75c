# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter over whole streams, compiled: the steps that run live, merged by stamp."""

from __future__ import annotations

from typing import NamedTuple

from quadpi_core.compiled import njit
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.signals.ekf_kernels import ERROR_STATES, Noise, Outcome, State, predict, update_pose


class Track(NamedTuple):
    """States at M IMU stamps, filled by :func:`run`; `variance` (M, 15) is the diagonal of the covariance."""

    time_ns: Stamps
    position: Array
    velocity: Array
    attitude: Array
    gyro_bias: Array
    accelerometer_bias: Array
    variance: Array


class Progress(NamedTuple):
    """How far :func:`run` has come: arrays (1,), and how many samples met each Outcome."""

    next_imu: Stamps
    next_pose: Stamps
    recorded: Stamps
    imu_counts: Stamps
    pose_counts: Stamps


@njit(cache=True)
def run(
    state: State,
    noise: Noise,
    imu: tuple[Stamps, Array, Array],
    poses: tuple[Stamps, Array, Array],
    progress: Progress,
    track: Track,
) -> None:
    """Merge IMU samples and poses by stamp, the IMU first where they tie, from `progress` on.

    Stops at the end of the IMU samples, or before one that asks for a RESET.
    """
    imu_time_ns, rates, specific_force = imu
    pose_time_ns, position, attitude = poses
    while progress.next_imu[0] < len(imu_time_ns):
        index = progress.next_imu[0]
        pose = progress.next_pose[0]
        if pose < len(pose_time_ns) and pose_time_ns[pose] < imu_time_ns[index]:
            outcome = update_pose(state, noise, pose_time_ns[pose], position[pose], attitude[pose])
            progress.pose_counts[outcome.value] += 1
            progress.next_pose[0] += 1
            continue
        outcome = predict(state, noise, imu_time_ns[index], rates[index], specific_force[index])
        if outcome == Outcome.RESET:
            return
        progress.imu_counts[outcome.value] += 1
        progress.next_imu[0] += 1
        if outcome == Outcome.USED:
            record(state, track, progress)


@njit(cache=True)
def record(state: State, track: Track, progress: Progress) -> None:
    """Append the state to the track."""
    row = progress.recorded[0]
    track.time_ns[row] = state.imu_time_ns[0]
    track.position[row] = state.position
    track.velocity[row] = state.velocity
    track.attitude[row] = state.attitude
    track.gyro_bias[row] = state.gyro_bias
    track.accelerometer_bias[row] = state.accelerometer_bias
    for index in range(ERROR_STATES):
        track.variance[row, index] = state.covariance[index, index]
    progress.recorded[0] += 1
