# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""When a vehicle was in the air, and what it flew there.

Neither commands nor rotor speeds alone tell a flight from motors that idle on the ground: the vehicle must
also have moved. Where the stack has a land detector, that counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from quadpi_core.errors import LogError
from quadpi_core.field.field_log import FieldLog, Series
from quadpi_core.frames import Array
from quadpi_core.records import STANDARD_GRAVITY, Threshold
from quadpi_core.screening.rotors_in_flight import runs_of

_GRID_HZ = 10.0
_LOADED_SHARE = Threshold(
    "mean command, or thrust by rotor speeds, in the air, over its 90 % quantile while the vehicle moves",
    0.5,
    "",
    "motors idle at 5 to 15 % of command and hover at 25 to 65 %; thrust seldom halves for a second",
    "flights of ../shared/data with a land detector",
)
_SHORTEST_S, _JOINED_S = 2.0, 2.0
_MOVED = Threshold(
    "least motion of a stretch in the air: metres, metres per second, radians per second",
    (0.15, 0.2, 0.05),
    "m, m/s, rad/s",
    "what an estimate drifts on the ground in seconds is less, and the quietest hover of ../shared/data more",
    "grounded parts and hovers of rrc_propeller and crazypad",
)
HOVER_SPEED = 0.5  # m/s
_PIECE_SHORTEST_S = 1.5


@dataclass(frozen=True)
class Stretch:
    """A part of a log in the air, s."""

    begin: float
    end: float

    @property
    def duration_s(self) -> float:
        """Its length."""
        return self.end - self.begin


@dataclass(frozen=True)
class Flown:
    """What was flown. Quantities that the log does not hold are None.

    Attributes:
        duration_s: of the log.
        airborne_s: of all stretches in the air.
        speed_m_s, climb_m_s, tilt_deg, rate_deg_s: median and largest; the largest climbs are up and down.
        height_m: lowest and highest above the start.
        shares: of the time in the air by manoeuvre, which may coincide.
        told_by: what showed that the vehicle was in the air.
    """

    duration_s: float
    airborne_s: float
    stretches: tuple[Stretch, ...]
    told_by: str
    speed_m_s: tuple[float, float] | None
    climb_m_s: tuple[float, float] | None
    height_m: tuple[float, float] | None
    tilt_deg: tuple[float, float] | None
    rate_deg_s: tuple[float, float] | None
    shares: dict[str, float]


def flown(log: FieldLog) -> Flown:
    """Stretches in the air, and speeds, attitude and manoeuvres there.

    Raises:
        LogError: for a log that holds no flight.
    """
    stretches, told_by = _stretches(log)
    if not stretches:
        raise LogError(f"{log.source}: no flight in it: {told_by}")
    time = np.concatenate([np.arange(one.begin, one.end, 1.0 / _GRID_HZ) for one in stretches])
    velocity = _at(velocity_of(log), time)
    position, attitude = _at(log.position, time), _at(log.attitude, time)
    imu = None if log.imu is None else log.imu.means(np.append(time, time[-1] + 1.0 / _GRID_HZ))
    speed = None if velocity is None else np.hypot(velocity[:, 0], velocity[:, 1])
    climb = None if velocity is None else -velocity[:, 2]
    tilt = None
    if attitude is not None:
        _, x, y, _ = (attitude / np.linalg.norm(attitude, axis=1, keepdims=True)).T
        tilt = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0)))
    rate = None if imu is None else np.degrees(np.linalg.norm(imu[:, :2], axis=1))
    yaw = None if imu is None else np.degrees(np.abs(imu[:, 2]))
    height = None if position is None else position[np.isfinite(position[:, 2])][0, 2] - position[:, 2]
    return Flown(
        duration_s=log.duration_s,
        airborne_s=sum(one.duration_s for one in stretches),
        stretches=tuple(stretches),
        told_by=told_by,
        speed_m_s=_ends(speed, np.nanmedian),
        climb_m_s=_ends(climb, np.nanmin),
        height_m=_ends(height, np.nanmin),
        tilt_deg=_ends(tilt, np.nanmedian),
        rate_deg_s=_ends(rate, np.nanmedian),
        shares=_shares(speed, climb, tilt, rate, yaw),
    )


