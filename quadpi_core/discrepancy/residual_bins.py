# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Residual energy in cells of flight: bins of a variable, seconds of a flight; and which hold too much.

Coefficients have been put where they fit best within their tolerances. The energy that is left in a cell is
held against that of draws without any effect, treated the same way. A p-value is adjusted for all cells that
were looked at by the smallest of each draw (Westfall and Young): cells share samples, and noise lasts longer
than one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.stats import gamma

from quadpi_core.discrepancy.residuals import VARIABLES, Residual, most_off, over_time, within_tolerance
from quadpi_core.discrepancy.search import Found
from quadpi_core.discrepancy.whitening import BANDS
from quadpi_core.evaluation.metrics import round_edges
from quadpi_core.flight import AXES
from quadpi_core.frames import Array

DRAWS = 200
_MOST_BINS = 12
# As much again is the chance that a coefficient of the simulation is beyond its tolerance.
_SIGNIFICANT = 0.025
# Noise grows with speed and load, and a coefficient has a form: a cell stands out from twice the root mean
# square that draws have.
_MATTERS = 4.0
SEGMENT_S = 1.0
# A bin that a smaller share of all samples falls into goes with its neighbour.
_FEWEST = 0.01
# Air near the ground changes with powers of the height.
_HEIGHTS_M = np.array([0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0])
# The draws' energies are close to sums of squares: a gamma distribution of their mean and variance.
_QUANTILE = 0.95

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Cells:
    """Cells of all flights; C of them: the bins of each variable, then the seconds of each flight.

    Attributes:
        edges: of the bins, by variable.
        bins: by variable, its cells.
        seconds: per flight, its cells.
        members: per flight (C, B), 1 where a sample lies in a cell.
    """

    edges: dict[str, Array]
    bins: dict[str, slice]
    seconds: list[slice]
    members: list[csr_array]

    @classmethod
    def of(cls, flights: Sequence[Residual]) -> Cells:
        """The cells of some flights."""
        edges = {name: _edges(name, flights) for name in VARIABLES}
        bins, seconds, first = {}, [], 0
        for name in VARIABLES:
            bins[name] = slice(first, first := first + len(edges[name]) - 1)
        owned = []
        for flight in flights:
            second = ((flight.time - flight.time[0]) / SEGMENT_S).astype(np.intp)
            # What is left over at the end belongs to the last whole one.
            second = np.minimum(second, max(int((flight.time[-1] - flight.time[0]) / SEGMENT_S) - 1, 0))
            seconds.append(slice(first, first + int(second[-1]) + 1))
            within = [bins[name].start + place(flight.variables[name], edges[name]) for name in VARIABLES]
            owned.append(np.stack([*within, first + second]))
            first = seconds[-1].stop
        members = [
            csr_array(
                (np.ones(own.size), (own.ravel(), np.tile(np.arange(own.shape[1]), len(own)))),
                (first, own.shape[1]),
            )
            for own in owned
        ]
        return cls(edges, bins, seconds, members)

    @property
    def samples(self) -> Array:
        """Number of samples (C,) in each."""
        total: Array = sum(own.sum(axis=1) for own in self.members)
        return total

    def energy(self, series: Sequence[Array]) -> Array:
        """Sum of squares (C, …) over the samples of each, of per flight (B, …)."""
        total: Array = sum(
            (own @ np.square(values).reshape(len(values), -1)).reshape(-1, *values.shape[1:])
            for own, values in zip(self.members, series, strict=True)
        )
        return total


@dataclass(frozen=True)
class Held:
    """What cells hold.

    Attributes:
        excess: (C, 6) energy beyond the mean of the draws; 0 where there is less.
        p_value: (C, 6) adjusted for all bins, or for all seconds.
        stands_out: (C, 6) whether that is significant, and large enough to matter.
        allowed: (C, 6) energy that 95 % of the draws stay below.
    """

    excess: Array
    p_value: Array
    stands_out: npt.NDArray[np.bool_]
    allowed: Array


