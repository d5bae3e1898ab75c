# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""All axes of a polynomial model evaluated together, one sample after the other, in compiled code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.methods import Evaluation
from quadpi_core.models.polynomial import FittedPolynomial
from quadpi_core.models.regressors import BASE_ROWS, RegressorProgram, check_inputs, rows_kernel


@dataclass(frozen=True)
class CompiledPolynomials:
    """The fitted axes packed for :func:`evaluate_kernel`: one program, tables padded to the longest."""

    program: RegressorProgram
    terms: npt.NDArray[np.int64]
    term_count: npt.NDArray[np.int64]
    coefficients: Array
    whitening: Array
    inflation: Array
    growth: Array
    rms_spread: Array
    polynomials: Mapping[str, FittedPolynomial]

    @classmethod
    def pack(cls, polynomials: Mapping[str, FittedPolynomial]) -> CompiledPolynomials:
        """Pack the axes held; common products of all axes are computed once."""
        longest = max(len(p.regressors) for p in polynomials.values())
        program = RegressorProgram.compile(r for p in polynomials.values() for r in p.regressors)
        terms = np.zeros((len(AXES), longest), dtype=np.int64)
        count = np.zeros(len(AXES), dtype=np.int64)
        coefficients = np.zeros((len(AXES), longest))
        whitening = np.zeros((len(AXES), longest, longest))
        inflation, growth, rms_spread = np.zeros(len(AXES)), np.zeros(len(AXES)), np.ones(len(AXES))
        start = 0
        for axis, polynomial in polynomials.items():
            k, size = AXES.index(axis), len(polynomial.regressors)
            terms[k, :size] = program.outputs[start : start + size]
            start += size
            count[k] = size
            coefficients[k, :size] = polynomial.coefficients
            whitening[k, :size, :size] = polynomial.whitening
            inflation[k] = polynomial.shape.inflation
            growth[k] = polynomial.shape.growth
            rms_spread[k] = polynomial.rms_spread
        return cls(program, terms, count, coefficients, whitening, inflation, growth, rms_spread, polynomials)

    def evaluate(self, inputs: Array, factors: Array) -> Evaluation:
        """Evaluate input vectors (N, 19) with half widths from :func:`.methods.interval_factors`."""
        check_inputs(inputs)
        out = np.empty((5, len(inputs), len(AXES)))
        program = self.program
        evaluate_kernel(
            inputs,
            program.first,
            program.second,
            program.weights,
            self.terms,
            self.term_count,
            self.coefficients,
            self.whitening,
            self.inflation,
            self.growth,
            self.rms_spread,
            factors,
            out,
        )
        return Evaluation(out[0], out[1], out[2], out[3], out[4])


@njit(cache=True)
def evaluate_kernel(
    inputs: Any,
    first: Any,
    second: Any,
    weights: Any,
    terms: Any,
    term_count: Any,
    coefficients: Any,
    whitening: Any,
    inflation: Any,
    growth: Any,
    rms_spread: Any,
    factors: Any,
    out: Any,
) -> None:
    """Fill `out` (5, N, 6) with predicted, lower, upper, leverage and relative width."""
    rows = np.empty((BASE_ROWS + first.shape[0], 1))
    for i in range(inputs.shape[0]):
        rows_kernel(inputs[i : i + 1], first, second, weights, rows)
        # u, v and w come first.
        speed_squared = inputs[i, 0] ** 2 + inputs[i, 1] ** 2 + inputs[i, 2] ** 2
        for axis in range(terms.shape[0]):
            size = term_count[axis]
            predicted = 0.0
            leverage = 0.0
            for a in range(size):
                predicted += coefficients[axis, a] * rows[terms[axis, a], 0]
                whitened = 0.0
                for b in range(a + 1):
                    whitened += whitening[axis, a, b] * rows[terms[axis, b], 0]
                leverage += whitened * whitened
            spread = np.sqrt(1.0 + inflation[axis] * leverage + growth[axis] * speed_squared)
            out[0, i, axis] = predicted
            out[1, i, axis] = predicted - factors[axis] * spread
            out[2, i, axis] = predicted + factors[axis] * spread
            out[3, i, axis] = leverage
            out[4, i, axis] = spread / rms_spread[axis] if size > 0 else 0.0
