# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whitening of autocorrelated residuals: columns of flights in frequency, their products, and their noise.

The noise of a measured wrench is not white: a moment is the derivative of a rate, and errors of the estimator
change slowly. Criteria that count samples as independent then find effects where there are none. In
frequency, stationary noise is independent from bin to bin, and only its spectrum has to be known. It counts
as white within bands, so products of columns by axis and band are all that fits need.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve, cholesky, solve_triangular

from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, DEVELOPMENT, Threshold

BAND_HZ = Threshold(
    "highest frequency compared",
    20.0,
    "Hz",
    "above it measured moments are noise of the gyro; flights are low-passed at 30 Hz",
    DEVELOPMENT,
)
EDGES_HZ = Threshold(
    "edges of the bands of noise",
    (0.0, 0.11, 0.3, 0.7, 1.5, 3.0, 5.0, 8.0, 12.0, BAND_HZ.value),
    "Hz",
    "narrow enough that noise counts as white within each; the lowest holds what is constant in a flight",
    CONVENTION,
)
TAPER_S = Threshold(
    "taper of a flight",
    0.5,
    "s at either end",
    "the ends of a flight differ, which without a taper leaks into every frequency",
    CONVENTION,
)
# Rounds of expectation and maximisation.
_ROUNDS = 4
Indices: TypeAlias = npt.NDArray[np.intp]
_Made = TypeVar("_Made")


class Memoised:
    """A value that does not change, with what is made of it, which searches share up to where they part."""

    @cached_property
    def _known(self) -> dict[Hashable, Any]:
        return {}

    def once(self, key: Hashable, make: Callable[[], _Made]) -> _Made:
        """What is made of the value, by a key that tells it apart; the same for all who ask again."""
        if key not in self._known:
            self._known[key] = make()
        return self._known[key]


class Spectrum(NamedTuple):
    """Columns of one flight in frequency.

    Attributes:
        rows: (6, B, K) per axis the mean, then real and imaginary part of each frequency in turn, scaled so
            that white noise of variance σ² gives rows of variance σ².
        band: (B,) index of the band of each row, in order.
    """

    rows: Array
    band: Indices


def spectrum(columns: Array, rate_hz: float) -> Spectrum:
    """Spectrum of columns (M, 6, K) of a flight, up to `BAND_HZ`."""
    samples = len(columns)
    frequency = np.fft.rfftfreq(samples, 1.0 / rate_hz)
    frequency = frequency[frequency <= BAND_HZ.value]
    faded = taper(samples, rate_hz)
    transformed = np.fft.rfft(columns * (faded / np.linalg.norm(faded))[:, None, None], axis=0)
    transformed = np.moveaxis(transformed[: len(frequency)], 1, 0)
    rows = np.empty((columns.shape[1], 2 * len(frequency) - 1, columns.shape[2]))
    rows[:, 0] = transformed[:, 0].real
    rows[:, 1::2], rows[:, 2::2] = transformed[:, 1:].real, transformed[:, 1:].imag
    rows[:, 1:] *= np.sqrt(2.0)
    return Spectrum(rows, np.searchsorted(EDGES_HZ.value[1:-1], np.repeat(frequency, 2)[1:], side="right"))


def taper(samples: int, rate_hz: float) -> Array:
    """Weights (M,) of the samples of a flight: 1, with half a cosine at either end."""
    ramp = min(int(TAPER_S.value * rate_hz), samples // 4)
    weights = np.ones(samples)
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(ramp) + 0.5) / max(ramp, 1))
    weights[:ramp], weights[samples - ramp :] = rise, rise[::-1]
    return weights


def band_means(values: Sequence[Array], bands: Sequence[Indices]) -> Array:
    """Mean (A, C) within each band of values (A, B) of each flight; 0 where no flight has rows."""
    together, band = np.concatenate(values, axis=1), np.concatenate(bands)
    sums = np.stack([np.bincount(band, own) for own in together])
    return sums / np.maximum(np.bincount(band), 1)


