# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Autocorrelated residuals made white: least squares among the frequencies of each flight.

The noise of a measured wrench is anything but white: a moment comes from the derivative of a rate, and what
the estimator got wrong changes slowly. Textbook criteria that count samples as independent then find effects
where there are none. In frequency, stationary noise is independent from bin to bin, and only its spectrum
has to be known; it is estimated axis by axis from what the fit of everything leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve, cholesky, solve_triangular

from quadpi_core.flight import AXES
from quadpi_core.frames import Array

# What is compared: beyond it measured moments are noise of the gyro.
BAND_HZ = 20.0
# The noise is taken as white between these. The lowest band takes what is constant in a flight.
_EDGES_HZ = (0.0, 0.11, 0.3, 0.7, 1.5, 3.0, 5.0, 8.0, 12.0, BAND_HZ)
_TAPER_S = 0.5
_ROUNDS = 6


class Spectrum(NamedTuple):
    """Columns of one flight among frequencies.

    Attributes:
        rows: (6, B, K) per axis, real and imaginary parts as rows, scaled so that white noise of variance σ²
            gives rows of variance σ².
        band: (B,) index of the band of each row.
    """

    rows: Array
    band: npt.NDArray[np.intp]


BANDS = len(_EDGES_HZ) - 1


def spectrum(columns: Array, rate_hz: float) -> Spectrum:
    """Bring columns (M, 6, K) of a flight to frequencies up to BAND_HZ."""
    samples = len(columns)
    frequency = np.fft.rfftfreq(samples, 1.0 / rate_hz)
    kept = frequency <= BAND_HZ
    taper = _taper(samples, rate_hz)
    transformed = np.fft.rfft(columns * (taper / np.linalg.norm(taper))[:, None, None], axis=0)[kept]
    real, imaginary = transformed.real, transformed.imag[1:]
    real[1:] *= np.sqrt(2.0)
    rows = np.concatenate((real, np.sqrt(2.0) * imaginary))
    bins = np.concatenate((frequency[kept], frequency[kept][1:]))
    band = np.searchsorted(_EDGES_HZ[1:-1], bins, side="right")
    return Spectrum(np.ascontiguousarray(np.moveaxis(rows, 1, 0)), band)


def _taper(samples: int, rate_hz: float) -> Array:
    """Rises and falls with half a cosine at the ends, so that they do not leak into every frequency."""
    ramp = min(int(_TAPER_S * rate_hz), samples // 4)
    taper = np.ones(samples)
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(ramp) + 0.5) / max(ramp, 1))
    taper[:ramp], taper[samples - ramp :] = rise, rise[::-1]
    return taper


def cross_gram(first: Array, second: Array) -> Array:
    """Sum over axes and rows (6, B, ·) of the products of two tables of weighted columns."""
    total: Array = sum(one.T @ other for one, other in zip(first, second, strict=True))
    return total


def estimate_noise(
    spectra: Sequence[Spectrum], columns: npt.NDArray[np.intp], residual: Array | None = None
) -> Array:
    """Variance (6, BANDS) of the noise, from what a fit of all columns leaves of the first.

    By expectation and maximisation: a band gets the mean square that is left plus what the uncertainty of the
    fit would take from it, so that many columns do not make the noise look small.

    Args:
        spectra: of flights.
        columns: (k,) indices of those that may explain the residual, with a prior deviation of 1.
        residual: (K,) weight of each column in the residual; column 0 alone unless given.
    """
    if residual is None:
        residual = np.eye(1, spectra[0].rows.shape[2])[0]
    spectra = [
        Spectrum(
            np.concatenate(((flight.rows @ residual)[:, :, None], flight.rows[:, :, columns]), axis=2),
            flight.band,
        )
        for flight in spectra
    ]
    noise = np.empty((len(AXES), BANDS))
    for axis in range(len(AXES)):
        # From below, where the fit is that of least squares, the rounds settle quickly.
        highest = np.concatenate([flight.rows[axis, flight.band == BANDS - 1, 0] for flight in spectra])
        noise[axis] = max(np.mean(np.square(highest)), np.finfo(float).tiny)
    for _ in range(_ROUNDS):
        gram = np.zeros((1 + len(columns), 1 + len(columns)))
        for flight in spectra:
            weighted = flight.rows / np.sqrt(noise[:, flight.band])[:, :, None]
            gram += cross_gram(weighted, weighted)
        lower = cholesky(gram[1:, 1:] + np.eye(len(gram) - 1), lower=True)
        fit = cho_solve((lower, True), gram[1:, 0])
        for axis in range(len(AXES)):
            squares, counts = np.zeros(BANDS), np.zeros(BANDS)
            for flight in spectra:
                rows = flight.rows[axis]
                left = rows[:, 0] - rows[:, 1:] @ fit
                spread = np.square(solve_triangular(lower, rows[:, 1:].T, lower=True)).sum(axis=0)
                squares += np.bincount(flight.band, left * left + spread, BANDS)
                counts += np.bincount(flight.band, minlength=BANDS)
            # A band that no flight is long enough for has the noise of the next.
            found = counts > 0
            noise[axis, found] = squares[found] / counts[found]
            noise[axis] = np.interp(np.arange(BANDS), np.flatnonzero(found), noise[axis, found])
    return noise


def band_squares(rows: Sequence[Array], spectra: Sequence[Spectrum]) -> Array:
    """Mean square (6, BANDS) of rows (6, B) of each flight; 0 in bands that no flight is long enough for."""
    squares, counts = np.zeros((len(AXES), BANDS)), np.zeros(BANDS)
    for own, flight in zip(rows, spectra, strict=True):
        counts += np.bincount(flight.band, minlength=BANDS)
        for axis in range(len(AXES)):
            squares[axis] += np.bincount(flight.band, own[axis] ** 2, BANDS)
    mean: Array = squares / np.maximum(counts, 1.0)
    return mean
