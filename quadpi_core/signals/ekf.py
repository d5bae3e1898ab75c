# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Error-state extended Kalman filter of IMU and motion-capture pose: one implementation, offline and live.

Live, feed :meth:`Ekf.predict` and :meth:`Ekf.update_pose` as samples arrive. Offline, :meth:`Ekf.run` calls
the same compiled steps over a whole recording, and gives the same states bit for bit.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import SignalError
from quadpi_core.flight import MAX_GAP_NS, Recording, Stamps
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.signals import ekf_kernels as kernels
from quadpi_core.signals import ekf_run
from quadpi_core.signals.ekf_initial import COLLECT_NS, initial_state
from quadpi_core.signals.ekf_kernels import Outcome, State
from quadpi_core.vehicle import Vehicle

Sample: TypeAlias = tuple[int, Array, Array]

_COLLECTED_MAX = 8192


@dataclass(frozen=True)
class EkfTrace:
    """Estimates at the stamps of IMU samples, from the initialisation on; nothing before it.

    After a pause of the IMU, or a jump back of its clock, the filter initialises anew and its stamps leave
    that time out.

    Attributes:
        time_ns: (M,) stamps.
        position, velocity: (M, 3) m and m/s, world.
        attitude: (M, 4) body to world.
        gyro_bias: (M, 3) rad/s.
        accelerometer_bias: (M, 3) m/s².
        variance: (M, 15) diagonal of the covariance of the error state, ordered as the slices of
            :mod:`quadpi_core.signals.ekf_kernels` (POSITION, VELOCITY, ATTITUDE, GYRO_BIAS, …).
        imu_counts, pose_counts: how many samples met each :class:`Outcome`.
    """

    time_ns: Stamps
    position: Array
    velocity: Array
    attitude: Array
    gyro_bias: Array
    accelerometer_bias: Array
    variance: Array
    imu_counts: dict[Outcome, int]
    pose_counts: dict[Outcome, int]

    def __len__(self) -> int:
        return len(self.time_ns)

    @property
    def velocity_body(self) -> Array:
        """(M, 3) m/s over ground, body axes."""
        return rotate_world_to_body(self.attitude, self.velocity)


