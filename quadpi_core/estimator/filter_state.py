# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The state of the Kalman filter: an estimate, the samples that change it, and all that the filter remembers.

The records are those of core/include/quadpi/estimator/filter_state.hpp, whose functions change them in place.

Error state, 16 numbers: position and velocity in the world, attitude as a rotation vector in body axes
(true = estimated ⊗ exp(error)), gyro bias, accelerometer bias, and the delay of motion capture: what it
stamps s was true at s less the delay.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.flight import NO_STAMP
from quadpi_core.frames import Array
from quadpi_core.records import Column, Quaternion4, Records, Vector3, columns_of, record_dtype
from quadpi_core.signals.chain import RATE_SPAN
from quadpi_core.vehicle import Vehicle


class ErrorState:
    """The error of an estimate; a covariance has a row and a column for each of its numbers."""

    position: Vector3
    velocity: Vector3
    attitude: Vector3
    gyro_bias: Vector3
    accelerometer_bias: Vector3
    delay: float


POSITION, VELOCITY, ATTITUDE, GYRO_BIAS, ACCELEROMETER_BIAS, _DELAY = columns_of(ErrorState)
DELAY, ERROR_STATES = _DELAY.start, _DELAY.stop

# Kinds of measurement.
POSE, WORLD_VELOCITY, BODY_VELOCITY = 0, 1, 2

# The drift of unrelated clocks, 0.5 ms in half a minute, as a random walk of the delay [s/√s].
_DELAY_WALK_S = 1e-4


class Outcome(IntEnum):
    """What became of one sample."""

    USED = 0
    COLLECTED = 1  # kept: for the initialisation, or until it is time to fuse it
    UNUSABLE = 2  # a value is not finite or impossible, or an attitude is no rotation
    STAMP_NOT_ADVANCING = 3
    TOO_LATE = 4
    TOO_EARLY = 5
    RESET = 6  # the IMU paused too long, its clock jumped back or its rate changed: the filter starts again
    REJECTED = 7  # contradicts the estimate by more than both uncertainties allow
    FROZEN = 8  # repeats the previous value bit for bit: no new measurement
    STAMP_JUMPED = 9  # an IMU sample far from the previous one: RESET if the next one agrees with it


# IMU samples without an estimate at their stamps that the monitor is given all the same: it reports the gap.
WITHOUT_ESTIMATE = (Outcome.UNUSABLE, Outcome.COLLECTED, Outcome.RESET)


class EstimatorStatus(IntEnum):
    """How far the estimate can be used."""

    INITIALISING = 0
    OK = 1
    DEGRADED = 2  # not settled, no correction for a while, or corrections are being rejected
    LOST = 3  # no correction for so long, or a velocity so uncertain, that there is no usable state


class ImuSample:
    """One IMU sample as it came, in body axes."""

    time_ns: int
    rates: Vector3  # rad/s
    specific_force: Vector3  # m/s²


class Measurement:
    """One pose or velocity that corrects the estimate: of motion capture, of GPS, of another estimator."""

    time_ns: int
    kind: int  # POSE, WORLD_VELOCITY or BODY_VELOCITY
    vector: Vector3  # position [m] in the world, or velocity over ground [m/s] in the axes of its kind
    attitude: Quaternion4  # body to world, of any norm and sign; zeros for a velocity
    # Standard deviations of vector and attitude [rad]; 0 is that of the vehicle, below 0 is not measured.
    deviation: Annotated[Array, 2]


class NominalState:
    """The numbers that are estimated, without their errors."""

    position: Vector3  # m, world
    velocity: Vector3  # m/s over ground, world
    attitude: Quaternion4  # body to world
    gyro_bias: Vector3  # rad/s
    accelerometer_bias: Vector3  # m/s²
    delay: float  # s, of motion capture


class Estimate(ImuSample, NominalState):
    """The state at one instant, with the IMU sample of that instant."""

    covariance: Annotated[Array, ERROR_STATES, ERROR_STATES]  # of the error state


class Noise:
    """What the filter assumes of the sensors."""

    gyro: float  # density, (rad/s)²/Hz
    accelerometer: float  # density, (m/s²)²/Hz
    gyro_bias: float  # growth of the variance per second
    accelerometer_bias: float  # growth of the variance per second
    delay: float  # growth of the variance per second
    position: float  # variance of a pose, m²
    attitude: float  # variance of a pose, rad²
    velocity: float  # variance of a velocity, (m/s)²
    delay_prior: float  # variance of the delay before anything is known of it, s²; 0: stamps are trusted
    rates: float  # variance of one gyro sample, (rad/s)²
    specific_force: float  # variance of one accelerometer sample, (m/s²)²
    gravity: float  # m/s², along the world's third axis


class Transition:
    """The blocks of the matrix F that a step of the IMU applies to the error state."""

    dt: float
    velocity_by_attitude: Annotated[Array, 3, 3]
    velocity_by_accelerometer_bias: Annotated[Array, 3, 3]
    attitude_by_attitude: Annotated[Array, 3, 3]
    world_force: Vector3  # specific force [m/s²] in the world


