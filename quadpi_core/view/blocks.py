# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A flight in blocks of equal duration, one row of numbers each: last values, and sums of what is counted.

The page draws blocks, so its cost does not grow with the rate of the input. The newest blocks are kept in a
ring, so memory does not grow with the flight either.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import AXES, MAX_JUMP_BACK_NS, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.vehicle import ROTORS

Rows = npt.NDArray[np.float32]


class Quantity(NamedTuple):
    """Adjacent columns of a row; a block has the last values, or the sum of all where they are counted."""

    name: str
    width: int
    counted: bool = False


_AXES, _INPUTS = len(AXES), len(INPUT_NAMES)
# Of the vehicle; SI units, body axes forward-right-down, world north-east-down.
COMMON = (
    Quantity("time", 1),  # of the newest sample, seconds since the first
    Quantity("state", 1),  # see `trust.State`
    Quantity("judged", 1),  # 1 where inputs and intervals are judged, else 0
    Quantity("measured", _AXES),
    Quantity("inputs", _INPUTS),
    Quantity("position", 3),
    Quantity("attitude", 4),
    Quantity("speed", 1),
)
# Of each model.
PER_MODEL = (
    Quantity("count", 1, counted=True),
    Quantity("misses", _AXES, counted=True),
    Quantity("predicted", _AXES),
    Quantity("lower", _AXES),
    Quantity("upper", _AXES),
)


def quantities(models: int, rotors: int) -> list[Quantity]:
    """What a row holds, one behind the other; quantities of a model are called `MODEL.name`."""
    of_models = [one._replace(name=f"{model}.{one.name}") for model in range(models) for one in PER_MODEL]
    return [*COMMON, Quantity("rotors", rotors), *of_models]


def _placed(held: Iterable[Quantity]) -> dict[str, tuple[int, int]]:
    placed, place = {}, 0
    for one in held:
        placed[one.name] = (place, one.width)
        place += one.width
    return placed


