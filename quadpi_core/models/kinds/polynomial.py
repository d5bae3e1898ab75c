# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Polynomials with terms chosen stepwise from a pool, each axis by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import Within
from quadpi_core.errors import ModelError, named_in
from quadpi_core.frames import Array
from quadpi_core.models.envelope import PlacedErrors, SpreadShape, fit_shape, leverage_of, squared_speed
from quadpi_core.models.fitted_polynomial import FittedPolynomials, PolynomialAxis
from quadpi_core.models.interval_rules import FlightErrors, ResidualRule, Rule, calibrate, inside_range
from quadpi_core.models.least_squares import (
    Gram,
    SelectionSettings,
    SelectionStep,
    StopRule,
    fit_coefficients,
    flight_grams,
    huber,
    select,
    sum_grams,
)
from quadpi_core.models.model_kind import Fit, IdentifyOptions, Kind, Pools, TrainingSamples, option
from quadpi_core.models.regressors import CandidatePool, Regressor, RegressorProgram
from quadpi_core.parallel import Progress, ReportProgress, one_blas_thread

# Stride over the training samples when recording the largest leverage and spread.
_PEAK_STEP = 8


@dataclass(frozen=True)
class Polynomial(Kind):
    """Each axis a polynomial in the terms of its pool, chosen stepwise.

    The defaults deviate from the paper because its residuals are neither independent nor from new flights:
    it stops by the predicted square error and takes σ_e² from the training residuals with N − 2 degrees of
    freedom, of plain least squares, where the default bounds the influence of samples far off (see
    :func:`quadpi_core.models.least_squares.huber`), and calibrates intervals on flights left out in turn,
    selection repeated without them.

    Attributes:
        stop: rule that ends the selection of terms, other than that of the settings.
        max_terms: most terms beyond the fixed ones.
    """

    stop: StopRule | None = option(None, "When to stop adding terms; default: the settings' rule.")
    max_terms: Annotated[int, Within(1)] = SelectionSettings.max_terms

    name = FittedPolynomials.method
    label = "polynomial"
    colour = "#D55E00"  # as in the paper
    normal_errors = True
    has_paper_settings = True
    fitted_type = FittedPolynomials

    def fit(
        self, samples: TrainingSamples, pools: Pools, options: IdentifyOptions, progress: ReportProgress
    ) -> Fit:
        """Fit one axis after the other, each reported before it begins."""
        paper = options.settings == "paper"
        stop = self.stop or ("pse" if paper else SelectionSettings.stop)
        settings = SelectionSettings(stop, self.max_terms)
        axes, held_out, log = {}, {}, {}
        for done, (axis, pool) in enumerate(pools.items()):
            progress(Progress(f"Identifying {axis}", done, len(pools)))
            # Products this small are over before threads have shared one out: ten flights of a minute take
            # 15 s with one thread of BLAS, 26 s with two.
            with named_in(axis), one_blas_thread():
                target = np.ascontiguousarray(samples.target(axis))
                search = TermSearch(pool, settings, samples.inputs, target, samples.flight)
                if paper:
                    axes[axis] = search.by_residuals()
                else:
                    axes[axis], held_out[axis] = search.by_flights()
            log[axis] = _selection_log(axes[axis], pool, search)
        return Fit(FittedPolynomials(axes), held_out, log)


