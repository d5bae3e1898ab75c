# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Least squares with bounded influence: wild samples move coefficients no more than ordinary ones do."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from quadpi_core.frames import Array

# Residuals up to so many deviations count in full (Huber's k). Of normal ones two in a thousand million are
# beyond, so that nothing is lost where there is nothing wild: the efficiency is 1 to eight digits.
TUNING = 6.0
# From the median of absolute residuals to a standard deviation, of normal ones.
_MAD = 1.4826
# Until predictions change by less than this share of the deviation.
_CHANGE, _ITERATIONS = 1e-3, 30


def huber(Z: Array, y: Array, coefficients: Array, whitening: Array) -> tuple[Array, Array]:
    """Coefficients (s,) and whitening (s, s) by iteratively reweighted least squares (Huber, 1964).

    Weights are 1 within TUNING deviations and fall as one over the residual beyond.

    Args:
        Z: regressors (N, s).
        y: target (N,).
        coefficients: (s,), by least squares; given back where no residual is beyond.
        whitening: see :func:`quadpi_core.models.selection.fit_coefficients`.

    Raises:
        numpy.linalg.LinAlgError: if the regressors are linearly dependent but for wild samples.
    """
    residual = y - Z @ coefficients
    for _ in range(_ITERATIONS):
        size = np.abs(residual)
        bound = TUNING * _MAD * float(np.median(size))
        if bound == 0.0 or not np.any(size > bound):
            break
        weighted = Z * np.minimum(1.0, bound / np.maximum(size, bound))[:, np.newaxis]
        matrix = weighted.T @ Z
        scale = 1.0 / np.sqrt(np.diag(matrix))
        factor = np.linalg.cholesky(matrix * np.outer(scale, scale))
        whitening = solve_triangular(factor, np.diag(scale), lower=True)
        coefficients = whitening.T @ (whitening @ (weighted.T @ y))
        before, residual = residual, y - Z @ coefficients
        if np.max(np.abs(residual - before)) < _CHANGE * bound / TUNING:
            break
    return coefficients, whitening
