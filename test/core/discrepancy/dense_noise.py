# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of flights as matrices, and the covariance of their noise, to compare sums by band with."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from quadpi_core.discrepancy.whitening import Columns, Indices, Noise, OfEachFlight, Spectrum
from quadpi_core.frames import Array

BANDS = 3
# Rows of two flights, the second of which reaches no third band.
ROWS = (np.array([0, 0, 0, 1, 1, 1, 2, 2]), np.array([0, 0, 1, 1, 1]))


def random_columns(rng: np.random.Generator, width: int, bands: tuple[Indices, ...] = ROWS) -> Columns:
    """Columns of flights with rows in some bands."""
    return Columns(tuple(Spectrum(rng.standard_normal((6, len(band), width)), band) for band in bands))


def random_noise(rng: np.random.Generator) -> Noise:
    """Noise of these flights with two and then one deviation that each has of its own."""
    noise = Noise(rng.uniform(0.5, 2.0, (len(ROWS), 6, BANDS)))
    for width, deviations in ((3, 2), (1, 1)):
        own = rng.standard_normal((len(ROWS), width, deviations))
        noise = noise.beside(OfEachFlight(random_columns(rng, width), own))
    return noise


def told(columns: Columns, place: int) -> Array:
    """Matrix (R, k) of columns of a flight."""
    return np.concatenate(columns.spectra[place].rows)


def deviating(noise: Noise, place: int) -> Array:
    """Matrix (R, E) of what the standard normal numbers of a flight add."""
    parts = [told(own.columns, place) @ own.deviations[place] for own in noise.own]
    return np.hstack(parts) if parts else np.zeros((1, 0))


def covariance(noise: Noise, columns: Columns, place: int) -> Array:
    """Covariance (R, R) of the noise of a flight."""
    own, variance = deviating(noise, place), noise.variance[place][:, columns.spectra[place].band]
    return np.asarray(np.diag(variance.ravel()) + own @ own.T)


def stacked(columns: Sequence[Columns], places: Iterable[int]) -> Array:
    """Matrix (R, k) of columns, those of flights below each other."""
    return np.vstack([np.hstack([told(own, place) for own in columns]) for place in places])


class Normal(NamedTuple):
    """A residual r = X b + n of flights with coefficients b ~ N(0, prior) and noise n.

    Attributes:
        log_density: of r.
        mean, covariance: (k,), (k, k) of b, given r.
        left: (R,) r less X times the mean.
    """

    log_density: float
    mean: Array
    covariance: Array
    left: Array

    @classmethod
    def of(
        cls,
        noise: Noise,
        residual: Columns,
        columns: Sequence[Columns],
        places: Sequence[int],
        prior: float | Array = 1.0,
    ) -> Normal:
        x, r = stacked(columns, places), stacked([residual], places)[:, 0]
        together = block_diag(*(covariance(noise, residual, place) for place in places))
        weighed, prior = np.linalg.solve(together, x), prior * np.ones(x.shape[1])
        posterior = np.linalg.inv(x.T @ weighed + np.diag(1.0 / prior))
        mean = posterior @ weighed.T @ r
        density = multivariate_normal.logpdf(r, cov=together + x * prior @ x.T)
        return cls(float(density), mean, posterior, r - x @ mean)
