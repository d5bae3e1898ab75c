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
from scipy.stats import norm

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
    """Standard deviation (N,) of the normal distribution whose central interval [L, U] is."""
    std: Array = 0.5 * (upper - lower) / norm.ppf(0.5 + 0.5 * confidence)
    return std


def crps_normal(measured: Array, mean: Array, std: Array) -> float:
    """Mean continuous ranked probability score of normal predictions, in the unit of y; lower is better.

    σ (z (2 Φ(z) − 1) + 2 φ(z) − 1/√π) with z = (y − mean)/σ (Gneiting and Raftery 2007, Eq. 21), which is
    |y − mean| in the limit of no spread.
    """
    error = measured - mean
    z = np.divide(error, std, out=np.zeros_like(error), where=std > 0.0)
    score = error * (2.0 * norm.cdf(z) - 1.0) + std * (2.0 * norm.pdf(z) - 1.0 / np.sqrt(np.pi))
    return float(np.mean(np.where(std > 0.0, score, np.abs(error))))


MOST_BINS = 8


@dataclass(frozen=True)
class RegimeBins:
    """Samples, coverage and mean width (N or Nm) in each bin; the last two are None where a bin is empty."""

    n: list[int]
    picp: list[float | None]
    mpiw: list[float | None]


def round_edges(values: Array, most: int = MOST_BINS) -> Array:
    """Edges of at most so many equal bins over the values, each 1, 2 or 5 times a power of ten wide."""
    lowest, highest = float(values.min()), float(values.max())
    extent = highest - lowest
    if extent < 1e-6 * max(abs(lowest), abs(highest), 1.0):
        # A constant: what rounding left of it is no range.
        extent = 1.0
    scale = 10.0 ** np.floor(np.log10(extent / most))
    for step in scale * np.array([1.0, 2.0, 5.0, 10.0, 20.0]):
        first, last = np.floor(lowest / step), np.floor(highest / step) + 1.0
        if last - first <= most:
            break
    # Rounded to what the step resolves: 0.3, not 0.30000000000000004.
    digits = max(0, 1 - int(np.floor(np.log10(step))))
    edges: Array = np.round(np.arange(first, last + 1.0) * step, digits)
    return edges


def by_bin(values: Array, inside: npt.NDArray[np.bool_], width: Array, edges: Array) -> RegimeBins:
    """Samples, coverage and mean width in each bin [edge, next edge).

    Args:
        values: (N,) that the bins are of, all within the edges.
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
