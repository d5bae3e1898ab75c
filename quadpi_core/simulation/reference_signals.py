# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reference signals with exact derivatives: zero until they start, at rest from their end on.

The fields of a signal are its keys in a scenario file. Jets: see :mod:`quadpi_core.simulation.derivatives`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from quadpi_core.errors import SimulationError
from quadpi_core.frames import Array
from quadpi_core.simulation.derivatives import Span, edge_jets, orbit_jets, wave_jets

# Instants closer than this are one: they are sums of decimal numbers.
ROUNDING_S = 1e-9
# Of edges and fades: nothing shorter can be told from a jump.
_SHORTEST_S = 1e-3
NOSES = ("north", "centre", "ahead")
TURNS = ("clockwise", "counterclockwise")


@dataclass(frozen=True, kw_only=True)
class Window:
    """A span of time with a smooth begin and a smooth end.

    Attributes:
        fade_s: of each of the two, within the duration.
    """

    start_s: float
    duration_s: float
    fade_s: float = 1.0

    def __post_init__(self) -> None:
        _require(self.start_s >= 0.0, "`start_s` must not be negative", self.start_s)
        _require(self.duration_s > 0.0, "`duration_s` must be positive", self.duration_s)
        _require(self.fade_s >= _SHORTEST_S, f"`fade_s` must be at least {_SHORTEST_S:g}", self.fade_s)
        longest = 0.5 * self.duration_s
        _require(self.fade_s <= longest + ROUNDING_S, f"`fade_s` must be at most {longest:g}", self.fade_s)

    @property
    def end(self) -> float:
        """Instant [s] from which on there is rest."""
        return self.start_s + self.duration_s

    @property
    def span(self) -> Span:
        """What the compiled loops take."""
        return self.start_s, self.duration_s, self.fade_s


@dataclass(frozen=True, kw_only=True)
class Wave(Window, ABC):
    """Sines that are faded in and out, in the unit of their axis."""

    amplitude: float

    @abstractmethod
    def tones(self) -> tuple[Array, Array, float]:
        """Frequencies (K,) Hz and phases (K,) rad at the start, and how fast all frequencies rise [Hz/s]."""

    def jets(self, time: Array) -> Array:
        """Jets (N, 3) at instants (N,) s."""
        return wave_jets(time, self.amplitude, *self.tones(), self.span)


@dataclass(frozen=True, kw_only=True)
class Sine(Wave):
    """One frequency; `phase_deg` is its phase at the start."""

    frequency_hz: float
    phase_deg: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(self.frequency_hz > 0.0, "`frequency_hz` must be positive", self.frequency_hz)

    def tones(self) -> tuple[Array, Array, float]:
        """See :class:`Wave`."""
        return np.array([self.frequency_hz]), np.array([math.radians(self.phase_deg)]), 0.0


@dataclass(frozen=True, kw_only=True)
class Chirp(Wave):
    """A frequency that changes evenly from one value to another."""

    from_hz: float
    to_hz: float

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(self.from_hz > 0.0, "`from_hz` must be positive", self.from_hz)
        _require(self.to_hz > 0.0, "`to_hz` must be positive", self.to_hz)

    def tones(self) -> tuple[Array, Array, float]:
        """See :class:`Wave`."""
        return np.array([self.from_hz]), np.zeros(1), (self.to_hz - self.from_hz) / self.duration_s