class TermSearch:
    """The terms of one axis, chosen from a pool on some flights, and what can be fitted with them.

    Args:
        pool: candidate and fixed regressors over the inputs.
        settings: of the selection.
        X: (N, 19) input vectors, columns as `quadpi_core.inputs.INPUT_NAMES`.
        y: (N,) target.
        flights: (N,) number of the flight, from 0; samples of a flight in time order.

    Attributes:
        regressors: of the pool, the fixed ones first.
        steps: log of the selection.

    Raises:
        ModelError: for too few samples or flights, a constant target, or a fixed regressor that the samples
            do not excite.
    """

    def __init__(
        self, pool: CandidatePool, settings: SelectionSettings, X: Array, y: Array, flights: npt.NDArray[Any]
    ) -> None:
        self.regressors = tuple(dict.fromkeys(pool.fixed + pool.candidates))
        if np.ptp(y) == 0:
            raise ModelError("the target is constant: there is nothing to identify")
        if len(y) <= len(self.regressors):
            raise ModelError(f"{len(y)} samples are too few for a pool of {len(self.regressors)} regressors")
        self._fixed, self._settings = len(pool.fixed), settings
        self._X, self._y, self._flights, self._speed = X, y, flights, squared_speed(X)
        self._grams = flight_grams(RegressorProgram.compile(self.regressors), X, y, flights)
        self._active, self.steps = self._select(self._grams, settings)
        self._terms, self._Z = self._evaluated(self._active)
        self._gram = sum_grams(self._grams)

    def by_residuals(self) -> PolynomialAxis:
        """The paper's way: plain least squares, and the noise of the training residuals."""
        coefficients, whitening = fit_coefficients(self._gram, self._active)
        freedom = float(len(self._y) - 2)
        std = float(np.sqrt(self._gram.residual_square(self._active, coefficients) / freedom))
        return self._axis(coefficients, whitening, SpreadShape(1.0, 0.0), ResidualRule(std, freedom))

    def by_flights(self) -> tuple[PolynomialAxis, list[FlightErrors]]:
        """Robust least squares, calibrated on flights left out in turn; and the errors on these."""
        fitted = huber(self._Z, self._y, *fit_coefficients(self._gram, self._active))
        error, leverage = self._y - self._Z @ fitted[0], leverage_of(self._Z, fitted[1])
        placed = self._held_out()
        # κ = N means that all training samples carry the information of a single one.
        shape = fit_shape(placed, most_inflation=len(self._y))
        trained = [
            PlacedErrors(error[mask], leverage[mask], self._speed[mask], np.ones(np.sum(mask), dtype=bool))
            for mask in (self._flights == k for k in range(len(self._grams)))
        ]
        held_out = [flight.under(shape) for flight in placed]
        rule = calibrate(held_out, [flight.under(shape) for flight in trained])
        return self._axis(*fitted, shape, rule), held_out

    def _axis(self, coefficients: Array, whitening: Array, shape: SpreadShape, rule: Rule) -> PolynomialAxis:
        spread = shape.of(leverage_of(self._Z, whitening), self._speed)
        rms = float(np.sqrt(np.mean(np.square(spread))))
        return PolynomialAxis(self._terms, coefficients, whitening, shape.inflation, shape.growth, rule, rms)

    def _held_out(self) -> list[PlacedErrors]:
        """Errors on each flight of a model selected and fitted without it."""
        grams, X, y, flights = self._grams, self._X, self._y, self._flights
        if len(grams) < 2:
            raise ModelError("intervals from held-out flights need two flights or more")
        settings = self._settings
        if settings.stop == "leave-one-flight-out" and len(grams) == 2:
            # With one of two flights left out, the rule would have only one flight, and it needs two.
            settings = replace(settings, stop="pse")
        held_out = []
        for left_out in range(len(grams)):
            rest = grams[:left_out] + grams[left_out + 1 :]
            active, _ = self._select(rest, settings)
            mine = flights == left_out
            _, Z = self._evaluated(active)
            fitted = fit_coefficients(sum_grams(rest), active)
            coefficients, whitening = huber(Z[~mine], y[~mine], *fitted)
            error, leverage = y - Z @ coefficients, leverage_of(Z, whitening)
            others = [
                (leverage[rows], self._speed[rows])
                for rows in (np.flatnonzero(flights == k)[::_PEAK_STEP] for k in range(len(grams)))
                if flights[rows[0]] != left_out
            ]
            inside = inside_range(X[mine], of=X[~mine])
            held_out.append(PlacedErrors(error[mine], leverage[mine], self._speed[mine], inside, others))
        return held_out

    def _select(
        self, grams: list[Gram], settings: SelectionSettings
    ) -> tuple[list[int], list[SelectionStep]]:
        return select(grams, self._fixed, settings, list(map(str, self.regressors)))

    def _evaluated(self, active: Sequence[int]) -> tuple[tuple[Regressor, ...], Array]:
        """Chosen terms, and their values (N, s)."""
        chosen = tuple(self.regressors[k] for k in active)
        return chosen, RegressorProgram.compile(chosen).evaluate(self._X)


def _selection_log(fitted: PolynomialAxis, pool: CandidatePool, search: TermSearch) -> list[dict[str, Any]]:
    """The steps as in the paper's tables: term, coefficient in the final model, R², criterion.

    A term that selection took out again, or that lies beyond the chosen set, has no coefficient.
    """
    final = dict(zip(fitted.regressors, fitted.coefficients.tolist(), strict=True))
    rows: list[dict[str, Any]] = [
        {"term": str(term), "coefficient": final[term], "r2": None, "fixed": True, "removed": []}
        for term in pool.fixed
    ]
    rows[-1] |= _fit_columns(search.steps[0])
    for step in search.steps[1:]:
        assert step.added is not None
        term = search.regressors[step.added]
        removed = [str(search.regressors[k]) for k in step.removed]
        row = {"term": str(term), "coefficient": final.get(term), "fixed": False, "removed": removed}
        rows.append(row | _fit_columns(step))
    return rows


def _fit_columns(step: SelectionStep) -> dict[str, float]:
    return {"r2": step.r2, "sse": step.sse, "criterion": step.score}


KIND = Polynomial()
