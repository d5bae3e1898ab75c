# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reference and truth of a simulated flight, and the signals that references are made of."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Annotated, Any, NamedTuple, TypeAlias, TypeVar

import numpy as np

from quadpi_core.config_schema import (
    Expected,
    Flag,
    Key,
    NotEmpty,
    NotNegative,
    OneOf,
    Positive,
    Real,
    RefusedError,
    Section,
    Within,
    check_config,
)
from quadpi_core.core import compiled
from quadpi_core.flight import Flight, Stamps
from quadpi_core.frames import Array, rotate_body_to_world
from quadpi_core.inputs import INPUT_NAMES, aerodynamic_inputs, relative_to_air
from quadpi_core.models.envelope import MARGIN, Envelope
from quadpi_core.records import Records, brief_repr
from quadpi_core.simulation.simulated_file import IdentifiedRange
from quadpi_core.vehicle import Vehicle


class Excursion(NamedTuple):
    """How a flight left the ranges of the inputs that a vehicle was identified on.

    Attributes:
        share: of the time outside, by more than the margin of a warning in flight.
        input: that went furthest, in widths of its range.
        reached: its value there.
        lower, upper: its range.
    """

    share: float
    input: str
    reached: float
    lower: float
    upper: float

    def sentence(self) -> str:
        """In words."""
        return (
            f"beyond the flights that the vehicle was identified on for {self.share:.1%} of its time, where "
            f"the simulation extrapolates: {self.input} reaches {self.reached:.3g} and was {self.lower:.3g} "
            f"to {self.upper:.3g}"
        )


def excursion(
    limits: IdentifiedRange | None, vehicle: Vehicle, log: Records, wind: Array
) -> Excursion | None:
    """How far records `state_records.Logged` (N,) in a wind (N, 3) m/s of the world lie outside; None inside.

    None also for a vehicle that was not identified, which has no limits.
    """
    if limits is None or len(log) == 0:
        return None
    attitude, velocity, rates, speeds = (
        np.ascontiguousarray(log[name]) for name in ("attitude", "velocity", "rates", "rotor_speeds")
    )
    inputs = aerodynamic_inputs(relative_to_air(velocity, attitude, wind), attitude, rates, speeds, vehicle)
    distances = Envelope.outside(inputs, limits.lower, limits.upper)
    outside = np.any(distances > MARGIN, axis=1)
    if not np.any(outside):
        return None
    row, column = np.unravel_index(int(np.argmax(distances)), distances.shape)
    ends = inputs[row, column], limits.lower[column], limits.upper[column]
    return Excursion(float(np.mean(outside)), INPUT_NAMES[column], *(float(value) for value in ends))


# Instants per second at which a flight is simulated, and a reference followed.
STEP_HZ = compiled.STEP_HZ
# Instants per second that are logged: those of the fastest sensors.
LOG_HZ = 500


@dataclass(frozen=True)
class Reference:
    """N instants, evenly spaced; world north-east-down, SI.

    Attributes:
        position: (N, 3) m.
        velocity: (N, 3) m/s, its derivative.
        acceleration: (N, 3) m/s², its second derivative.
        yaw: (N,) rad, not wrapped.
        yaw_rate: (N,) rad/s, its derivative.
        tilt: (N, 2) rad of roll and pitch added to the controller's demand, to excite moments.
        thrust: (N,) added to the controller's demand, as a share of the weight.
    """

    position: Array
    velocity: Array
    acceleration: Array
    yaw: Array
    yaw_rate: Array
    tilt: Array
    thrust: Array

    def __len__(self) -> int:
        return len(self.yaw)

    def every(self, step: int) -> Reference:
        """Every `step`-th instant, from the first."""
        return Reference(**{column.name: getattr(self, column.name)[::step] for column in fields(self)})

    @classmethod
    def hover(cls, position: Array, samples: int) -> Reference:
        """Hover at a position (3,), nose north."""
        still = np.zeros((samples, 3))
        level = np.zeros(samples)
        return cls(still + position, still, still, level, level, np.zeros((samples, 2)), level)


