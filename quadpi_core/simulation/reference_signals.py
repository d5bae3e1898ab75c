# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reference signals with exact derivatives: zero until they start, constant after their end.

The fields of a signal are its keys in a scenario file, where it is listed under its axis, by its kind; an
amplitude's key ends with the unit of the axis. A signal is computed as jets, each a value with its first and
second derivative by time, in compiled loops.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Annotated, Any, TypeAlias, TypeVar

import numpy as np

from quadpi_core.config_schema import (
    Expected,
    Flag,
    Key,
    NotEmpty,
    NotNegative,
    OneOf,
    Positive,
    ReadBy,
    Real,
    Section,
    Within,
    check_config,
)
from quadpi_core.core import compiled
from quadpi_core.frames import Array

# Start, duration and fade of a window [s].
Span: TypeAlias = tuple[float, float, float]
# Instants closer than this [s] are the same one: they are sums of decimal numbers.
_ROUNDING_S = 1e-9
# Axes that a flight can move, each with the unit of its amplitudes in files; shares are of the weight.
AXES = {"x": "m", "y": "m", "height": "m", "yaw": "deg", "roll": "deg", "pitch": "deg", "thrust": "share"}

# In the unit of the axis, which :func:`_require_unit` checks.
Amplitude: TypeAlias = Annotated[Real, Key("amplitude_m", "amplitude_deg", "amplitude_share")]
# Of edges and fades [s]: anything shorter than the simulation's step is a jump.
Transition: TypeAlias = Annotated[float, Within(1e-3)]


@dataclass(frozen=True, kw_only=True)
class Window(Section):
    """A span of time with a smooth begin and a smooth end.

    Attributes:
        duration_s: duration; None in a file for a span to the end of the flight, see :func:`within_flight`.
        fade_s: duration of begin and end each, within the duration.
    """

    start_s: NotNegative
    duration_s: Positive | None = None
    fade_s: Transition = 1.0

    def __post_init__(self) -> None:
        if self.duration_s is None:
            return
        longest = 0.5 * self.duration_s
        _require(self.fade_s <= longest + _ROUNDING_S, f"`fade_s` must be at most {longest:g}", self.fade_s)

    @property
    def span(self) -> Span:
        """What the compiled loops take.

        Raises:
            ValueError: before the duration of the flight is known.
        """
        if self.duration_s is None:
            raise ValueError("the duration of the flight is not known yet")
        return self.start_s, self.duration_s, self.fade_s

    @property
    def end(self) -> float:
        """Instant [s] from which on there is rest."""
        return self.start_s + self.span[1]


@dataclass(frozen=True, kw_only=True)
class Wave(Window):
    """Sines that are faded in and out, in the unit of their axis."""

    amplitude: Amplitude

    def _jets(self, time: Array, frequencies: Array, phases: Array, rise: float = 0.0) -> Array:
        return wave_jets(time, self.amplitude, frequencies, phases, rise, self.span)


@dataclass(frozen=True, kw_only=True)
class Sine(Wave):
    """One frequency; `phase_deg` is its phase at the start."""

    frequency_hz: Positive
    phase_deg: Real = 0.0

    def jets(self, time: Array) -> Array:
        """Jets (N, 3) at instants (N,) s."""
        return self._jets(time, np.array([self.frequency_hz]), np.array([math.radians(self.phase_deg)]))


@dataclass(frozen=True, kw_only=True)
class Chirp(Wave):
    """A frequency that changes evenly from one value to another."""

    from_hz: Positive
    to_hz: Positive

    def jets(self, time: Array) -> Array:
        """Jets (N, 3) at instants (N,) s."""
        rise = (self.to_hz - self.from_hz) / self.span[1]
        return self._jets(time, np.array([self.from_hz]), np.zeros(1), rise)


@dataclass(frozen=True, kw_only=True)
class Multisine(Wave):
    """Several frequencies, each of the amplitude, with Schroeder's phases, which keep the sum's peaks low."""

    frequencies_hz: Annotated[
        tuple[Positive, ...], NotEmpty(), Expected("must be a list of positive numbers")
    ]

    def jets(self, time: Array) -> Array:
        """Jets (N, 3) at instants (N,) s."""
        order = np.arange(len(self.frequencies_hz))
        return self._jets(time, np.array(self.frequencies_hz), -math.pi * order * (order + 1) / len(order))


@dataclass(frozen=True, kw_only=True)
class Edges(Section):
    """Smooth steps up and down, in the unit of their axis.

    Attributes:
        rise_s: duration of each edge.
    """

    amplitude: Amplitude
    rise_s: Transition
    start_s: NotNegative

    @property
    def end(self) -> float:
        """Instant [s] from which on there is rest."""
        return self.start_s + self.rise_s


@dataclass(frozen=True, kw_only=True)
class Step(Edges):
    """One step, which stays."""

    def jets(self, time: Array) -> Array:
        """Jets (N, 3) at instants (N,) s."""
        return edge_jets(time, np.array([self.start_s]), np.array([self.amplitude]), self.rise_s)


