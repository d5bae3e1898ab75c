# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of flights as matrices, and the covariance of their noise, to compare sums by band with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadpi_core.discrepancy.whitening import Columns, Indices, Noise, OfEachFlight, Spectrum
from quadpi_core.frames import Array

BANDS = 3
# Rows of two flights, the second of which reaches no third band.
ROWS = (np.array([0, 0, 0, 1, 1, 1, 2, 2]), np.array([0, 0, 1, 1, 1]))


def random_columns(rng: np.random.Generator, width: int, bands: tuple[Indices, ...] = ROWS) -> Columns:
    """Columns of flights with rows in some bands."""
    return Columns(tuple(Spectrum(rng.standard_normal((6, len(band), width)), band) for band in bands))


def random_noise(rng: np.random.Generator, held: tuple[int, ...] = ()) -> Noise:
    """Noise of these flights with two and then one deviation that each has of its own."""
    noise = Noise(rng.uniform(0.5, 2.0, (6, BANDS)), np.isin(np.arange(6), held))
    for width, deviations in ((3, 2), (1, 1)):
        own = rng.standard_normal((len(ROWS), width, deviations))
        noise = noise.beside(OfEachFlight(random_columns(rng, width), own))
    return noise


def told(noise: Noise, columns: Columns, place: int) -> Array:
    """Matrix (R, k) of columns of a flight in axes that say something."""
    return np.concatenate(columns.spectra[place].rows[~noise.held])


def deviating(noise: Noise, place: int) -> Array:
    """Matrix (R, E) of what the standard normal numbers of a flight add."""
    parts = [told(noise, own.columns, place) @ own.deviations[place] for own in noise.own]
    return np.hstack(parts) if parts else np.zeros((1, 0))


def covariance(noise: Noise, band: NDArray[np.intp], place: int) -> Array:
    """Covariance (R, R) of the noise of a flight in axes that say something."""
    own = deviating(noise, place)
    return np.asarray(np.diag(noise.variance[~noise.held][:, band].ravel()) + own @ own.T)