@dataclass(frozen=True, eq=False)
class Columns:
    """k columns of the residual of F flights: spectra (6, B, k), one of each flight."""

    spectra: tuple[Spectrum, ...]

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.spectra[0].rows.shape[2])

    @property
    def bands(self) -> int:
        """Number of bands that any flight has rows in."""
        return 1 + max(int(own.band[-1]) for own in self.spectra)

    @cached_property
    def counts(self) -> Indices:
        """Rows (C,) of all flights in each band."""
        return np.bincount(np.concatenate([own.band for own in self.spectra]))

    def products(self, other: Columns) -> Array:
        """Products (F, 6, C, k, j) with j columns of the same flights, summed over the rows of each band."""
        bands = self.bands
        axes = len(self.spectra[0].rows)
        products = np.zeros((len(self.spectra), axes, bands, self.width, other.width))
        for flight, one, two in zip(products, self.spectra, other.spectra, strict=True):
            edges = np.searchsorted(one.band, np.arange(bands + 1)).tolist()
            for band, (start, end) in enumerate(pairwise(edges)):
                flight[:, band] = np.swapaxes(one.rows[:, start:end], 1, 2) @ two.rows[:, start:end]
        return products

    def like(self, rows: Callable[[int], Array]) -> Columns:
        """Columns of the same flights, of rows (6, B, ·) by the place of each."""
        return Columns(tuple(Spectrum(rows(place), own.band) for place, own in enumerate(self.spectra)))

    def plus(self, change: Callable[[int], Array]) -> Columns:
        """The columns with rows (6, B, k) added to those of each flight, by its place."""
        return self.like(lambda place: self.spectra[place].rows + change(place))


class Part(NamedTuple):
    """Columns of all flights and the weight (k,) of each in a sum."""

    columns: Columns
    weights: Array


Sum: TypeAlias = Sequence[Part]


def rows_of(parts: Sum, place: int) -> Array:
    """Rows (6, B) of a sum of columns of a flight."""
    rows = np.zeros(parts[0].columns.spectra[place].rows.shape[:2])
    for part in parts:
        if part.weights.any():
            rows += part.columns.spectra[place].rows @ part.weights
    return rows


class PairsOfColumns:
    """What is made of each two columns, kept as long as both are."""

    def __init__(self, make: Callable[[Columns, Columns], Array]) -> None:
        self._make = make
        self._known: WeakKeyDictionary[Columns, WeakKeyDictionary[Columns, Array]] = WeakKeyDictionary()

    def __call__(self, first: Columns, second: Columns) -> Array:
        """(…, k, j) of k and j columns."""
        of_first = self._known.setdefault(first, WeakKeyDictionary())
        found = of_first.get(second)
        if found is None:
            reversed_ = self._known.setdefault(second, WeakKeyDictionary()).get(first)
            found = self._make(first, second) if reversed_ is None else np.swapaxes(reversed_, -1, -2)
            of_first[second] = found
        return found


