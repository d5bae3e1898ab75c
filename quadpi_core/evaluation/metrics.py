# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of predictions and of prediction intervals, as pure functions on arrays of shape (N,).

`measured` y, `predicted` ŷ and the bounds `lower` L and `upper` U share one unit; so do MPIW, RMSE and the
Winkler score.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import fft
from scipy.special import betaincinv, ndtr, ndtri, stdtrit  # scipy.stats takes a second to import

from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import inside_interval

# How steeply CWC punishes coverage below the nominal one; the value of Khosravi et al. (2011).
CWC_ETA = 50.0


def picp(measured: Array, lower: Array, upper: Array) -> float:
    """Prediction interval coverage probability: share of samples inside (van Beers, de Visser, Eq. PICP)."""
    return float(np.mean(inside_interval(measured, lower, upper)))


def mpiw(lower: Array, upper: Array) -> float:
    """Mean prediction interval width: mean of U − L (van Beers and de Visser, Eq. MPIW)."""
    return float(np.mean(upper - lower))


def nmpiw(lower: Array, upper: Array, training_range: float) -> float:
    """MPIW as a fraction of `training_range`, the range (max − min) of the measured training data.

    The range is that of the training data for every group of flights, so that widths of different groups
    compare; the range of the evaluated flight itself would reward a flight that covers much ground.
    """
    return mpiw(lower, upper) / training_range


def rmse(measured: Array, predicted: Array) -> float:
    """Root mean square error of the prediction."""
    return float(np.sqrt(np.mean((measured - predicted) ** 2)))


def r_squared(measured: Array, predicted: Array) -> float | None:
    """Coefficient of determination 1 − Σ(y − ŷ)² / Σ(y − ȳ)²; None where y is constant: undefined."""
    if np.ptp(measured) == 0.0:
        return None
    residual = np.sum((measured - predicted) ** 2)
    return float(1.0 - residual / np.sum((measured - measured.mean()) ** 2))


def winkler(measured: Array, lower: Array, upper: Array, confidence: float) -> float:
    """Mean Winkler (interval) score: width plus 2/α times the distance outside, α = 1 − confidence.

    Lower is better; among intervals it is smallest in expectation for the true quantiles
    (Gneiting and Raftery 2007, Eq. 43).
    """
    outside = np.maximum(lower - measured, 0.0) + np.maximum(measured - upper, 0.0)
    return float(np.mean(upper - lower + 2.0 / (1.0 - confidence) * outside))


def cwc(
    measured: Array,
    lower: Array,
    upper: Array,
    training_range: float,
    confidence: float,
    eta: float = CWC_ETA,
) -> float:
    """Coverage width criterion, NMPIW (1 + γ exp(−η (PICP − μ))), lower is better.

    γ is 1 where the coverage is below μ, the nominal confidence, else 0: the criterion is NMPIW for intervals
    that cover, and at least twice that for others (Khosravi, Nahavandi, Creighton and Atiya 2011, Eq. 4, 5).
    """
    width = nmpiw(lower, upper, training_range)
    short = picp(measured, lower, upper) - confidence
    return float(width * (1.0 + (np.exp(-eta * short) if short < 0.0 else 0.0)))


def implied_std(lower: Array, upper: Array, confidence: float) -> Array:
    """Standard deviation (N,) of the normal distribution that has [L, U] as its central interval."""
    return 0.5 * (upper - lower) / ndtri(0.5 + 0.5 * confidence)


def crps_normal(measured: Array, mean: Array, std: Array) -> float:
    """Mean continuous ranked probability score of normal predictions, in the unit of y; lower is better.

    σ (z (2 Φ(z) − 1) + 2 φ(z) − 1/√π) with z = (y − mean)/σ (Gneiting and Raftery 2007, Eq. 21), which is
    |y − mean| in the limit of no spread.
    """
    error = measured - mean
    z = np.divide(error, std, out=np.zeros_like(error), where=std > 0.0)
    density = np.exp(-(z**2) / 2.0) / np.sqrt(2.0 * np.pi)
    score = error * (2.0 * ndtr(z) - 1.0) + std * (2.0 * density - 1.0 / np.sqrt(np.pi))
    return float(np.mean(np.where(std > 0.0, score, np.abs(error))))


# Bins of a regime: few enough for a table.
MOST_BINS = 8


