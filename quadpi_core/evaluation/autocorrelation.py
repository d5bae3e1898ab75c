# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How many independent samples an autocorrelated series is worth.

Residuals of flight data at hundreds of hertz are strongly autocorrelated, and whatever is estimated from
them is far less certain than their number suggests. A series may consist of several flights: `groups`
gives a label per sample, and no pair of samples is ever formed across two flights.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import fft

from quadpi_core.frames import Array


def split_by_group(x: npt.ArrayLike, groups: npt.ArrayLike | None = None) -> list[Array]:
    """The series (N,) as one array per label, samples in their order; one array without `groups`."""
    x = np.asarray(x, dtype=float)
    if groups is None:
        return [x]
    labels = np.asarray(groups)
    return [x[labels == label] for label in np.unique(labels)]


def autocovariance(series: list[Array]) -> Array:
    """Autocovariances γ_0, γ_1, … up to the longest series, pooled over centred `series`.

    γ_k = Σ_g Σ_t x_g(t) x_g(t+k) / N with N samples in all: the biased estimator, positive semidefinite.
    """
    longest = max(len(x) for x in series)
    pooled = np.zeros(longest)
    for x in series:
        spectrum = fft.rfft(x, fft.next_fast_len(2 * len(x), real=True))
        products = fft.irfft(np.abs(spectrum) ** 2, fft.next_fast_len(2 * len(x), real=True))
        pooled[: len(x)] += products[: len(x)]
    return pooled / sum(len(x) for x in series)


def integrated_time(x: npt.ArrayLike, groups: npt.ArrayLike | None = None) -> float:
    """Integrated autocorrelation time τ = 1 + 2 Σ ρ_k in samples: the mean of N is worth N/τ of them.

    The sum ends by the initial monotone sequence of Geyer (1992): sums of adjacent pairs of ρ_k, as long
    as they are positive, each no larger than the one before. Deviations are taken from the mean of all
    groups, so a flight that differs as a whole counts as the correlation that it is.

    Args:
        x: (N,) series, for example the residuals of a model.
        groups: (N,) labels of the flights; None where all samples are of one.

    Returns:
        τ between 1 and N. A negative correlation gives 1, which is on the safe side; a constant series,
        whose correlation is undefined, gives N.
    """
    x = np.asarray(x, dtype=float)
    extent = np.ptp(x)
    if extent == 0.0:
        return float(len(x))
    covariance = autocovariance(split_by_group((x - x.mean()) / extent, groups))
    correlation = covariance / covariance[0]
    pairs = correlation[: len(correlation) // 2 * 2].reshape(-1, 2).sum(axis=1)
    not_positive = np.flatnonzero(pairs <= 0.0)
    positive = pairs[: not_positive[0]] if len(not_positive) else pairs
    return float(np.clip(2.0 * np.minimum.accumulate(positive).sum() - 1.0, 1.0, len(x)))


def effective_sample_size(x: npt.ArrayLike, groups: npt.ArrayLike | None = None) -> float:
    """Number of independent samples, N/τ, with the same mean's variance; see :func:`integrated_time`."""
    return np.size(x) / integrated_time(x, groups)
