# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Error-state extended Kalman filter of IMU and motion capture: one implementation, offline and live.

Live, feed :meth:`Ekf.predict`, :meth:`Ekf.update_pose` and :meth:`Ekf.update_velocity` as samples arrive.
Offline, :meth:`Ekf.run` calls the same compiled steps over a whole recording, and gives the same states bit
for bit.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core import sample_limits
from quadpi_core.errors import SignalError
from quadpi_core.estimator import buffer, filter_memory, filter_run
from quadpi_core.estimator import propagate as kernels
from quadpi_core.estimator.corrections import BODY_VELOCITY, JOURNAL, POSE, VALUES, WORLD_VELOCITY
from quadpi_core.estimator.filter_memory import Clock, Source
from quadpi_core.estimator.filter_status import status_of
from quadpi_core.estimator.imu_rate import RATE_BEFORE_HZ
from quadpi_core.estimator.initialise import (
    COLLECT_NS,
    ImuSample,
    Initial,
    Measurement,
    initial_from_poses,
    initial_from_velocities,
)
from quadpi_core.estimator.odometry import FusedSamples
from quadpi_core.estimator.propagate import ERROR_STATES, EstimatorStatus, Noise, Outcome, Row
from quadpi_core.flight import MAX_GAP_NS, MAX_JUMP_BACK_NS, Recording, Stamps
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.signals.resample import RATE_SPAN, nominal_rate
from quadpi_core.vehicle import Vehicle

_COLLECTED_MAX = 8192
# How far the delay of motion capture wanders: the drift of unrelated clocks, 0.5 ms in half a minute.
_DELAY_WALK_S = 1e-4
_OUTCOMES = tuple(Outcome)
_STATUSES = tuple(EstimatorStatus)
_IMU, _POSE, _VELOCITY = range(3)
_NO_JOURNAL = (np.empty(0, dtype=np.int64), np.empty((0, JOURNAL)))


class State(NamedTuple):
    """The estimate at the stamp of the newest IMU sample; views that the next samples overwrite.

    Attributes:
        time_ns: (1,) stamp.
        row: (279,) see :class:`quadpi_core.estimator.propagate.Row`.
    """

    time_ns: Stamps
    row: Array

    @property
    def position(self) -> Array:
        """(3,) m, world."""
        return self.row[Row.POSITION]

    @property
    def velocity(self) -> Array:
        """(3,) m/s over ground, world."""
        return self.row[Row.VELOCITY]

    @property
    def attitude(self) -> Array:
        """(4,) body to world."""
        return self.row[Row.ATTITUDE]

    @property
    def gyro_bias(self) -> Array:
        """(3,) rad/s."""
        return self.row[Row.GYRO_BIAS]

    @property
    def accelerometer_bias(self) -> Array:
        """(3,) m/s²."""
        return self.row[Row.ACCELEROMETER_BIAS]

    @property
    def rates(self) -> Array:
        """(3,) rad/s, the IMU sample as it came."""
        return self.row[Row.RATES]

    @property
    def specific_force(self) -> Array:
        """(3,) m/s², the IMU sample as it came."""
        return self.row[Row.FORCE]

    @property
    def covariance(self) -> Array:
        """(16, 16) of the error state, ordered as the slices of :mod:`quadpi_core.estimator.propagate`."""
        return self.row[Row.COVARIANCE].reshape(ERROR_STATES, ERROR_STATES)