@dataclass(frozen=True)
class RegimeBins:
    """Samples, coverage and mean width (N or Nm) in each bin; the last two are None where a bin is empty."""

    n: list[int]
    picp: list[float | None]
    mpiw: list[float | None]


def round_edges(values: Array, most: int = MOST_BINS) -> Array:
    """Edges of equal bins over the values, at round numbers.

    The bins are 1, 2 or 5 times a power of ten wide, as narrow as `most` bins allow.
    """
    lowest, highest = float(values.min()), float(values.max())
    extent = highest - lowest
    if extent < 1e-6 * max(abs(lowest), abs(highest), 1.0):
        # Constant up to rounding: one bin.
        extent = 1.0
    scale = 10.0 ** np.floor(np.log10(extent / most))
    for step in scale * np.array([1.0, 2.0, 5.0, 10.0, 20.0]):
        first, last = np.floor(lowest / step), np.floor(highest / step) + 1.0
        if last - first <= most:
            break
    # 0.3, not 0.30000000000000004.
    digits = max(0, 1 - int(np.floor(np.log10(step))))
    return np.round(np.arange(first, last + 1.0) * step, digits)


def by_bin(values: Array, inside: npt.NDArray[np.bool_], width: Array, edges: Array) -> RegimeBins:
    """Samples, coverage and mean width in each bin [edge, next edge).

    Args:
        values: (N,) that are binned, all within the edges.
        inside: (N,) whether the measurement lay in its interval.
        width: (N,) of the interval.
        edges: (B + 1,) increasing.
    """
    bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(bins, minlength=len(edges) - 1)

    def mean(quantity: npt.NDArray[Any]) -> list[float | None]:
        sums = np.bincount(bins, weights=quantity, minlength=len(edges) - 1)
        return [float(total / n) if n else None for total, n in zip(sums, count, strict=True)]

    return RegimeBins(count.tolist(), mean(inside), mean(width))


# Fewest blocks in a flight; autocorrelations at longer lags than such a block are not used.
_FEWEST_BLOCKS = 5


def block_length(series: list[Array]) -> int:
    """Automatic block length for the circular block bootstrap of the mean over `series`.

    Politis and White (2004) with the correction of Patton, Politis and White (2009):
    b = (2 Ĝ² / D̂)^⅓ N^⅓ with Ĝ = Σ λ(k/M) |k| γ_k, D̂ = 4/3 (Σ λ(k/M) γ_k)² and the flat-top window λ.
    Their limits on M and b of order √N are widened to a fifth of the longest flight: at 400 Hz, √N samples
    of a half-minute flight are shorter than its correlation time.

    Args:
        series: one array of samples per flight.
    """
    size = sum(len(x) for x in series)
    longest = max(len(x) for x in series)
    covariance = autocovariance([x - x.mean() for x in series])
    limit = longest // _FEWEST_BLOCKS
    if covariance[0] <= 0.0 or limit < 1:
        return 1
    bandwidth = _bandwidth(covariance / covariance[0], size, limit)
    lags = np.arange(1, min(bandwidth, longest - 1) + 1)
    window = np.minimum(1.0, 2.0 * (1.0 - lags / bandwidth))
    weighted = window * covariance[lags]
    spectrum_at_zero = covariance[0] + 2.0 * weighted.sum()
    slope = 2.0 * (weighted * lags).sum()
    if spectrum_at_zero <= 0.0:
        return limit
    length = (1.5 * size * (slope / spectrum_at_zero) ** 2) ** (1.0 / 3.0)
    return int(np.clip(np.ceil(length), 1, limit))


def _bandwidth(correlation: Array, size: int, limit: int) -> int:
    """M: twice the lag after which a run of correlations is insignificant (Politis and White, Sec. 3.2)."""
    run = max(5, int(np.ceil(np.sqrt(np.log10(size)))))
    insignificant = np.abs(correlation[1 : limit + run + 1]) < 2.0 * np.sqrt(np.log10(size) / size)
    runs = np.flatnonzero(np.convolve(insignificant, np.ones(run), mode="valid") == run)
    return 2 * min(max(1, int(runs[0])), limit) if len(runs) else 2 * limit