def velocity_of(log: FieldLog) -> Series | None:
    """Velocity (N, 3) in the world: as logged, else the slope of positions that come often enough."""
    # Below this rate the noise of positions over the time between them is no velocity.
    if log.velocity is not None or log.position is None or log.position.rate_hz < 12.0:
        return log.velocity
    # Straight lines over 0.4 s: for 1 mm of noise at 100 Hz that is 1 cm/s.
    half, time, values = 0.2, log.position.time, log.position.values
    low = np.searchsorted(time, time - half)
    high = np.searchsorted(time, time + half, side="right")
    count = (high - low)[:, np.newaxis].astype(np.float64)

    def sums(of: Array) -> Array:
        total = np.vstack([np.zeros(of.shape[1]), np.cumsum(of, axis=0)])
        return total[high] - total[low]

    # Centred on the middle of the log, so that sums of squares lose no digits.
    clock = (time - time.mean())[:, np.newaxis]
    t, tt, x, tx = sums(clock), sums(clock**2), sums(values), sums(clock * values)
    spread = count * tt - t**2
    good = (count[:, 0] >= 4) & (spread[:, 0] > 1e-9)
    slope = (count * tx - t * x)[good] / spread[good]
    return Series(time[good], slope) if good.sum() > 1 else None


def _at(series: Series | None, time: Array) -> Array | None:
    values = None if series is None else series.at(time)
    return None if values is None or not np.isfinite(values).any() else values


def _ends(values: Array | None, lower: object) -> tuple[float, float] | None:
    if values is None or not np.isfinite(values).any():
        return None
    return float(lower(values)), float(np.nanmax(values))  # type: ignore[operator]


def _shares(
    speed: Array | None, climb: Array | None, tilt: Array | None, rate: Array | None, yaw: Array | None
) -> dict[str, float]:
    shares: dict[str, float] = {}

    def add(name: str, values: Array | None, low: float, high: float = np.inf) -> None:
        if values is not None and np.isfinite(values).any():
            known = values[np.isfinite(values)]
            shares[name] = float(np.mean((known >= low) & (known < high)))

    add("hover (below 0.5 m/s)", speed, 0.0, HOVER_SPEED)
    add("slow (0.5 to 3 m/s)", speed, HOVER_SPEED, 3.0)
    add("fast (above 3 m/s)", speed, 3.0)
    add("climb or descent (above 0.5 m/s)", None if climb is None else np.abs(climb), 0.5)
    add("turns (yaw above 30 °/s)", yaw, 30.0)
    add("steep (tilt above 30°)", tilt, 30.0)
    add("aerobatics (roll or pitch above 200 °/s)", rate, 200.0)
    return shares


def _stretches(log: FieldLog) -> tuple[list[Stretch], str]:
    """Stretches in the air and what told them; or none, and why."""
    told = _signals(log)
    if not told:
        return [], "it logs neither commands nor rotor speeds, state or gyro"
    reason = ""
    for name, series in told:
        found = [one for one in _runs(series) if _moved(log, one, is_sure=name == "the land detector")]
        if found:
            return found, name
        reason = reason or f"by {name} the vehicle never left the ground for {_SHORTEST_S:g} s"
    return [], reason


def _signals(log: FieldLog) -> list[tuple[str, Series]]:
    """What can tell, the best first: each 1 in the air and 0 on the ground."""
    told, velocity = [], velocity_of(log)
    detector = log.landed if log.landed is not None and log.landed.values.min() < 0.5 else None
    for name, series, power in (("commands", log.commands, 1), ("rotor speeds", log.rotor_speeds, 2)):
        if series is not None:
            load = np.mean(series.values**power, axis=1, keepdims=True)
            most = float(np.quantile(_in_motion(series.time, load, velocity), 0.9))
            if most > 0.0:
                loaded = (load > _LOADED_SHARE.value * most) * 1.0
                if detector is not None:
                    # A crashed vehicle may lie there for minutes before it is held to have landed.
                    below = detector.held(series.time)
                    told.append(("the land detector", Series(series.time, loaded * (below < 0.5))))
                told.append((name, Series(series.time, loaded)))
    if detector is not None:
        end = max(own.time[-1] for own in log.series().values())
        time = np.arange(detector.time[0], end, 1.0 / _GRID_HZ)
        told.append(("the land detector", Series(time, 1.0 - detector.held(time))))
    if velocity is not None:
        moving = np.linalg.norm(velocity.values, axis=1, keepdims=True) > _MOVED.value[1]
        told.append(("velocity", Series(velocity.time, moving * 1.0)))
    if log.imu is not None:
        turning = np.linalg.norm(log.imu.values[:, :3], axis=1, keepdims=True)
        told.append(("gyro", Series(log.imu.time, (turning > _MOVED.value[2]) * 1.0)))
    return told


