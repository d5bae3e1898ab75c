# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Energy of residuals in bins of a variable and in seconds, tested against noise and tolerances.

The regression works in frequency; bins need time. A flight has as many samples here as it has rows there, and
mean squares are the same in both.

Coefficients are first fitted within their tolerances. The remaining energy in a cell is compared with that of
draws without any effect, treated in the same way. P-values are adjusted for all cells by the smallest p-value
of each draw (Westfall and Young), as cells share samples and noise is correlated over several cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.stats import gamma, norm

from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.evidence import Indices, residual_weights
from quadpi_core.discrepancy.search import Found
from quadpi_core.evaluation.metrics import round_edges
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.rotations import rotation_matrix
from quadpi_core.thresholds import CONVENTION, Threshold

VARIABLES = ("speed", "u", "v", "w", "height", "rotor_speed", "rates", "heading", "north", "east", "time")
# Edges of the bins of the height [m]: the air near the ground changes with powers of the height.
_HEIGHTS_M = np.array([0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0])
BEYOND_TOLERANCES = Threshold(
    "coefficients beyond what is allowed for",
    0.025,
    "probability that any coefficient of a simulation is",
    "half of the 5 % by which a range may be named in flights without a discrepancy",
    CONVENTION,
)
SIGNIFICANCE = Threshold(
    "significance of a cell",
    0.025,
    "p-value, adjusted for all cells",
    "the other half of the 5 %",
    CONVENTION,
)
CELL_DRAWS = Threshold(
    "draws without any effect",
    200,
    "draws",
    "five of them lie beyond the quantile that makes a cell significant",
    CONVENTION,
)
EFFECT_SIZE = Threshold(
    "energy that matters",
    4.0,
    "mean energy of a cell in the draws",
    "twice their root mean square: noise grows with speed and load, and a coefficient has a form",
    "none: a convention; 20 sets of flights without a discrepancy stay below it (test_by_condition.py)",
)
ALLOWED = Threshold(
    "allowed energy",
    0.95,
    "quantile of the draws",
    "what is shown as allowed in a figure is exceeded by chance in one bin of twenty",
    CONVENTION,
)
MOST_BINS = Threshold(
    "bins of a variable",
    12,
    "bins",
    "enough to see where an axis disagrees, and few enough that chance is divided among few",
    CONVENTION,
)
FEWEST_SAMPLES = Threshold(
    "samples of a bin",
    0.01,
    "of all samples",
    "a bin with fewer says nothing, and is merged with its neighbour",
    CONVENTION,
)
SEGMENT_S = Threshold(
    "length of a cell in time",
    1.0,
    "s",
    "a manoeuvre lasts one to a few seconds",
    CONVENTION,
)


class Residual(NamedTuple):
    """One flight; wrenches (B, 6) in N and Nm, body axes, measured less simulated, up to the band's end.

    Attributes:
        flight: name of the flight.
        time: (B,) s since the flight began.
        variables: (B,) each, by names of `VARIABLES`: m/s through the air, m above the world's origin,
            rad/s (mean of the rotors; magnitude of the rates), degrees, m north and east of that origin, s
            since the first sample.
        before: residual of the simulation as it is.
        beyond: residual with coefficients fitted within their tolerances, together with the effects.
        after: residual with effects and coefficients as fitted on all other flights.
    """

    flight: str
    time: Array
    variables: dict[str, Array]
    before: Array
    beyond: Array
    after: Array


def residuals(found: Found) -> list[Residual]:
    """Residuals of the flights of a search, in their order."""
    regression, columns = found.regression, found.regression.columns
    tolerances = columns.tolerances
    # Together with the effects that were found: alone, coefficients would take their place.
    without = found.fit.left.copy()
    without[tolerances] = 0.0
    projected = regression.gram[tolerances, : len(without)] @ without
    fitted = within_tolerance(regression.gram[np.ix_(tolerances, tolerances)], projected[:, None])[:, 0]
    before = residual_weights(len(without), ())
    beyond = before.copy()
    beyond[tolerances] -= fitted
    result = []
    for place, (flight, held_out) in enumerate(zip(regression.flights, found.closing.left_out, strict=True)):
        samples = len(flight.thinned)
        at = sample_indices(len(columns.bands[place]), samples)
        rows = [columns.combined(place, weights) for weights in (before, beyond, held_out.left)]
        series = over_time(np.stack(rows, axis=2), samples)
        result.append(
            Residual(
                flight=flight.thinned.name,
                time=flight.thinned.time[at],
                variables={name: values[at] for name, values in variables(flight).items()},
                before=series[:, :, 0],
                beyond=series[:, :, 1],
                after=series[:, :, 2],
            )
        )
    return result