@dataclass(frozen=True)
class Estimates:
    """Estimates at the stamps of IMU samples, of the filter or the smoother.

    Attributes:
        time_ns: (M,) stamps.
        nominal: (M, 17) the estimates, in the order of :class:`Row`; the properties are views.
        variance: (M, 16) diagonal of the covariance of the error state, ordered as the slices of
            :mod:`quadpi_core.estimator.propagate` (POSITION, VELOCITY, ATTITUDE, GYRO_BIAS, …).
    """

    time_ns: Stamps
    nominal: Array
    variance: Array

    def __len__(self) -> int:
        return len(self.time_ns)

    @property
    def position(self) -> Array:
        """(M, 3) m, world."""
        return self._columns(Row.POSITION)

    @property
    def velocity(self) -> Array:
        """(M, 3) m/s over ground, world."""
        return self._columns(Row.VELOCITY)

    @property
    def attitude(self) -> Array:
        """(M, 4) body to world."""
        return self._columns(Row.ATTITUDE)

    @property
    def gyro_bias(self) -> Array:
        """(M, 3) rad/s."""
        return self._columns(Row.GYRO_BIAS)

    @property
    def accelerometer_bias(self) -> Array:
        """(M, 3) m/s²."""
        return self._columns(Row.ACCELEROMETER_BIAS)

    @property
    def delay_s(self) -> Array:
        """(M,) of motion capture."""
        delay: Array = self.nominal[:, Row.DELAY - Row.NOMINAL.start]
        return delay

    @property
    def velocity_body(self) -> Array:
        """(M, 3) m/s over ground, body axes."""
        return rotate_world_to_body(self.attitude, self.velocity)

    def _columns(self, part: slice) -> Array:
        return self.nominal[:, part.start - Row.NOMINAL.start : part.stop - Row.NOMINAL.start]


@dataclass(frozen=True)
class EkfTrace(Estimates):
    """What the filter gave from its initialisation on; nothing before it.

    After a pause of the IMU, or a jump back of its clock, the filter initialises anew and its stamps leave
    that time out.

    Attributes:
        fused: what the estimator gives to the outside at those stamps.
        status: (M,) see :class:`EstimatorStatus`.
        sample: (M,) index of the IMU sample.
        imu_outcomes: (N,) what became of each IMU sample, values of :class:`Outcome`.
        imu_counts, pose_counts, velocity_counts: how many samples met each :class:`Outcome`.
    """

    fused: FusedSamples
    status: npt.NDArray[np.uint8]
    sample: npt.NDArray[np.int64]
    imu_outcomes: npt.NDArray[np.int64]
    imu_counts: dict[Outcome, int]
    pose_counts: dict[Outcome, int]
    velocity_counts: dict[Outcome, int]


class Segment(NamedTuple):
    """What the filter did between two beginnings, for the smoother.

    Attributes:
        initial: estimate that it began with.
        samples: indices of the IMU samples that it used, from the one at or before the beginning on.
        first: place in `samples` of the first one that live has an estimate at.
        journal_ns: (J,) instants of its corrections.
        journal: (J, 14) those, see :mod:`.ekf_corrections`.
    """

    initial: Initial
    samples: npt.NDArray[np.int64]
    first: int
    journal_ns: Stamps
    journal: Array


