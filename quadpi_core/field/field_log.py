# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A log as it is: series on their own clocks, any number of rotors, whatever is missing left empty.

Body axes are forward-right-down, the world is north-east-down, units are SI; a rotor's command is its share
of the range that the flight stack uses, from 0 to 1. Times are seconds since the log began.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.logs.log_format import LogFormat
from quadpi_core.records import Threshold
from quadpi_core.rotor_order import Motor

STALE_GAP_S = Threshold(
    "pause behind the first records of a topic that makes them stale",
    2.0,
    "s",
    "loggers write at first what was last sent, seconds or minutes before; the battery, the slowest topic "
    "that is read, comes once a second",
    "PX4 logs of ../shared/data, whose topics pause for less",
)
# Multirotors by their number of motors.
FRAMES = {3: "tricopter", 4: "quadcopter", 6: "hexacopter", 8: "octocopter"}
# A topic begins with so many stale records at most: one of each instance that is written.
_STALE_MOST = 3


@dataclass(frozen=True)
class Series:
    """Samples of one topic.

    Attributes:
        time: (N,) s, rising.
        values: (N, C), finite.
    """

    time: Array
    values: Array

    def __len__(self) -> int:
        return len(self.time)

    @property
    def rate_hz(self) -> float:
        """Usual number of samples a second; 0 for fewer than two."""
        return float(1.0 / np.median(np.diff(self.time))) if len(self.time) > 1 else 0.0

    def at(self, time: Array) -> Array:
        """Values (M, C) by straight lines between samples; NaN outside, and in pauses of a second or more."""
        if len(self.time) < 2:
            return np.full((len(time), self.values.shape[1]), np.nan)
        # Three intervals: below that a sample was lost, and a line still passes what was there.
        longest = max(1.0, 3.0 / self.rate_hz)
        after = np.clip(np.searchsorted(self.time, time), 1, len(self.time) - 1)
        pause = self.time[after] - self.time[after - 1] > longest
        outside = (time < self.time[0]) | (time > self.time[-1])
        share = (time - self.time[after - 1]) / (self.time[after] - self.time[after - 1])
        low, high = self.values[after - 1], self.values[after]
        found: Array = low + share[:, np.newaxis] * (high - low)
        found[pause | outside] = np.nan
        return found

    def held(self, time: Array) -> Array:
        """Values (M, C) of the last sample before each time; of the first one before that."""
        return self.values[np.maximum(np.searchsorted(self.time, time, side="right") - 1, 0)]

    def means(self, edges: Array) -> Array:
        """Mean values (M, C) between edges (M + 1,); NaN where no sample is."""
        places = np.searchsorted(self.time, edges)
        sums = np.vstack([np.zeros(self.values.shape[1]), np.cumsum(self.values, axis=0)])[places]
        counts = np.diff(places)[:, np.newaxis]
        with np.errstate(invalid="ignore"):
            means: Array = np.diff(sums, axis=0) / np.where(counts > 0, counts, np.nan)
        return means

    def filled_means(self, edges: Array) -> Array:
        """As :meth:`means`, on the line between samples where none is."""
        means = self.means(edges)
        return np.where(np.isfinite(means), means, self.at(0.5 * (edges[1:] + edges[:-1])))

    def during(self, begin: float, end: float) -> Series:
        """The samples of a part."""
        inside = (self.time >= begin) & (self.time < end)
        return Series(self.time[inside], self.values[inside])


def series_of(time_ns: Stamps, values: Array, start_ns: int) -> Series | None:
    """A series from stamps (N,) in ns and values (N,) or (N, C); None for fewer than two usable samples.

    Left out are samples that are not finite, whose stamp does not rise, and stale ones at the beginning.
    """
    values = values[:, np.newaxis] if values.ndim == 1 else values
    kept = np.all(np.isfinite(values), axis=1)
    time, values = (time_ns[kept] - start_ns) * 1e-9, values[kept].astype(np.float64)
    if len(time) < 2:
        return None
    steps = np.diff(time)
    jumps = np.flatnonzero(steps[:_STALE_MOST] > max(STALE_GAP_S.value, 10.0 * float(np.median(steps))))
    first = int(jumps[-1]) + 1 if len(jumps) and len(time) > 2 * _STALE_MOST else 0
    time, values = time[first:], values[first:]
    rises = np.concatenate([[True], time[1:] > np.maximum.accumulate(time)[:-1]])
    time, values = time[rises], values[rises]
    return Series(time, values) if len(time) > 1 else None


