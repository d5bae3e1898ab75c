# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Small linear algebra that gives the same bits on every machine, which BLAS and LAPACK do not."""

from __future__ import annotations

import numpy as np

from quadpi_core.frames import Array


def matrix_times(matrix: Array, vector: Array) -> Array:
    """Product (M,) of a matrix (M, N) and a vector (N,)."""
    product = np.zeros(len(matrix))
    for column, value in zip(matrix.T, vector, strict=True):
        product += column * value
    return product


def inverse(matrix: Array) -> Array:
    """Inverse of a matrix (N, N), by Gauss and Jordan with the largest pivot of each column.

    Of a singular matrix it is not finite.
    """
    size = len(matrix)
    both = np.concatenate((matrix, np.eye(size)), axis=1)
    with np.errstate(all="ignore"):
        for column in range(size):
            pivot = column + int(np.argmax(np.abs(both[column:, column])))
            both[[column, pivot]] = both[[pivot, column]]
            both[column] /= both[column, column]
            others = np.arange(size) != column
            both[others] -= both[others, column, None] * both[column]
    return np.ascontiguousarray(both[:, size:])