def over_time(rows: Array, samples: int) -> Array:
    """Series (B, 6, C) in time of rows (6, B, C) in frequency, the inverse of `whitening.spectrum`.

    Args:
        rows: see :class:`quadpi_core.discrepancy.whitening.Spectrum`.
        samples: number of samples of the flight.
    """
    count = rows.shape[1]
    kept = (count + 1) // 2
    transformed = rows[:, :kept].astype(complex)
    transformed[:, 1:] = (rows[:, 1:kept] + 1j * rows[:, kept:]) / np.sqrt(2.0)
    series = np.fft.irfft(transformed, n=count, axis=1, norm="ortho") * np.sqrt(count / samples)
    return np.ascontiguousarray(np.moveaxis(series, 0, 1))


def sample_indices(count: int, samples: int) -> npt.NDArray[np.intp]:
    """Indices (count,) of the samples of a flight at the times of :func:`over_time`."""
    at: npt.NDArray[np.intp] = np.minimum(
        np.round(np.arange(count) * (samples / count)).astype(np.intp), samples - 1
    )
    return at


def largest_deviation(count: int) -> float:
    """Multiple of its tolerance that the furthest of `count` coefficients may reach."""
    return float(norm.isf(BEYOND_TOLERANCES.value / (2.0 * count)))


def within_tolerance(gram: Array, projected: Array) -> Array:
    """Best-fitting coefficients (K, D), none further off than :func:`largest_deviation`.

    A coefficient that would go further is fixed at its bound, and the others are fitted again.

    Args:
        gram: (K, K) Gram matrix of the whitened columns of tolerances.
        projected: (K, D) projections of D residuals on them.
    """
    matrix, most = gram + np.eye(len(gram)), largest_deviation(len(gram))
    best = np.linalg.solve(matrix, projected).astype(float)
    for draw in np.flatnonzero((np.abs(best) > most).any(axis=0)):
        own = best[:, draw]
        held = np.zeros(len(own), dtype=bool)
        while (beyond := ~held & (np.abs(own) > most)).any():
            held |= beyond
            own[held] = np.clip(own[held], -most, most)
            free = ~held
            rest: Array = projected[free, draw] - matrix[np.ix_(free, held)] @ own[held]
            own[free] = np.linalg.solve(matrix[np.ix_(free, free)], rest)
    return best


def variables(compared: Compared) -> dict[str, Array]:
    """Variables (M,) that a residual may depend on, by the names of `VARIABLES`."""
    states = compared.states
    velocity = states["velocity_air"]
    ahead = rotation_matrix(states["attitude"])[:, :2, 0]
    time = compared.thinned.time
    return {
        "speed": np.linalg.norm(velocity, axis=1),
        "u": velocity[:, 0],
        "v": velocity[:, 1],
        "w": velocity[:, 2],
        "height": -states["position"][:, 2],
        "rotor_speed": states["rotor_speeds"].mean(axis=1),
        "rates": np.linalg.norm(states["rates"], axis=1),
        "heading": np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0])),
        "north": states["position"][:, 0],
        "east": states["position"][:, 1],
        "time": time - time[0],
    }


@dataclass(frozen=True)
class Cells:
    """The C cells of all flights: the bins of each variable, then the seconds of each flight.

    Attributes:
        edges: edges of the bins of each variable.
        bins: cells of each variable.
        seconds: cells of each flight.
        members: per flight (C, B), 1 where a sample lies in a cell.
    """

    edges: dict[str, Array]
    bins: dict[str, slice]
    seconds: list[slice]
    members: list[csr_array]

    @classmethod
    def of(cls, flights: Sequence[Residual]) -> Cells:
        """The cells of some flights."""
        edges = {
            name: bin_edges(name, np.concatenate([flight.variables[name] for flight in flights]))
            for name in VARIABLES
        }
        bins, seconds, first = {}, [], 0
        for name in VARIABLES:
            bins[name] = slice(first, first := first + len(edges[name]) - 1)
        owned = []
        for flight in flights:
            second = ((flight.time - flight.time[0]) / SEGMENT_S.value).astype(np.intp)
            # An incomplete second at the end belongs to the one before.
            second = np.minimum(second, max(int((flight.time[-1] - flight.time[0]) / SEGMENT_S.value) - 1, 0))
            seconds.append(slice(first, first + int(second[-1]) + 1))
            within = [
                bins[name].start + bin_indices(flight.variables[name], edges[name]) for name in VARIABLES
            ]
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
        """Number of samples (C,) in each cell."""
        total: Array = sum(own.sum(axis=1) for own in self.members)
        return total

    def energy(self, series: Sequence[Array]) -> Array:
        """Sum of squares (C, …) over the samples of each cell, of series (B, …) of each flight."""
        total: Array = sum(
            (own @ np.square(values).reshape(len(values), -1)).reshape(-1, *values.shape[1:])
            for own, values in zip(self.members, series, strict=True)
        )
        return total


@dataclass(frozen=True)
class CellTest:
    """Test of the energy of cells against draws without any effect.

    Attributes:
        excess: (C, 6) energy beyond the mean of the draws; 0 where there is less.
        p_value: (C, 6) adjusted for all bins, or for all seconds.
        stands_out: (C, 6) whether that is significant, and large enough to matter.
        allowed: (C, 6) energy that most of the draws stay below.
    """

    excess: Array
    p_value: Array
    stands_out: npt.NDArray[np.bool_]
    allowed: Array


