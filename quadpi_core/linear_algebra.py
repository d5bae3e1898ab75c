# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Small linear algebra that gives the same bits on every machine, which BLAS and LAPACK do not."""

from __future__ import annotations

import math

import numpy as np

from quadpi_core.frames import Array

# Sweeps over all pairs, of which a 4 x 4 matrix takes five or six; and the share of a difference on the
# diagonal that turns no vector any more.
_SWEEPS = 12
_NOTHING = 1e-20


def matrix_times(matrix: Array, other: Array) -> Array:
    """Product (M,) or (M, K) of a matrix (M, N) and a vector (N,) or another matrix (N, K)."""
    product = np.zeros((len(matrix), *other.shape[1:]))
    for column, row in zip(matrix.T, other, strict=True):
        product += np.multiply.outer(column, row)
    return product


def times_each(matrix: Array, vector: Array) -> Array:
    """Products (..., 3) of matrices (..., 3, 3) and vectors (..., 3)."""
    x, y, z = (matrix[..., k] * vector[..., k, None] for k in range(3))
    product: Array = x + y + z
    return product


def eigen(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues (N,) of a symmetric matrix (N, N), the largest first, and eigenvectors (N, N), as rows.

    By Jacobi's rotations (Golub and Van Loan, Matrix Computations, section 8.5).
    """
    values, vectors = matrix.copy(), np.eye(len(matrix))
    for _ in range(_SWEEPS):
        for p, q in zip(*np.triu_indices(len(matrix), 1), strict=True):
            off = float(values[p, q])
            if abs(off) <= _NOTHING * abs(float(values[p, p] - values[q, q])):
                continue
            slope = float(values[q, q] - values[p, p]) / (2.0 * off)
            tangent = math.copysign(1.0, slope) / (abs(slope) + math.sqrt(slope * slope + 1.0))
            cosine = 1.0 / math.sqrt(tangent * tangent + 1.0)
            for rows in (values, values.T, vectors):
                first, second = cosine * rows[p], cosine * rows[q]
                rows[p], rows[q] = first - tangent * second, second + tangent * first
            values[p, q] = values[q, p] = 0.0
    order = np.argsort(-np.diag(values))
    return np.diag(values)[order], vectors[order]


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


def pseudo_inverse(matrix: Array) -> Array:
    """The least of all X (N, M) with M X = 1 for a matrix (M, N) of full rank; not finite for another one.

    Rows are scaled to their largest entry, as they may have different units.
    """
    if matrix.shape[0] == matrix.shape[1]:
        return inverse(matrix)
    scale = np.abs(matrix).max(axis=1)
    with np.errstate(all="ignore"):
        rows = matrix / scale[:, np.newaxis]
    gram = np.stack([matrix_times(rows, row) for row in rows], axis=1)
    across = inverse(gram)
    inverted = np.stack([matrix_times(rows.T, column) for column in across.T], axis=1) / scale
    return np.ascontiguousarray(inverted)