class BlockStore:
    """The newest blocks of a flight, rows of :func:`quantities`; a number that nothing gave is NaN.

    Args:
        block_ns: duration of a block.
        capacity: how many are kept.

    Attributes:
        models, rotors: how many it has room for.
        columns: place and width of each quantity in a row, by name.
    """

    def __init__(self, block_ns: int, capacity: int) -> None:
        self.block_ns = block_ns
        self.capacity = capacity
        self.newest = -1
        self.columns: dict[str, tuple[int, int]] = {}
        self._rows: Rows = np.empty((capacity, 0), dtype=np.float32)
        self._lay_out(0, ROTORS)
        self._changed_from: int | None = None

    @property
    def oldest(self) -> int:
        """Number of the oldest block that is kept."""
        return max(0, self.newest + 1 - self.capacity)

    def add_model(self) -> int:
        """Make room for one more model; returns its number."""
        self._lay_out(self.models + 1, self.rotors)
        return self.models - 1

    def set_rotors(self, rotors: int) -> None:
        """Make room for another number of rotors."""
        self._lay_out(self.models, rotors)

    def _lay_out(self, models: int, rotors: int) -> None:
        columns = quantities(models, rotors)
        placed, before = _placed(columns), self.columns
        rows = np.full((self.capacity, sum(one.width for one in columns)), np.nan, dtype=np.float32)
        for name in before.keys() & placed.keys():
            (old, _), (new, _) = before[name], placed[name]
            width = min(before[name][1], placed[name][1])
            rows[:, new : new + width] = self._rows[:, old : old + width]
        self.models, self.rotors, self.columns, self._rows = models, rotors, placed, rows
        self._quantities = {one.name: one for one in columns}

    def add(self, time_ns: Stamps, **values: Array) -> None:
        """Take samples into their blocks; those before the first block or the oldest kept are left out.

        Args:
            time_ns: (K,) nanoseconds since the flight's start.
            **values: (K, width) or, for a width of one, (K,), by quantity; `model_0__count` for `0.count`.
        """
        numbers = time_ns // self.block_ns
        usable = (numbers >= 0) & (numbers > self.newest - self.capacity)
        if not usable.all():
            numbers, values = numbers[usable], {name: value[usable] for name, value in values.items()}
        if len(numbers) == 0:
            return
        if np.any(np.diff(numbers) < 0):
            order = np.argsort(numbers, kind="stable")
            numbers, values = numbers[order], {name: value[order] for name, value in values.items()}
        self._open(int(numbers[-1]))
        first = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
        blocks = numbers[first]
        # A batch longer than the ring leaves its end.
        recent = blocks >= self.oldest
        slots = blocks[recent] % self.capacity
        for name, value in values.items():
            key = name.removeprefix("model_").replace("__", ".")
            values_of_samples = value.reshape(len(numbers), -1)
            place, width = self.columns[key]
            old = self._rows[slots, place : place + width]
            if self._quantities[key].counted:
                new = np.add.reduceat(values_of_samples, first, axis=0)[recent]
                new = np.where(np.isnan(old), new, old + new)
            else:
                new = values_of_samples[np.append(first[1:], len(numbers)) - 1][recent]
                new = np.where(np.isnan(new), old, new)
            self._rows[slots, place : place + width] = new
        changed = int(blocks[0])
        self._changed_from = changed if self._changed_from is None else min(changed, self._changed_from)

    def get(self, first: int, last: int) -> tuple[int, Rows]:
        """The blocks from `first` to `last` that are kept, as the number of the first and rows (N, width)."""
        first, last = max(first, self.oldest), min(last, self.newest)
        return first, self._rows[np.arange(first, last + 1) % self.capacity]

    def value(self, number: int, name: str) -> Rows:
        """A quantity (width,) of one block; NaN where it is not kept."""
        place, width = self.columns[name]
        if not self.oldest <= number <= self.newest:
            return np.full(width, np.nan, dtype=np.float32)
        return self._rows[number % self.capacity, place : place + width]

    def inside(self, last: int, model: int, seconds: float, least_s: float) -> Array:
        """Share (6,) of a model's samples inside their intervals, over the seconds up to a block.

        Blocks that are not judged do not count; NaN with fewer than `least_s` of others.
        """
        first = max(self.oldest, last + 1 - round(1e9 * seconds / self.block_ns))
        slots = np.arange(first, min(last, self.newest) + 1) % self.capacity
        place, _ = self.columns[f"{model}.count"]
        rows = self._rows[slots, place : place + 1 + _AXES]
        rows = rows[(self._rows[slots, self.columns["judged"][0]] == 1.0) & ~np.isnan(rows[:, 0])]
        if len(rows) * self.block_ns < 1e9 * least_s:
            return np.full(_AXES, np.nan)
        count, *misses = rows.sum(axis=0, dtype=float)
        return 1.0 - np.array(misses) / count

    def take_changed(self) -> int | None:
        """Number of the first block that has changed since the last call; None if none has."""
        changed, self._changed_from = self._changed_from, None
        return changed

    def _open(self, number: int) -> None:
        if number <= self.newest:
            return
        count = min(number - self.newest, self.capacity)
        self._rows[np.arange(number - count + 1, number + 1) % self.capacity] = np.nan
        self.newest = number


# One per pixel of a wide screen, of which the first is as long as a block.
BINS = 2000
FIRST_BIN_S = 0.05
# Of the track, which is a line in space.
POINTS, FIRST_POINT_S = 1000, 0.25
# Ranks of the states of `trust.State` by code: of several in one bin the highest is shown.
_RANK = np.array([1, 3, 4, 2, 0], dtype=np.uint8)
_EMPTY = 255


