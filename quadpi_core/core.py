# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The compiled core, functions of C++ on records, and what it computes for arrays.

In a checkout, a module that was built from other sources than are there is refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

_AGAIN = "run `make environment`, or install quadpi again"

try:
    import quadpi_core._core as compiled
except ImportError as error:
    raise ImportError(f"quadpi's compiled core cannot be used: {error}; {_AGAIN}") from error

__all__ = ["compiled"]

_SUFFIXES = (".hpp", ".cpp", ".txt")


def _sources_digest(folder: Path) -> str:
    """SHA-256 of the sources, as core/CMakeLists.txt makes it."""
    paths = [path for path in folder.rglob("*") if path.suffix in _SUFFIXES and path.is_file()]
    names = sorted((path.relative_to(folder).as_posix(), path) for path in paths)
    digests = "".join(sha256(path.read_bytes()).hexdigest() for _, path in names)
    return sha256(digests.encode()).hexdigest()


_sources = Path(__file__).resolve().parent.parent / "core"
if (_sources / "include" / "quadpi").is_dir() and _sources_digest(_sources) != compiled.SOURCES:
    raise ImportError(f"quadpi's compiled core is older than core/: {_AGAIN}")


Array: TypeAlias = NDArray[np.float64]


def sine(angles: ArrayLike) -> Array:
    """Sine of each of angles (...) rad."""
    return _of_each(compiled.sine, angles)


def cosine(angles: ArrayLike) -> Array:
    """Cosine of each of angles (...) rad."""
    return _of_each(compiled.cosine, angles)


def arctangent(y: ArrayLike, x: ArrayLike) -> Array:
    """Angles (...) rad, from -π to π, of points (x, y), both (...)."""
    return _of_each(compiled.arctangent, y, x)


def arcsine(sines: ArrayLike) -> Array:
    """Angles (...) rad, from -π/2 to π/2, of sines (...) from -1 to 1."""
    given = np.asarray(sines, float)
    return arctangent(given, np.sqrt((1.0 - given) * (1.0 + given)))


def exponential(exponents: ArrayLike) -> Array:
    """E to the power of each of (...)."""
    return _of_each(compiled.exponential, exponents)


def hyperbolic_tangent(arguments: ArrayLike) -> Array:
    """Hyperbolic tangent of each of (...)."""
    return _of_each(compiled.hyperbolic_tangent, arguments)


# The numpy function of the same values, for code that is to run without quadpi.
IN_NUMPY: Mapping[Callable[..., Array], str] = {
    sine: "np.sin",
    cosine: "np.cos",
    arctangent: "np.arctan2",
    arcsine: "np.arcsin",
    exponential: "np.exp",
    hyperbolic_tangent: "np.tanh",
}


def _of_each(function: Callable[..., None], *arguments: ArrayLike) -> Array:
    given = np.broadcast_arrays(*(np.asarray(one, float) for one in arguments))
    values = np.empty(given[0].shape)
    function(*map(np.ascontiguousarray, given), values)
    return values[()]


# Sweeps over all pairs, of which a 4 x 4 matrix takes five or six; and the share of a difference on the
# diagonal that turns no vector any more.
_SWEEPS = 12
_NOTHING = 1e-20


def matrix_times(matrix: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Product (M,) or (M, K) of a matrix (M, N) and a vector (N,) or another matrix (N, K)."""
    product = np.zeros((len(matrix), *other.shape[1:]))
    for column, row in zip(matrix.T, other, strict=True):
        product += np.multiply.outer(column, row)
    return product


def times_each(matrix: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Products (..., 3) of matrices (..., 3, 3) and vectors (..., 3)."""
    x, y, z = (matrix[..., k] * vector[..., k, None] for k in range(3))
    return x + y + z


def eigen(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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


def inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
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


def pseudo_inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
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
