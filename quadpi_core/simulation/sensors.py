# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Sensor streams of a simulated vehicle: the truth sampled on each sensor's clock, then degraded.

In the order of the signal: mounting and lost frames, effects, noise, faults.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, TypeAlias

import numpy as np

from quadpi_core.config_schema import Expected, OneOf, Real, Section, Within, nearest, unknown_key
from quadpi_core.core import cosine, sine
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
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.signals.chain import Mask, interpolate, interpolate_attitude
from quadpi_core.simulation.applied_effects import altered_recording
from quadpi_core.simulation.effect_definition import Effects
from quadpi_core.simulation.effects.sensing import imu_misalignment
from quadpi_core.simulation.sensor_noise import (
    MotionCapture,
    SensorSuite,
    generator,
    inertial_samples,
    rotor_speed_unit,
    turned,
)
from quadpi_core.simulation.truth import Truth
from quadpi_core.vehicle import ROTORS, Vehicle

# Signals of each topic, with the unit that the size of a failure has in files; None where it has no size.
SIGNALS: dict[str, dict[str, str | None]] = {
    "imu": {"angular_velocity": "rad_s", "specific_force": "m_s2"},
    "rotor_speeds": {"speeds": "rad_s"},
    "mocap/pose": {"position": "m", "attitude": None},
    "wind": {"velocity": "m_s"},
}
_SPIKE_EVERY = 10
# Far beyond any flight [s], and its nanoseconds are still whole numbers of 64 bits.
Time: TypeAlias = Annotated[float, Within(0.0, 1e6)]


@dataclass(frozen=True)
class Sent:
    """Messages of a sensor: a stream of N samples, when each was taken (N,), and when it arrives (N,)."""

    stream: Stream
    taken_ns: Stamps
    arrival_ns: Stamps


@dataclass(frozen=True)
class FaultKind:
    """How a kind of failure alters the messages of a sensor.

    Attributes:
        summary: description in a few words.
        alter: gives the altered messages, from those without the failure, the samples (N,) in its window, and
            the fault.
        topics: topics that can fail in this way.
        one_signal: whether it may be confined to one signal of the topic.
        rotors: how many rotors may be named, fewest and most.
        size: "signal" where it adds to a signal, "stamps" where to the stamps, else "".
    """

    summary: str
    alter: Callable[[Sent, Mask, Fault], Sent]
    topics: tuple[str, ...] = tuple(SIGNALS)
    one_signal: bool = False
    rotors: tuple[int, int] = (0, 0)
    size: str = ""

    def sizes(self, topic: str) -> dict[str, str | None]:
        """Keys of a file that give the size, each with the signal that it belongs to."""
        if self.size == "stamps":
            return {"size_s": None}
        if self.size == "signal":
            return {f"size_{unit}": signal for signal, unit in SIGNALS[topic].items() if unit}
        return {}


def _not_finite(sent: Sent, window: Mask, fault: Fault) -> Sent:
    return _with_values(sent, window, fault, lambda values: np.full_like(values, np.nan))


def _frozen(sent: Sent, window: Mask, fault: Fault) -> Sent:
    last_good = _before(window)
    return _with_values(sent, window, fault, lambda values: values[last_good])


def _dropout(sent: Sent, window: Mask, _fault: Fault) -> Sent:
    outside = ~window
    columns = {name: values[outside] for name, values in vars(sent.stream).items()}
    return Sent(type(sent.stream)(**columns), sent.taken_ns[outside], sent.arrival_ns[outside])


def _spike(sent: Sent, window: Mask, fault: Fault) -> Sent:
    isolated = np.zeros_like(window)
    isolated[np.flatnonzero(window)[::_SPIKE_EVERY]] = True
    return _with_values(sent, isolated, fault, lambda values: values + fault.size)


def _half_reading(sent: Sent, window: Mask, fault: Fault) -> Sent:
    return _with_values(sent, window, fault, lambda values: 0.5 * values)


