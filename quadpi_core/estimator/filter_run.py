# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter over whole streams, in the order of arrival."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.errors import SignalError
from quadpi_core.estimator.filter_state import (
    BODY_VELOCITY,
    ERROR_STATES,
    ESTIMATE,
    IMU_SAMPLE,
    MEASUREMENT,
    POSE,
    SCALAR,
    TRANSITION,
    WORLD_VELOCITY,
    NominalState,
)
from quadpi_core.estimator.initialise import Initial
from quadpi_core.flight import ImuStream, OdometryStream, Recording, Stamps
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.records import (
    RATE_MAX_RAD_S,
    SPECIFIC_FORCE_MAX_M_S2,
    Column,
    Quaternion4,
    Records,
    Vector3,
    columns_of,
    record_dtype,
)


class EstimatedSample(NominalState):
    """The estimate at the stamp of one IMU sample, without the correlations of its errors."""

    time_ns: int
    variance: Annotated[Array, ERROR_STATES]


class FilteredSample(EstimatedSample):
    """The same of the filter."""

    status: int
    sample: int  # index of the IMU sample


class Progress:
    """How far a run has come."""

    samples: int  # IMU samples taken
    measurements: int  # measurements taken
    estimates: int  # estimates written


ESTIMATED, FILTERED = record_dtype(EstimatedSample), record_dtype(FilteredSample)
_PROGRESS = record_dtype(Progress)


@dataclass(frozen=True)
class Estimates:
    """Estimates at the stamps of IMU samples, of the filter or the smoother.

    Attributes:
        time_ns: (M,) stamps.
        rows: (M,) each :class:`EstimatedSample`, whose fields these are: position (M, 3) m and velocity m/s
            over ground, world, attitude (M, 4) body to world, the biases of gyro rad/s and accelerometer
            m/s², the delay (M,) s of motion capture, and the diagonal (M, 16) of the covariance of the error
            state, see :mod:`.filter_state`.
    """

    time_ns: Stamps
    rows: Records

    def __len__(self) -> int:
        return len(self.time_ns)

    position, velocity, attitude = Column("position"), Column("velocity"), Column("attitude")
    gyro_bias, accelerometer_bias = Column("gyro_bias"), Column("accelerometer_bias")
    delay_s, variance = Column("delay"), Column("variance")

    @property
    def velocity_body(self) -> Array:
        """(M, 3) m/s over ground, body axes."""
        return rotate_world_to_body(self.attitude, self.velocity)


@dataclass(frozen=True)
class EkfTrace(Estimates):
    """The filter's estimates from its initialisation on; there are none before.

    After a pause of the IMU, or a jump back of its clock, the filter initialises again, and that time has no
    estimates.

    Attributes:
        fused: odometry and corrected IMU at those stamps.
        imu_outcomes: (N,) what became of each IMU sample, values of :class:`Outcome`.
    """

    fused: FusedSamples
    imu_outcomes: npt.NDArray[np.int64]

    @property
    def status(self) -> npt.NDArray[np.int64]:
        """(M,) see :class:`EstimatorStatus`."""
        return self.rows["status"]

    @property
    def sample(self) -> npt.NDArray[np.int64]:
        """(M,) index of the IMU sample."""
        return self.rows["sample"]


class Arrivals(NamedTuple):
    """The samples of a recording in the order of their arrival.

    Attributes:
        samples: (N,) each :class:`ImuSample`.
        measurements: (M,) each :class:`Measurement`.
        after: (M,) how many IMU samples had arrived before each.
    """

    samples: Records
    measurements: Records
    after: Stamps


class Trace(NamedTuple):
    """What a run writes.

    Attributes:
        progress: (1,) a :class:`Progress`.
        outcomes: (N,) what became of each IMU sample.
        rows: (N,) each :class:`FilteredSample`.
        fused: (N,) each :class:`FusedSample`; (0,) where they are not needed.
        journal: (J,) each :class:`Correction`; (0,) where they are not needed.
    """

    progress: Records
    outcomes: npt.NDArray[np.int64]
    rows: Records
    fused: Records
    journal: Records

    @classmethod
    def empty(cls, arrivals: Arrivals, journal: Records, *, fused: bool) -> Trace:
        """Room for a run, with `fused` where odometry is needed of it."""
        count = len(arrivals.samples)
        return cls(
            np.zeros(1, _PROGRESS),
            np.zeros(count, dtype=np.int64),
            np.empty(count, FILTERED),
            np.empty(count if fused else 0, FUSED),
            journal,
        )


