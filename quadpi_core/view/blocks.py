# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A flight in blocks of equal duration, one row of numbers each: extremes, sums or last values.

The page draws blocks, so its cost does not grow with the rate of the input, and no extreme is lost. The
newest blocks are kept in a ring, so memory does not grow with the flight either.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import AXES, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.vehicle import ROTORS

Rows = npt.NDArray[np.float32]


class Fold(Enum):
    """How the samples of a block become one number."""

    MIN = "min"
    MAX = "max"
    SUM = "sum"
    LAST = "last"


class Quantity(NamedTuple):
    """Adjacent columns of a row."""

    name: str
    width: int
    fold: Fold


_AXES, _INPUTS = len(AXES), len(INPUT_NAMES)
# Of the vehicle; SI units, body axes forward-right-down, world north-east-down.
COMMON = (
    Quantity("time", 1, Fold.MAX),  # of the newest sample, seconds since the first
    Quantity("state", 1, Fold.LAST),  # see `trust.State`
    Quantity("causes", 1, Fold.LAST),  # bits of the causes that are not ok
    Quantity("distance", 1, Fold.MAX),  # of the worst input outside its training range
    Quantity("measured_min", _AXES, Fold.MIN),
    Quantity("measured_max", _AXES, Fold.MAX),
    Quantity("inputs_min", _INPUTS, Fold.MIN),
    Quantity("inputs_max", _INPUTS, Fold.MAX),
    Quantity("position", 3, Fold.LAST),
    Quantity("attitude", 4, Fold.LAST),
    Quantity("velocity", 3, Fold.LAST),
    Quantity("speed", 1, Fold.MAX),
    Quantity("rotor_min", ROTORS, Fold.MIN),
    Quantity("rotor_max", ROTORS, Fold.MAX),
)
# Of each model.
PER_MODEL = (
    Quantity("count", 1, Fold.SUM),
    Quantity("misses", _AXES, Fold.SUM),
    Quantity("predicted_min", _AXES, Fold.MIN),
    Quantity("predicted_max", _AXES, Fold.MAX),
    Quantity("lower", _AXES, Fold.MIN),
    Quantity("upper", _AXES, Fold.MAX),
)
_COMMON_WIDTH = sum(one.width for one in COMMON)
_MODEL_WIDTH = sum(one.width for one in PER_MODEL)


def columns(models: int) -> dict[str, tuple[int, int]]:
    """Place and width of each quantity in a row: by its name, of a model by `MODEL.name`."""
    placed: dict[str, tuple[int, int]] = {}
    place = 0
    for prefix, quantities in (("", COMMON), *((f"{model}.", PER_MODEL) for model in range(models))):
        for one in quantities:
            placed[prefix + one.name] = (place, one.width)
            place += one.width
    return placed


class BlockStore:
    """The newest blocks of a flight, rows of :func:`columns`; a number that nothing gave is NaN.

    Args:
        block_ns: duration of a block.
        capacity: how many are kept.
    """

    def __init__(self, block_ns: int, capacity: int) -> None:
        self.block_ns = block_ns
        self.capacity = capacity
        self.models = 0
        self.newest = -1
        self._rows = np.full((capacity, _COMMON_WIDTH), np.nan, dtype=np.float32)
        self._quantities = {one.name: one for one in COMMON}
        self._columns = columns(0)
        self._changed_from: int | None = None

    @property
    def oldest(self) -> int:
        """Number of the oldest block that is kept."""
        return max(0, self.newest + 1 - self.capacity)

    def add_model(self) -> int:
        """Make room for one more model; returns its number."""
        added = np.full((self.capacity, _MODEL_WIDTH), np.nan, dtype=np.float32)
        self._rows = np.concatenate((self._rows, added), axis=1)
        for one in PER_MODEL:
            self._quantities[f"{self.models}.{one.name}"] = one
        self.models += 1
        self._columns = columns(self.models)
        return self.models - 1

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
            folded = _folded(value.reshape(len(numbers), -1), first, self._quantities[key].fold)[recent]
            place, width = self._columns[key]
            old = self._rows[slots, place : place + width]
            self._rows[slots, place : place + width] = _joined(old, folded, self._quantities[key].fold)
        changed = int(blocks[0])
        self._changed_from = changed if self._changed_from is None else min(changed, self._changed_from)

    def get(self, first: int, last: int) -> tuple[int, Rows]:
        """The blocks from `first` to `last` that are kept, as the number of the first and rows (N, width)."""
        first, last = max(first, self.oldest), min(last, self.newest)
        return first, self._rows[np.arange(first, last + 1) % self.capacity]

    def value(self, number: int, name: str) -> Rows:
        """A quantity (width,) of one block; NaN where it is not kept."""
        place, width = self._columns[name]
        if not self.oldest <= number <= self.newest:
            return np.full(width, np.nan, dtype=np.float32)
        row: Rows = self._rows[number % self.capacity, place : place + width]
        return row

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


def _folded(values: Array, first: npt.NDArray[np.int64], fold: Fold) -> Rows:
    """Values (K, W) of blocks that begin at `first` (B,), folded to (B, W)."""
    folded: Rows
    if fold is Fold.LAST:
        folded = values[np.append(first[1:], len(values)) - 1].astype(np.float32)
        return folded
    together = {Fold.MIN: np.fmin, Fold.MAX: np.fmax, Fold.SUM: np.add}[fold]
    folded = together.reduceat(values, first, axis=0).astype(np.float32)
    return folded


def _joined(old: Rows, new: Rows, fold: Fold) -> Rows:
    """What a block is after more samples; NaN stands for none."""
    if fold is Fold.LAST:
        return np.where(np.isnan(new), old, new)
    if fold is Fold.SUM:
        return np.where(np.isnan(old), new, old + new)
    return np.fmin(old, new) if fold is Fold.MIN else np.fmax(old, new)