@dataclass(frozen=True, kw_only=True)
class Multisine(Wave):
    """Several frequencies, each of the amplitude, with Schroeder's phases, which keep the sum's peaks low."""

    frequencies_hz: tuple[float, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(len(self.frequencies_hz) > 0, "`frequencies_hz` must not be empty", self.frequencies_hz)
        for frequency in self.frequencies_hz:
            _require(frequency > 0.0, "`frequencies_hz` must be positive", frequency)

    def tones(self) -> tuple[Array, Array, float]:
        """See :class:`Wave`."""
        order = np.arange(len(self.frequencies_hz))
        phases = -math.pi * order * (order + 1) / len(order)
        return np.array(self.frequencies_hz), phases, 0.0


@dataclass(frozen=True, kw_only=True)
class Edges(ABC):
    """Smooth steps up and down, in the unit of their axis.

    Attributes:
        rise_s: how long each edge takes.
    """

    amplitude: float
    rise_s: float
    start_s: float

    def __post_init__(self) -> None:
        _require(self.start_s >= 0.0, "`start_s` must not be negative", self.start_s)
        _require(self.rise_s >= _SHORTEST_S, f"`rise_s` must be at least {_SHORTEST_S:g}", self.rise_s)

    @abstractmethod
    def edges(self) -> tuple[Array, Array]:
        """Instants (E,) s at which edges begin, and by how much (E,) each rises."""

    @property
    def end(self) -> float:
        """Instant [s] from which on there is rest."""
        return self.start_s + self.rise_s

    def jets(self, time: Array) -> Array:
        """Jets (N, 3) at instants (N,) s."""
        return edge_jets(time, *self.edges(), self.rise_s)


@dataclass(frozen=True, kw_only=True)
class Step(Edges):
    """One step, which stays."""

    def edges(self) -> tuple[Array, Array]:
        """See :class:`Edges`."""
        return np.array([self.start_s]), np.array([self.amplitude])


@dataclass(frozen=True, kw_only=True)
class Pulse(Edges):
    """One step and back, once or many times.

    Attributes:
        width_s: from the begin of the rise to the begin of the fall.
        period_s: from pulse to pulse; twice the width where it is not given.
        alternate: every other pulse is negative.
    """

    width_s: float
    count: int = 1
    period_s: float | None = None
    alternate: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(
            self.width_s >= self.rise_s, f"`width_s` must be at least `rise_s`, {self.rise_s:g}", self.width_s
        )
        _require(self.count >= 1, "`count` must be at least 1", self.count)
        whole = self.width_s + self.rise_s
        _require(self._period >= whole - ROUNDING_S, f"`period_s` must be at least {whole:g}", self._period)

    @property
    def _period(self) -> float:
        return 2.0 * self.width_s if self.period_s is None else self.period_s

    @property
    def end(self) -> float:
        """See :class:`Edges`."""
        return super().end + (self.count - 1) * self._period + self.width_s

    def edges(self) -> tuple[Array, Array]:
        """See :class:`Edges`."""
        rises = self.start_s + self._period * np.arange(self.count)
        heights = np.full(self.count, float(self.amplitude))
        if self.alternate:
            heights[1::2] *= -1.0
        return np.concatenate((rises, rises + self.width_s)), np.concatenate((heights, -heights))


Signal: TypeAlias = Wave | Edges
SIGNALS: dict[str, type[Signal]] = {
    "sine": Sine,
    "pulse": Pulse,
    "step": Step,
    "chirp": Chirp,
    "multisine": Multisine,
}


@dataclass(frozen=True, kw_only=True)
class Orbit(Window):
    """A circle around the origin, flown at one speed after a smooth start; the nose is north when it begins.

    Attributes:
        nose: stays north, or points to the centre, or ahead.
        turn: seen from above.
    """

    radius_m: float
    speed_m_s: float
    fade_s: float = 4.0
    nose: str = "north"
    turn: str = "clockwise"

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(self.radius_m > 0.0, "`radius_m` must be positive", self.radius_m)
        _require(self.speed_m_s > 0.0, "`speed_m_s` must be positive", self.speed_m_s)
        _require(self.nose in NOSES, f"`nose` must be {', '.join(NOSES[:-1])} or {NOSES[-1]}", self.nose)
        _require(self.turn in TURNS, f"`turn` must be {' or '.join(TURNS)}", self.turn)

    def jets(self, time: Array) -> tuple[Array, Array, Array]:
        """Jets (N, 3) of north [m], east [m] and yaw [rad] at instants (N,) s."""
        sense = 1.0 if self.turn == "clockwise" else -1.0
        # The centre begins ahead of the nose, or to its side: then yaw is the angle that is flown.
        bearing = -0.5 * math.pi * sense if self.nose == "ahead" else math.pi
        turn_rate = sense * self.speed_m_s / self.radius_m
        north, east, angle = orbit_jets(time, self.radius_m, turn_rate, bearing, self.span)
        return north, east, np.zeros_like(angle) if self.nose == "north" else angle


def _require(condition: bool, rule: str, found: Any) -> None:
    if not condition:
        raise SimulationError(
            f"{rule}, found {found:g}" if isinstance(found, float) else f"{rule}, found {found}"
        )
