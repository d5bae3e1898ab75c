# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whitening of autocorrelated residuals: least squares in the frequencies of each flight.

The noise of a measured wrench is not white: a moment is the derivative of a rate, and errors of the estimator
change slowly. Criteria that count samples as independent then find effects where there are none. In
frequency, stationary noise is independent from bin to bin, and only its spectrum has to be known; it is
estimated axis by axis from what the fit of all columns leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve, cholesky, solve_triangular

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.thresholds import CONVENTION, DEVELOPMENT, Threshold

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


class Spectrum(NamedTuple):
    """Columns of one flight in frequency.

    Attributes:
        rows: (6, B, K) real and imaginary parts per axis, scaled so that white noise of variance σ² gives
            rows of variance σ².
        band: (B,) index of the band of each row.
    """

    rows: Array
    band: npt.NDArray[np.intp]


def spectrum(columns: Array, rate_hz: float, highest_hz: float = BAND_HZ.value) -> Spectrum:
    """Spectrum of columns (M, 6, K) of a flight, up to a highest frequency.

    The bands are those between the edges of `EDGES_HZ` below it, and the rest up to it.
    """
    samples = len(columns)
    frequency = np.fft.rfftfreq(samples, 1.0 / rate_hz)
    kept = frequency <= highest_hz
    faded = taper(samples, rate_hz)
    transformed = np.fft.rfft(columns * (faded / np.linalg.norm(faded))[:, None, None], axis=0)[kept]
    real, imaginary = transformed.real, transformed.imag[1:]
    real[1:] *= np.sqrt(2.0)
    rows = np.concatenate((real, np.sqrt(2.0) * imaginary))
    bins = np.concatenate((frequency[kept], frequency[kept][1:]))
    edges = [edge for edge in EDGES_HZ.value[1:] if edge < highest_hz]
    band = np.searchsorted(edges, bins, side="right")
    return Spectrum(np.ascontiguousarray(np.moveaxis(rows, 1, 0)), band)


def taper(samples: int, rate_hz: float) -> Array:
    """Weights (M,) of the samples of a flight: 1, with half a cosine at either end."""
    ramp = min(int(TAPER_S.value * rate_hz), samples // 4)
    weights = np.ones(samples)
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(ramp) + 0.5) / max(ramp, 1))
    weights[:ramp], weights[samples - ramp :] = rise, rise[::-1]
    return weights


def cross_gram(first: Array, second: Array) -> Array:
    """Sum over axes and rows (6, B, ·) of the products of two tables of weighted columns."""
    total: Array = sum(one.T @ other for one, other in zip(first, second, strict=True))
    return total


def estimate_noise(spectra: Sequence[Spectrum], most: Array | None = None) -> Array:
    """Variance (6, C) of the noise in C bands: that of the residual after a fit of all columns.

    Args:
        spectra: per flight the residual, and the columns that may explain it with a prior deviation of 1.
        most: (6, C) what no noise exceeds, such as the squares before any fit. A fit that is bent by one axis
            may leave more than that in another, whose noise would then be overstated, and bend it further.
    """
    most = np.full((len(AXES), 1), np.inf) if most is None else most
    products = band_products(spectra)
    last = products.shape[1] - 1
    alone = []
    for axis in range(len(AXES)):
        own = [Spectrum(flight.rows[axis : axis + 1], flight.band) for flight in spectra]
        # Starting from too little noise, where the fit is that of least squares, the rounds converge quickly.
        highest = np.concatenate([flight.rows[0, flight.band == last, 0] for flight in own])
        first = np.full((1, last + 1), np.mean(np.square(highest)))
        alone.append(settled_noise(own, products[axis : axis + 1], first, _prior, most[axis : axis + 1]))
    # Fitted together from the start, an axis with too little noise would bend the fit, and the error that
    # this leaves in another axis would count as its noise for good.
    return settled_noise(spectra, products, np.concatenate(alone), _prior, most)


def _prior(gram: Array) -> Array:
    return np.eye(len(gram))


def band_products(spectra: Sequence[Spectrum]) -> Array:
    """Products (A, C, K, K) of the columns with each other, summed over the rows of each band of all flights.

    Noise is white within a band, so the Gram matrix of whitened columns is a weighted sum of them.
    """
    bands = 1 + max(int(flight.band.max()) for flight in spectra)
    axes, _, columns = spectra[0].rows.shape
    products = np.zeros((axes, bands, columns, columns))
    for rows, band in spectra:
        for index in range(bands):
            own = rows[:, band == index]
            products[:, index] += np.swapaxes(own, 1, 2) @ own
    return products


def settled_noise(
    spectra: Sequence[Spectrum],
    products: Array,
    noise: Array,
    penalty: Callable[[Array], Array],
    most: Array | float = np.inf,
) -> Array:
    """Variance (A, C) of the residual of A axes after a fit of the columns, which it weighs in turn.

    By expectation and maximisation: the variance of a band is its mean square after the fit plus the variance
    of the fit itself, so that many columns do not make the noise look small.

    Args:
        spectra: per flight the residual, and the columns that may explain it.
        products: (A, C, K, K) see :func:`band_products`.
        noise: (A, C) variance to start from.
        penalty: (K, K) matrix to add to the Gram matrix (K, K) of the whitened columns, such as the precision
            of their prior.
        most: (A, C) what no variance exceeds.
    """
    bands = [flight.band for flight in spectra]
    counts = np.bincount(np.concatenate(bands))
    # A band that no flight is long enough for has the noise of the next.
    filled = np.flatnonzero(counts)
    for _ in range(_ROUNDS):
        gram = np.tensordot(1.0 / np.maximum(noise, np.finfo(float).tiny), products, axes=2)
        lower = cholesky(gram[1:, 1:] + penalty(gram[1:, 1:]), lower=True)
        fit = cho_solve((lower, True), gram[1:, 0])
        # Not by the covariance, whose products with the columns cancel.
        whitening = solve_triangular(lower, np.eye(len(lower)), lower=True)
        left = [np.square(flight.rows[:, :, 0] - flight.rows[:, :, 1:] @ fit) for flight in spectra]
        spread = np.sum((whitening @ products[:, :, 1:, 1:]) * whitening, axis=(2, 3))
        means = band_means(left, bands) + spread / np.maximum(counts, 1)
        noise = np.stack([np.interp(np.arange(len(own)), filled, own[filled]) for own in means])
        noise = np.minimum(noise, most)
    return np.maximum(noise, np.finfo(float).tiny)


def band_means(values: Sequence[Array], bands: Sequence[npt.NDArray[np.intp]]) -> Array:
    """Mean (A, C) within each band of values (A, B) of each flight; 0 where no flight has rows."""
    together, band = np.concatenate(values, axis=1), np.concatenate(bands)
    counts = np.bincount(band)
    sums = np.stack([np.bincount(band, own) for own in together])
    mean: Array = sums / np.maximum(counts, 1)
    return mean