class Segment(NamedTuple):
    """What the filter did between two initialisations, for the smoother.

    Attributes:
        initial: estimate that it began with.
        samples: indices of the IMU samples that it used, from the one at or before the beginning on.
        first: place in `samples` of the first one that has an estimate live.
        journal: (J,) each :class:`.filter_state.Correction`.
        noise: (1,) what it assumed, a :class:`.filter_state.Noise`.
        rate_hz: of the IMU, as it assumed.
    """

    initial: Initial
    samples: npt.NDArray[np.int64]
    first: int
    journal: Records
    noise: Records
    rate_hz: float


@dataclass
class SegmentLog:
    """Segments of a recording that is taken in blocks.

    Attributes:
        imu_ns: stamps of all its IMU samples.
        journal: (M,) room for a correction by each of its measurements.
        segments: that have ended.
        used: indices of the IMU samples that the present segment used since its start, by block.
        taken: IMU samples of the blocks taken so far.
    """

    imu_ns: Stamps
    journal: Records
    segments: list[Segment]
    used: list[npt.NDArray[np.int64]]
    taken: int


def imu_records(imu: ImuStream) -> Records:
    """Each sample of a stream as an :class:`ImuSample`."""
    samples = np.empty(len(imu), IMU_SAMPLE)
    samples["time_ns"], samples["rates"] = imu.time_ns, imu.angular_velocity
    samples["specific_force"] = imu.specific_force
    return samples


def in_order_of_arrival(recording: Recording) -> Arrivals:
    """The IMU samples of a recording, and its poses and velocities; the pose first where they tie.

    Raises:
        SignalError: if the recording has neither poses nor velocities.
    """
    pose, twist = recording.pose, recording.twist
    if pose is None and twist is None:
        raise SignalError(
            f"{recording.source}: topics mocap/pose, mocap/odometry and mocap/twist are missing: "
            "nothing to correct the IMU by"
        )
    parts, after = [], []
    if pose is not None:
        part = np.zeros(len(pose), MEASUREMENT)
        part["time_ns"], part["kind"] = pose.time_ns, POSE
        part["vector"], part["attitude"] = pose.position, pose.attitude
        part["deviation"] = pose.deviation
        parts.append(part)
        after.append(recording.arrivals_of(pose))
    if twist is not None:
        part = np.zeros(len(twist), MEASUREMENT)
        part["time_ns"], part["kind"] = twist.time_ns, np.where(twist.in_body, BODY_VELOCITY, WORLD_VELOCITY)
        part["vector"] = twist.velocity
        part["deviation"][:, 0] = twist.deviation
        parts.append(part)
        after.append(recording.arrivals_of(twist))
    arrived = np.concatenate(after).astype(np.int64)
    order = np.argsort(arrived, kind="stable")
    return Arrivals(imu_records(recording.imu), np.concatenate(parts)[order], arrived[order])


class Spans(NamedTuple):
    """From when to when there were samples of the IMU and of motion capture [ns]; None without any."""

    imu: tuple[int, int] | None = None
    mocap: tuple[int, int] | None = None
    mocap_topic: str = ""

    def extended(self, block: Recording) -> Spans:
        """The spans with one more block of the recording."""
        mocap = block.twist if block.pose is None else block.pose
        return Spans(
            _extended(self.imu, block.imu.time_ns),
            self.mocap if mocap is None else _extended(self.mocap, mocap.time_ns),
            self.mocap_topic if mocap is None else mocap.topic,
        )


def never_started(source: str, spans: Spans) -> SignalError:
    """The error of a recording over which the filter gave no estimate."""
    mocap = f"{spans.mocap_topic} {_span_text(spans.mocap)}" if spans.mocap else ""
    return SignalError(
        f"{source}: the estimator never started: it needs one second with IMU samples and "
        f"motion capture; imu spans {_span_text(spans.imu)}, {mocap}"
    )