class OfEachFlight(NamedTuple):
    """Independent deviations that every flight has of its own.

    Attributes:
        columns: k columns.
        deviations: (F, k, E) what each of E standard normal numbers of a flight adds of each column.
    """

    columns: Columns
    deviations: Array


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of flights: white within each axis and band, and what every flight has of its own.

    Attributes:
        variance: (F, 6, C) of each flight in C bands.
        own: what flights have of their own.
        products: see :meth:`Columns.products`.
    """

    variance: Array
    own: tuple[OfEachFlight, ...] = ()
    products: PairsOfColumns = field(default_factory=lambda: PairsOfColumns(Columns.products))

    @cached_property
    def precision(self) -> Array:
        """Squared weights (F, 6, C)."""
        return 1.0 / self.variance

    def beside(self, *own: OfEachFlight) -> Noise:
        """The noise with further deviations of each flight."""
        return replace(self, own=(*self.own, *own))

    @cached_property
    def gram(self) -> PairsOfColumns:
        """Gram matrices (F, k, j) of whitened columns of each flight."""
        return PairsOfColumns(self._gram)

    def grams(self, first: Sequence[Columns], second: Sequence[Columns]) -> Array:
        """Gram matrices (F, K, J) of the columns of some together and those of others."""
        rows = [np.concatenate([self.gram(one, two) for two in second], axis=2) for one in first]
        return np.concatenate(rows, axis=1)

    def squares(self, parts: Sum, place: int) -> float:
        """Squares of a sum of columns of a flight, in variances of the noise."""
        columns, weights = [part.columns for part in parts], np.concatenate([part.weights for part in parts])
        return float(weights @ self.grams(columns, columns)[place] @ weights)

    def _gram(self, first: Columns, second: Columns) -> Array:
        white = self._white(first, second)
        if not self.own:
            return white
        # The inverse of 1 + Q Qᵀ, by Woodbury.
        return white - np.swapaxes(self._seen(first), 1, 2) @ self.covariance @ self._seen(second)

    @cached_property
    def _white(self) -> PairsOfColumns:
        def weighed(first: Columns, second: Columns) -> Array:
            return np.einsum("fac,facij->fij", self.precision, self.products(first, second))

        return PairsOfColumns(weighed)

    def _seen(self, columns: Columns) -> Array:
        """Products (F, E, k) of all deviations and columns."""
        parts = [np.swapaxes(own.deviations, 1, 2) @ self._white(own.columns, columns) for own in self.own]
        return np.concatenate(parts, axis=1)

    @cached_property
    def covariance(self) -> Array:
        """Covariance (F, E, E) of what a residual tells of the deviations of each flight."""
        covariance = np.linalg.inv(self._information)
        return np.asarray(covariance, dtype=float)

    @cached_property
    def _information(self) -> Array:
        parts = [self._seen(own.columns) @ own.deviations for own in self.own]
        information: Array = np.concatenate(parts, axis=2)
        return information + np.eye(information.shape[1])

    def deviations(self, parts: Sum, place: int) -> Array:
        """Mean (E,) of the deviations of a flight, as its residual, a sum of columns, tells them."""
        seen = sum(self._seen(part.columns)[place] @ part.weights for part in parts)
        return self.covariance[place] @ seen

    def own_rows(self, parts: Sum, place: int) -> Array:
        """Rows (6, B) of what a flight has of its own, as its residual, a sum of columns, tells it."""
        rows = np.zeros(parts[0].columns.spectra[place].rows.shape[:2])
        if self.own:
            ends = np.cumsum([own.deviations.shape[2] for own in self.own])[:-1]
            for own, values in zip(self.own, np.split(self.deviations(parts, place), ends), strict=True):
                rows += own.columns.spectra[place].rows @ (own.deviations[place] @ values)
        return rows

    @cached_property
    def cost(self) -> float:
        """Evidence [nat] that all that flights may have of their own costs."""
        return 0.5 * float(np.linalg.slogdet(self._information)[1].sum()) if self.own else 0.0


def estimate_noise(products: Array, counts: Indices, most: Array) -> Array:
    """Variance (6, C) of the noise in C bands: that of the residual after a fit of all columns.

    Args:
        products: (6, C, K, K) of the residual, and of the columns that may explain it with a prior deviation
            of 1, over all flights; see :meth:`Columns.products`.
        counts: (C,) rows of each band.
        most: (6, C) what no noise exceeds, such as the squares before any fit. A fit that is bent by one axis
            may leave more than that in another, whose noise would then be overstated, and bend it further.
    """

    def prior(gram: Array) -> Array:
        return np.eye(len(gram))

    # Starting from too little noise, where the fit is that of least squares, the rounds converge quickly.
    first = np.repeat(products[:, -1:, 0, 0] / counts[-1], len(counts), axis=1)
    alone = [
        settled_noise(products[own], counts, first[own], prior, most[own])
        for own in (slice(axis, axis + 1) for axis in range(len(products)))
    ]
    # Fitted together from the start, an axis with too little noise would bend the fit, and the error that
    # this leaves in another axis would count as its noise for good.
    return settled_noise(products, counts, np.concatenate(alone), prior, most)


def settled_noise(
    products: Array,
    counts: Indices,
    noise: Array,
    penalty: Callable[[Array], Array],
    most: Array | float = np.inf,
) -> Array:
    """Variance (A, C) of the residual of A axes after a fit of the columns, which it weighs in turn.

    By expectation and maximisation: the variance of a band is its mean square after the fit plus the variance
    of the fit itself, so that many columns do not make the noise look small.

    Args:
        products: (A, C, K, K) of the residual, and of the columns that may explain it, over all flights.
        counts: (C,) rows of each band.
        noise: (A, C) variance to start from.
        penalty: (K, K) matrix to add to the Gram matrix (K, K) of the whitened columns, such as the precision
            of their prior.
        most: (A, C) what no variance exceeds.
    """
    # A band that no flight is long enough for has the noise of the next.
    filled = np.flatnonzero(counts)
    for _ in range(_ROUNDS):
        gram = np.tensordot(1.0 / np.maximum(noise, np.finfo(float).tiny), products, axes=2)
        lower = cholesky(gram[1:, 1:] + penalty(gram[1:, 1:]), lower=True)
        weights = np.concatenate(([1.0], -cho_solve((lower, True), gram[1:, 0])))
        # Not by the covariance, whose products with the columns cancel.
        whitening = solve_triangular(lower, np.eye(len(lower)), lower=True)
        squares = np.maximum(products @ weights @ weights, 0.0)
        squares += np.sum((whitening @ products[:, :, 1:, 1:]) * whitening, axis=(2, 3))
        means = squares[:, filled] / counts[filled]
        noise = np.stack([np.interp(np.arange(len(counts)), filled, own) for own in means])
        noise = np.minimum(noise, most)
    return np.maximum(noise, np.finfo(float).tiny)