def held_series(time_ns: Stamps, values: Array, start_ns: int) -> Series | None:
    """A series (N, 1) of what is written when it changes: each value holds until the next, however late.

    What was said before the log began holds at its beginning.
    """
    time = np.maximum.accumulate(np.maximum((time_ns - start_ns) * 1e-9, 0.0))
    last = np.append(np.diff(time) > 0.0, True)[: len(time)]
    return Series(time[last], values[last, np.newaxis].astype(np.float64)) if len(time) else None


def places_of(motors: Sequence[Motor]) -> Array | None:
    """Places and spins (R, 3) of motors, as `FieldLog.places` has them; None if all are at the centre."""
    places = np.round(np.array([motor[:3] for motor in motors]).reshape(-1, 3), 6)
    return places if places[:, :2].any() else None


@dataclass(frozen=True)
class Setting:
    """What the user can set so that the next log tells more.

    Attributes:
        parameter: as the flight stack names it, or a field of its log.
        present: its value in the log, or that it is not there.
        wanted: value to give it.
        gains: what the next log then tells.
    """

    parameter: str
    present: str
    wanted: str
    gains: str

    def sentence(self) -> str:
        """In words."""
        return f"{self.parameter} is {self.present}: {self.wanted}, for {self.gains}"


@dataclass(frozen=True)
class FieldLog:
    """One flight as logged.

    Attributes:
        name: of the file.
        source: its path.
        stack: flight stack, such as PX4.
        firmware: as the log names it; empty where it does not.
        frame: in words, such as "quadcopter X"; empty where the log does not say.
        rotors: number; None where the log does not say.
        no_multirotor: what else the vehicle is, with the parameter that says so; empty for a multirotor.
        imu: (N, 6) rad/s and m/s²: rates, specific force.
        attitude: (N, 4) quaternion w, x, y, z from body to world.
        velocity: (N, 3) m/s in the world.
        position: (N, 3) m in the world.
        commands: (N, R), by the stack's motor numbers.
        rotor_speeds: (N, R) rad/s, by the stack's motor numbers.
        battery: (N, 1) V.
        landed: (N, 1) 1 where the stack held the vehicle to be on the ground, from each sample to the next.
        density: (N, 1) kg/m³.
        vibe: (N, 3) m/s², vibration along the body axes as the stack itself measures it at full rate.
        places: (R, 3) of the motors, forward and right, in any unit, and their spins as in a vehicle, 0
            where those are not told; None where not known.
        drag_prefix: of the stack's parameters of drag, MCOEF, BCOEF_X and BCOEF_Y; empty where it has none.
        facts: further things that the log says of the vehicle, by name.
        parameters: of the stack, by name.
        settings: that would make the next log tell more.
        notes: what was assumed, or is wrong.
    """

    name: str
    source: str
    stack: str
    firmware: str = ""
    frame: str = ""
    rotors: int | None = None
    no_multirotor: str = ""
    imu: Series | None = None
    attitude: Series | None = None
    velocity: Series | None = None
    position: Series | None = None
    commands: Series | None = None
    rotor_speeds: Series | None = None
    battery: Series | None = None
    landed: Series | None = None
    density: Series | None = None
    vibe: Series | None = None
    places: npt.NDArray[np.float64] | None = None
    drag_prefix: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    settings: Sequence[Setting] = ()
    notes: Sequence[str] = ()

    def series(self) -> dict[str, Series]:
        """The series that are there, by name."""
        return {name: value for name, value in vars(self).items() if isinstance(value, Series)}

    def motor(self, number: int) -> str:
        """Motor of a number from 1, with its corner where it is known."""
        forward, right, _ = (0.0, 0.0, 0.0) if self.places is None else self.places[number - 1]
        if not forward or not right:
            return f"motor {number}"
        return f"motor {number} ({'front' if forward > 0 else 'rear'} {'right' if right > 0 else 'left'})"

    @property
    def duration_s(self) -> float:
        """From the first sample to the last of any topic."""
        ends = [(own.time[0], own.time[-1]) for own in self.series().values()]
        return float(max(end for _, end in ends) - min(begin for begin, _ in ends)) if ends else 0.0


@dataclass(frozen=True)
class Stack:
    """How the logs of a flight stack are read.

    Attributes:
        log_format: of the logs, as in :mod:`quadpi_core.logs.formats`.
        read: gives one flight; its arguments are the path, the number of a flight in it or None, and the
            pairs of poles that the user knows, or None.
    """

    log_format: LogFormat[Any]
    read: Callable[[Path, int | None, int | None], FieldLog]
