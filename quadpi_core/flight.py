# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights: a recording holds sensor streams, each on its own clock; a flight holds signals on one grid.

A log reader or a bag gives a :class:`Recording`. :func:`quadpi_core.estimator.fusion.fuse` turns it into a
:class:`Flight` on the IMU's time grid, with the state estimated. Everything is SI, body axes
forward-right-down, world north-east-down, quaternions (w, x, y, z) body to world, rotors in the order of
the vehicle file. Stamps are integer nanoseconds; samples are on the first axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.core import compiled
from quadpi_core.errors import LogError, named_in
from quadpi_core.findings import NOTHING_TO_SAY, DataQuality, UsedPart
from quadpi_core.frames import Array
from quadpi_core.records import brief_repr
from quadpi_core.vehicle import Motors, stated_deviation

Stamps: TypeAlias = npt.NDArray[np.int64]
_DAY_NS = 86_400 * 1_000_000_000
# What these are stands in core/include/quadpi/limits.hpp.
FLIGHT_MAX_NS, MAX_GAP_NS = compiled.FLIGHT_MAX_NS, compiled.MAX_GAP_NS
MAX_JUMP_BACK_NS, NO_STAMP = compiled.MAX_JUMP_BACK_NS, compiled.NO_STAMP
# Seconds in messages have 32 bits.
STAMP_MAX_NS = 2**31 * 1_000_000_000 - 1
# Largest value of any quantity in SI units; sums of squares of such numbers keep their digits.
VALUE_MAX = 1e6
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")

_SomeStream = TypeVar("_SomeStream", bound="Stream")


@dataclass(frozen=True)
class Stream:
    """Samples of one topic: `time_ns` (N,) and one array of N rows per quantity.

    `shapes` are those of a row of each quantity; -1 stands for any length.
    """

    __repr__ = brief_repr

    topic: ClassVar[str]
    shapes: ClassVar[tuple[tuple[int, ...], ...]]
    time_ns: Stamps

    def __len__(self) -> int:
        return len(self.time_ns)

    def take(self: _SomeStream, rows: slice | npt.NDArray[Any]) -> _SomeStream:
        """The samples in a range, at indices, or that a mask (N,) selects."""
        return type(self)(*(getattr(self, column.name)[rows] for column in fields(self)))

    @classmethod
    def join(cls: type[_SomeStream], parts: Sequence[Stream]) -> _SomeStream:
        """The stream of consecutive parts of this kind."""
        return cls(
            *(np.concatenate([getattr(part, column.name) for part in parts]) for column in fields(cls))
        )

    def require_samples(self, source: str) -> None:
        """Refuse an empty stream with a LogError that names source and topic."""
        if len(self) == 0:
            raise LogError(f"{source}: topic {self.topic}: holds no samples")

    def require_shapes(self, source: str) -> None:
        """Refuse arrays that do not belong together with a LogError that names source and topic."""
        for column, shape in zip(fields(self), ((), *self.shapes), strict=True):
            values = getattr(self, column.name)
            kinds, words = {"time_ns": ("i", "int64 nanoseconds"), "in_body": ("b", "true and false")}.get(
                column.name, ("fiu", "numbers")
            )
            if not isinstance(values, np.ndarray) or values.dtype.kind not in kinds:
                raise LogError(
                    f"{source}: topic {self.topic}: {column.name}: expected an array of {words}, found "
                    f"{array_checks.description(values)}"
                )
            fitting = tuple(values.shape[-1] if width == -1 else width for width in shape)
            if values.shape != (len(self), *fitting):
                raise LogError(
                    f"{source}: topic {self.topic}: {column.name} has shape {values.shape}, expected "
                    f"{(len(self), *fitting)}"
                )

    def check(self, source: str) -> None:
        """Refuse what no later step can use.

        Raises:
            LogError: naming source, topic and sample, for arrays that do not belong together, an empty
                stream, stamps that repeat, run backward, span more than FLIGHT_MAX_NS or are none that a
                message can hold, and values that are not finite or beyond VALUE_MAX.
        """
        where = f"{source}: topic {self.topic}"
        self.require_shapes(source)
        check_stamps(where, self.time_ns)
        values = ValueCheck(where)
        values.add(self)
        values.finish()


