# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Polynomials with terms chosen stepwise from a pool, each axis by itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import ModelError, named_in
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.axis_estimator import AxisEstimator, fit_of, flight_labels, require_finite
from quadpi_core.models.candidate_pool import CandidatePool
from quadpi_core.models.fitted_polynomial import (
    CompiledPolynomials,
    FittedPolynomial,
    PlacedErrors,
    SpreadShape,
    fit_shape,
    leverage_of,
    squared_speed,
)
from quadpi_core.models.interval_rules import (
    ResidualRule,
    Rule,
    calibrate,
    inside_range,
)
from quadpi_core.models.least_squares import Gram, fit_coefficients, flight_grams, huber, sum_grams
from quadpi_core.models.model_kind import Fit, IdentifyOptions, Kind, Pools, TrainingSamples, option
from quadpi_core.models.regressors import Regressor, RegressorProgram, check_inputs
from quadpi_core.models.selection import SelectionSettings, SelectionStep, StopRule, select
from quadpi_core.parallel import Progress, ReportProgress, one_blas_thread

NoiseRule: TypeAlias = Literal["held-out", "residual"]

# Stride over the training samples when recording the largest leverage and spread.
_PEAK_STEP = 8


@dataclass(eq=False)
class StepwisePolynomial(AxisEstimator):
    """Polynomial regression with terms chosen stepwise from a pool, and prediction intervals.

    Args:
        pool: candidate and fixed regressors over the inputs X.
        stop: when selection ends; see :class:`~quadpi_core.models.selection.SelectionSettings`.
        max_terms: most terms beyond the fixed ones.
        f_enter: partial F value that admits a term.
        f_remove: partial F value that keeps a term.
        rank_tolerance: share of a candidate's squared norm that must be new.
        noise: "held-out" calibrates intervals on flights left out in turn, selection repeated without
            them; "residual" is the paper's rule.

    The defaults deviate from the paper because its residuals are neither independent nor from new flights:
    it stops by the predicted square error and takes σ_e² from the training residuals with N − 2 degrees of
    freedom, of plain least squares, where the default bounds the influence of samples far off (see
    :func:`quadpi_core.models.least_squares.huber`). :meth:`paper` gives those settings.

    Attributes:
        fitted_: the identified :class:`FittedPolynomial`.
        steps_: selection log, :class:`~quadpi_core.models.selection.SelectionStep` per step.
        held_out_: errors on each flight of the model without it; None under "residual".
    """

    pool: CandidatePool
    stop: StopRule = "leave-one-flight-out"
    max_terms: int = 10
    f_enter: float = 4.0
    f_remove: float = 4.0
    rank_tolerance: float = 1e-9
    noise: NoiseRule = "held-out"

    @classmethod
    def paper(cls, pool: CandidatePool) -> StepwisePolynomial:
        """The settings of the paper, for reproducing its tables."""
        return cls(pool, stop="pse", noise="residual")

    @property
    def _settings(self) -> SelectionSettings:
        return SelectionSettings(self.stop, self.max_terms, self.f_enter, self.f_remove, self.rank_tolerance)

    @property
    def _regressors(self) -> tuple[Regressor, ...]:
        return tuple(dict.fromkeys(self.pool.fixed + self.pool.candidates))

    def fit(self, X: Array, y: Array, groups: npt.ArrayLike | None = None) -> StepwisePolynomial:
        """Select terms and estimate coefficients and noise.

        Args:
            X: (N, 19) input vectors, columns as `quadpi_core.inputs.INPUT_NAMES`.
            y: (N,) target.
            groups: (N,) label of the flight of each sample; samples of a flight in time order. Without it
                five contiguous parts of the samples stand in for flights.

        Raises:
            ModelError: naming the sample that is not finite, too few samples or flights, a constant
                target, or a fixed regressor that the samples do not excite.
        """
        X, y, flights = _checked(X, y, groups)
        regressors = self._regressors
        if len(y) <= len(regressors):
            raise ModelError(f"{len(y)} samples are too few for a pool of {len(regressors)} regressors")
        program = RegressorProgram.compile(regressors)
        grams = flight_grams(program, X, y, flights)
        active, self.steps_ = self._select(grams, self._settings)
        gram = sum_grams(grams)
        chosen = tuple(regressors[k] for k in active)
        Z = RegressorProgram.compile(chosen).evaluate(X)
        coefficients, whitening = fit_coefficients(gram, active)
        if self.noise != "residual":
            coefficients, whitening = huber(Z, y, coefficients, whitening)
        rule: Rule
        error, leverage = y - Z @ coefficients, leverage_of(Z, whitening)
        speed = squared_speed(X)
        if self.noise == "residual":
            freedom = float(len(y) - 2)
            std = float(np.sqrt(gram.residual_square(active, coefficients) / freedom))
            shape, rule, self.held_out_ = SpreadShape(1.0, 0.0), ResidualRule(std, freedom), None
        else:
            held_out = self._held_out_errors(grams, X, y, flights)
            # κ = N means that all training samples carry the information of a single one.
            shape = fit_shape(held_out, most_inflation=len(y))
            members = [flights == k for k in range(len(grams))]
            everywhere = np.ones(len(y), dtype=bool)
            trained = [PlacedErrors(error[m], leverage[m], speed[m], everywhere[m]) for m in members]
            self.held_out_ = [flight.under(shape) for flight in held_out]
            rule = calibrate(self.held_out_, [flight.under(shape) for flight in trained])
        rms_spread = float(np.sqrt(np.mean(np.square(shape.of(leverage, speed)))))
        self.fitted_ = FittedPolynomial(chosen, coefficients, whitening, shape, rule, rms_spread)
        self.n_features_in_ = X.shape[1]
        return self

    def centre_and_spread(self, X: Array) -> tuple[Array, Array]:
        """Prediction and spread (N,) for input vectors (N, 19)."""
        self.require_fitted()
        X = _finite_inputs(X)
        return self.fitted_.program.evaluate(X) @ self.fitted_.coefficients, self.fitted_.spread(X)

    def selection_log(self) -> list[dict[str, Any]]:
        """The steps as in the paper's tables: term, coefficient in the final model, R², criterion.

        A term that selection took out again, or that lies beyond the chosen set, has no coefficient.
        """
        self.require_fitted()
        final = dict(zip(self.fitted_.regressors, self.fitted_.coefficients.tolist(), strict=True))
        rows: list[dict[str, Any]] = [
            {"term": str(term), "coefficient": final[term], "r2": None, "fixed": True, "removed": []}
            for term in self.pool.fixed
        ]
        rows[-1] |= _fit_columns(self.steps_[0])
        regressors = self._regressors
        for step in self.steps_[1:]:
            assert step.added is not None
            term = regressors[step.added]
            removed = [str(regressors[k]) for k in step.removed]
            row = {"term": str(term), "coefficient": final.get(term), "fixed": False, "removed": removed}
            rows.append(row | _fit_columns(step))
        return rows

    def _select(
        self, grams: list[Gram], settings: SelectionSettings
    ) -> tuple[list[int], list[SelectionStep]]:
        return select(grams, len(self.pool.fixed), settings, list(map(str, self._regressors)))

    def _held_out_errors(
        self, grams: list[Gram], X: Array, y: Array, flights: npt.NDArray[np.int64]
    ) -> list[PlacedErrors]:
        """Errors on each flight of a model selected and fitted without it."""
        if len(grams) < 2:
            raise ModelError("intervals from held-out flights need two flights or more, or noise='residual'")
        settings, regressors = self._settings, self._regressors
        if settings.stop == "leave-one-flight-out" and len(grams) == 2:
            # With one of two flights left out, the rule would have only one flight, and it needs two.
            settings = replace(settings, stop="pse")
        held_out = []
        for left_out in range(len(grams)):
            rest = grams[:left_out] + grams[left_out + 1 :]
            active, _ = self._select(rest, settings)
            chosen = tuple(regressors[k] for k in active)
            mine = flights == left_out
            Z = RegressorProgram.compile(chosen).evaluate(X)
            fitted = fit_coefficients(sum_grams(rest), active)
            coefficients, whitening = huber(Z[~mine], y[~mine], *fitted)
            error, leverage = y - Z @ coefficients, leverage_of(Z, whitening)
            inside = inside_range(X[mine], of=X[~mine])
            others = [
                (leverage[rows], squared_speed(X[rows]))
                for rows in (np.flatnonzero(flights == k)[::_PEAK_STEP] for k in range(len(grams)))
                if flights[rows[0]] != left_out
            ]
            held_out.append(PlacedErrors(error[mine], leverage[mine], squared_speed(X[mine]), inside, others))
        return held_out