def against_draws(found: Found, flights: Sequence[Residual], cells: Cells, seed: int) -> CellTest:
    """Test the energy beyond tolerances against that of draws without any effect."""
    energy = cells.energy([flight.beyond for flight in flights])
    drawn = _drawn_energy(found, cells, seed)
    mean, variance = drawn.mean(axis=2), drawn.var(axis=2)
    # Energies of draws are sums of squares: close to a gamma distribution of their mean and variance.
    shape, scale = np.square(mean) / variance, variance / mean
    chance = gamma.sf(energy, shape, scale=scale)
    chance_drawn = gamma.sf(drawn, shape[:, :, None], scale=scale[:, :, None])
    p_value = np.empty_like(chance)
    first = cells.seconds[0].start
    for family in (slice(0, first), slice(first, len(energy))):
        smallest = np.sort(chance_drawn[family].min(axis=(0, 1)))
        below = np.searchsorted(smallest, chance[family], side="right")
        p_value[family] = (1.0 + below) / (1.0 + len(smallest))
    return CellTest(
        excess=np.maximum(energy - mean, 0.0),
        p_value=p_value,
        stands_out=standing_out(p_value, energy, mean),
        allowed=allowed_energy(drawn),
    )


def standing_out(p_value: Array, energy: Array, mean: Array) -> npt.NDArray[np.bool_]:
    """Whether cells hold significantly more energy than the mean of the draws, and enough to matter."""
    out: npt.NDArray[np.bool_] = (p_value <= SIGNIFICANCE.value) & (energy >= EFFECT_SIZE.value * mean)
    return out


def allowed_energy(drawn: Array) -> Array:
    """Energy (...) that most of the draws (..., D) stay below."""
    allowed: Array = np.quantile(drawn, ALLOWED.value, axis=-1)
    return allowed


def _drawn_energy(found: Found, cells: Cells, seed: int) -> Array:
    """Energy (C, 6, D) of D residuals without any effect, after the same fit of coefficients."""
    regression, columns = found.regression, found.regression.columns
    tolerances = columns.tolerances
    gram = regression.gram[np.ix_(tolerances, tolerances)]
    draws, most = CELL_DRAWS.value, largest_deviation(len(tolerances))
    rng = np.random.default_rng(seed)
    off = np.clip(rng.standard_normal((len(tolerances), draws)), -most, most)

    # What generic functions predict is not noise, even where no effect explains it.
    spectrum = np.minimum(regression.noise, found.left.noise)

    def noise(place: int) -> Array:
        rng, band = np.random.default_rng((seed, place)), columns.bands[place]
        # Noise differs from flight to flight: its variance is known as well as its squares in a band allow.
        bands = spectrum.shape[1]
        count = np.maximum(np.bincount(band, minlength=bands), 1)[:, None]
        share = rng.chisquare(count, (len(AXES), bands, draws)) / count
        deviation = np.sqrt(spectrum[:, :, None] / share)
        return deviation[:, band] * rng.standard_normal((len(AXES), len(band), draws))

    # Noise is made twice rather than kept: it is by far the largest of all arrays.
    projected = gram @ off
    allowed = [columns.rows(place, tolerances) for place in range(len(regression.flights))]
    for place, rows in enumerate(allowed):
        weighted = rows * regression.weighting.precision[:, columns.bands[place]][:, :, None]
        projected += np.einsum("abk,abd->kd", weighted, noise(place), optimize=True)
    left = off - within_tolerance(gram, projected)
    energy = np.zeros((len(cells.samples), len(AXES), draws))
    for place, rows in enumerate(allowed):
        series = over_time(rows @ left + noise(place), len(regression.flights[place].thinned))
        energy += (cells.members[place] @ np.square(series).reshape(len(series), -1)).reshape(energy.shape)
    return energy


def bin_indices(values: Array, edges: Array) -> Indices:
    """Bin (B,) of each value; the first and the last are open."""
    return np.searchsorted(edges[1:-1], values, side="right")


def bin_edges(name: str, values: Array) -> Array:
    """Edges (K + 1,), round numbers, of the bins of a variable with these values (N,)."""
    if name == "height":
        within = (values.min() < _HEIGHTS_M) & (values.max() > _HEIGHTS_M)
        edges = np.concatenate(([min(values.min(), 0.0)], _HEIGHTS_M[within], [values.max()]))
    else:
        edges = round_edges(values, MOST_BINS.value)
    fewest = FEWEST_SAMPLES.value * len(values)
    while len(edges) > 2:
        counts = np.bincount(bin_indices(values, edges), minlength=len(edges) - 1)
        small = int(np.argmin(counts))
        if counts[small] >= fewest:
            break
        # Into the neighbour that holds fewer.
        left = small > 0 and (small == len(counts) - 1 or counts[small - 1] <= counts[small + 1])
        edges = np.delete(edges, small if left else small + 1)
    return edges