def check_stamps(where: str, time_ns: Stamps) -> None:
    """Refuse the stamps (N,) of a topic that no later step can use; see :meth:`Stream.check`.

    Raises:
        LogError: that begins with `where` and names the sample, where there is one.
    """
    if len(time_ns) == 0:
        raise LogError(f"{where}: holds no samples")
    outside = (time_ns < 0) | (time_ns > STAMP_MAX_NS)
    if np.any(outside):
        index = int(np.argmax(outside))
        raise LogError(
            f"{where}: sample {index}: the stamp is before 1970 or after 2038 ({time_ns[index]} ns)"
        )
    steps = np.diff(time_ns)
    if np.any(steps <= 0):
        index = int(np.argmax(steps <= 0)) + 1
        kind = "repeats" if steps[index - 1] == 0 else "runs backward"
        raise LogError(f"{where}: sample {index}: the stamp {kind} ({time_ns[index]} ns)")
    if time_ns[-1] - time_ns[0] > FLIGHT_MAX_NS:
        index = int(np.argmax(steps)) + 1
        raise LogError(
            f"{where}: sample {index}: comes {steps[index - 1] / _DAY_NS:.1f} days after the one before; "
            f"no flight lasts {FLIGHT_MAX_NS // _DAY_NS} days"
        )


