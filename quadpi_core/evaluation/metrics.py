# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of predictions and of prediction intervals, as pure functions on arrays of shape (N,).

`measured` y, `predicted` ŷ and the bounds `lower` L and `upper` U share one unit; so do MPIW, RMSE and the
Winkler score.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.stats import norm

from quadpi_core.frames import Array

# How steeply CWC punishes coverage below the nominal one; the value of Khosravi et al. (2011).
CWC_ETA = 50.0


def inside_interval(measured: Array, lower: Array, upper: Array) -> npt.NDArray[np.bool_]:
    """Indicator c (N,): whether y lies in the closed interval [L, U] (van Beers and de Visser, Eq. PICP)."""
    return (lower <= measured) & (measured <= upper)


def picp(measured: Array, lower: Array, upper: Array) -> float:
    """Prediction interval coverage probability, a fraction: mean of c (van Beers and de Visser, Eq. PICP)."""
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