@dataclass(frozen=True)
class Truth:
    """N instants of a simulated flight; body axes forward-right-down, world north-east-down, SI.

    Attributes:
        vehicle: as it truly flew: mass and inertia include effects such as a payload.
        position: (N, 3) m, world.
        attitude: (N, 4) body to world.
        velocity: (N, 3) m/s over ground, body axes.
        rates: (N, 3) rad/s.
        acceleration: (N, 3) m/s², second derivative of the position, world.
        angular_acceleration: (N, 3) rad/s².
        rotor_speeds: (N, rotors) rad/s.
        rotor_accelerations: (N, rotors) rad/s².
        wrench: (N, 6) aerodynamics and every effect, gravity not included.
        wind: (N, 3) m/s of the air over ground, world.
        known_wind: (N, 3) m/s, the part of it that an anemometer measures; None without one.
        reference: reference of the controller at the same instants.
        excursion: where the flight goes beyond those that the vehicle was identified on; None where it
            does not, and for a vehicle that was not identified.
    """

    __repr__ = brief_repr

    name: str
    vehicle: Vehicle
    time_ns: Stamps
    position: Array
    attitude: Array
    velocity: Array
    rates: Array
    acceleration: Array
    angular_acceleration: Array
    rotor_speeds: Array
    rotor_accelerations: Array
    wrench: Array
    wind: Array
    known_wind: Array | None
    reference: Reference
    excursion: Excursion | None = None

    def __len__(self) -> int:
        return len(self.time_ns)

    @property
    def time(self) -> Array:
        """Seconds (N,) since the first instant."""
        return 1e-9 * (self.time_ns - self.time_ns[0])

    @property
    def specific_force(self) -> Array:
        """Specific force (N, 3) m/s² at the centre of gravity, body axes."""
        return self.wrench[:, :3] / self.vehicle.mass_kg

    @property
    def position_error(self) -> Array:
        """Distance (N,) m from the reference."""
        return np.linalg.norm(self.position - self.reference.position, axis=1)

    @property
    def speed(self) -> Array:
        """Airspeed (N,) m/s."""
        over_ground = rotate_body_to_world(self.attitude, self.velocity)
        return np.linalg.norm(over_ground - self.wind, axis=1)

    def flight(self) -> Flight:
        """The truth as a flight, as if the estimator were perfect."""
        return Flight(
            name=self.name,
            vehicle=self.vehicle.name,
            source=self.name,
            start_ns=int(self.time_ns[0]),
            time=self.time,
            position=self.position,
            attitude=self.attitude,
            velocity=self.velocity,
            rates=self.rates,
            angular_acceleration=self.angular_acceleration,
            specific_force=self.specific_force,
            rotor_speeds=self.rotor_speeds,
            wind=self.wind,
        )


# The fields of a signal are its keys in a scenario file, where it is listed under its axis, by its kind; an
# amplitude's key ends with the unit of the axis. A signal is computed as jets, each a value with its first
# and second derivative by time, in compiled loops.

# Instants closer than this [s] are the same one: they are sums of decimal numbers.
_ROUNDING_S = 1e-9
# Axes that a flight can move, each with the unit of its amplitudes in files; shares are of the weight.
AXES = {"x": "m", "y": "m", "height": "m", "yaw": "deg", "roll": "deg", "pitch": "deg", "thrust": "share"}

Amplitude: TypeAlias = Annotated[Real, Key("amplitude_m", "amplitude_deg", "amplitude_share")]
# Duration [s] of edges and fades: one shorter than a step of the simulation would be a jump.
Transition: TypeAlias = Annotated[float, Within(1e-3)]


@dataclass(frozen=True, kw_only=True)
class Window(Section):
    """A span of time with a smooth begin and a smooth end, of `fade_s` each.

    In a file its duration may be left out: it then lasts to the end of the flight, see :func:`within_flight`.
    """

    start_s: NotNegative
    duration_s: Positive | None = None
    fade_s: Transition = 1.0

    def __post_init__(self) -> None:
        longest = math.inf if self.duration_s is None else 0.5 * self.duration_s
        _require(self.fade_s <= longest + _ROUNDING_S, f"`fade_s` must be at most {longest:g}", self.fade_s)

    @property
    def end(self) -> float:
        """Instant [s] from which on there is rest."""
        return self.start_s + (self.duration_s or 0.0)

    def _span(self) -> Array:
        return np.array([self.start_s, self.duration_s, self.fade_s], dtype=float)


