# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of values that come in parts: the longest run of equal ones, and their range."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.screening.wild_samples import EvenRows


@dataclass(frozen=True)
class Range:
    """Smallest, median and largest value of a quantity over the recording."""

    quantity: str
    unit: str
    lowest: float
    median: float
    highest: float


class LongestRun:
    """Longest run of equal rows that are added in parts; the first of equally long ones."""

    def __init__(self) -> None:
        self._count = 0
        self._start = 0
        self._longest = (0, 0)
        self._last: Array | None = None

    def add(self, rows: Array) -> None:
        """Add the next rows (N, C)."""
        if len(rows) == 0:
            return
        joined = rows if self._last is None else np.concatenate((self._last, rows))
        # Index of the second of two rows that are side by side, counted from the first of all.
        second = self._count + len(rows) - len(joined) + 1
        borders = second + np.flatnonzero(np.any(joined[1:] != joined[:-1], axis=1))
        if len(borders):
            lengths = np.diff(borders, prepend=self._start)
            longest = int(np.argmax(lengths))
            self._compare(int(borders[longest] - lengths[longest]), int(borders[longest]))
            self._start = int(borders[-1])
        self._count += len(rows)
        self._last = rows[-1:].copy()

    def longest(self) -> tuple[int, int]:
        """Index of its first row, and of its last one."""
        self._compare(self._start, self._count)
        return self._longest[0], self._longest[1] - 1

    def _compare(self, first: int, end: int) -> None:
        if end - first > self._longest[1] - self._longest[0]:
            self._longest = first, end


class RunningRange:
    """Range of a quantity that is added in parts; the median of a long flight is that of some samples."""

    def __init__(self, quantity: str, unit: str) -> None:
        self._quantity, self._unit = quantity, unit
        self._lowest, self._highest = np.inf, -np.inf
        self._known = EvenRows()

    def add(self, values: Array) -> None:
        """Add the next values (N,); those that are not finite are skipped."""
        known = values[np.isfinite(values)]
        self._known.add(known)
        self._lowest = min(self._lowest, float(known.min(initial=np.inf)))
        self._highest = max(self._highest, float(known.max(initial=-np.inf)))

    def ranges(self) -> Iterator[Range]:
        """The range; none without a value."""
        if len(self._known.rows()):
            median = float(np.median(self._known.rows()))
            yield Range(self._quantity, self._unit, self._lowest, median, self._highest)