class Timeline:
    """The most serious state of each bin; bins double their duration when the session outgrows them."""

    def __init__(self) -> None:
        self.bin_s = FIRST_BIN_S
        self._states = np.full(BINS, _EMPTY, dtype=np.uint8)
        self._used = 0

    def add(self, time_s: Array, states: npt.NDArray[np.uint8]) -> None:
        """Take states (M,) at their times."""
        for at, state in zip(time_s.tolist(), states.tolist(), strict=True):
            if at < 0.0:
                continue
            while at >= BINS * self.bin_s:
                self._halve()
            place = int(at / self.bin_s)
            self._states[place] = _worst(int(self._states[place]), state)
            self._used = max(self._used, place + 1)

    @property
    def codes(self) -> str:
        """One character per bin: the digit of the state, or `-` without one."""
        return "".join(
            "-" if state == _EMPTY else str(state) for state in self._states[: self._used].tolist()
        )

    def _halve(self) -> None:
        pairs = self._states.reshape(-1, 2)
        merged = [_worst(int(one), int(other)) for one, other in pairs]
        self._states[:] = _EMPTY
        self._states[: len(merged)] = merged
        self._used = (self._used + 1) // 2
        self.bin_s *= 2.0


class Track:
    """Positions of a whole session, at most :data:`POINTS`; every other one goes when it is full."""

    def __init__(self) -> None:
        self._every_s = FIRST_POINT_S
        self._points: list[tuple[float, ...]] = []
        self._next_s = 0.0

    def add(self, time_s: Array, position: Array) -> None:
        """Take positions (K, 3) at rising times (K,), leaving out those that are too near in time."""
        while True:
            place = int(np.searchsorted(time_s, self._next_s))
            if place == len(time_s):
                return
            at = float(time_s[place])
            self._next_s = at + self._every_s
            self._points.append((round(at, 2), *(round(float(value), 2) for value in position[place])))
            if len(self._points) >= POINTS:
                self._points = self._points[::2]
                self._every_s *= 2.0

    @property
    def points(self) -> list[tuple[float, ...]]:
        """Time and position of each."""
        return self._points


def _worst(one: int, other: int) -> int:
    if _EMPTY in (one, other):
        return other if one == _EMPTY else one
    return one if _RANK[one] >= _RANK[other] else other


# A step forward beyond this is not drawn: a pause between two flights, or a clock that was set.
LONGEST_GAP_NS = 60_000_000_000
# What is drawn in the place of a jump: enough to be seen on a page of 30 s.
PAUSE_NS = 1_000_000_000


class FlightClock:
    """Maps stamps to nanoseconds since the first one.

    Args:
        on_jump: called with the time of the page and the step in nanoseconds, for every jump.
    """

    def __init__(self, on_jump: Callable[[int, int], None]) -> None:
        self._on_jump = on_jump
        self._offset_ns: int | None = None
        self._last_ns = 0

    @property
    def started(self) -> bool:
        """Whether there was a stamp."""
        return self._offset_ns is not None

    def advance(self, time_ns: Stamps) -> Stamps:
        """Times (K,) of the stamps that lead: of the first model's predictions; jumps are found here."""
        if self._offset_ns is None:
            self._offset_ns, self._last_ns = -int(time_ns[0]), int(time_ns[0])
        steps = np.diff(time_ns, prepend=self._last_ns)
        jumps = (steps < -MAX_JUMP_BACK_NS) | (steps > LONGEST_GAP_NS)
        shifts = np.cumsum(np.where(jumps, PAUSE_NS - steps, 0))
        times: Stamps = time_ns + self._offset_ns + shifts
        for place in np.flatnonzero(jumps).tolist():
            self._on_jump(int(times[place]), int(steps[place]))
        self._offset_ns += int(shifts[-1])
        self._last_ns = int(time_ns[-1])
        return times

    def place(self, time_ns: Stamps) -> tuple[Stamps, npt.NDArray[np.bool_]]:
        """Times (K,) of other stamps, and which of them are near enough to the leading ones to be drawn."""
        if self._offset_ns is None:
            return time_ns, np.zeros(len(time_ns), dtype=np.bool_)
        near: npt.NDArray[np.bool_] = np.abs(time_ns - self._last_ns) <= LONGEST_GAP_NS
        return time_ns + self._offset_ns, near

    def time_of(self, stamp_ns: int) -> int:
        """Time of one stamp, however far from the leading ones."""
        return stamp_ns + (self._offset_ns or 0)
