# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter over whole streams, in the order of arrival."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import SignalError
from quadpi_core.estimator.filter_state import (
    BODY_VELOCITY,
    ERROR_STATES,
    IMU_SAMPLE,
    MEASUREMENT,
    POSE,
    WORLD_VELOCITY,
    NominalState,
)
from quadpi_core.estimator.initialise import Initial
from quadpi_core.estimator.output import FUSED, FusedSamples
from quadpi_core.flight import ImuStream, Recording, Stamps
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.records import Records, record_dtype


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
        rows: (M,) each :class:`EstimatedSample`; the properties are views.
    """

    time_ns: Stamps
    rows: Records

    def __len__(self) -> int:
        return len(self.time_ns)

    @property
    def position(self) -> Array:
        """(M, 3) m, world."""
        return self.rows["position"]

    @property
    def velocity(self) -> Array:
        """(M, 3) m/s over ground, world."""
        return self.rows["velocity"]

    @property
    def attitude(self) -> Array:
        """(M, 4) body to world."""
        return self.rows["attitude"]

    @property
    def gyro_bias(self) -> Array:
        """(M, 3) rad/s."""
        return self.rows["gyro_bias"]

    @property
    def accelerometer_bias(self) -> Array:
        """(M, 3) m/s²."""
        return self.rows["accelerometer_bias"]

    @property
    def delay_s(self) -> Array:
        """(M,) of motion capture."""
        return self.rows["delay"]

    @property
    def variance(self) -> Array:
        """(M, 16) diagonal of the covariance of the error state, see :mod:`.filter_state`."""
        return self.rows["variance"]

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