class Ekf:
    """The filter; it starts by itself once a second of IMU samples and corrections has come.

    Args:
        vehicle: for its sensor noise and gravity.
        rate_hz: nominal rate of the IMU, which turns its noise per sample into a density. None measures it in
            the second before each start, and starts anew when it changes.
    """

    def __init__(self, vehicle: Vehicle, rate_hz: float | None = None) -> None:
        self._vehicle = vehicle
        self._measures = rate_hz is None
        self._rate_hz = rate_hz or RATE_BEFORE_HZ
        self._sensors = vehicle.noise
        self._gravity = vehicle.gravity_m_s2
        self._memory = filter_memory.allocate(self._rate_hz, assumed_noise(vehicle, self._rate_hz))
        self._initial: Initial | None = None
        self._caught_up: Stamps = np.empty(0, dtype=np.int64)
        self._imu: deque[ImuSample] = deque(maxlen=_COLLECTED_MAX)
        self._measurements: deque[Measurement] = deque(maxlen=_COLLECTED_MAX)
        self._journal = _NO_JOURNAL
        self._sample = np.empty(6)
        self._value = np.zeros(VALUES)

    @property
    def initialised(self) -> bool:
        """Whether there is an estimate."""
        return self._initial is not None

    @property
    def status(self) -> EstimatorStatus:
        """How far the estimate can be used; of a LOST one nothing may be published as odometry."""
        status: EstimatorStatus = _STATUSES[self._memory.clock[Clock.STATUS]]
        return status

    @property
    def state(self) -> State:
        """The estimate as it stands.

        Raises:
            SignalError: before the first second has been collected.
        """
        if self._initial is None:
            raise SignalError(
                "the estimator is not initialised: it needs a second of IMU samples and motion capture"
            )
        head = self._memory.clock[Clock.HEAD]
        return State(self._memory.stamps[head : head + 1], self._memory.rows[head])

    @property
    def settled_ns(self) -> int | None:
        """No estimate comes at or before this stamp, unless the IMU's clock is set back; None at first."""
        if self._initial is not None:
            return int(self._memory.stamps[self._memory.clock[Clock.HEAD]])
        return self._imu[0][0] + COLLECT_NS - 1 if self._imu else None

    @property
    def delay_s(self) -> float:
        """By how much motion capture's stamps are late, as estimated."""
        return float(self.state.row[Row.DELAY])

    @property
    def delay_std_s(self) -> float:
        """Standard deviation of :attr:`delay_s`."""
        return float(np.sqrt(self.state.covariance[kernels.DELAY, kernels.DELAY]))

    @property
    def since_correction_s(self) -> float:
        """Time of the IMU's clock since a correction was last accepted."""
        return 1e-9 * float(self.state.time_ns[0] - self._memory.clock[Clock.ACCEPTED_NS])

    @property
    def imu_counts(self) -> dict[Outcome, int]:
        """How many IMU samples met each outcome so far."""
        return self._counts(_IMU)

    @property
    def pose_counts(self) -> dict[Outcome, int]:
        """How many poses met each outcome so far; one that is held counts when it is fused or refused."""
        return self._counts(_POSE)

    @property
    def velocity_counts(self) -> dict[Outcome, int]:
        """How many velocities met each outcome so far; see :attr:`pose_counts`."""
        return self._counts(_VELOCITY)

    def reset(self) -> None:
        """Forget the estimate and start collecting anew; the counts stay."""
        filter_memory.forget(self._memory)
        self._initial = None
        self._imu.clear()
        self._measurements.clear()

    def predict(self, time_ns: int, gyro: Array, specific_force: Array) -> Outcome:
        """Take one IMU sample: gyro (3,) rad/s and specific_force (3,) m/s², body axes.

        Corrections that waited for it are fused. Never raises on bad samples: they are refused, counted, and
        the outcome says why.
        """
        sample = self._sample
        sample[:3] = gyro
        sample[3:] = specific_force
        if self._initial is None:
            outcome = self._collect_imu(time_ns, sample)
        else:
            outcome = _OUTCOMES[buffer.step(*self._memory, time_ns, sample, *self._journal)]
            if outcome is Outcome.USED:
                return outcome
            if outcome is Outcome.RESET:
                self.reset()
                self._collect_imu(time_ns, sample)
        self._memory.counts[_IMU, outcome] += 1
        return outcome

    def update_pose(self, time_ns: int, position: Array, attitude: Array) -> Outcome:
        """Take one pose: position (3,) m in the world, attitude (4,) body to world, of either sign.

        It is COLLECTED and fused at the IMU sample after :data:`.ekf_buffer.HOLD_NS`, or refused at once;
        what became of it then is in :attr:`pose_counts`. Never raises on bad samples.
        """
        self._value[:3] = position
        self._value[3:] = attitude
        return self._take(time_ns, POSE)

    def update_velocity(self, time_ns: int, velocity: Array, body: bool) -> Outcome:
        """Take one velocity (3,) m/s over ground, in body axes or in the world; see :meth:`update_pose`."""
        self._value[:3] = velocity
        self._value[3:] = 0.0
        return self._take(time_ns, BODY_VELOCITY if body else WORLD_VELOCITY)

    def run(self, recording: Recording) -> EkfTrace:
        """Estimate over a whole recording, its streams merged by arrival; IMU first where they tie.

        Continues from the estimate as it stands, so a fresh recording wants a fresh filter.

        Raises:
            SignalError: if the recording has no motion capture, or never a second of IMU samples and that.
        """
        trace = self.take(recording)
        if len(trace) == 0:
            raise never_started(recording.source, Spans().seen(recording))
        return trace

    def take(self, block: Recording) -> EkfTrace:
        """Estimate over the next block of a recording; see :func:`quadpi_core.recording_blocks.by_arrival`.

        Blocks of any length give the same estimates, bit for bit. There are none before the filter begins.

        Raises:
            SignalError: if the recording has no motion capture.
        """
        track, outcomes, _ = self._run(block, journalled=False)
        return EkfTrace(
            time_ns=track.time_ns,
            nominal=track.nominal,
            variance=track.variance,
            fused=FusedSamples(track.time_ns, track.fused),
            status=track.status,
            sample=track.sample,
            imu_outcomes=outcomes,
            imu_counts=self.imu_counts,
            pose_counts=self.pose_counts,
            velocity_counts=self.velocity_counts,
        )

    def segments(self, recording: Recording) -> list[Segment]:
        """What the filter does over a whole recording, for the smoother.

        Raises:
            SignalError: as :meth:`run`.
        """
        segments = self._run(recording, journalled=True)[2]
        if not segments:
            raise never_started(recording.source, Spans().seen(recording))
        return segments

    @property
    def noise(self) -> Noise:
        """What the filter assumes of the sensors."""
        return filter_memory.noise_of(self._memory.noise)

    def _run(
        self, recording: Recording, *, journalled: bool
    ) -> tuple[filter_run.Track, npt.NDArray[np.int64], list[Segment]]:
        imu = recording.imu
        if recording.pose is None and recording.twist is None:
            raise SignalError(
                f"{recording.source}: topics mocap/pose, mocap/odometry and mocap/twist are missing: "
                "nothing to correct the IMU by"
            )
        samples = np.ascontiguousarray(np.concatenate((imu.angular_velocity, imu.specific_force), axis=1))
        measurements = filter_run.merge(recording)
        track = filter_run.empty_track(len(imu), fused=not journalled)
        progress = filter_run.Progress(*(np.zeros(size, dtype=np.int64) for size in (1, 1, 1, len(imu))))
        if journalled:
            room = len(measurements.time_ns)
            self._journal = np.empty(room, dtype=np.int64), np.empty((room, JOURNAL))
        segments: list[Segment] = []
        began = 0

        def close() -> None:
            if self._initial is not None and journalled:
                sampled = track.sample[began + 1 : int(progress.recorded[0])]
                segments.append(self._segment(self._initial, imu.time_ns, sampled))

        while progress.imu[0] < len(imu):
            if self._initial is not None:
                filter_run.run(
                    self._memory, imu.time_ns, samples, measurements, progress, track, *self._journal
                )
                if progress.imu[0] == len(imu):
                    break
                # The next sample asks for a RESET.
                close()
            index = int(progress.imu[0])
            self._feed_next(imu.time_ns, samples, measurements, progress)
            if self._initial is not None and progress.imu[0] > index:
                began = int(progress.recorded[0])
                filter_run.record(self._memory, track, progress, index)
        close()
        self._journal = _NO_JOURNAL
        return track.until(int(progress.recorded[0])), progress.outcomes, segments

    def _segment(self, initial: Initial, imu_ns: Stamps, sampled: npt.NDArray[np.int64]) -> Segment:
        """What happened since the beginning; `sampled` are the IMU samples used since it caught up."""
        used = np.concatenate((np.searchsorted(imu_ns, self._caught_up), sampled))
        corrections = int(self._memory.clock[Clock.JOURNALLED])
        journal_ns, journal = self._journal
        return Segment(
            initial,
            used,
            len(self._caught_up) - 1,
            journal_ns[:corrections].copy(),
            journal[:corrections].copy(),
        )

    def _feed_next(
        self,
        imu_ns: Stamps,
        samples: Array,
        measurements: filter_run.Measurements,
        progress: filter_run.Progress,
    ) -> None:
        """Take the next sample by arrival as if it came live."""
        index, following = int(progress.imu[0]), int(progress.measurement[0])
        if following < len(measurements.time_ns) and measurements.after[following] <= index:
            self._value[:] = measurements.value[following]
            self._take(int(measurements.time_ns[following]), int(measurements.kind[following]))
            progress.measurement[0] += 1
        else:
            outcome = self.predict(int(imu_ns[index]), samples[index, :3], samples[index, 3:])
            progress.outcomes[index] = outcome
            progress.imu[0] += 1

    def _take(self, time_ns: int, kind: int) -> Outcome:
        if self._initial is not None:
            return _OUTCOMES[buffer.hold(self._memory, time_ns, kind, self._value)]
        outcome = self._collect_measurement(time_ns, kind)
        self._memory.counts[_POSE if kind == POSE else _VELOCITY, outcome] += 1
        return outcome

    def _collect_imu(self, time_ns: int, sample: Array) -> Outcome:
        if not sample_limits.usable_imu(sample):
            return Outcome.UNUSABLE
        last_ns = self._imu[-1][0] if self._imu else time_ns - 1
        if not -MAX_JUMP_BACK_NS <= time_ns - last_ns <= MAX_GAP_NS:
            self.reset()
        elif time_ns <= last_ns:
            return Outcome.STAMP_NOT_ADVANCING
        self._imu.append((time_ns, sample.copy()))
        if time_ns - self._imu[0][0] >= COLLECT_NS:
            self._start(time_ns)
        return Outcome.COLLECTED

    def _collect_measurement(self, time_ns: int, kind: int) -> Outcome:
        value = self._value
        usable = sample_limits.usable_pose(value) if kind == POSE else sample_limits.usable_velocity(value)
        if not usable:
            return Outcome.UNUSABLE
        marks = self._memory.sources[0 if kind == POSE else 1]
        last_ns = int(marks[Source.ARRIVED_NS])
        if last_ns - MAX_JUMP_BACK_NS <= time_ns <= last_ns:
            return Outcome.STAMP_NOT_ADVANCING
        if time_ns <= last_ns:
            self._measurements.clear()
        marks[Source.ARRIVED_NS] = time_ns
        self._measurements.append((time_ns, kind, value.copy()))
        return Outcome.COLLECTED

    def _start(self, time_ns: int) -> None:
        """Begin to estimate if what was collected suffices, else forget what is too old for that."""
        imu = list(self._imu)
        poses = [one for one in self._measurements if one[1] == POSE]
        velocities = [one for one in self._measurements if one[1] != POSE]
        initial = initial_from_poses(imu, poses, self._sensors, self._gravity) if poses else None
        if initial is None and not poses and velocities:
            initial = initial_from_velocities(imu, velocities, self._sensors, self._gravity)
        if initial is None:
            while self._imu and self._imu[0][0] < time_ns - COLLECT_NS:
                self._imu.popleft()
            while self._measurements and self._measurements[0][0] < time_ns - COLLECT_NS:
                self._measurements.popleft()
            return
        self._initial = initial
        arrived_ns = self._memory.sources[:, Source.ARRIVED_NS].copy()
        if self._measures:
            self._take_rate(nominal_rate(np.array([stamp for stamp, _ in imu], dtype=np.int64)))
        filter_memory.start(self._memory, initial.time_ns, initial.row, initial.imu_ns)
        if self._measures:
            self._memory.clock[Clock.SPAN_NS] = round(1e9 * RATE_SPAN / self._rate_hz)
        caught_up = [(stamp, sample) for stamp, sample in imu if stamp >= initial.imu_ns]
        counted = self._memory.counts[_IMU].copy()
        for stamp, sample in caught_up[1:]:
            buffer.predict(self._memory, stamp, sample)
        self._memory.counts[_IMU] = counted
        self._caught_up = np.array([stamp for stamp, _ in caught_up], dtype=np.int64)
        delay_ns = round(1e9 * self._sensors.mocap_delay_s)
        for stamp, kind, value in self._measurements:
            if stamp - delay_ns > initial.time_ns:
                buffer.hold(self._memory, stamp, kind, value)
        self._memory.sources[:, Source.ARRIVED_NS] = arrived_ns
        self._memory.clock[Clock.ACCEPTED_NS] = time_ns
        self._memory.clock[Clock.STATUS] = status_of(self._memory, time_ns)
        self._imu.clear()
        self._measurements.clear()

    def _take_rate(self, rate_hz: float) -> None:
        """Go on with a memory for an IMU of that rate; the counts stay."""
        if rate_hz != self._rate_hz:
            counts = self._memory.counts
            self._memory = filter_memory.allocate(rate_hz, assumed_noise(self._vehicle, rate_hz))
            self._memory.counts[:] = counts
            self._rate_hz = rate_hz

    def _counts(self, source: int) -> dict[Outcome, int]:
        counted = self._memory.counts[source]
        return {outcome: int(counted[outcome]) for outcome in Outcome}


