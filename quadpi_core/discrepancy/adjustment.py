# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which coefficients of a simulation are adjusted beside the effects that were added to it.

A coefficient moves within its tolerance in the fit of an effect. What one axis gains by that, another may
lose: the thrust of rotors that is bent to explain a weight also turns the vehicle. So only those coefficients
are adjusted with which flights left out gain, and none of their axes loses more than its noise can do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quadpi_core.discrepancy.evidence import Indices
from quadpi_core.frames import Array
from quadpi_core.thresholds import CONVENTION, Threshold

LOST = Threshold(
    "loss of an axis",
    2.0,
    "standard deviations of what noise alone changes",
    "the level of the intervals that are stated: less is no loss that flights show",
    CONVENTION,
)


class LeftOut(NamedTuple):
    """What a flight needs to be judged by the fit of all others; column 0 is its residual after the effects.

    Attributes:
        others: (1 + c, 1 + c) Gram matrix of all other flights.
        own: (1 + c, 1 + c) Gram matrix of the flight in the same weights.
        squares: (6, 1 + c, 1 + c) Gram matrices of each axis of the flight, without weights.
        noisy: (6, 1 + c, 1 + c) the same with each row times the standard deviation of its noise.
    """

    others: Array
    own: Array
    squares: Array
    noisy: Array


class _Result(NamedTuple):
    """Left-out flights after a fit: weighted squares of all, squares (6,), weights (F, 1 + c) of columns."""

    total: float
    axes: Array
    weights: Array


@dataclass(frozen=True)
class Adjustment:
    """The choice of coefficients to adjust.

    Attributes:
        flights: each flight.
        precisions: (c,) prior precision of each column after the first.
        coefficients: number of coefficients, whose columns come first; the columns after them, of the shapes
            of laws, are fitted in any case.
    """

    flights: list[LeftOut]
    precisions: Array
    coefficients: int

    def chosen(self) -> Indices:
        """Numbers of the coefficients that are adjusted: all, or those that help one after the other."""
        everything = np.arange(self.coefficients)
        before = self._after(everything[:0])
        best = self._after(everything)
        if best.total < before.total and not self._loses(before, best):
            return everything
        best, kept = before, everything[:0]
        while True:
            larger = [np.append(kept, index) for index in np.setdiff1d(everything, kept)]
            results = [(own, result) for own in larger if (result := self._after(own)).total < best.total]
            allowed = [(own, result) for own, result in results if not self._loses(before, result)]
            if not allowed:
                return np.sort(kept)
            kept, best = min(allowed, key=lambda item: item[1].total)

    def _after(self, coefficients: Indices) -> _Result:
        """Flights left out after the fit of some coefficients and all shapes."""
        fitted = 1 + np.append(coefficients, np.arange(self.coefficients, len(self.precisions)))
        weights = np.zeros((len(self.flights), 1 + len(self.precisions)))
        weights[:, 0] = 1.0
        penalty = np.diag(self.precisions[fitted - 1])
        total, axes = 0.0, np.zeros(len(self.flights[0].squares))
        for flight, own in zip(self.flights, weights, strict=True):
            matrix = flight.others[np.ix_(fitted, fitted)] + penalty
            own[fitted] = -np.linalg.solve(matrix, flight.others[fitted, 0])
            total += float(own @ flight.own @ own)
            axes += own @ flight.squares @ own
        return _Result(total, axes, weights)

    def _loses(self, before: _Result, after: _Result) -> bool:
        """Whether an axis loses more than noise alone would make of the change."""
        changed = np.zeros(len(before.axes))
        for flight, change in zip(self.flights, after.weights - before.weights, strict=True):
            changed += change @ flight.noisy @ change
        # Of squares |r + c|² − |r|² = c² + 2 r·c, noise r makes a deviation of 2 √(c' Σ c).
        noise = 2.0 * np.sqrt(np.maximum(changed, 0.0))
        return bool(np.any(after.axes - before.axes > LOST.value * noise))