def against_draws(found: Found, flights: Sequence[Residual], cells: Cells, seed: int) -> Held:
    """Hold the energy beyond tolerances against that of draws without any effect."""
    energy = cells.energy([flight.beyond for flight in flights])
    drawn = _drawn_energy(found, cells, seed)
    mean, variance = drawn.mean(axis=2), drawn.var(axis=2)
    shape, scale = np.square(mean) / variance, variance / mean
    chance = gamma.sf(energy, shape, scale=scale)
    chance_drawn = gamma.sf(drawn, shape[:, :, None], scale=scale[:, :, None])
    p_value = np.empty_like(chance)
    first = cells.seconds[0].start
    for family in (slice(0, first), slice(first, len(energy))):
        smallest = np.sort(chance_drawn[family].min(axis=(0, 1)))
        below = np.searchsorted(smallest, chance[family], side="right")
        p_value[family] = (1.0 + below) / (1.0 + len(smallest))
    return Held(
        excess=np.maximum(energy - mean, 0.0),
        p_value=p_value,
        stands_out=(p_value <= _SIGNIFICANT) & (energy >= _MATTERS * mean),
        allowed=np.quantile(drawn, _QUANTILE, axis=2),
    )


def _drawn_energy(found: Found, cells: Cells, seed: int) -> Array:
    """Energy (C, 6, DRAWS) of residuals without any effect, coefficients put where they fit best."""
    design = found.design
    tolerances = design.tolerances
    gram = design.gram[np.ix_(tolerances, tolerances)]
    most = most_off(len(tolerances))
    rng = np.random.default_rng(seed)
    off = np.clip(rng.standard_normal((len(tolerances), DRAWS)), -most, most)

    # What generic functions predict is no noise either, where it has no name.
    spectrum = np.minimum(design.noise, found.left.noise)

    def noise(place: int) -> Array:
        rng, band = np.random.default_rng((seed, place)), design.bands[place]
        # Noise differs from flight to flight: no better known than its own squares in a band could tell.
        count = np.maximum(np.bincount(band, minlength=BANDS), 1)[:, None]
        share = rng.chisquare(count, (len(AXES), BANDS, DRAWS)) / count
        deviation = np.sqrt(spectrum[:, :, None] / share)
        return deviation[:, band] * rng.standard_normal((len(AXES), len(band), DRAWS))

    # Made twice rather than kept: it is by far the largest of all arrays.
    projected = gram @ off
    columns = [design.rows(place, tolerances) for place in range(len(design.flights))]
    for place, rows in enumerate(columns):
        weighted = rows / design.noise[:, design.bands[place]][:, :, None]
        projected += np.einsum("abk,abd->kd", weighted, noise(place), optimize=True)
    left = off - within_tolerance(gram, projected)
    energy = np.zeros((len(cells.samples), len(AXES), DRAWS))
    for place, rows in enumerate(columns):
        series = over_time(rows @ left + noise(place), len(design.flights[place].thinned))
        energy += (cells.members[place] @ np.square(series).reshape(len(series), -1)).reshape(energy.shape)
    return energy


def place(values: Array, edges: Array) -> Indices:
    """Bin (B,) of each value; the first and the last are open."""
    return np.searchsorted(edges[1:-1], values, side="right")


def _edges(name: str, flights: Sequence[Residual]) -> Array:
    """Edges (K + 1,) of the bins of a variable, round numbers."""
    values = np.concatenate([flight.variables[name] for flight in flights])
    if name == "height":
        within = (values.min() < _HEIGHTS_M) & (values.max() > _HEIGHTS_M)
        edges = np.concatenate(([min(values.min(), 0.0)], _HEIGHTS_M[within], [values.max()]))
    else:
        edges = round_edges(values, _MOST_BINS)
    fewest = _FEWEST * len(values)
    while len(edges) > 2:
        counts = np.bincount(place(values, edges), minlength=len(edges) - 1)
        small = int(np.argmin(counts))
        if counts[small] >= fewest:
            break
        # Into the neighbour that holds fewer.
        left = small > 0 and (small == len(counts) - 1 or counts[small - 1] <= counts[small + 1])
        edges = np.delete(edges, small if left else small + 1)
    return edges
