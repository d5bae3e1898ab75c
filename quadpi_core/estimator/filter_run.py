# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter over whole streams, compiled: the steps that run live, merged by arrival."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.estimator.buffer import hold, predict, release
from quadpi_core.estimator.corrections import BODY_VELOCITY, POSE, VALUES, WORLD_VELOCITY, Count
from quadpi_core.estimator.filter_memory import Clock, Memory, noise_of
from quadpi_core.estimator.odometry import FUSED, fill_fused
from quadpi_core.estimator.propagate import ERROR_STATES, Outcome, Row, covariance_of
from quadpi_core.flight import Recording, Stamps
from quadpi_core.frames import Array

_HEAD, _STATUS = Clock.HEAD, Clock.STATUS
_NOMINAL = Row.NOMINAL


class Measurements(NamedTuple):
    """Corrections in the order of their arrival.

    Attributes:
        after: (M,) how many IMU samples were there before it.
        time_ns: (M,) stamps.
        kind: (M,) see :mod:`.ekf_corrections`.
        value: (M, 7).
    """

    after: Count
    time_ns: Stamps
    kind: Count
    value: Array


class Track(NamedTuple):
    """Estimates at M IMU stamps, filled by :func:`run`.

    Attributes:
        nominal: (M, 17) see :class:`Row`.
        variance: (M, 16) the diagonal of the covariance.
        fused: (M, 88) see :class:`quadpi_core.estimator.odometry.FusedSamples`; (0, 88) where nobody asks.
        status: (M,) see :class:`EstimatorStatus`.
        sample: (M,) index of the IMU sample.
    """

    time_ns: Stamps
    nominal: Array
    variance: Array
    fused: Array
    status: npt.NDArray[np.uint8]
    sample: Count

    def until(self, end: int) -> Track:
        """The first estimates."""
        return Track(
            self.time_ns[:end],
            self.nominal[:end],
            self.variance[:end],
            self.fused[:end],
            self.status[:end],
            self.sample[:end],
        )


class Progress(NamedTuple):
    """How far :func:`run` has come: arrays (1,), and what became of the IMU samples (N,) until there."""

    imu: Count
    measurement: Count
    recorded: Count
    outcomes: Count


def merge(recording: Recording) -> Measurements:
    """Poses and velocities in the order of their arrival, the pose first where they tie."""
    pose, twist = recording.pose, recording.twist
    after, time_ns, kind, value = [], [], [], []
    if pose is not None:
        after.append(recording.arrivals_of(pose))
        time_ns.append(pose.time_ns)
        kind.append(np.full(len(pose), POSE))
        value.append(np.concatenate((pose.position, pose.attitude), axis=1))
    if twist is not None:
        after.append(recording.arrivals_of(twist))
        time_ns.append(twist.time_ns)
        kind.append(np.where(twist.in_body, BODY_VELOCITY, WORLD_VELOCITY))
        value.append(np.pad(twist.velocity, ((0, 0), (0, VALUES - 3))))
    arrived = np.concatenate(after)
    order = np.argsort(arrived, kind="stable")
    return Measurements(
        arrived[order].astype(np.int64),
        np.concatenate(time_ns)[order],
        np.concatenate(kind).astype(np.int64)[order],
        np.ascontiguousarray(np.concatenate(value)[order], dtype=np.float64),
    )


def empty_track(samples: int, fused: bool) -> Track:
    """Room for that many estimates, and for what the estimator gives to the outside if asked for."""
    return Track(
        np.empty(samples, dtype=np.int64),
        np.empty((samples, _NOMINAL.stop - _NOMINAL.start)),
        np.empty((samples, ERROR_STATES)),
        np.empty((samples if fused else 0, FUSED)),
        np.empty(samples, dtype=np.uint8),
        np.empty(samples, dtype=np.int64),
    )


@njit(cache=True)
def run(
    memory: Memory,
    imu_ns: Stamps,
    samples: Array,
    measurements: Measurements,
    progress: Progress,
    track: Track,
    journal_ns: Stamps,
    journal: Array,
) -> None:
    """Take IMU samples (N, 6) and measurements from `progress` on, as they arrived.

    Stops at the end of the IMU samples, or before one that asks for a RESET.
    """
    while progress.imu[0] < len(imu_ns):
        index, following = progress.imu[0], progress.measurement[0]
        if following < len(measurements.time_ns) and measurements.after[following] <= index:
            hold(
                memory,
                measurements.time_ns[following],
                measurements.kind[following],
                measurements.value[following],
            )
            progress.measurement[0] += 1
            continue
        outcome = predict(memory, imu_ns[index], samples[index])
        if outcome == Outcome.RESET.value:
            return
        progress.outcomes[index] = outcome
        progress.imu[0] += 1
        if outcome == Outcome.USED.value:
            release(memory, journal_ns, journal)
            record(memory, track, progress, index)
        else:
            memory.counts[0, outcome] += 1


@njit(cache=True)
def record(memory: Memory, track: Track, progress: Progress, sample: int) -> None:
    """Append the estimate as it stands after an IMU sample."""
    row = progress.recorded[0]
    head = memory.clock[_HEAD]
    track.time_ns[row] = memory.stamps[head]
    for index in range(track.nominal.shape[1]):
        track.nominal[row, index] = memory.rows[head, _NOMINAL.start + index]
    track.status[row] = memory.clock[_STATUS]
    track.sample[row] = sample
    covariance = covariance_of(memory.rows[head])
    for index in range(ERROR_STATES):
        track.variance[row, index] = covariance[index, index]
    if len(track.fused) > 0:
        fill_fused(memory.rows[head], noise_of(memory.noise).rates, track.fused[row])
    progress.recorded[0] += 1
