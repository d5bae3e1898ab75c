# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Small linear algebra, beside numpy's."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.core import eigen, inverse, matrix_times, times_each

RANDOM = np.random.default_rng(0)


@pytest.mark.parametrize("size", [1, 3, 6])
def test_inverse_is_that_of_numpy(size):
    for _ in range(20):
        matrix = RANDOM.normal(size=(size, size))
        np.testing.assert_allclose(inverse(matrix), np.linalg.inv(matrix), rtol=1e-8, atol=1e-10)


def test_inverse_takes_the_largest_pivot_of_a_column():
    """Without rows exchanged a zero divides; with a tiny one in its place, digits are lost."""
    np.testing.assert_array_equal(inverse(np.array([[0.0, 2.0], [4.0, 0.0]])), [[0.0, 0.25], [0.5, 0.0]])
    matrix = np.array([[1e-20, 1.0], [1.0, 1.0]])
    np.testing.assert_allclose(inverse(matrix), [[-1.0, 1.0], [1.0, 0.0]], atol=1e-15)


def test_a_singular_matrix_has_no_finite_inverse():
    assert not np.isfinite(inverse(np.array([[1.0, 2.0], [2.0, 4.0]]))).all()


def test_a_matrix_times_a_vector():
    matrix, vector = RANDOM.normal(size=(4, 6)), RANDOM.normal(size=6)
    np.testing.assert_allclose(matrix_times(matrix, vector), matrix @ vector, rtol=1e-12)
    other = RANDOM.normal(size=(6, 3))
    np.testing.assert_allclose(matrix_times(matrix, other), matrix @ other, rtol=1e-12)


def test_matrices_times_vectors_of_their_own():
    matrices, vectors = RANDOM.normal(size=(5, 3, 3)), RANDOM.normal(size=(5, 3))
    np.testing.assert_allclose(
        times_each(matrices, vectors), [m @ v for m, v in zip(matrices, vectors, strict=True)], rtol=1e-12
    )


@pytest.mark.parametrize("spread", [0.0, 1e-12, 1.0, 1e12])
def test_eigenvectors_are_those_of_numpy(spread):
    """Of equal eigenvalues, of nearly equal ones and of such of very different size."""
    for _ in range(20):
        basis = np.linalg.qr(RANDOM.normal(size=(4, 4)))[0]
        matrix = basis @ np.diag([1.0, 1.0, 1.0 + spread, 2.0 + spread]) @ basis.T
        matrix = 0.5 * (matrix + matrix.T)
        values, vectors = eigen(matrix)
        np.testing.assert_allclose(
            values, np.linalg.eigvalsh(matrix)[::-1], rtol=1e-14, atol=1e-14 * values[0]
        )
        np.testing.assert_allclose(vectors @ vectors.T, np.eye(4), atol=1e-14)
        np.testing.assert_allclose(matrix @ vectors.T, vectors.T * values, atol=1e-14 * values[0])
