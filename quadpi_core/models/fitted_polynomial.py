# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fitted polynomials, and the compiled evaluation of all axes of them, one sample after the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.config_schema import NotNegative, Text, Within, parse_config
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import Rule, StoredRule
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.models.regressors import (
    BASE_ROWS,
    Records,
    Regressor,
    RegressorProgram,
    rows_kernel,
)
from quadpi_core.models.spread import SpreadShape, leverage_of, squared_speed

# One axis: number of terms, 0 where it is not held; κ and γ of its spread; root mean square of that.
_AXIS = np.dtype(
    [("size", np.int64), ("inflation", np.float64), ("growth", np.float64), ("rms_spread", np.float64)],
    align=True,
)
# One term: row of the program, and coefficient.
_TERM = np.dtype([("row", np.int64), ("coefficient", np.float64)], align=True)


@dataclass(frozen=True)
class FittedPolynomial:
    """ŷ = Z(x) β with the regressors in order of selection, and what its intervals need.

    Attributes:
        regressors: s terms, the bias first, the fixed ones before the selected.
        coefficients: (s,), SI units.
        whitening: (s, s) lower triangular W with leverage h = |W z|².
        shape: of the spread over the inputs.
        rule: gives the interval's factor on the spread.
        rms_spread: root mean square of the spread over the training samples, the unit of relative width.
    """

    method: ClassVar[str] = "polynomial"
    regressors: tuple[Regressor, ...]
    coefficients: Array
    whitening: Array
    shape: SpreadShape
    rule: Rule
    rms_spread: float

    @cached_property
    def program(self) -> RegressorProgram:
        """Evaluates the regressors."""
        return RegressorProgram.compile(self.regressors)

    def leverage(self, inputs: Array) -> Array:
        """Leverage h (N,) of input vectors (N, 19)."""
        return leverage_of(self.program.evaluate(inputs), self.whitening)

    def spread(self, inputs: Array) -> Array:
        """Spread (N,) at input vectors (N, 19)."""
        return self.shape.of(self.leverage(inputs), squared_speed(inputs))

    def arrays(self) -> dict[str, Array]:
        """What a stored model keeps as arrays, by name."""
        return {"coefficients": self.coefficients, "whitening": np.ascontiguousarray(self.whitening)}

    def to_json(self) -> dict[str, Any]:
        """What a stored model keeps beside the arrays."""
        return {
            "regressors": self.terms,
            "inflation": self.shape.inflation,
            "growth": self.shape.growth,
            "rule": self.rule.to_json(),
            "rms_spread": self.rms_spread,
        }

    @classmethod
    def stored(cls, data: dict[str, Any], arrays: dict[str, Array]) -> FittedPolynomial:
        """Read what `to_json` and `arrays` gave.

        Raises:
            ModelError: for numbers that no fit gives.
        """
        entry = parse_config(_Entry, data, cls.method, ModelError)
        regressors = tuple(Regressor.parse(text) for text in entry.regressors)
        coefficients, whitening, size = arrays["coefficients"], arrays["whitening"], len(regressors)
        if coefficients.shape != (size,) or whitening.shape != (size, size):
            raise ModelError(f"shapes do not fit the {size} regressors")
        shape = SpreadShape(entry.inflation, entry.growth)
        return cls(regressors, coefficients, whitening, shape, entry.rule, entry.rms_spread)

    @property
    def terms(self) -> list[str]:
        """What the prediction is made of, in words."""
        return [str(regressor) for regressor in self.regressors]


@dataclass(frozen=True)
class _Entry:
    """What a stored model keeps beside the arrays."""

    regressors: tuple[Text, ...]
    inflation: NotNegative
    growth: NotNegative
    rule: StoredRule
    rms_spread: Annotated[float, Within(1.0)]


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
        """Evaluate input vectors (N, 19) with half widths from :func:`.model_kind.interval_factors`."""
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
