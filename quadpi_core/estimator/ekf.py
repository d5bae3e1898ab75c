# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Error-state extended Kalman filter of IMU and motion capture: one implementation, offline and live.

Live, feed :meth:`Ekf.step`, :meth:`Ekf.update_pose` and :meth:`Ekf.update_velocity` as samples arrive.
Offline, :meth:`Ekf.run` calls the same compiled steps over a whole recording, and gives the same states bit
for bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.errors import SignalError
from quadpi_core.estimator import filter_state
from quadpi_core.estimator.filter_run import (
    FUSED,
    Arrivals,
    EkfTrace,
    FusedSamples,
    Segment,
    SegmentLog,
    Spans,
    Trace,
    in_order_of_arrival,
    never_started,
)
from quadpi_core.estimator.filter_state import (
    BODY_VELOCITY,
    CORRECTION,
    IMU_SAMPLE,
    MEASUREMENT,
    POSE,
    RATE_BEFORE_HZ,
    WORLD_VELOCITY,
    EstimatorStatus,
    Outcome,
    State,
)
from quadpi_core.estimator.initialise import COLLECT_NS, CollectedSamples, Initial
from quadpi_core.flight import MAX_GAP_NS, MAX_JUMP_BACK_NS, Recording
from quadpi_core.frames import Array
from quadpi_core.records import Records
from quadpi_core.signals.chain import RATE_SPAN, nominal_rate
from quadpi_core.vehicle import Vehicle

_OUTCOMES = tuple(Outcome)
_STATUSES = tuple(EstimatorStatus)
_USED = _OUTCOMES.index(Outcome.USED)
# Rows of the counts.
_IMU, _POSES, _VELOCITIES = range(3)
_NO_JOURNAL = np.empty(0, CORRECTION)
UNSTATED = np.zeros(2)


class Step(NamedTuple):
    """What one IMU sample gave.

    Attributes:
        outcome: what became of the sample.
        status: how far the estimate can be used; one that is LOST must not be published as odometry.
        fused: the estimate at the stamp of the sample, which the next step overwrites; None if there is none.
    """

    outcome: Outcome
    status: EstimatorStatus
    fused: FusedSamples | None


