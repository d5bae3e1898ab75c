# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A whole session at a glance, however long: its state over time and its track, coarser as it grows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array

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