@dataclass(frozen=True, kw_only=True)
class Wave(Window, ABC):
    """Sines that are faded in and out, in the unit of their axis."""

    amplitude: Amplitude

    @abstractmethod
    def _sines(self) -> tuple[Array, Array, float]:
        """Frequencies (K,) Hz, phases (K,) rad, and how fast the frequencies rise [Hz/s]."""

    def jets(self, time: Array) -> Array:
        """Jets (N, 3) at instants (N,) s."""
        jets = np.empty((len(time), 3))
        compiled.wave_jets(time, self.amplitude, *self._sines(), self._span(), jets)
        return jets


@dataclass(frozen=True, kw_only=True)
class Sine(Wave):
    """One frequency; `phase_deg` is its phase at the start."""

    frequency_hz: Positive
    phase_deg: Real = 0.0

    def _sines(self) -> tuple[Array, Array, float]:
        return np.array([self.frequency_hz]), np.array([math.radians(self.phase_deg)]), 0.0


@dataclass(frozen=True, kw_only=True)
class Chirp(Wave):
    """A frequency that changes evenly from one value to another."""

    from_hz: Positive
    to_hz: Positive

    def _sines(self) -> tuple[Array, Array, float]:
        return np.array([self.from_hz]), np.zeros(1), (self.to_hz - self.from_hz) / float(self._span()[1])


@dataclass(frozen=True, kw_only=True)
class Multisine(Wave):
    """Several frequencies, each of the amplitude, with Schroeder's phases, which keep the sum's peaks low."""

    frequencies_hz: Annotated[
        tuple[Positive, ...], NotEmpty(), Expected("must be a list of positive numbers")
    ]

    def _sines(self) -> tuple[Array, Array, float]:
        order = np.arange(len(self.frequencies_hz))
        return np.array(self.frequencies_hz), -math.pi * order * (order + 1) / len(order), 0.0


@dataclass(frozen=True, kw_only=True)
class Step(Section):
    """A smooth step, which stays, in the unit of its axis; `rise_s` is the duration of its edge."""

    amplitude: Amplitude
    rise_s: Transition
    start_s: NotNegative

    @property
    def end(self) -> float:
        """Instant [s] from which on there is rest."""
        return float(self._edges()[0][-1]) + self.rise_s

    def _edges(self) -> tuple[Array, Array]:
        """Instants (E,) s at which edges begin, the last one last, and how far each rises (E,)."""
        return np.array([self.start_s]), np.array([self.amplitude])

    def jets(self, time: Array) -> Array:
        """Jets (N, 3) at instants (N,) s."""
        jets = np.empty((len(time), 3))
        compiled.edge_jets(time, *self._edges(), self.rise_s, jets)
        return jets


@dataclass(frozen=True, kw_only=True)
class Pulse(Step):
    """One step and back, once or many times.

    Attributes:
        width_s: from the begin of the rise to the begin of the fall.
        period_s: from pulse to pulse; twice the width where it is not given.
        alternate: every other pulse is negative.
    """

    width_s: Real
    count: Annotated[int, Within(positive=True)] = 1
    period_s: Real | None = None
    alternate: Flag = False

    def __post_init__(self) -> None:
        rule = f"`width_s` must be at least `rise_s`, {self.rise_s:g}"
        _require(self.width_s >= self.rise_s, rule, self.width_s)
        whole = self.width_s + self.rise_s
        _require(self._period >= whole - _ROUNDING_S, f"`period_s` must be at least {whole:g}", self._period)

    @property
    def _period(self) -> float:
        return 2.0 * self.width_s if self.period_s is None else self.period_s

    def _edges(self) -> tuple[Array, Array]:
        rises = self.start_s + self._period * np.arange(self.count)
        heights = np.full(self.count, float(self.amplitude))
        if self.alternate:
            heights[1::2] *= -1.0
        return np.concatenate((rises, rises + self.width_s)), np.concatenate((heights, -heights))