def _checked(X: Array, y: Array, groups: npt.ArrayLike | None) -> tuple[Array, Array, npt.NDArray[np.int64]]:
    X, y = _finite_inputs(X), np.ascontiguousarray(y, dtype=float)
    if y.shape != (len(X),):
        raise ModelError(f"y has shape {y.shape}, expected ({len(X)},) as X has {len(X)} rows")
    if not np.all(np.isfinite(y)):
        raise ModelError(f"sample {np.argmin(np.isfinite(y))}: target is not finite")
    if len(y) == 0 or np.ptp(y) == 0:
        raise ModelError("the target is constant: there is nothing to identify")
    labels = flight_labels(groups, len(y))
    return X, y, np.unique(labels, return_inverse=True)[1].astype(np.int64)


def _finite_inputs(X: Array) -> Array:
    X = np.ascontiguousarray(X, dtype=float)
    check_inputs(X)
    require_finite(X, INPUT_NAMES)
    return X


def _fit_columns(step: SelectionStep) -> dict[str, float]:
    return {"r2": step.r2, "sse": step.sse, "criterion": step.score}


@dataclass(frozen=True)
class Polynomial(Kind):
    """Each axis a polynomial in the terms of its pool.

    Attributes:
        stop: rule that ends the selection of terms, other than that of the settings.
    """

    stop: StopRule | None = option(None, "When to stop adding terms; default: the settings' rule.")

    name = FittedPolynomial.method
    label = "polynomial"
    colour = "#D55E00"  # as in the paper
    normal_errors = True
    has_paper_settings = True
    axis_type = FittedPolynomial

    def fit(
        self, samples: TrainingSamples, pools: Pools, options: IdentifyOptions, progress: ReportProgress
    ) -> Fit:
        """Fit one axis after the other, each reported before it begins."""
        kind = StepwisePolynomial.paper if options.settings == "paper" else StepwisePolynomial
        polynomials = {axis: kind(pool) for axis, pool in pools.items()}
        for done, (axis, polynomial) in enumerate(polynomials.items()):
            progress(Progress(f"Identifying {axis}", done, len(polynomials)))
            if self.stop is not None:
                polynomial.set_params(stop=self.stop)
            # Products this small are over before threads have shared one out: ten flights of a minute take
            # 15 s with one thread of BLAS, 26 s with two.
            with named_in(axis), one_blas_thread():
                polynomial.fit(samples.inputs, samples.target(axis), samples.flight)
        log = {axis: polynomial.selection_log() for axis, polynomial in polynomials.items()}
        return replace(fit_of(polynomials), log=log)

    def compile(self, fitted: Mapping[str, Any]) -> CompiledPolynomials:
        """Pack the axes."""
        return CompiledPolynomials.pack(fitted)


KIND = Polynomial()