def block_bootstrap_variance(series: list[Array], block: int) -> tuple[float, float]:
    """Variance of the mean over `series` under the circular block bootstrap within each flight.

    The bootstrap draws blocks of b consecutive samples, so that each block keeps the correlation of the
    flight. The variance of a mean over all possible resamples has a closed form: no resampling, no seed.
    With block means m over all starts, Var = Σ_g (n_g/N)² · var(m_g) · b_g/n_g, where b_g is `block` or a
    fifth of the flight, whichever is shorter.

    Returns:
        The variance and its equivalent degrees of freedom, 1.5 times the number of blocks less one
        (overlapping batch means, Meketon and Schmeiser 1984).
    """
    size = sum(len(x) for x in series)
    variance, blocks = 0.0, 0.0
    for x in series:
        length = max(1, min(block, len(x) // _FEWEST_BLOCKS))
        total = np.concatenate(([0.0], np.cumsum(np.concatenate((x, x[: length - 1])))))
        means = (total[length:] - total[:-length]) / length
        variance += len(x) / size**2 * length * float(np.var(means))
        blocks += len(x) / length
    return variance, max(1.0, 1.5 * blocks - 1.0)


def coverage_interval(
    inside: npt.ArrayLike,
    errors: npt.ArrayLike,
    groups: npt.ArrayLike | None = None,
    confidence: float = 0.95,
) -> tuple[float, float]:
    """Confidence interval of the coverage that autocorrelated samples show.

    The Clopper–Pearson interval at the effective sample size p (1 − p) / Var, with Var of the block
    bootstrap and Student's correction for its degrees of freedom (Korn and Graubard 1998). Unlike the
    bootstrap's percentiles it stays within 0…1 and keeps its coverage where few samples lie outside:
    5 % outliers of an AR(1) series, ρ = 0.98, N = 2000, are covered by percentiles 83 % of the time, by
    this interval 90 %, by the binomial interval 26 %.

    A coverage of exactly 0 or 1 leaves no variance to bootstrap. The effective sample size is then that
    of the prediction errors, which are at least as correlated as their indicator, so certainty is never
    claimed. Flights are taken as given: the interval holds for these flights, not for flights to come,
    which differ more than samples do.

    Args:
        inside: (N,) whether each measurement lay in its interval.
        errors: (N,) measured − predicted.
        groups: (N,) labels of the flights.
        confidence: of the interval returned, not of the prediction intervals.
    """
    series = split_by_group(inside, groups)
    size = sum(len(x) for x in series)
    coverage = float(np.mean(np.asarray(inside, dtype=float)))
    binomial = coverage * (1.0 - coverage) / size
    if binomial == 0.0:
        trials = effective_sample_size(errors, groups)
    else:
        variance, degrees = block_bootstrap_variance(series, block_length(series))
        tail = 0.5 + 0.5 * confidence
        student = ndtri(tail) / stdtrit(degrees, tail)
        trials = size * binomial / max(variance, binomial) * student**2
    return clopper_pearson(coverage, trials, confidence)


def coverage_interval_by_flight(
    inside: npt.NDArray[np.bool_], errors: Array, of: npt.NDArray[np.int64]
) -> tuple[float, float]:
    """95 % confidence interval of a coverage; arrays (N,), `of` the flight of each sample.

    Of several flights each is one cluster: the variance of the ratio of inside to all samples between them
    (Cochran 1977, ch. 9A), Student's t with one degree of freedom less than
    flights. It is never narrower than that of these flights alone, as flights may agree by chance.
    """
    low, high = coverage_interval(inside, errors, of)
    _, flight, sizes = np.unique(of, return_inverse=True, return_counts=True)
    flights = len(sizes)
    if flights > 1:
        apart = np.bincount(flight, inside) - np.mean(inside) * sizes
        deviation = np.sqrt(flights / (flights - 1) * np.sum(np.square(apart / len(of))))
        half = float(stdtrit(flights - 1, 0.975) * deviation)
        centre = float(np.mean(inside))
        low, high = max(min(low, centre - half), 0.0), min(max(high, centre + half), 1.0)
    return low, high


def clopper_pearson(proportion: float, trials: float, confidence: float) -> tuple[float, float]:
    """Exact binomial interval of a proportion seen in `trials`, which need not be whole."""
    successes = proportion * trials
    failures = trials - successes
    tail = 0.5 - 0.5 * confidence
    low = betaincinv(successes, failures + 1.0, tail) if successes > 0.0 else 0.0
    high = betaincinv(successes + 1.0, failures, 1.0 - tail) if failures > 0.0 else 1.0
    return float(low), float(high)


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