def assumed_noise(vehicle: Vehicle, rate_hz: float) -> Noise:
    """What the filter assumes of the sensors of a vehicle whose IMU has this rate."""
    noise = vehicle.noise
    return Noise(
        gyro=noise.gyro_noise_rad_s**2 / rate_hz,
        accelerometer=noise.accelerometer_noise_m_s2**2 / rate_hz,
        gyro_bias=noise.gyro_bias_walk**2,
        accelerometer_bias=noise.accelerometer_bias_walk**2,
        delay=_DELAY_WALK_S**2 if noise.mocap_delay_std_s > 0.0 else 0.0,
        position=noise.mocap_position_m**2,
        attitude=noise.mocap_attitude_rad**2,
        velocity=noise.mocap_velocity_m_s**2,
        delay_prior=noise.mocap_delay_std_s**2,
        rates=noise.gyro_noise_rad_s**2,
        force=noise.accelerometer_noise_m_s2**2,
        gravity=vehicle.gravity_m_s2,
    )


class Spans(NamedTuple):
    """From when to when there were samples of the IMU and of motion capture [ns]; None without any."""

    imu: tuple[int, int] | None = None
    mocap: tuple[int, int] | None = None
    mocap_topic: str = ""

    def seen(self, block: Recording) -> Spans:
        """The spans after one more block of the recording."""
        mocap = block.twist if block.pose is None else block.pose
        return Spans(
            _longer(self.imu, block.imu.time_ns),
            self.mocap if mocap is None else _longer(self.mocap, mocap.time_ns),
            self.mocap_topic if mocap is None else mocap.topic,
        )


def never_started(source: str, spans: Spans) -> SignalError:
    """The error of a recording over which the filter gave no estimate."""
    mocap = f"{spans.mocap_topic} {_span(spans.mocap)}" if spans.mocap else ""
    return SignalError(
        f"{source}: the estimator never started: it needs one second with IMU samples and "
        f"motion capture; imu spans {_span(spans.imu)}, {mocap}"
    )


def _longer(span: tuple[int, int] | None, time_ns: Stamps) -> tuple[int, int] | None:
    if len(time_ns) == 0:
        return span
    return int(time_ns[0]) if span is None else span[0], int(time_ns[-1])


def _span(span: tuple[int, int] | None) -> str:
    return "no time" if span is None else f"{span[0] * 1e-9:.3f} to {span[1] * 1e-9:.3f} s"
