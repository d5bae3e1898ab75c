# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of predictions and of prediction intervals, as pure functions on arrays of shape (N,).

`measured` y, `predicted` ŷ and the bounds `lower` L and `upper` U share one unit; so do MPIW, RMSE and the
Winkler score.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array


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