class ValueCheck:
    """Check of the values of a topic whose samples are added in parts; see :meth:`Stream.check`."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._before = 0
        # By column: the first sample that is not finite, and the largest number with its sample.
        self._not_finite: dict[str, int] = {}
        self._largest: dict[str, tuple[float, int]] = {}

    def add(self, stream: Stream) -> None:
        """Add the next samples."""
        for column in fields(stream) if len(stream) else ():
            values = getattr(stream, column.name).reshape(len(stream), -1)
            if values.dtype.kind != "f":
                continue
            self._largest.setdefault(column.name, (0.0, 0))
            finite = np.isfinite(values).all(axis=1)
            if not np.all(finite):
                self._not_finite.setdefault(column.name, self._before + int(np.argmin(finite)))
                continue
            index, place = divmod(int(np.argmax(np.abs(values))), values.shape[1])
            if abs(values[index, place]) > abs(self._largest[column.name][0]):
                self._largest[column.name] = float(values[index, place]), self._before + index
        self._before += len(stream)

    def finish(self) -> None:
        """Refuse values that no later step can use.

        Raises:
            LogError: naming the sample, for values that are not finite or beyond VALUE_MAX.
        """
        for name, (value, index) in self._largest.items():
            if name in self._not_finite:
                raise LogError(f"{self._where}: sample {self._not_finite[name]}: {name} is not finite")
            if abs(value) > VALUE_MAX:
                raise LogError(
                    f"{self._where}: sample {index}: {name} holds {value:.3g}; nothing in a flight is beyond "
                    f"{VALUE_MAX:g}"
                )


@dataclass(frozen=True, repr=False)
class ImuStream(Stream):
    """angular_velocity (N, 3) rad/s and specific_force (N, 3) m/s² in body axes (hover: z near -9.8)."""

    topic: ClassVar[str] = "imu"
    shapes: ClassVar = ((3,), (3,))
    angular_velocity: Array
    specific_force: Array


@dataclass(frozen=True, repr=False)
class RotorSpeedStream(Stream):
    """speeds (N, rotors) rad/s, mechanical, rotor order of the vehicle file."""

    topic: ClassVar[str] = "rotor_speeds"
    shapes: ClassVar = ((-1,),)
    speeds: Array


@dataclass(frozen=True, repr=False)
class MotorCommandStream(Stream):
    """commands (N, rotors) to the motors, a share of their range, rotor order of the vehicle file.

    A scale of its own is that of the source: :class:`quadpi_core.vehicle.Motors` is of one source.
    """

    topic: ClassVar[str] = "motor_commands"
    shapes: ClassVar = ((-1,),)
    commands: Array


@dataclass(frozen=True, repr=False)
class BatteryStream(Stream):
    """voltage (N,) V of the battery."""

    topic: ClassVar[str] = "battery"
    shapes: ClassVar = ((),)
    voltage: Array


@dataclass(frozen=True, repr=False)
class AirStream(Stream):
    """pressure (N,) Pa and temperature celsius (N,) of the air; NaN where a message does not tell it."""

    topic: ClassVar[str] = "pressure"
    shapes: ClassVar = ((), ())
    pressure: Array
    celsius: Array


@dataclass(frozen=True, repr=False)
class TemperatureStream(AirStream):
    """An :class:`AirStream` of a source that measures temperature alone."""

    topic: ClassVar[str] = "temperature"


# Standard deviation that marks a quantity as not measured.
NOT_MEASURED = -1.0


@dataclass(frozen=True, repr=False)
class _NoisyStream(Stream):
    """Samples with an optional standard deviation: 0 takes that of the vehicle file."""

    def __post_init__(self) -> None:
        if self.deviation is None:  # type: ignore[attr-defined]
            unstated = np.zeros((len(self.time_ns), *self.shapes[-1]))
            object.__setattr__(self, "deviation", unstated)


@dataclass(frozen=True, repr=False)
class PoseStream(_NoisyStream):
    """position (N, 3) m in the world and attitude (N, 4) body to world, of motion capture, GPS or vision.

    deviation (N, 2): standard deviations of both, m and rad; NOT_MEASURED for a part that has no values.
    """

    topic: ClassVar[str] = "mocap/pose"
    shapes: ClassVar = ((3,), (4,), (2,))
    position: Array
    attitude: Array
    deviation: Array = None  # type: ignore[assignment]


@dataclass(frozen=True, repr=False)
class TwistStream(_NoisyStream):
    """velocity (N, 3) m/s over ground, measured: in body axes where `in_body` (N,), else in the world.

    deviation (N,): its standard deviation, m/s.
    """

    topic: ClassVar[str] = "mocap/twist"
    shapes: ClassVar = ((3,), (), ())
    velocity: Array
    in_body: npt.NDArray[np.bool_]
    deviation: Array = None  # type: ignore[assignment]


@dataclass(frozen=True, repr=False)
class OdometryStream(_NoisyStream):
    """A fused state: position (N, 3) m world, attitude (N, 4), velocity (N, 3) m/s and rates (N, 3) body.

    deviation (N, 3): standard deviations of position m, attitude rad and velocity m/s; 0 where not known.
    """

    @property
    def stated(self) -> Array:
        """The deviations (N, 3) that somebody measured, see :func:`stated_deviation`."""
        return stated_deviation(self.deviation)

    topic: ClassVar[str] = "odometry"
    shapes: ClassVar = ((3,), (4,), (3,), (3,), (3,))
    position: Array
    attitude: Array
    velocity: Array
    rates: Array
    deviation: Array = None  # type: ignore[assignment]


@dataclass(frozen=True, repr=False)
class WindStream(Stream):
    """velocity (N, 3) m/s of the air over ground, in the world."""

    topic: ClassVar[str] = "wind"
    shapes: ClassVar = ((3,),)
    velocity: Array


@dataclass(frozen=True, repr=False)
class WrenchStream(Stream):
    """wrench (N, 6) N and Nm in body axes, gravity not included, that a simulation gave for this flight."""

    topic: ClassVar[str] = "simulation/wrench"
    shapes: ClassVar = ((6,),)
    wrench: Array


# Compared and hashed by identity: arrays have no truth value.
@dataclass(frozen=True, eq=False)
class Recording:
    """What one log holds, topic by topic; None where the log has no such topic.

    Attributes:
        name: stem of the file that it came from.
        vehicle: name of the vehicle file.
        source: path of the file, for messages.
        commands: to the motors; of a vehicle with `motors`, rotor speeds are made of them.
        battery: of whose voltage rotor speeds from commands depend.
        pressure, temperature: of the air; of the temperature alone where another source tells it.
        board_air: whether the temperature is that of a barometer on a board, which is warmer than the air.
        command_source: name of the adapter or format whose scale the commands have.
        commanded: whether the rotor speeds are made of the commands.
        arrivals: by topic, number of IMU samples that arrived before each sample (N,), where the log has it.
        quality: problems found in the data.
        remedies: by topic, what makes the source record it more often.
    """

    __repr__ = brief_repr

    name: str
    vehicle: str
    source: str
    imu: ImuStream
    rotor_speeds: RotorSpeedStream | None = None
    pose: PoseStream | None = None
    twist: TwistStream | None = None
    odometry: OdometryStream | None = None
    wind: WindStream | None = None
    simulated: WrenchStream | None = None
    commands: MotorCommandStream | None = None
    battery: BatteryStream | None = None
    pressure: AirStream | None = None
    temperature: AirStream | None = None
    board_air: bool = False
    command_source: str = ""
    commanded: bool = False
    arrivals: Mapping[str, Stamps] = field(default_factory=dict)
    quality: DataQuality = NOTHING_TO_SAY
    remedies: Mapping[str, str] = field(default_factory=dict)

    def require_rotors(self, vehicle: str, rotors: int) -> None:
        """Refuse speeds or commands of another number of rotors, naming source and topic in a LogError."""
        speeds, commands = self.rotor_speeds, self.commands
        for topic, values in (
            (RotorSpeedStream.topic, None if speeds is None else speeds.speeds),
            (MotorCommandStream.topic, None if commands is None else commands.commands),
        ):
            if values is not None and values.shape[1] != rotors:
                raise LogError(
                    f"{self.source}: topic {topic}: {values.shape[1]} rotors, vehicle {vehicle} has {rotors}"
                )

    def arrivals_of(self, stream: Stream) -> Stamps:
        """Number of IMU samples that arrived before each sample (N,): from the log, else from the stamps.

        Stamps are also used for a stream that has lost samples since it was read.
        """
        known = self.arrivals.get(stream.topic)
        if known is not None and len(known) == len(stream):
            return known
        return np.searchsorted(self.imu.time_ns, stream.time_ns, side="right")

    def streams(self) -> list[Stream]:
        """The streams that are present, which later steps use: rotor speeds, not what they may be made of."""
        return [stream for name in STREAM_KINDS if (stream := getattr(self, name)) is not None]

    def check(self) -> None:
        """Check every stream (see :meth:`Stream.check`)."""
        for stream in self.streams():
            stream.check(self.source)


# By the fields of a recording.
STREAM_KINDS: Mapping[str, type[Stream]] = {
    "imu": ImuStream,
    "rotor_speeds": RotorSpeedStream,
    "pose": PoseStream,
    "twist": TwistStream,
    "odometry": OdometryStream,
    "wind": WindStream,
    "simulated": WrenchStream,
}


# Numbers per sample of each quantity of a flight.
_FLIGHT_COLUMNS = {
    "position": 3,
    "attitude": 4,
    "velocity": 3,
    "rates": 3,
    "angular_acceleration": 3,
    "specific_force": 3,
    "rotor_speeds": array_checks.ANY,
    "wind": 3,
}


# Steps on an even grid from which on samples are left out between them.
_HOLE_STEPS = 1.5


def hole_ends(time: Array) -> npt.NDArray[np.int64]:
    """The samples of an even time grid (N,) s that come after some were left out, as `fusion.fuse` does."""
    steps = np.diff(time)
    usual = np.median(steps) if len(steps) else 0.0
    return np.flatnonzero(steps > _HOLE_STEPS * usual) + 1


def mean_rate_hz(time: Array) -> float:
    """Mean sample rate of an even time grid (N,) s, without its holes."""
    ends = hole_ends(time)
    holes_s = float(np.sum(time[ends] - time[ends - 1]))
    return float((len(time) - 1 - len(ends)) / (time[-1] - time[0] - holes_s))


@dataclass(frozen=True)
class Flight:
    """One flight on one time grid, filtered by one low-pass so that all signals share its delay.

    Attributes:
        start_ns: stamp of the first sample.
        time: (N,) seconds since the first sample; even but for holes where no rotor speeds are known.
        position: (N, 3) m, world.
        attitude: (N, 4) body to world.
        velocity: (N, 3) m/s over ground, body axes.
        rates: (N, 3) rad/s.
        angular_acceleration: (N, 3) rad/s², the derivative of `rates`.
        specific_force: (N, 3) m/s².
        rotor_speeds: (N, rotors) rad/s.
        wind: (N, 3) m/s, world; zero where it was not measured.
        quality: problems found in the data of the recording.
        biases_estimated: whether biases of the IMU were estimated and removed; false with odometry.
        position_measured: whether the position was measured, by motion capture or as a log has it; else it
            is the integrated velocity.
        sha256: hash of the sensor streams, the same for every copy of the flight; empty where not known.
        motors: that made the rotor speeds of motor commands; None where they were measured.
        air_ratio: density of the air over that of the vehicle file; 1 where nothing tells it.
    """

    __repr__ = brief_repr

    name: str
    vehicle: str
    source: str
    start_ns: int
    time: Array
    position: Array
    attitude: Array
    velocity: Array
    rates: Array
    angular_acceleration: Array
    specific_force: Array
    rotor_speeds: Array
    wind: Array
    quality: DataQuality = NOTHING_TO_SAY
    biases_estimated: bool = True
    position_measured: bool = True
    sha256: str = ""
    motors: Motors | None = None
    air_ratio: float = 1.0

    def __post_init__(self) -> None:
        """Refuse arrays that do not belong together, in the words of `quadpi_core.array_checks`."""
        with named_in(f"flight {self.name}"):
            time = array_checks.floats("time", self.time, finite=False)
            object.__setattr__(self, "time", time)
            for name, width in _FLIGHT_COLUMNS.items():
                array = array_checks.floats(
                    name, getattr(self, name), width, rows=len(time), of="time", finite=False
                )
                object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.time)

    def require_finite(self) -> None:
        """Refuse numbers that are not finite with a LogError that names flight, quantity and sample."""
        for name in ("time", *_FLIGHT_COLUMNS):
            finite = np.isfinite(getattr(self, name)).reshape(len(self), -1).all(axis=1)
            if not finite.all():
                raise LogError(f"{self.source or self.name}: {name}: sample {np.argmin(finite)}: not finite")

    @cached_property
    def rate_hz(self) -> float:
        """Mean sample rate, without what is left out in between."""
        return mean_rate_hz(self.time)

    @property
    def stamps_ns(self) -> Stamps:
        """Stamps (N,) of its samples."""
        return self.start_ns + np.round(1e9 * self.time).astype(np.int64)

    def slice(self, keep: slice | npt.NDArray[np.bool_]) -> Flight:
        """The samples of a range or mask (N,); `time` and `start_ns` still count from the original start."""
        kept: dict[str, Any] = {name: getattr(self, name)[keep] for name in ("time", *_FLIGHT_COLUMNS)}
        return replace(self, **kept)

    def longest_stretch(self) -> Flight:
        """The longest part without a hole, as spectra and roll-outs need; `quality` says so."""
        ends = hole_ends(self.time)
        if len(ends) == 0:
            return self
        begins, lasts = np.r_[0, ends], np.r_[ends, len(self)] - 1
        k = int(np.argmax(self.time[lasts] - self.time[begins]))
        part = self.slice(slice(int(begins[k]), int(lasts[k]) + 1))
        used = UsedPart(
            float(part.time[0]),
            float(part.time[-1]),
            len(part),
            float(self.time[-1] - self.time[0]),
            f"the longest of {len(begins)} parts with rotor speeds",
        )
        return replace(part, quality=self.quality.joined(DataQuality(used=(used,))))