@dataclass(frozen=True, kw_only=True)
class Pulse(Edges):
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
        _require(
            self.width_s >= self.rise_s, f"`width_s` must be at least `rise_s`, {self.rise_s:g}", self.width_s
        )
        whole = self.width_s + self.rise_s
        _require(self._period >= whole - _ROUNDING_S, f"`period_s` must be at least {whole:g}", self._period)

    @property
    def _period(self) -> float:
        return 2.0 * self.width_s if self.period_s is None else self.period_s

    @property
    def end(self) -> float:
        """See :class:`Edges`."""
        return super().end + (self.count - 1) * self._period + self.width_s

    def jets(self, time: Array) -> Array:
        """Jets (N, 3) at instants (N,) s."""
        rises = self.start_s + self._period * np.arange(self.count)
        heights = np.full(self.count, float(self.amplitude))
        if self.alternate:
            heights[1::2] *= -1.0
        begins = np.concatenate((rises, rises + self.width_s))
        return edge_jets(time, begins, np.concatenate((heights, -heights)), self.rise_s)


Signal: TypeAlias = Sine | Pulse | Step | Chirp | Multisine
# The signals of each axis, which add up.
Motion: TypeAlias = Mapping[str, tuple[Signal, ...]]
_Moving = TypeVar("_Moving", bound=Window | Edges)


@dataclass(frozen=True, kw_only=True)
class _Entry(Section):
    """One signal in a file, under the name of its kind."""

    sine: Sine | None = None
    pulse: Pulse | None = None
    step: Step | None = None
    chirp: Chirp | None = None
    multisine: Multisine | None = None

    def __post_init__(self) -> None:
        if sum(signal is not None for signal in vars(self).values()) != 1:
            raise ValueError(f"expected one of {', '.join(vars(self))}")

    @property
    def signal(self) -> Signal:
        """The signal."""
        signal: Signal = next(signal for signal in vars(self).values() if signal is not None)
        return signal


def _require_unit(unit: str, entries: Any) -> Any:
    """Refuse keys of amplitudes that do not end with the unit of their axis."""
    key = f"amplitude_{unit}"
    for number, entry in enumerate(entries if isinstance(entries, list) else (), start=1):
        for kind, signal in entry.items() if isinstance(entry, dict) else ():
            given = [name for name in signal if str(name).startswith("amplitude")] if signal else ()
            if kind in _KINDS and isinstance(signal, dict) and given != [key]:
                wrong = [name for name in given if name != key]
                problem = f"unknown key `{wrong[0]}`; the amplitude is" if wrong else "missing key"
                raise ValueError(f"entry {number}, {kind}: {problem} `{key}`")
    return entries


Lengths: TypeAlias = Annotated[tuple[_Entry, ...], ReadBy(partial(_require_unit, "m"), first=True)]
Angles: TypeAlias = Annotated[tuple[_Entry, ...], ReadBy(partial(_require_unit, "deg"), first=True)]
Shares: TypeAlias = Annotated[tuple[_Entry, ...], ReadBy(partial(_require_unit, "share"), first=True)]


@dataclass(frozen=True, kw_only=True)
class _MotionFile(Section):
    """The key `motion` of a flight: the signals of each axis of :data:`AXES`."""

    x: Lengths = ()
    y: Lengths = ()
    height: Lengths = ()
    yaw: Angles = ()
    roll: Angles = ()
    pitch: Angles = ()
    thrust: Shares = ()


_KINDS = {"sine": Sine, "pulse": Pulse, "step": Step, "chirp": Chirp, "multisine": Multisine}


def read_motion(data: Any) -> Motion:
    """The key `motion` of a flight, for `config_schema.ReadBy`."""
    entries = vars(check_config(_MotionFile, data))
    return {axis: tuple(entry.signal for entry in listed) for axis, listed in entries.items() if listed}


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

    def jets(self, time: Array) -> tuple[Array, Array, Array]:
        """Jets (N, 3) of north [m], east [m] and yaw [rad] at instants (N,) s."""
        sense = 1.0 if self.turn == "clockwise" else -1.0
        # The centre begins ahead of the nose, or to its side: then yaw is the angle that is flown.
        bearing = -0.5 * math.pi * sense if self.nose == "ahead" else math.pi
        turn_rate = sense * self.speed_m_s / self.radius_m
        north, east, angle = orbit_jets(time, self.radius_m, turn_rate, bearing, self.span)
        return north, east, np.zeros_like(angle) if self.nose == "north" else angle


def _require(condition: bool, rule: str, found: float) -> None:
    if not condition:
        raise ValueError(f"{rule}, found {found:g}")


def wave_jets(
    time: Array, amplitude: float, frequencies: Array, phases: Array, sweep: float, window: Span
) -> Array:
    """Jets (N, 3) of a sum of sines whose frequencies (K,) Hz rise by `sweep` [Hz/s], faded in and out."""
    jets = np.empty((len(time), 3))
    compiled.wave_jets(time, amplitude, frequencies, phases, sweep, np.array(window), jets)
    return jets


def edge_jets(time: Array, instants: Array, heights: Array, rise: float) -> Array:
    """Jets (N, 3) of a sum of edges that begin at instants (E,) s and rise by heights (E,)."""
    jets = np.empty((len(time), 3))
    compiled.edge_jets(time, instants, heights, rise, jets)
    return jets


def orbit_jets(time: Array, radius: float, turn_rate: float, bearing: float, window: Span) -> Array:
    """Jets (3, N, 3) of north, east and angle on a circle from a bearing [rad], turning at a rate [rad/s]."""
    jets = np.empty((3, len(time), 3))
    compiled.orbit_jets(time, radius, turn_rate, bearing, np.array(window), jets)
    return jets
