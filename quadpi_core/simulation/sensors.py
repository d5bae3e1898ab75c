# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Sensor streams of a simulated vehicle: the truth sampled on each sensor's clock, then degraded.

In the order of the signal: mounting and lost frames, effects, noise, faults.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from quadpi_core.elementary import cosine, sine
from quadpi_core.errors import SimulationError
from quadpi_core.flight import (
    MAX_GAP_NS,
    ImuStream,
    PoseStream,
    Recording,
    RotorSpeedStream,
    Stamps,
    Stream,
    WindStream,
)
from quadpi_core.frames import Array
from quadpi_core.signals.resample import Mask, interpolate, interpolate_attitude
from quadpi_core.simulation.applied_effects import altered_recording
from quadpi_core.simulation.effect_definition import Effects
from quadpi_core.simulation.effects.sensing import imu_misalignment
from quadpi_core.simulation.failures import Fault, Sent, apply_faults
from quadpi_core.simulation.sensor_noise import (
    MotionCapture,
    SensorSuite,
    generator,
    inertial_samples,
    rotor_speed_unit,
    turned,
)
from quadpi_core.simulation.truth import Truth
from quadpi_core.thresholds import CONVENTION, Threshold
from quadpi_core.vehicle import Vehicle

_FIELDS = {"imu": "imu", "rotor_speeds": "rotor_speeds", "mocap/pose": "pose", "wind": "wind"}
JITTER_MAX = Threshold(
    "largest jitter of a frame",
    0.4,
    "of its period",
    "with less than half, frames keep their order",
    CONVENTION,
)


@dataclass(frozen=True)
class Sensed:
    """Messages of the sensors of one flight.

    Attributes:
        recording: recording as a bag of the flight holds it; with some faults :meth:`Recording.check` refuses
            it.
        erpm: (M, rotors) electrical speeds, whole numbers, whose mechanical ones are
            `recording.rotor_speeds`; None for a vehicle without pole pairs, whose mechanical speeds are
            measured directly.
        arrival_ns: when each sample arrived, by topic.
    """

    recording: Recording
    erpm: Array | None
    arrival_ns: dict[str, Stamps]


def sense(
    truth: Truth, vehicle: Vehicle, suite: SensorSuite, effects: Effects, faults: Iterable[Fault], seed: int
) -> Sensed:
    """Sensor streams of a flight; wind only where an anemometer measures it.

    Args:
        truth: truth of the flight, evenly sampled.
        vehicle: nominal vehicle, without the effects.
        suite: sensors and their noise.
        effects: effects, of which only those of kind "sensor" act here.
        faults: applied last, before electrical speeds are rounded.
        seed: seed of all random numbers.

    Raises:
        SimulationError: for a sensor whose rate does not divide that of the truth, and a fault of a sensor
            that is not there or after the end of the flight.
    """
    recording = altered_recording(effects, ideal_recording(truth, vehicle, suite, seed), vehicle)
    sent = {}
    for ideal in recording.streams():
        stream = _with_noise(ideal, suite, vehicle, seed)
        sent[stream.topic] = Sent(stream, stream.time_ns, _arrival(stream, suite.mocap, seed))
    try:
        sent = apply_faults(faults, sent, int(truth.time_ns[0]), int(truth.time_ns[-1]))
    except SimulationError as error:
        raise SimulationError(f"flight {truth.name}: {error}") from None
    streams: dict[str, Any] = {_FIELDS[topic]: one.stream for topic, one in sent.items()}
    erpm, rotors = None, streams["rotor_speeds"]
    if vehicle.pole_pairs is not None:
        erpm = np.rint(rotors.speeds / rotor_speed_unit(vehicle))
        streams["rotor_speeds"] = replace(rotors, speeds=vehicle.rotor_speeds_from_erpm(erpm))
    return Sensed(
        recording=replace(recording, **streams),
        erpm=erpm,
        arrival_ns={topic: one.arrival_ns for topic, one in sent.items()},
    )


def ideal_recording(truth: Truth, vehicle: Vehicle, suite: SensorSuite, seed: int) -> Recording:
    """Noise-free sensor streams at the mounting of the sensors, without lost frames of motion capture.

    Raises:
        SimulationError: for a sensor whose rate does not divide that of the truth.
    """
    taken = _every(truth, suite.imu.rate, "imu", suite)
    arm = np.array(suite.imu.position)
    swept = np.cross(truth.angular_acceleration, arm) + np.cross(truth.rates, np.cross(truth.rates, arm))
    imu = ImuStream(truth.time_ns[taken], truth.rates[taken], (truth.specific_force + swept)[taken])
    taken = _every(truth, suite.rotor_speeds.rate, "rotor_speeds", suite)
    rotor_speeds = RotorSpeedStream(truth.time_ns[taken], truth.rotor_speeds[taken])
    wind = None
    if truth.known_wind is not None:
        taken = _every(truth, suite.wind.rate, "wind", suite)
        wind = WindStream(truth.time_ns[taken], truth.known_wind[taken])
    recording = Recording(
        name=truth.name,
        vehicle=vehicle.name,
        source=truth.name,
        imu=imu,
        rotor_speeds=rotor_speeds,
        pose=_seen_poses(truth, suite.mocap, seed),
        wind=wind,
    )
    turned_imu: Recording = imu_misalignment.function(recording, vehicle, np.array(suite.imu.misalignment))
    return turned_imu