def _extended(span: tuple[int, int] | None, time_ns: Stamps) -> tuple[int, int] | None:
    if len(time_ns) == 0:
        return span
    return int(time_ns[0]) if span is None else span[0], int(time_ns[-1])


def _span_text(span: tuple[int, int] | None) -> str:
    return "no time" if span is None else f"{span[0] * 1e-9:.3f} to {span[1] * 1e-9:.3f} s"


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
*_, MOTION_FORCE = columns_of(Motion)
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


# The result is that of Rauch, Tung and Striebel; the form is Bierman's modification of the Bryson-Frazier
# smoother, a recursion of the adjoint state that needs no inverse: G. J. Bierman, "Fixed interval smoothing
# with discrete measurements" (1973). The forward pass repeats the corrections of the causal filter in the
# order of their instants. It is stored at checkpoints only; between two of them it runs again when the
# backward pass gets there, so that memory stays bounded.

# IMU samples between checkpoints: a second at the usual rate.
CHUNK = 500


class Inputs(NamedTuple):
    """What the forward pass runs over.

    Attributes:
        imu: (M,) each :class:`ImuSample` that the filter used.
        journal: (J,) each :class:`Correction`, by its instant.
        noise: (1,) the :class:`Noise`.
    """

    imu: Records
    journal: Records
    noise: Records


class Length:
    """How much of a tape is in use."""

    events: int
    steps: int
    scalars: int
    estimates: int


class Tape(NamedTuple):
    """A forward pass over a chunk, for the backward pass.

    Attributes:
        length: (1,) see :class:`Length`.
        events: (T,) what happened, in order; the details are in the next array's order of each kind.
        steps: each :class:`Transition`.
        scalars: each :class:`Scalar`.
        estimates: each :class:`Estimate`.
    """

    length: Records
    events: Stamps
    steps: Records
    scalars: Records
    estimates: Records

    @classmethod
    def empty(cls, samples: int, corrections: int) -> Tape:
        """Room for a pass over that many IMU samples and corrections; without any, a pass is not recorded."""
        return cls(
            np.zeros(1, record_dtype(Length)),
            np.empty(2 * samples + 7 * corrections, dtype=np.int64),
            # With room for one more step and correction: a pass works there.
            np.empty(samples + corrections + 1, TRANSITION),
            np.empty(6 * corrections + 6, SCALAR),
            np.empty(samples, ESTIMATE),
        )


def smooth(imu_stream: ImuStream, segments: Sequence[Segment]) -> Estimates:
    """Smoothed estimates over a whole recording, at the IMU samples that the filter used.

    Args:
        imu_stream: of the recording.
        segments: at least one, see :meth:`.ekf.Ekf.segments`.
    """
    imu = imu_records(imu_stream)
    rows = np.concatenate([_smooth(imu, segment) for segment in segments])
    return Estimates(rows["time_ns"].copy(), rows)


def _smooth(imu: Records, segment: Segment) -> Records:
    """Smoothed estimates (M,) of one segment."""
    inputs = Inputs(imu[segment.samples], segment.journal, segment.noise)
    chunks = list(pairwise([*range(0, len(inputs.imu), CHUNK), len(inputs.imu)]))
    checkpoints = np.empty(len(chunks), ESTIMATE)
    applied = np.zeros(len(chunks) + 1, dtype=np.int64)
    estimate, no_tape = segment.initial.estimate.copy(), Tape.empty(0, 0)
    for chunk, (first, last) in enumerate(chunks):
        checkpoints[chunk] = estimate[0]
        applied[chunk + 1] = compiled.forward(inputs, estimate, first, last, int(applied[chunk]), no_tape)

    smoothed = np.empty(len(inputs.imu), ESTIMATED)
    adjoint, information = np.zeros(ERROR_STATES), np.zeros((ERROR_STATES, ERROR_STATES))
    tape = Tape.empty(CHUNK, int(np.diff(applied).max(initial=0)))
    for chunk, (first, last) in reversed(list(enumerate(chunks))):
        compiled.forward(inputs, checkpoints[chunk : chunk + 1], first, last, int(applied[chunk]), tape)
        compiled.backward(tape, adjoint, information, smoothed[first:last])
    smoothed["time_ns"] = inputs.imu["time_ns"]
    return smoothed[segment.first :]