class Scalar:
    """One scalar component of a measurement, and how it corrected the error state."""

    jacobian: Annotated[Array, ERROR_STATES]  # h
    residual: float  # measured less estimated, before the other components
    variance: float  # of the component, with what the linear model leaves out
    gain: Annotated[Array, ERROR_STATES]  # k
    innovation: float
    innovation_variance: float


class Widening:
    """Variances added to an estimate before a measurement beyond its gate is believed."""

    position: float
    velocity: float
    attitude: float
    delay: float


class Correction:
    """A measurement as it was fused."""

    time_ns: int  # of the estimate that it corrected
    nis: float  # squared innovation in units of its covariance
    measurement: Measurement
    widening: Widening


class Source:
    """What is remembered of one source of measurements: poses or velocities."""

    arrived_ns: int  # stamp of the last measurement that was held
    last: Measurement  # the last one whose value was new
    repeats: int  # of that value
    changes: int  # of the value, up to where repeating is known to be no habit of this source
    refused: Measurement  # the last one rejected
    refused_since_ns: int
    refusals: int  # in a row that agree among themselves
    step_ns: int  # between the last two measurements
    step_before_ns: int  # between the two before


class Filter:
    """All that the filter remembers beside its ring of estimates."""

    noise: Noise
    newest: int  # place of the newest estimate in the ring
    filled: int  # places in use
    status: int  # see EstimatorStatus
    counts: Annotated[npt.NDArray[np.int64], 3, len(Outcome)]  # of IMU samples, poses and velocities
    accepted_ns: int  # stamp of the IMU sample at which a correction was last accepted
    jumped_ns: int  # stamp of the previous IMU sample, where that was far from all before it
    rate_span_ns: int  # usual time of RATE_SPAN steps of the IMU; 0 where its rate is given
    rate_off_ns: int  # for how long nearly all such spans have differed from that
    sources: Annotated[Records, Source, 2]  # poses and velocities
    # A ring of measurements that wait for their time, by stamp.
    held: Annotated[Records, Measurement, compiled.HELD]
    held_first: int
    held_count: int
    journalled: int  # corrections written to the journal
    corrected: Estimate  # after the last correction, at its instant
    # Room to work.
    prior: Estimate
    trial: Estimate
    correction: Correction
    transition: Transition
    scalars: Annotated[Records, Scalar, 6]


IMU_SAMPLE, MEASUREMENT, ESTIMATE = (record_dtype(kind) for kind in (ImuSample, Measurement, Estimate))
NOISE, TRANSITION, SCALAR = (record_dtype(kind) for kind in (Noise, Transition, Scalar))
CORRECTION, FILTER = record_dtype(Correction), record_dtype(Filter)


@dataclass(frozen=True)
class State:
    """The estimate at the stamp of the newest IMU sample; views that the next samples overwrite.

    Attributes:
        rows: () an :class:`Estimate`, whose fields these are: position (3,) m and velocity m/s over ground,
            world, attitude (4,) body to world, the biases of gyro rad/s and accelerometer m/s², rates rad/s
            and specific_force m/s² of the IMU as they came, and the covariance (16, 16) of the error state.
    """

    rows: Records
    position, velocity, attitude = Column("position"), Column("velocity"), Column("attitude")
    gyro_bias, accelerometer_bias = Column("gyro_bias"), Column("accelerometer_bias")
    rates, specific_force, covariance = Column("rates"), Column("specific_force"), Column("covariance")

    @property
    def time_ns(self) -> int:
        """Stamp."""
        return int(self.rows["time_ns"])

    @property
    def delay_s(self) -> float:
        """By how much the stamps of motion capture are late."""
        return float(self.rows["delay"])


class Memory(NamedTuple):
    """The filter's memory, which kernels change in place.

    Attributes:
        filter: (1,) a :class:`Filter`.
        ring: (N,) an :class:`Estimate` at the stamp of each IMU sample of the last half second.
    """

    filter: Records
    ring: Records


class Live(NamedTuple):
    """The same, as it takes one IMU sample after the other.

    Attributes:
        filter, ring: as there.
        sample: (1,) an :class:`ImuSample`, the one at hand.
        fused: (1,) the `output.FusedSample` after it.
    """

    filter: Records
    ring: Records
    sample: Records
    fused: Records


def allocate(vehicle: Vehicle, rate_hz: float) -> Memory:
    """An empty memory for a vehicle whose IMU has this rate."""
    length = max(int(np.ceil(1e-9 * compiled.BUFFER_NS * rate_hz)), RATE_SPAN) + 3
    memory = Memory(np.zeros(1, FILTER), np.zeros(length, ESTIMATE))
    memory.filter["noise"] = assumed_noise(vehicle, rate_hz)
    forget(memory)
    return memory


