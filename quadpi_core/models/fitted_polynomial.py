# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fitted polynomials, and the compiled evaluation of all axes of them, one sample after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.config_schema import NotNegative, Text, Within, parse_config
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import VELOCITY_INPUTS
from quadpi_core.models.interval_rules import FlightErrors, Rule, StoredRule, flights_peak
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.models.regressors import (
    BASE_ROWS,
    Regressor,
    RegressorProgram,
    rows_kernel,
)
from quadpi_core.records import Records

# Least and most that the variance due to airspeed can be on average, relative to that of a hover.
_LEAST_GROWTH, _MOST_GROWTH = 1e-6, 1e2
# Mean squared airspeed, m²/s², below which flights do not determine the growth with airspeed.
_HOVER = 0.01


@dataclass(frozen=True)
class SpreadShape:
    """Spread √(1 + κ h + γ V²) of leverage h and airspeed V: how errors on new flights grow.

    They grow with leverage, where the training samples constrain the coefficients poorly, and with airspeed,
    as the terms that the polynomial lacks do, however many samples there were.

    Attributes:
        inflation: κ.
        growth: γ, s²/m².
    """

    inflation: float
    growth: float

    def of(self, leverage: Array, speed_squared: Array) -> Array:
        """Spread (N,) at leverages (N,) and squared airspeeds (N,) in m²/s²."""
        spread: Array = np.sqrt(1.0 + self.inflation * leverage + self.growth * speed_squared)
        return spread


@dataclass(frozen=True)
class PlacedErrors:
    """Errors of a polynomial on one flight, and where they were made.

    Attributes:
        error: (N,).
        leverage: (N,).
        speed_squared: (N,) of the airspeed, m²/s².
        inside: (N,) whether every input lies in the range of the samples that the polynomial was fitted to.
        others: leverage (M,) and squared airspeed (M,) of some samples of each flight that it was fitted to.
    """

    error: Array
    leverage: Array
    speed_squared: Array
    inside: npt.NDArray[np.bool_]
    others: Sequence[tuple[Array, Array]] = ()

    def under(self, shape: SpreadShape) -> FlightErrors:
        """The errors beside the spread of a shape."""
        spread = shape.of(self.leverage, self.speed_squared)
        if not self.others:
            return FlightErrors(self.error, spread, self.inside)
        return FlightErrors(
            self.error,
            spread,
            self.inside,
            width=spread / flights_peak(shape.of(*causes) for causes in self.others),
            leverage=self.leverage / flights_peak(leverage for leverage, _ in self.others),
        )


def fit_shape(flights: Sequence[PlacedErrors], most_inflation: float) -> SpreadShape:
    """κ, 1 to `most_inflation`, and γ that maximise the likelihood of held-out errors e ~ N(0, σ² spread²).

    Flights weigh the same. Independent residuals of a true model would give κ = 1 and γ = 0; correlation and
    a wrong model give hundreds, and a γ that doubles the variance at some speed of the flights.
    """
    squares = [np.square(flight.error) for flight in flights]
    if not any(np.any(square) for square in squares):
        return SpreadShape(1.0, 0.0)
    causes = [np.stack((flight.leverage, flight.speed_squared)) for flight in flights]
    typical = max(float(np.mean([np.mean(cause[1]) for cause in causes])), _HOVER)

    def cost(logs: Array) -> tuple[float, Array]:
        """Negative log-likelihood with the best σ, and its gradient, for logarithms of κ and γ."""
        weights = np.exp(logs)
        variances = [1.0 + weights @ cause for cause in causes]
        pairs = list(zip(squares, causes, variances, strict=True))
        scale = np.mean([np.mean(e / v) for e, _, v in pairs])
        pull = np.mean([c @ (e / v**2) / len(e) for e, c, v in pairs], axis=0) / scale
        push = np.mean([c @ (1.0 / v) / len(v) for _, c, v in pairs], axis=0)
        value = np.log(scale) + np.mean([np.mean(np.log(v)) for v in variances])
        return float(value), weights * (push - pull)

    bounds = np.log([(1.0, max(most_inflation, 1.0)), (_LEAST_GROWTH / typical, _MOST_GROWTH / typical)])
    low, high = bounds.T
    # From either cause alone, as the likelihood may have a maximum near each.
    starts = [(0.5 * (low[0] + high[0]), low[1]), (low[0], np.log(1.0 / typical))]
    from scipy.optimize import minimize  # here, as no model in flight needs it

    fits = [minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds) for start in starts]
    inflation, growth = np.exp(min(fits, key=lambda fit: fit.fun).x)
    return SpreadShape(float(inflation), float(growth))


def squared_speed(inputs: Array) -> Array:
    """Squared airspeed (N,), m²/s², of input vectors (N, 19)."""
    squared: Array = np.square(inputs[:, VELOCITY_INPUTS]).sum(axis=1)
    return squared


def leverage_of(regressors: Array, whitening: Array) -> Array:
    """Leverage h (N,) = |W z|² for each row z of the regressors (N, s)."""
    leverage: Array = np.square(regressors @ whitening.T).sum(axis=1)
    return leverage


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
        return {"regressors": self.terms, **spread_json(self.shape, self.rule, self.rms_spread)}

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
        return cls(regressors, coefficients, whitening, *entry.spread())

    @property
    def terms(self) -> list[str]:
        """What the prediction is made of, in words."""
        return [str(regressor) for regressor in self.regressors]


@dataclass(frozen=True)
class SpreadEntry:
    """What a stored model keeps of the intervals of an axis beside the arrays."""

    inflation: NotNegative
    growth: NotNegative
    rule: StoredRule
    rms_spread: Annotated[float, Within(1.0)]

    def spread(self) -> tuple[SpreadShape, Rule, float]:
        """Shape, rule and root mean square of the spread."""
        return SpreadShape(self.inflation, self.growth), self.rule, self.rms_spread


def spread_json(shape: SpreadShape, rule: Rule, rms_spread: float) -> dict[str, Any]:
    """What :class:`SpreadEntry` reads."""
    return {**vars(shape), "rule": rule.to_json(), "rms_spread": rms_spread}


@dataclass(frozen=True)
class _Entry(SpreadEntry):
    """What a stored model keeps beside the arrays."""

    regressors: tuple[Text, ...]


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

    def evaluate(
        self,
        inputs: Array,
        factors: Array,
        derivatives: Records | None = None,  # noqa: ARG002 - for kinds that use them
    ) -> Evaluation:
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