def _swapped(sent: Sent, window: Mask, fault: Fault) -> Sent:
    return _with_values(sent, window, fault, lambda values: values[:, ::-1])


def _jump(sent: Sent, window: Mask, fault: Fault) -> Sent:
    return _with_values(sent, window, fault, lambda values: values + np.array([fault.size, 0.0, 0.0]))


def _stamps_repeated(sent: Sent, window: Mask, _fault: Fault) -> Sent:
    stamps = sent.stream.time_ns
    return _with_stamps(sent, np.where(window, stamps[_before(window)], stamps))


def _stamps_backward(sent: Sent, window: Mask, fault: Fault) -> Sent:
    stamps = sent.stream.time_ns
    return _with_stamps(sent, np.where(window, stamps - round(1e9 * fault.size), stamps))


def _before(window: Mask) -> int:
    """Index of the sample before the window, or of the first where there is none."""
    return max(int(np.argmax(window)) - 1, 0)


def _with_values(sent: Sent, window: Mask, fault: Fault, alter: Callable[[Array], Array]) -> Sent:
    """The signals and rotors that fail, put through `alter` and taken from it in the window."""
    failing = [rotor - 1 for rotor in fault.rotors] or slice(None)
    columns = {}
    for signal in fault.signals:
        values = getattr(sent.stream, signal).copy()
        values[:, failing] = np.where(window[:, None], alter(values[:, failing]), values[:, failing])
        columns[signal] = values
    return replace(sent, stream=replace(sent.stream, **columns))


def _with_stamps(sent: Sent, time_ns: Stamps) -> Sent:
    return replace(sent, stream=replace(sent.stream, time_ns=time_ns))


_ROTORS_ONLY = ("rotor_speeds",)

KINDS: dict[str, FaultKind] = {
    "not_finite": FaultKind("sends no numbers (NaN)", _not_finite, one_signal=True, rotors=(0, ROTORS)),
    "frozen": FaultKind("repeats its last sample", _frozen, one_signal=True, rotors=(0, ROTORS)),
    "dropout": FaultKind("sends nothing", _dropout),
    "spike": FaultKind(f"every {_SPIKE_EVERY}th sample is off", _spike, rotors=(0, ROTORS), size="signal"),
    "half_reading": FaultKind("reads half the speed", _half_reading, topics=_ROTORS_ONLY, rotors=(0, ROTORS)),
    "swapped": FaultKind("two rotors are exchanged", _swapped, topics=_ROTORS_ONLY, rotors=(2, 2)),
    "jump": FaultKind("sees the vehicle farther north", _jump, topics=("mocap/pose",), size="signal"),
    "stamps_repeated": FaultKind("its clock stands still", _stamps_repeated),
    "stamps_backward": FaultKind("its clock is set back", _stamps_backward, size="stamps"),
}