def forget(memory: Memory) -> None:
    """Empty the memory, but for the noise and the counts."""
    noise, counts = memory.filter["noise"].copy(), memory.filter["counts"].copy()
    memory.filter[:] = np.zeros(1, FILTER)
    memory.filter["noise"], memory.filter["counts"] = noise, counts
    memory.filter["jumped_ns"] = memory.filter["sources"]["arrived_ns"] = NO_STAMP


def begin(memory: Memory, estimate: Records, imu_ns: int) -> None:
    """Begin with an estimate (1,) whose instant is at or after an IMU sample stamped `imu_ns`."""
    forget(memory)
    memory.filter["corrected"] = memory.ring[0] = estimate[0]
    memory.ring["time_ns"][0] = imu_ns
    memory.filter["filled"] = 1
    memory.filter["accepted_ns"] = imu_ns


def assumed_noise(vehicle: Vehicle, rate_hz: float) -> Records:
    """The :class:`Noise` (1,) that the filter assumes of a vehicle whose IMU has this rate."""
    # Python's powers are those of the C library, which differ by processor.
    sensors = vehicle.noise
    noise = np.zeros(1, NOISE)
    noise["gyro"] = np.square(sensors.gyro_noise_rad_s) / rate_hz
    noise["accelerometer"] = np.square(sensors.accelerometer_noise_m_s2) / rate_hz
    noise["gyro_bias"] = np.square(sensors.gyro_bias_walk)
    noise["accelerometer_bias"] = np.square(sensors.accelerometer_bias_walk)
    noise["delay"] = np.square(_DELAY_WALK_S) if sensors.mocap_delay_std_s > 0.0 else 0.0
    noise["position"] = np.square(sensors.mocap_position_m)
    noise["attitude"] = np.square(sensors.mocap_attitude_rad)
    noise["velocity"] = np.square(sensors.mocap_velocity_m_s)
    noise["delay_prior"] = np.square(sensors.mocap_delay_std_s)
    noise["rates"] = np.square(sensors.gyro_noise_rad_s)
    noise["specific_force"] = np.square(sensors.accelerometer_noise_m_s2)
    noise["gravity"] = vehicle.gravity_m_s2
    return noise


# A rate is measured over the first second by :func:`quadpi_core.signals.chain.nominal_rate`, which jitter,
# single lost samples and repeated stamps do not change. From then on every span of ten steps is compared with
# it. Single spans are longer where samples were lost; the rate has changed when nearly all spans differ for
# a while (imu_rate.hpp). After a pause or a jump of the clock the rate is measured again: the driver may have
# restarted.

# Largest difference from a given rate, as a share of it: the cut-off of a low-pass designed for that rate,
# and the noise of the estimator, are off by as much.
RATE_TOLERANCE = 0.1
# Used until the rate is known; no sample is judged before.
RATE_BEFORE_HZ = 500.0


class ImuRate(NamedTuple):
    """What is known of the rate.

    Attributes:
        measured_hz: by the stamps; 0 while it is being measured.
        given_hz: by the user; 0 where the measured one counts.
        lost: whether it is being measured again, after a pause or a change.
    """

    measured_hz: float = 0.0
    given_hz: float = 0.0
    lost: bool = False

    @classmethod
    def from_meters(cls, meters: Records, given_hz: float) -> ImuRate:
        """The rate as a :class:`Meter` (1,) knows it now, beside the one given by the user."""
        span_ns = float(meters["span_ns"][0])
        return cls(1e9 * RATE_SPAN / span_ns if span_ns > 0.0 else 0.0, given_hz, bool(meters["lost"][0]))

    @property
    def differs(self) -> bool:
        """Whether the configured rate contradicts the measured one."""
        known = self.given_hz > 0.0 and self.measured_hz > 0.0
        return known and abs(self.measured_hz / self.given_hz - 1.0) > RATE_TOLERANCE

    @property
    def filter_hz(self) -> float:
        """The rate to design filters for; 0 where it is not known, or not the one that was given."""
        if self.measured_hz == 0.0 or self.differs:
            return 0.0
        return self.given_hz or self.measured_hz

    @property
    def begins(self) -> bool:
        """Whether the first second has not passed yet: nothing can be judged, and nothing is wrong."""
        return self.measured_hz == 0.0 and not self.lost

    def __str__(self) -> str:
        if self.differs:
            return f"stamps say {self.measured_hz:.0f} Hz, imu_rate_hz is {self.given_hz:g}"
        return f"{self.filter_hz:.4g} Hz" if self.filter_hz else "being measured"


class Meter:
    """What is remembered of the stamps."""

    span_ns: float  # usual time of ten steps; 0 while it is not known
    lost: bool  # whether the rate is being measured again, after a pause or a change
    changes: int  # how often `span_ns` or `lost` has changed
    count: int  # stamps since the measurement began
    newest_ns: int
    jumped_ns: int  # stamp of the previous sample, where that was far from all before it
    off_ns: int  # for how long nearly all spans have differed from the usual one
    stamps: Annotated[npt.NDArray[np.int64], compiled.METER_ROOM]  # a ring of those since it began


METER = record_dtype(Meter)
