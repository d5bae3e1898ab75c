# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Gram matrices of regressors and target, per flight, in one pass and without an N × p matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array
from quadpi_core.models.regressors import BASE_ROWS, RegressorProgram, rows_kernel

# Samples per block: large enough for the matrix product, small enough to stay in the cache.
_BLOCK = 2048


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
        return Gram(
            self.matrix + other.matrix,
            self.moment + other.moment,
            self.square + other.square,
            self.count + other.count,
        )

    def __sub__(self, other: Gram) -> Gram:
        return Gram(
            self.matrix - other.matrix,
            self.moment - other.moment,
            self.square - other.square,
            self.count - other.count,
        )

    @property
    def total_square(self) -> float:
        """Σ (y − ȳ)²."""
        return float(self.square - self.moment[0] ** 2 / self.count)

    def residual_square(self, active: list[int], coefficients: Array) -> float:
        """Σ (y − z_active · coefficients)², of any coefficients, also such fitted elsewhere."""
        explained = 2.0 * self.moment[active] - self.matrix[np.ix_(active, active)] @ coefficients
        return max(float(self.square - coefficients @ explained), 0.0)


def flight_grams(
    program: RegressorProgram, inputs: Array, target: Array, groups: npt.NDArray[np.int64]
) -> list[Gram]:
    """One Gram per flight.

    Args:
        program: its outputs are the regressors, the constant first.
        inputs: (N, 19).
        target: (N,).
        groups: (N,) flight number of each sample, 0 to F − 1.
    """
    return [
        _accumulate(program, inputs[groups == group], target[groups == group])
        for group in range(int(groups.max()) + 1)
    ]


def _accumulate(program: RegressorProgram, inputs: Array, target: Array) -> Gram:
    size = len(program.outputs)
    matrix = np.zeros((size, size))
    moment = np.zeros(size)
    rows = np.empty((BASE_ROWS + len(program.first), _BLOCK))
    for start in range(0, len(inputs), _BLOCK):
        block = np.ascontiguousarray(inputs[start : start + _BLOCK])
        rows_kernel(block, program.first, program.second, program.weights, rows)
        regressors = rows[program.outputs, : len(block)]
        matrix += regressors @ regressors.T
        moment += regressors @ target[start : start + _BLOCK]
    return Gram(matrix, moment, float(target @ target), len(target))
