# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Small linear algebra that gives the same bits on every machine, which BLAS and LAPACK do not."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.frames import Array

Vector: TypeAlias = tuple[float, float, float]


@njit(cache=True, nogil=True)
def matrix_times(matrix: Array, vector: Array) -> Array:
    """Product (M,) of a matrix (M, N) and a vector (N,)."""
    product = np.zeros(matrix.shape[0])
    for row in range(matrix.shape[0]):
        for column in range(matrix.shape[1]):
            product[row] += matrix[row, column] * vector[column]
    return product


@njit(cache=True, nogil=True)
def product3(matrix: Array, vector: Array | Vector) -> Vector:
    """Product of a matrix (3, 3) and a vector (3,), without an array of its own."""
    x, y, z = vector[0], vector[1], vector[2]
    return (
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z,
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z,
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z,
    )


@njit(cache=True, nogil=True)
def cross(left: Array | Vector, right: Array | Vector) -> Vector:
    """Vector product of two vectors (3,)."""
    return (
        left[1] * right[2] - left[2] * right[1],
        left[2] * right[0] - left[0] * right[2],
        left[0] * right[1] - left[1] * right[0],
    )


@njit(cache=True, error_model="numpy")
def inverse(matrix: Array) -> Array:
    """Inverse of a matrix (N, N), by Gauss and Jordan with the largest pivot of each column.

    Of a singular matrix it is not finite.
    """
    size = matrix.shape[0]
    left, right = matrix.copy(), np.eye(size)
    for column in range(size):
        pivot = column
        for row in range(column + 1, size):
            if abs(left[row, column]) > abs(left[pivot, column]):
                pivot = row
        for other in range(size):
            left[column, other], left[pivot, other] = left[pivot, other], left[column, other]
            right[column, other], right[pivot, other] = right[pivot, other], right[column, other]
        # Element by element: arithmetic on whole rows takes numba four times as long to compile.
        scale = left[column, column]
        for other in range(size):
            left[column, other] /= scale
            right[column, other] /= scale
        for row in range(size):
            if row != column:
                factor = left[row, column]
                for other in range(size):
                    left[row, other] -= factor * left[column, other]
                    right[row, other] -= factor * right[column, other]
    return right