def _in_motion(time: Array, load: Array, velocity: Series | None) -> Array:
    """The loads (M, 1) while the vehicle moves, where that is told: idling may outlast the flight."""
    if velocity is None:
        return load
    moves = np.linalg.norm(velocity.at(time), axis=1) > HOVER_SPEED
    return load[moves] if moves.mean() * np.ptp(time) > _SHORTEST_S else load


def _runs(series: Series) -> list[Stretch]:
    """Where a signal of 0 and 1 is mostly 1, pauses joined and what is short left out."""
    edges = np.arange(series.time[0], series.time[-1] + 1.0 / _GRID_HZ, 1.0 / _GRID_HZ)
    if len(edges) < 2:
        return []
    values = series.means(edges)[:, 0]
    filled = np.where(np.isfinite(values), values, series.at(edges[:-1])[:, 0])
    aloft = runs_of(np.nan_to_num(filled) > 0.5)
    runs = [(edges[begin], edges[min(end, len(edges) - 1)]) for begin, end in aloft]
    joined: list[tuple[float, float]] = []
    for begin, end in runs:
        if joined and begin - joined[-1][1] < _JOINED_S:
            joined[-1] = (joined[-1][0], end)
        else:
            joined.append((begin, end))
    return [Stretch(float(begin), float(end)) for begin, end in joined if end - begin >= _SHORTEST_S]


def _moved(log: FieldLog, stretch: Stretch, *, is_sure: bool) -> bool:
    """Whether the vehicle moved; where nothing tells, it is taken to have."""
    if is_sure:
        return True
    metres, speed, rate = _MOVED.value
    told = False
    for series, limit in ((log.position, metres), (log.velocity, speed)):
        own = None if series is None else series.during(stretch.begin, stretch.end)
        if own is not None and len(own) > 1:
            told = True
            if np.ptp(own.values, axis=0).max() > limit:
                return True
    if told:
        return False
    imu = None if log.imu is None else log.imu.during(stretch.begin, stretch.end)
    if imu is None or len(imu) < 2:
        return True
    level = abs(float(np.median(np.linalg.norm(imu.values[:, 3:], axis=1))) - STANDARD_GRAVITY)
    return float(np.std(imu.values[:, :3], axis=0).max()) > rate or level > 0.5 * STANDARD_GRAVITY


class Averages(NamedTuple):
    """Means of series over steps of which all is known.

    Attributes:
        means: (N, C) of each series.
        time: (N,) s, of the middle of a step.
        stretch: (N,) its number.
    """

    means: tuple[Array, ...]
    time: Array
    stretch: Array


def averages(stretches: Sequence[Stretch], step_s: float, *series: Series) -> Averages:
    """Means of series over equal steps of about a length, s, of each stretch."""
    counts = [1 + max(1, round(one.duration_s / step_s)) for one in stretches]
    edges = [np.linspace(one.begin, one.end, count) for one, count in zip(stretches, counts, strict=True)]
    means = [np.vstack([own.filled_means(part) for part in edges]) for own in series]
    time = np.concatenate([0.5 * (part[1:] + part[:-1]) for part in edges])
    known = np.isfinite(np.hstack(means)).all(axis=1)
    stretch = np.repeat(np.arange(float(len(edges))), [len(part) - 1 for part in edges])
    return Averages(tuple(own[known] for own in means), time[known], stretch[known])


def pieces(stretches: tuple[Stretch, ...], longest_s: float) -> list[Stretch]:
    """Stretches cut into equal pieces, as clusters of samples that go together.

    A tenth of the time in the air each, within limits: that of any gust or manoeuvre, and `longest_s`.
    """
    together = sum(one.duration_s for one in stretches)
    return cut(stretches, float(np.clip(0.1 * together, _PIECE_SHORTEST_S, longest_s)))


def cut(stretches: Sequence[Stretch], length_s: float) -> list[Stretch]:
    """Stretches in equal pieces of about a length."""
    found = []
    for one in stretches:
        count = max(1, round(one.duration_s / length_s))
        ends = np.linspace(one.begin, one.end, count + 1)
        found += [Stretch(float(begin), float(end)) for begin, end in pairwise(ends)]
    return found