def _every(truth: Truth, rate_hz: float, sensor: str, suite: SensorSuite) -> slice:
    """The instants of the truth at which a sensor samples."""
    truth_hz = 1e9 / float(truth.time_ns[1] - truth.time_ns[0])
    step = round(truth_hz / rate_hz)
    if step < 1 or not math.isclose(step * rate_hz, truth_hz):
        raise SimulationError(
            f"noise {suite.name}: {sensor}: `rate_hz` must divide the {truth_hz:g} Hz of the simulation, "
            f"found {rate_hz:g}"
        )
    return slice(None, None, step)


def _seen_poses(truth: Truth, mocap: MotionCapture, seed: int) -> PoseStream:
    """Poses at the instants of the frames in which the markers are seen, between samples of the truth."""
    random = generator(seed, "mocap frames")
    count = int(truth.time[-1] * mocap.rate)
    drawn = mocap.capture_jitter * mocap.rate * random.standard_normal(count)
    jitter = drawn.clip(-JITTER_MAX.value, JITTER_MAX.value)
    # Half a period from the start: with jitter, too, every frame lies within the flight.
    frames = truth.time_ns[0] + np.rint(1e9 / mocap.rate * (np.arange(count) + 0.5 + jitter)).astype(np.int64)
    attitude = interpolate_attitude(truth.time_ns, truth.attitude, frames, MAX_GAP_NS).values
    lost = random.random(count) < mocap.dropout_probability
    hidden = _hidden(
        _tilted(attitude, math.radians(mocap.obscured_angle)),
        random.random(count),
        mocap.obscured_share,
        1.0 / (mocap.obscured_burst * mocap.rate),
    )
    seen = ~(lost | hidden)
    position = interpolate(truth.time_ns, truth.position, frames[seen], MAX_GAP_NS).values
    return PoseStream(frames[seen], position, attitude[seen])


def _tilted(attitude: Array, angle: float) -> Mask:
    """Where roll or pitch exceed an angle [rad], from their cosine and sine alone."""
    w, x, y, z = attitude.T
    sine_of_pitch = 2.0 * (w * y - x * z)
    roll_x, roll_y = 1.0 - 2.0 * (x * x + y * y), 2.0 * (y * z + w * x)
    rolled = roll_x < cosine(angle) * np.sqrt(roll_x * roll_x + roll_y * roll_y)
    pitched = np.abs(sine_of_pitch) > sine(min(angle, 0.5 * math.pi))
    tilted: Mask = rolled | pitched
    return tilted


def _hidden(tilted: Mask, draws: Array, share: float, ending: float) -> Mask:
    """Frames in which the markers are hidden: a share of those tilted, in bursts.

    A burst ends with probability `ending` per frame, or when the vehicle is level again.
    """
    ending = min(ending, 1.0) if share < 1.0 else 0.0
    beginning = min(ending * share / (1.0 - share), 1.0) if share < 1.0 else 1.0
    hidden, before = np.zeros_like(tilted), -1
    for frame in np.flatnonzero(tilted).tolist():
        if frame != before + 1 or frame == 0:
            hidden[frame] = draws[frame] < share
        elif hidden[before]:
            hidden[frame] = draws[frame] >= ending
        else:
            hidden[frame] = draws[frame] < beginning
        before = frame
    return hidden


def _with_noise(stream: Stream, suite: SensorSuite, vehicle: Vehicle, seed: int) -> Stream:
    random = generator(seed, stream.topic)

    def noisy(values: Array, deviation: float) -> Array:
        return values + deviation * random.standard_normal(values.shape)

    match stream:
        case ImuStream():
            imu = suite.imu
            return replace(
                stream,
                angular_velocity=inertial_samples(
                    stream.angular_velocity, imu.gyro, imu.rate, generator(seed, "gyro")
                ),
                specific_force=inertial_samples(
                    stream.specific_force, imu.accelerometer, imu.rate, generator(seed, "accelerometer")
                ),
            )
        case RotorSpeedStream():
            speeds = noisy(stream.speeds, suite.rotor_speeds.noise * rotor_speed_unit(vehicle))
            return replace(stream, speeds=np.maximum(speeds, 0.0))
        case PoseStream():
            position = noisy(stream.position, suite.mocap.position_noise)
            turn = suite.mocap.attitude_noise * random.standard_normal(position.shape)
            return replace(stream, position=position, attitude=turned(stream.attitude, turn))
        case WindStream():
            return replace(stream, velocity=noisy(stream.velocity, suite.wind.noise))
    return stream


def _arrival(stream: Stream, mocap: MotionCapture, seed: int) -> Stamps:
    """Arrival of each sample: at once, except for poses, which arrive late and in order."""
    if not isinstance(stream, PoseStream):
        return stream.time_ns
    late = mocap.latency + mocap.arrival_jitter * generator(seed, "mocap arrival").exponential(
        size=len(stream)
    )
    arrival: Stamps = np.maximum.accumulate(stream.time_ns + np.rint(1e9 * late).astype(np.int64))
    return arrival
