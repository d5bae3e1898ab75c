# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""All axes of a polynomial model evaluated together, one sample after the other, in compiled code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.methods import Evaluation
from quadpi_core.models.polynomial import FittedPolynomial
from quadpi_core.models.regressors import (
    BASE_ROWS,
    Records,
    RegressorProgram,
    check_inputs,
    rows_kernel,
)

# One axis: number of terms, 0 where it is not held; κ and γ of its spread; root mean square of that.
_AXIS = np.dtype(
    [("size", np.int64), ("inflation", np.float64), ("growth", np.float64), ("rms_spread", np.float64)],
    align=True,
)
# One term: row of the program, and coefficient.
_TERM = np.dtype([("row", np.int64), ("coefficient", np.float64)], align=True)


@dataclass(frozen=True)
class CompiledPolynomials:
    """The fitted axes packed for :func:`evaluate_kernel`: one program, tables padded to the longest.

    Attributes:
        program: of the regressors of all axes; common products are computed once.
        axes: (6,) size, inflation, growth and rms_spread.
        terms: (6, s) row and coefficient.
        whitening: (6, s, s) lower triangular, with leverage h = |W z|².
    """

    program: RegressorProgram
    axes: Records
    terms: Records
    whitening: Array

    @classmethod
    def pack(cls, polynomials: Mapping[str, FittedPolynomial]) -> CompiledPolynomials:
        """Pack the axes held."""
        longest = max(len(p.regressors) for p in polynomials.values())
        program = RegressorProgram.compile(r for p in polynomials.values() for r in p.regressors)
        axes = np.zeros(len(AXES), dtype=_AXIS)
        terms = np.zeros((len(AXES), longest), dtype=_TERM)
        whitening = np.zeros((len(AXES), longest, longest))
        start = 0
        for axis, polynomial in polynomials.items():
            k, size = AXES.index(axis), len(polynomial.regressors)
            shape = polynomial.shape
            axes[k] = size, shape.inflation, shape.growth, polynomial.rms_spread
            terms["row"][k, :size] = program.outputs[start : start + size]
            terms["coefficient"][k, :size] = polynomial.coefficients
            whitening[k, :size, :size] = polynomial.whitening
            start += size
        return cls(program, axes, terms, whitening)

    def evaluate(self, inputs: Array, factors: Array) -> Evaluation:
        """Evaluate input vectors (N, 19) with half widths from :func:`.methods.interval_factors`."""
        check_inputs(inputs)
        out = np.zeros((5, len(inputs), len(AXES)))
        evaluate_kernel(inputs, self.program.operations, self.axes, self.terms, self.whitening, factors, out)
        # Faster one by one than by *out.
        return Evaluation(out[0], out[1], out[2], out[3], out[4])


@njit(cache=True)
def evaluate_kernel(
    inputs: Array,
    operations: Records,
    axes: Records,
    terms: Records,
    whitening: Array,
    factors: Array,
    out: Array,
) -> None:
    """Fill predicted, lower, upper, leverage and relative width of `out` (5, N, 6) for the axes held."""
    rows = np.empty((BASE_ROWS + operations.shape[0], 1))
    for i in range(inputs.shape[0]):
        rows_kernel(inputs[i : i + 1], operations, rows)
        # u, v and w come first.
        speed_squared = inputs[i, 0] ** 2 + inputs[i, 1] ** 2 + inputs[i, 2] ** 2
        for axis in range(axes.shape[0]):
            fitted = axes[axis]
            if fitted.size == 0:
                continue
            predicted = 0.0
            leverage = 0.0
            for a in range(fitted.size):
                predicted += terms[axis, a].coefficient * rows[terms[axis, a].row, 0]
                whitened = 0.0
                for b in range(a + 1):
                    whitened += whitening[axis, a, b] * rows[terms[axis, b].row, 0]
                leverage += whitened * whitened
            spread = np.sqrt(1.0 + fitted.inflation * leverage + fitted.growth * speed_squared)
            out[0, i, axis] = predicted
            out[1, i, axis] = predicted - factors[axis] * spread
            out[2, i, axis] = predicted + factors[axis] * spread
            out[3, i, axis] = leverage
            out[4, i, axis] = spread / fitted.rms_spread
