# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Least squares with bounded influence: wild samples move coefficients no more than ordinary ones do."""

from __future__ import annotations

import numpy as np

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.gram import Gram
from quadpi_core.models.selection import fit_coefficients

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
        ModelError: if the regressors are linearly dependent but for wild samples.
    """
    residual = y - Z @ coefficients
    for _ in range(_ITERATIONS):
        size = np.abs(residual)
        bound = TUNING * _MAD * float(np.median(size))
        if bound == 0.0 or not np.any(size > bound):
            break
        weights = bound / np.maximum(size, bound)
        weighted = Z * weights[:, np.newaxis]
        gram = Gram(weighted.T @ Z, weighted.T @ y, float((weights * y) @ y), len(y))
        try:
            coefficients, whitening = fit_coefficients(gram, list(range(Z.shape[1])))
        except np.linalg.LinAlgError as error:
            raise ModelError(
                f"the terms of the model differ in wild samples alone, with residuals up to {size.max():.3g}"
            ) from error
        before, residual = residual, y - Z @ coefficients
        if np.max(np.abs(residual - before)) < _CHANGE * bound / TUNING:
            break
    return coefficients, whitening