@dataclass(frozen=True, kw_only=True)
class Orbit(Window):
    """A circle around the origin, flown at one speed after a smooth start; the nose is north when it begins.

    Attributes:
        nose: stays north, or points to the centre, or ahead.
        turn: seen from above.
    """

    radius_m: Positive
    speed_m_s: Positive
    fade_s: Transition = 4.0
    nose: Annotated[str, OneOf("north", "centre", "ahead")] = "north"
    turn: Annotated[str, OneOf("clockwise", "counterclockwise")] = "clockwise"

    def jets(self, time: Array) -> Array:
        """Jets (3, N, 3) of north [m], east [m] and yaw [rad] at instants (N,) s."""
        sense = 1.0 if self.turn == "clockwise" else -1.0
        # The centre begins ahead of the nose, or to its side: then yaw is the angle that is flown.
        bearing = -0.5 * math.pi * sense if self.nose == "ahead" else math.pi
        jets = np.empty((3, len(time), 3))
        turn_rate = sense * self.speed_m_s / self.radius_m
        compiled.orbit_jets(time, self.radius_m, turn_rate, bearing, self._span(), jets)
        if self.nose == "north":
            jets[2] = 0.0
        return jets


Signal: TypeAlias = Sine | Pulse | Step | Chirp | Multisine
# The signals of each axis, which add up.
Motion: TypeAlias = Mapping[str, tuple[Signal, ...]]
_KINDS = {"sine": Sine, "pulse": Pulse, "step": Step, "chirp": Chirp, "multisine": Multisine}
_Moving = TypeVar("_Moving", bound=Window | Step)


@dataclass(frozen=True)
class _Entry:
    """One signal in a file, under the name of its kind; its amplitude's key ends with the unit."""

    unit: str

    def read(self, _kind: Any, data: Any) -> Signal:
        """The signal."""
        listed = check_config(dict[Annotated[str, OneOf(*_KINDS)], Any], data)
        if len(listed) != 1 or None in listed.values():
            raise RefusedError(f"expected one of {', '.join(_KINDS)}")
        ((kind, keys),) = listed.items()
        key = f"amplitude_{self.unit}"
        if isinstance(keys, Mapping):
            given = [name for name in keys if str(name).startswith("amplitude")]
            if given != [key]:
                wrong = [name for name in given if name != key]
                problem = f"unknown key `{wrong[0]}`; the amplitude is" if wrong else "missing key"
                raise RefusedError(f"{kind}: {problem} `{key}`")
        by_kind: Any = dict[str, _KINDS[kind]]  # type: ignore[valid-type]
        return check_config(by_kind, listed)[kind]


def read_motion(data: Any) -> Motion:
    """The key `motion` of a flight, for `config_schema.ReadBy`."""
    motion: dict[str, tuple[Signal, ...]] = {}
    for axis, entries in check_config(dict[Annotated[str, OneOf(*AXES)], Any], data).items():
        signals: Any = tuple[Annotated[Any, _Entry(AXES[axis])], ...]
        motion |= check_config(dict[str, signals], {axis: () if entries is None else entries})
    return {axis: motion[axis] for axis in AXES if motion.get(axis)}


def motion_as_dict(motion: Motion) -> dict[str, Any]:
    """The key `motion` of a flight, the inverse of :func:`read_motion`."""
    names = {kind: name for name, kind in _KINDS.items()}
    return {
        axis: [{names[type(signal)]: signal_as_dict(signal, AXES[axis])} for signal in signals]
        for axis, signals in motion.items()
    }


def signal_as_dict(signal: Signal | Orbit, unit: str = "") -> dict[str, Any]:
    """The keys of a signal or an orbit in a file."""
    values = {name: value for name, value in asdict(signal).items() if value is not None}
    keys = {"amplitude": f"amplitude_{unit}"}
    return {keys.get(name, name): list(v) if isinstance(v, tuple) else v for name, v in values.items()}


def within_flight(signal: _Moving, flight_s: float, where: str) -> _Moving:
    """The signal, lasting to the end of the flight where its duration is not given.

    Raises:
        ValueError: naming `where` and what is wrong, for one that ends after the flight.
    """
    try:
        if isinstance(signal, Window) and signal.duration_s is None:
            _require(signal.start_s < flight_s, f"`start_s` must be below {flight_s:g}", signal.start_s)
            signal = replace(signal, duration_s=flight_s - signal.start_s)
        if signal.end > flight_s + _ROUNDING_S:
            raise ValueError(f"ends at {signal.end:g} s, after the flight, which lasts {flight_s:g} s")
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    return signal


def _require(condition: bool, rule: str, found: float) -> None:
    if not condition:
        raise ValueError(f"{rule}, found {found:g}")