@dataclass(frozen=True)
class Fault(Section):
    """An entry of `faults`: a sensor fails at `at_s` after the start of the flight, for `for_s`.

    Which keys an entry may have beside the first four depends on its kind and topic, see :class:`FaultKind`.

    Attributes:
        kind: a name of :data:`KINDS`.
        topic: topic that fails; `rotor_speeds` also where a bag holds `erpm`.
        signal: the one quantity of the stream that fails, by its name in :data:`SIGNALS`; None: all.
        size_rad_s, size_m_s2, size_m, size_m_s: how much is added to the signal of that unit.
        size_s: time by which stamps are set back.
        rotors: the rotors that fail, from 1; none named: all.
    """

    kind: Annotated[str, OneOf(*KINDS)]
    topic: str
    at_s: Time
    for_s: Time
    signal: str | None = None
    size_rad_s: Real | None = None
    size_m_s2: Real | None = None
    size_m: Real | None = None
    size_m_s: Real | None = None
    size_s: Time | None = None
    rotors: Annotated[tuple[Any, ...], Expected("must be a list of rotors")] = ()

    def __post_init__(self) -> None:
        """Refuse keys that this kind of failure does not have on this topic."""
        kind = KINDS[self.kind]
        _require_one_of("topic", self.topic, kind.topics)
        sizes = kind.sizes(self.topic)
        has_signals = kind.one_signal and len(SIGNALS[self.topic]) > 1
        has_rotors = self.topic == "rotor_speeds" and kind.rotors[1] > 0
        optional = ["signal"] * has_signals + ["rotors"] * has_rotors
        known = ["kind", "topic", "at_s", "for_s", *optional, *sizes]
        for key in self.as_dict():
            if key not in known:
                raise ValueError(unknown_key(key, known))
        if self.signal is not None:
            _require_one_of("signal", self.signal, SIGNALS[self.topic])
        if sizes and len([key for key in sizes if getattr(self, key) is not None]) != 1:
            raise ValueError(f"{self.kind} of {self.topic} needs `{'` or `'.join(sizes)}`")
        if has_rotors:
            _require_rotors(self.rotors, *kind.rotors)

    @property
    def signals(self) -> tuple[str, ...]:
        """The quantities of the stream that fail."""
        if self.signal is not None:
            return (self.signal,)
        sized = [s for key, s in KINDS[self.kind].sizes(self.topic).items() if getattr(self, key) is not None]
        return tuple(signal for signal in sized if signal) or tuple(SIGNALS[self.topic])

    @property
    def size(self) -> float:
        """How much is added, in the unit of the signal, or s of the stamps; 0 where nothing is."""
        given = (self.size_rad_s, self.size_m_s2, self.size_m, self.size_m_s, self.size_s)
        return next((size for size in given if size is not None), 0.0)

    def as_dict(self) -> dict[str, Any]:
        """The entry of a scenario file."""
        entry = {key: list(value) if key == "rotors" else value for key, value in vars(self).items()}
        return {key: value for key, value in entry.items() if value is not None and value != []}


def _require_one_of(key: str, value: str, known: Collection[str]) -> None:
    if value not in known:
        raise ValueError(f"`{key}` must be one of {', '.join(known)}, found {value!r}{nearest(value, known)}")


def _require_rotors(rotors: tuple[Any, ...], fewest: int, most: int) -> None:
    known = all(type(rotor) is int and 1 <= rotor <= ROTORS for rotor in rotors)
    if not known or len(set(rotors)) != len(rotors) or not fewest <= len(rotors) <= most:
        count = f"{fewest} different" if fewest == most else "different"
        raise ValueError(f"`rotors` must list {count} numbers from 1 to {ROTORS}, found {list(rotors)!r}")


def apply_faults(
    faults: Iterable[Fault], sent: Mapping[str, Sent], start_ns: int, end_ns: int
) -> dict[str, Sent]:
    """Messages of the sensors with the faults.

    Args:
        faults: faults in the order in which they are applied.
        sent: messages by topic.
        start_ns: start of the flight, to which the times of the faults refer.
        end_ns: end of the flight.

    Raises:
        SimulationError: for a fault of a topic that the flight does not have, or after its end.
    """
    altered = dict(sent)
    for fault in faults:
        what = f"fault {fault.kind} of topic {fault.topic} at {fault.at_s:g} s"
        if fault.topic not in altered:
            raise SimulationError(f"{what}: the flight has no such topic, but {', '.join(altered)}")
        if start_ns + round(1e9 * fault.at_s) > end_ns:
            raise SimulationError(f"{what}: the flight lasts {1e-9 * (end_ns - start_ns):g} s")
        before = altered[fault.topic]
        since_start = before.taken_ns - start_ns
        window = since_start >= round(1e9 * fault.at_s)
        window &= since_start < round(1e9 * (fault.at_s + fault.for_s))
        if window.any():
            altered[fault.topic] = KINDS[fault.kind].alter(before, window, fault)
    return altered


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
    return imu_misalignment.function(recording, vehicle, np.array(suite.imu.misalignment))


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
    return rolled | pitched


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
    return np.maximum.accumulate(stream.time_ns + np.rint(1e9 * late).astype(np.int64))