class Ekf:
    """The filter; it starts by itself once a second of IMU samples and poses has come.

    Args:
        vehicle: for its sensor noise and gravity.
        rate_hz: nominal rate of the IMU, which turns its noise per sample into a density.
    """

    def __init__(self, vehicle: Vehicle, rate_hz: float) -> None:
        noise = vehicle.noise
        self._sensors = noise
        self._noise = kernels.Noise(
            gyro=noise.gyro_noise_rad_s**2 / rate_hz,
            accelerometer=noise.accelerometer_noise_m_s2**2 / rate_hz,
            gyro_bias=noise.gyro_bias_walk**2,
            accelerometer_bias=noise.accelerometer_bias_walk**2,
            position=noise.mocap_position_m**2,
            attitude=noise.mocap_attitude_rad**2,
            gravity=vehicle.gravity_m_s2,
        )
        self._state: State | None = None
        self._imu: deque[Sample] = deque(maxlen=_COLLECTED_MAX)
        self._poses: deque[Sample] = deque(maxlen=_COLLECTED_MAX)
        self._imu_counts = np.zeros(len(Outcome), dtype=np.int64)
        self._pose_counts = np.zeros(len(Outcome), dtype=np.int64)

    @property
    def initialised(self) -> bool:
        """Whether there is an estimate."""
        return self._state is not None

    @property
    def state(self) -> State:
        """The estimate as it stands; its arrays change with the next sample.

        Raises:
            SignalError: before the first second has been collected.
        """
        if self._state is None:
            raise SignalError("the estimator is not initialised: it needs a second of IMU samples and poses")
        return self._state

    @property
    def imu_counts(self) -> dict[Outcome, int]:
        """How many IMU samples met each outcome so far."""
        return _as_dict(self._imu_counts)

    @property
    def pose_counts(self) -> dict[Outcome, int]:
        """How many poses met each outcome so far."""
        return _as_dict(self._pose_counts)

    def reset(self) -> None:
        """Forget the estimate and start collecting anew; the counts stay."""
        self._state = None
        self._imu.clear()
        self._poses.clear()

    def predict(self, time_ns: int, gyro: Array, specific_force: Array) -> Outcome:
        """Take one IMU sample: gyro (3,) rad/s and specific_force (3,) m/s², body axes.

        Never raises on bad samples: they are refused, counted, and the outcome says why.
        """
        if self._state is None:
            outcome = self._collect_imu(time_ns, gyro, specific_force)
        else:
            outcome = Outcome(kernels.predict(self._state, self._noise, time_ns, gyro, specific_force))
            if outcome == Outcome.RESET:
                self.reset()
                self._collect_imu(time_ns, gyro, specific_force)
        self._imu_counts[outcome] += 1
        return outcome

    def update_pose(self, time_ns: int, position: Array, attitude: Array) -> Outcome:
        """Take one pose: position (3,) m in the world, attitude (4,) body to world, of either sign.

        Never raises on bad samples: they are refused, counted, and the outcome says why.
        """
        if self._state is None:
            outcome = self._collect_pose(time_ns, position, attitude)
        else:
            outcome = Outcome(kernels.update_pose(self._state, self._noise, time_ns, position, attitude))
        self._pose_counts[outcome] += 1
        return outcome

    def run(self, recording: Recording) -> EkfTrace:
        """Estimate over a whole recording, its streams merged by stamp; IMU first where stamps tie.

        Continues from the estimate as it stands, so a fresh recording wants a fresh filter.

        Raises:
            SignalError: if the recording has no pose, or never a second of IMU samples and poses.
        """
        imu, pose = recording.imu, recording.pose
        if pose is None:
            raise SignalError(
                f"{recording.source}: topic mocap/pose is missing: nothing to correct the IMU by"
            )
        samples = (imu.time_ns, _rows(imu.angular_velocity), _rows(imu.specific_force))
        poses = (pose.time_ns, _rows(pose.position), _rows(pose.attitude))
        track = _empty_track(len(imu))
        progress = ekf_run.Progress(
            next_imu=np.zeros(1, dtype=np.int64),
            next_pose=np.zeros(1, dtype=np.int64),
            recorded=np.zeros(1, dtype=np.int64),
            imu_counts=self._imu_counts,
            pose_counts=self._pose_counts,
        )
        while progress.next_imu[0] < len(imu):
            if self._state is None:
                self._feed_next(samples, poses, progress)
                if self._state is not None:
                    ekf_run.record(self._state, track, progress)
            else:
                ekf_run.run(self._state, self._noise, samples, poses, progress, track)
                if progress.next_imu[0] < len(imu):
                    self._feed_next(samples, poses, progress)
        recorded = slice(int(progress.recorded[0]))
        if recorded.stop == 0:
            raise SignalError(
                f"{recording.source}: the estimator never started: it needs one second with IMU samples and "
                f"poses; imu spans {_span(imu.time_ns)}, mocap/pose {_span(pose.time_ns)}"
            )
        return EkfTrace(
            **{name: column[recorded] for name, column in track._asdict().items()},
            imu_counts=self.imu_counts,
            pose_counts=self.pose_counts,
        )

    def _feed_next(
        self,
        imu: tuple[Stamps, Array, Array],
        poses: tuple[Stamps, Array, Array],
        progress: ekf_run.Progress,
    ) -> None:
        """Take the next sample by stamp as if it arrived live."""
        index, pose = progress.next_imu[0], progress.next_pose[0]
        if pose < len(poses[0]) and poses[0][pose] < imu[0][index]:
            self.update_pose(int(poses[0][pose]), poses[1][pose], poses[2][pose])
            progress.next_pose[0] += 1
        else:
            self.predict(int(imu[0][index]), imu[1][index], imu[2][index])
            progress.next_imu[0] += 1

    def _collect_imu(self, time_ns: int, gyro: Array, specific_force: Array) -> Outcome:
        if not kernels.usable_imu(gyro, specific_force):
            return Outcome.UNUSABLE
        last_ns = self._imu[-1][0] if self._imu else time_ns - 1
        if not -kernels.MAX_JUMP_BACK_NS <= time_ns - last_ns <= MAX_GAP_NS:
            self.reset()
        elif time_ns <= last_ns:
            return Outcome.STAMP_NOT_ADVANCING
        self._imu.append((time_ns, np.array(gyro), np.array(specific_force)))
        if time_ns - self._imu[0][0] >= COLLECT_NS:
            self._state = initial_state(self._imu, self._poses, self._sensors)
            if self._state is None:
                self._forget_before(time_ns - COLLECT_NS)
            else:
                self._catch_up(self._state)
        return Outcome.COLLECTED

    def _collect_pose(self, time_ns: int, position: Array, attitude: Array) -> Outcome:
        if not kernels.usable_pose(position, attitude):
            return Outcome.UNUSABLE
        if self._poses and time_ns < self._poses[-1][0] - kernels.MAX_JUMP_BACK_NS:
            self._poses.clear()
        elif self._poses and time_ns <= self._poses[-1][0]:
            return Outcome.STAMP_NOT_ADVANCING
        self._poses.append((time_ns, np.array(position), np.array(attitude)))
        return Outcome.COLLECTED

    def _forget_before(self, time_ns: int) -> None:
        for collected in (self._imu, self._poses):
            while collected and collected[0][0] < time_ns:
                collected.popleft()

    def _catch_up(self, state: State) -> None:
        """Bring the state from the last pose that it was initialised by to the last IMU sample."""
        for time_ns, gyro, specific_force in self._imu:
            if time_ns > state.time_ns[0]:
                kernels.predict(state, self._noise, time_ns, gyro, specific_force)
        self._imu.clear()
        self._poses.clear()


def _rows(values: Array) -> Array:
    return np.ascontiguousarray(values, dtype=np.float64)


def _empty_track(samples: int) -> ekf_run.Track:
    return ekf_run.Track(
        np.empty(samples, dtype=np.int64),
        *(np.empty((samples, columns)) for columns in (3, 3, 4, 3, 3, kernels.ERROR_STATES)),
    )


def _as_dict(counts: npt.NDArray[np.int64]) -> dict[Outcome, int]:
    return {outcome: int(counts[outcome]) for outcome in Outcome}


def _span(time_ns: Stamps) -> str:
    return f"{time_ns[0] * 1e-9:.3f} to {time_ns[-1] * 1e-9:.3f} s"