class Ekf:
    """The filter; it starts by itself once a second of IMU samples and corrections has come.

    Args:
        vehicle: for its sensor noise and gravity.
        rate_hz: nominal rate of the IMU, which turns its noise per sample into a density. None measures it in
            the second before each start, and starts again when it changes.
    """

    def __init__(self, vehicle: Vehicle, rate_hz: float | None = None) -> None:
        self._vehicle = vehicle
        self._measures_rate = rate_hz is None
        self._rate_hz = rate_hz or RATE_BEFORE_HZ
        self._memory = filter_state.allocate(vehicle, self._rate_hz)
        self._initial: Initial | None = None
        self._log: SegmentLog | None = None
        # Of the IMU samples, those since the initial estimate stay after the start.
        self._collected = CollectedSamples(vehicle)
        # The sample at hand.
        self._sample = np.zeros(1, IMU_SAMPLE)
        self._measurement = np.zeros(1, MEASUREMENT)
        self._fused = FusedSamples.from_rows(np.empty(1, FUSED))
        # What a sample that is used gives, by status: made for each it would cost a quarter of its step.
        self._used = tuple(Step(Outcome.USED, status, self._fused) for status in _STATUSES)
        self._live = self._held()

    @property
    def initialised(self) -> bool:
        """Whether there is an estimate."""
        return self._initial is not None

    @property
    def status(self) -> EstimatorStatus:
        """How far the estimate can be used; one that is LOST must not be published as odometry."""
        return _STATUSES[self._memory.filter["status"][0]]

    @property
    def state(self) -> State:
        """The newest estimate.

        Raises:
            SignalError: before the first second has been collected.
        """
        if self._initial is None:
            raise SignalError(
                "the estimator is not initialised: it needs a second of IMU samples and motion capture"
            )
        newest = int(self._memory.filter["newest"][0])
        return State(self._memory.ring[newest])

    @property
    def settled_ns(self) -> int | None:
        """No estimate comes at or before this stamp, unless the IMU's clock is set back; None at first."""
        if self._initial is not None:
            return self.state.time_ns
        imu = self._collected.imu
        return int(imu[0]["time_ns"][0]) + COLLECT_NS - 1 if imu else None

    @property
    def delay_s(self) -> float:
        """By how much motion capture's stamps are late, as estimated."""
        return self.state.delay_s

    @property
    def delay_std_s(self) -> float:
        """Standard deviation of :attr:`delay_s`."""
        return float(np.sqrt(self.state.covariance[filter_state.DELAY, filter_state.DELAY]))

    @property
    def since_correction_s(self) -> float:
        """Time of the IMU's clock since a correction was last accepted."""
        return 1e-9 * float(self.state.time_ns - self._memory.filter["accepted_ns"][0])

    @property
    def imu_counts(self) -> dict[Outcome, int]:
        """How many IMU samples met each outcome so far."""
        return self._counts(_IMU)

    @property
    def pose_counts(self) -> dict[Outcome, int]:
        """How many poses met each outcome so far; one that is held counts when it is fused or refused."""
        return self._counts(_POSES)

    @property
    def velocity_counts(self) -> dict[Outcome, int]:
        """How many velocities met each outcome so far; see :attr:`pose_counts`."""
        return self._counts(_VELOCITIES)

    def reset(self) -> None:
        """Forget the estimate and collect samples for a new start; the counts stay."""
        filter_state.forget(self._memory)
        self._initial = None
        self._collected.clear()

    def step(self, time_ns: int, gyro: Array, specific_force: Array) -> Step:
        """Take one IMU sample: gyro (3,) rad/s and specific_force (3,) m/s², body axes.

        Propagates the estimate to its stamp, then fuses the measurements whose time has come. Never raises on
        bad samples: they are refused, counted, and the outcome says why.
        """
        code, status = compiled.step(self._live, time_ns, gyro, specific_force)
        if code == _USED:
            return self._used[status]
        outcome = self._take_unused(_OUTCOMES[code])
        if outcome is not Outcome.COLLECTED or self._initial is None:
            return Step(outcome, self.status, None)
        compiled.fill_newest(*self._memory, self._fused.rows)
        return Step(outcome, self.status, self._fused)

    def update_pose(
        self, time_ns: int, position: Array, attitude: Array, deviation: Array = UNSTATED
    ) -> Outcome:
        """Take one pose: position (3,) m in the world, attitude (4,) body to world, of either sign.

        Its `deviation` (2,) is as of :class:`quadpi_core.flight.PoseStream`.

        It is COLLECTED and fused at the IMU sample 10 ms later, or refused at once; what
        became of it then is in :attr:`pose_counts`. Never raises on bad samples.
        """
        measurement = self._measurement
        measurement["time_ns"], measurement["kind"] = time_ns, POSE
        measurement["vector"], measurement["attitude"] = position, attitude
        measurement["deviation"] = deviation
        return self._update(measurement)

    def update_velocity(self, time_ns: int, velocity: Array, body: bool, deviation: float = 0.0) -> Outcome:
        """Take one velocity (3,) m/s over ground, in body axes or in the world; see :meth:`update_pose`."""
        measurement = self._measurement
        measurement["time_ns"], measurement["kind"] = time_ns, BODY_VELOCITY if body else WORLD_VELOCITY
        measurement["vector"], measurement["attitude"] = velocity, 0.0
        measurement["deviation"] = deviation
        return self._update(measurement)

    def run(self, recording: Recording) -> EkfTrace:
        """Estimate over a whole recording, its streams merged by arrival; IMU first where they tie.

        Continues from the present estimate, so a fresh recording wants a fresh filter.

        Raises:
            SignalError: if the recording has no motion capture, or never a second of IMU samples and that.
        """
        trace = self.take(recording)
        if len(trace) == 0:
            raise never_started(recording.source, Spans().extended(recording))
        return trace

    def take(self, block: Recording) -> EkfTrace:
        """Estimate over the next block of a recording; see :func:`quadpi_core.reading_options.by_arrival`.

        Blocks of any length give the same estimates, bit for bit. There are none before the filter starts.

        Raises:
            SignalError: if the recording has no motion capture.
        """
        arrivals = in_order_of_arrival(block)
        trace = Trace.empty(arrivals, self._journal, fused=True)
        self._run(arrivals, trace)
        count = int(trace.progress["estimates"][0])
        rows, fused = trace.rows[:count], trace.fused[:count]
        return EkfTrace(rows["time_ns"].copy(), rows, FusedSamples.from_rows(fused), trace.outcomes)

    def segments(self, recording: Recording) -> list[Segment]:
        """What the filter does over a whole recording, for the smoother."""
        self.log_segments(recording)
        arrivals = in_order_of_arrival(recording)
        self._run(arrivals, Trace.empty(arrivals, self._journal, fused=False))
        segments = self.logged_segments()
        if not segments:
            raise never_started(recording.source, Spans().extended(recording))
        return segments

    def log_segments(self, recording: Recording) -> None:
        """Log what the smoother needs while blocks of this recording are taken; before the first of them."""
        streams = (stream for stream in (recording.pose, recording.twist) if stream is not None)
        journal = np.empty(sum(map(len, streams)), CORRECTION)
        self._log = SegmentLog(recording.imu.time_ns, journal, segments=[], used=[], taken=0)

    def logged_segments(self) -> list[Segment]:
        """The segments of the blocks taken since :meth:`log_segments`, which ends the log."""
        log, self._log = self._log, None
        assert log is not None  # the caller began it
        if self._initial is not None:
            self._end_segment(self._initial, log)
        return log.segments

    @property
    def _journal(self) -> Records:
        return _NO_JOURNAL if self._log is None else self._log.journal

    def _run(self, arrivals: Arrivals, trace: Trace) -> None:
        """Take every sample."""
        progress = trace.progress[0]
        first = 0
        while True:
            if self._initial is not None:
                compiled.run(*self._memory, arrivals, trace)
                if self._log is not None:
                    used = trace.rows["sample"][first : progress["estimates"]]
                    self._log.used.append(self._log.taken + used)
            index = int(progress["samples"])
            if index == len(arrivals.samples):
                break
            # Before the start, and at a RESET, samples come as they do live.
            if self._initial is not None and self._log is not None:
                self._end_segment(self._initial, self._log)
            self._feed_next(arrivals, trace)
            if self._initial is not None and progress["samples"] > index:
                first = int(progress["estimates"])
                compiled.record(*self._memory, trace, index)
        if self._log is not None:
            self._log.taken += index

    def _end_segment(self, initial: Initial, log: SegmentLog) -> None:
        """Log what the filter did since its start."""
        # The start itself propagates to the newest IMU sample.
        stamps = [sample["time_ns"][0] for sample in self._collected.imu]
        caught_up = np.searchsorted(log.imu_ns, stamps)
        samples = np.concatenate((caught_up[:-1], *log.used))
        count = int(self._memory.filter["journalled"][0])
        noise = self._memory.filter["noise"].copy()
        log.segments.append(
            Segment(initial, samples, len(caught_up) - 1, log.journal[:count].copy(), noise, self._rate_hz)
        )
        log.used.clear()

    def _feed_next(self, arrivals: Arrivals, trace: Trace) -> None:
        """Take the next sample by arrival as if it came live."""
        progress = trace.progress[0]
        index, following = int(progress["samples"]), int(progress["measurements"])
        if following < len(arrivals.measurements) and arrivals.after[following] <= index:
            self._update(arrivals.measurements[following : following + 1])
            progress["measurements"] += 1
        else:
            self._sample[:] = arrivals.samples[index]
            outcome = Outcome.COLLECTED if self._initial is None else Outcome.RESET
            trace.outcomes[index] = self._take_unused(outcome)
            progress["samples"] += 1

    def _take_unused(self, outcome: Outcome) -> Outcome:
        """Count the IMU sample at hand, which the filter did not use; collect it if there is no estimate."""
        if outcome is Outcome.RESET:
            self.reset()
            self._collect_imu()
        elif self._initial is None:
            outcome = self._collect_imu()
        self._memory.filter["counts"][0, _IMU, outcome] += 1
        return outcome

    def _update(self, measurement: Records) -> Outcome:
        """Take a measurement (1,)."""
        if self._initial is not None:
            return _OUTCOMES[compiled.hold(*self._memory, measurement)]
        outcome = self._collect_measurement(measurement)
        source = _POSES if measurement["kind"][0] == POSE else _VELOCITIES
        self._memory.filter["counts"][0, source, outcome] += 1
        return outcome

    def _collect_imu(self) -> Outcome:
        """Keep the IMU sample at hand for the start, and start if a second has been collected."""
        if not compiled.usable_imu(self._sample["rates"], self._sample["specific_force"]):
            return Outcome.UNUSABLE
        time_ns, imu = int(self._sample["time_ns"][0]), self._collected.imu
        last_ns = int(imu[-1]["time_ns"][0]) if imu else time_ns - 1
        if not -MAX_JUMP_BACK_NS <= time_ns - last_ns <= MAX_GAP_NS:
            self.reset()
        elif time_ns <= last_ns:
            return Outcome.STAMP_NOT_ADVANCING
        imu.append(self._sample.copy())
        self._start_if_possible()
        return Outcome.COLLECTED

    def _collect_measurement(self, measurement: Records) -> Outcome:
        """Keep a measurement for the start."""
        if not compiled.usable_measurement(measurement):
            return Outcome.UNUSABLE
        sources = self._memory.filter["sources"][0]
        source, time_ns = sources[0 if measurement["kind"][0] == POSE else 1], int(measurement["time_ns"][0])
        last_ns = int(source["arrived_ns"])
        if last_ns - MAX_JUMP_BACK_NS <= time_ns <= last_ns:
            return Outcome.STAMP_NOT_ADVANCING
        if time_ns <= last_ns:
            self._collected.clear_measurements()
        source["arrived_ns"] = time_ns
        self._collected.measurements.append(measurement.copy())
        return Outcome.COLLECTED

    def _start_if_possible(self) -> None:
        """Begin to estimate if the collected samples suffice."""
        collected = self._collected
        imu = collected.second_of_imu
        initial = None if imu is None else collected.initial(imu)
        if imu is None or initial is None:
            return
        self._initial = initial
        arrived_ns = self._memory.filter["sources"]["arrived_ns"].copy()
        if self._measures_rate and (rate_hz := nominal_rate(imu["time_ns"])) != self._rate_hz:
            counts = self._memory.filter["counts"]
            self._memory, self._rate_hz = filter_state.allocate(self._vehicle, rate_hz), rate_hz
            self._memory.filter["counts"] = counts
            self._live = self._held()
        memory = self._memory
        filter_state.begin(memory, initial.estimate, initial.imu_ns)
        if self._measures_rate:
            memory.filter["rate_span_ns"] = round(1e9 * RATE_SPAN / self._rate_hz)
        compiled.catch_up(*memory, imu[imu["time_ns"] > initial.imu_ns])
        delay_ns = round(1e9 * self._vehicle.noise.mocap_delay_s)
        for measurement in collected.measurements:
            if measurement["time_ns"][0] - delay_ns > initial.time_ns:
                compiled.hold(*memory, measurement)
        memory.filter["sources"]["arrived_ns"] = arrived_ns
        while collected.imu[0]["time_ns"][0] < initial.imu_ns:
            collected.imu.popleft()
        collected.clear_measurements()

    def _held(self) -> compiled.LiveFilter:
        return compiled.LiveFilter(filter_state.Live(*self._memory, self._sample, self._fused.rows))

    def _counts(self, source: int) -> dict[Outcome, int]:
        counts = self._memory.filter["counts"][0, source]
        return {outcome: int(counts[outcome]) for outcome in Outcome}
