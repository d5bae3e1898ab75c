# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Least squares on Gram matrices, accumulated per flight in one pass without an N × p matrix, and Huber's."""

from __future__ import annotations

import operator
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.errors import ModelError, one_line
from quadpi_core.frames import Array
from quadpi_core.models.regressors import BASE_ROWS, RegressorProgram

# Samples that a thread takes at a time; fixed, so that sums do not depend on the number of cores.
_PIECE = 10_000
# Numbers of 8 bytes in a cache line.
_CACHE_LINE = 8


@dataclass(frozen=True)
class Gram:
    """Sums over samples of regressors z (p,) and target y: all that least squares needs to know.

    The first regressor is the constant 1, so `moment[0]` is the sum of y.

    Attributes:
        matrix: (p, p) Σ z zᵀ.
        moment: (p,) Σ z y.
        square: Σ y².
        count: number of samples.
    """

    matrix: Array
    moment: Array
    square: float
    count: int

    def __add__(self, other: Gram) -> Gram:
        return Gram(*map(operator.add, vars(self).values(), vars(other).values()))

    def __sub__(self, other: Gram) -> Gram:
        return Gram(*map(operator.sub, vars(self).values(), vars(other).values()))

    @property
    def total_square(self) -> float:
        """Σ (y − ȳ)²."""
        return float(self.square - self.moment[0] ** 2 / self.count)

    def residual_square(self, active: list[int], coefficients: Array) -> float:
        """Σ (y − z_active · coefficients)², of any coefficients, also such fitted elsewhere."""
        explained = 2.0 * self.moment[active] - self.matrix[np.ix_(active, active)] @ coefficients
        return max(float(self.square - coefficients @ explained), 0.0)


def sum_grams(grams: Sequence[Gram]) -> Gram:
    """The Gram of all flights together."""
    return reduce(operator.add, grams)


@contextmanager
def identifiable(what: str) -> Iterator[None]:
    """Say what flights cannot tell where equations of a fit turn out to be singular.

    Raises:
        ModelError: in the place of numpy's error.
    """
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise ModelError(
            f"{what} cannot be identified from these flights, as the equations have no solution "
            f"({one_line(error)}): `quadpi info` tells of flights whose sensors disagree; else fly "
            "manoeuvres about every axis"
        ) from error


def fit_coefficients(gram: Gram, active: list[int]) -> tuple[Array, Array]:
    """Least squares on the active regressors by a Cholesky factor of the scaled Gram matrix.

    Returns:
        Coefficients (s,) and the whitening matrix W (s, s), lower triangular, with Wᵀ W = (ZᵀZ)⁻¹, so that
        the leverage of a regressor row z is |W z|².

    Raises:
        numpy.linalg.LinAlgError: if a regressor is zero on all samples, or they are linearly dependent.
    """
    from scipy.linalg import solve_triangular

    matrix = gram.matrix[np.ix_(active, active)]
    squares = np.diag(matrix)
    if not np.all(squares > 0.0):
        raise np.linalg.LinAlgError("a regressor is zero on all samples")
    scale = 1.0 / np.sqrt(squares)
    factor = np.linalg.cholesky(matrix * np.outer(scale, scale))
    whitening = solve_triangular(factor, np.diag(scale), lower=True)
    return whitening.T @ (whitening @ gram.moment[active]), whitening


def flight_grams(
    program: RegressorProgram, inputs: Array, target: Array, groups: npt.NDArray[np.int64]
) -> list[Gram]:
    """One Gram per flight, the work shared among the processor's cores.

    Args:
        program: its outputs are the regressors, the constant first.
        inputs: (N, 19).
        target: (N,).
        groups: (N,) flight number of each sample, 0 to F − 1.
    """
    pieces = []
    for flight in range(int(groups.max()) + 1):
        samples = np.flatnonzero(groups == flight)
        pieces += [(flight, samples[start : start + _PIECE]) for start in range(0, len(samples), _PIECE)]

    def gram_of(piece: tuple[int, npt.NDArray[np.intp]]) -> Gram:
        return _accumulate(program, inputs[piece[1]], target[piece[1]])

    totals: dict[int, Gram] = {}
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        for (flight, _), gram in zip(pieces, threads.map(gram_of, pieces), strict=True):
            totals[flight] = totals[flight] + gram if flight in totals else gram
    return list(totals.values())


def _accumulate(program: RegressorProgram, inputs: Array, target: Array) -> Gram:
    """The Gram of some samples: the target goes along as one more regressor."""
    target_row = BASE_ROWS + len(program.operations)
    factors = np.append(program.outputs, target_row)
    size = len(factors)
    factors = np.pad(factors, (0, -size % compiled.TILE_ROWS), mode="edge")
    sums = np.zeros((len(factors), len(factors)))
    rows = _aligned_zeros(target_row + 1, compiled.GRAM_BLOCK)
    compiled.add_to_gram(
        np.ascontiguousarray(inputs), np.ascontiguousarray(target), program.operations, factors, rows, sums
    )
    lower = np.tril(sums[:size, :size])
    sums = lower + np.tril(lower, -1).T
    return Gram(sums[:-1, :-1], sums[:-1, -1], float(sums[-1, -1]), len(target))


def _aligned_zeros(rows: int, columns: int) -> Array:
    """Zeros (rows, columns) from the start of a cache line: vectors across two of them load at half speed."""
    buffer = np.zeros(rows * columns + _CACHE_LINE)
    skip = -(buffer.ctypes.data // buffer.itemsize) % _CACHE_LINE
    return buffer[skip : skip + rows * columns].reshape(rows, columns)


# Huber's k: residuals up to this many standard deviations have weight 1. Two in 1e9 normal residuals lie
# beyond, so without outliers the efficiency is 1 to eight digits.
TUNING = 6.0
# Standard deviation over median absolute residual, of a normal distribution.
_MAD = 1.4826
# Iterations end when predictions change by less than this share of the standard deviation.
_CHANGE, _ITERATIONS = 1e-3, 30


def huber(Z: Array, y: Array, coefficients: Array, whitening: Array) -> tuple[Array, Array]:
    """Coefficients (s,) and whitening (s, s) by iteratively reweighted least squares (Huber, 1964).

    Weights are 1 within TUNING deviations and fall as one over the residual beyond.

    Args:
        Z: regressors (N, s).
        y: target (N,).
        coefficients: (s,), by least squares; given back where no residual is beyond.
        whitening: see :func:`fit_coefficients`.

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
