# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What every estimator of an axis has, however it is fitted: the protocol of scikit-learn, and intervals."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm
from sklearn.base import clone, is_regressor
from sklearn.metrics import r2_score
from sklearn.model_selection import KFold, cross_val_score

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.axis_estimator import AxisEstimator, fit_of
from quadpi_core.models.candidate_pool import CandidatePool
from quadpi_core.models.interval_rules import LEVELS, FlightErrors, HeldOutRule, NormalRule
from quadpi_core.models.kinds.bootstrap import BootstrapEnsemble
from quadpi_core.models.kinds.polynomial import StepwisePolynomial
from quadpi_core.models.kinds.quality_driven import QualityDrivenEnsemble

ESTIMATORS = (
    StepwisePolynomial(CandidatePool.parse(["u"], ["P^2(v)"]), stop="bic", max_terms=4),
    BootstrapEnsemble(seed=5, members=3),
    QualityDrivenEnsemble(seed=5, confidence=0.9),
)
EACH = pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)


class Line(AxisEstimator):
    """A line through the origin in the first column, with a spread of 2 everywhere."""

    def __init__(self, shrink: float = 1.0) -> None:
        self.shrink = shrink

    def fit(self, X: Array, y: Array) -> Line:
        self.slope_ = self.shrink * float(X[:, 0] @ y / (X[:, 0] @ X[:, 0]))
        self.fitted_: Any = SimpleNamespace(rule=NormalRule())
        self.held_out_ = None
        return self

    def centre_and_spread(self, X: Array) -> tuple[Array, Array]:
        self.require_fitted()
        return self.slope_ * X[:, 0], np.full(len(X), 2.0)


@pytest.fixture
def data() -> tuple[Array, Array]:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200, 2))
    return X, 3.0 * X[:, 0] + 2.0 * rng.normal(size=200)


def test_an_interval_is_the_centre_and_the_factor_of_the_rule_times_the_spread(data) -> None:
    X, y = data
    line = Line().fit(X, y)
    for confidence in (0.5, 0.95):
        lower, upper = line.predict_interval(X, confidence)
        half = norm.ppf(0.5 + 0.5 * confidence) * 2.0
        np.testing.assert_allclose(lower, line.predict(X) - half)
        np.testing.assert_allclose(upper, line.predict(X) + half)
    np.testing.assert_array_equal(line.predict(X), line.slope_ * X[:, 0])


def test_the_score_is_that_of_scikit_learn(data) -> None:
    X, y = data
    line = Line(shrink=0.5).fit(X, y)
    assert line.score(X, y) == pytest.approx(r2_score(y, line.predict(X)))
    assert line.score(X, y) < Line().fit(X, y).score(X, y)


def test_scikit_learn_validates_an_estimator_of_ones_own(data) -> None:
    X, y = data
    line = Line()
    scores = cross_val_score(line, X, y, cv=KFold(4))
    assert scores.shape == (4,)
    assert scores.mean() > 0.5
    assert not hasattr(line, "fitted_")


@EACH
def test_every_kind_is_cloned_with_its_parameters(estimator: AxisEstimator) -> None:
    twin = clone(estimator)
    assert is_regressor(twin)
    assert twin is not estimator
    assert twin.get_params() == estimator.get_params()


@EACH
def test_parameters_are_set_by_name(estimator: AxisEstimator) -> None:
    twin = clone(estimator)
    name, value = next(iter(estimator.get_params().items()))
    assert twin.set_params(**{name: "other"}).get_params()[name] == "other"
    assert estimator.get_params()[name] == value
    with pytest.raises(ValueError, match=f"unknown parameter 'depth'; known: {name}, "):
        twin.set_params(depth=3)


@EACH
def test_asking_before_the_fit_is_refused(estimator: AxisEstimator) -> None:
    X = np.zeros((3, 19))
    for ask in (estimator.predict, estimator.predict_interval, lambda _: estimator.held_out_coverage()):
        with pytest.raises(ModelError, match="call fit first"):
            ask(X)


def held_out(errors: list[float]) -> FlightErrors:
    return FlightErrors(np.array(errors), np.ones(len(errors)), np.ones(len(errors), dtype=bool))


def test_coverage_of_a_flight_left_out_takes_the_factor_of_the_others(data) -> None:
    """One flight has factor 1 and the other 3: each is judged by that of the other."""
    line = Line().fit(*data)
    line.fitted_.rule = HeldOutRule(np.repeat([[1.0], [3.0]], len(LEVELS), axis=1), 2)
    line.held_out_ = [held_out([0.5, 2.0, 2.9, -3.5]), held_out([0.5, 0.9, -2.0, 4.0])]
    covered = line.held_out_coverage(0.95)
    assert covered is not None
    assert covered.tolist() == [0.75, 0.5]


def test_without_flights_left_out_there_is_no_coverage_of_them(data) -> None:
    line = Line().fit(*data)
    assert line.held_out_coverage() is None
    line.held_out_ = [held_out([0.5])]
    assert line.held_out_coverage() is None


def test_a_fit_holds_errors_of_the_axes_that_have_them(data) -> None:
    with_errors, without = Line().fit(*data), Line().fit(*data)
    with_errors.held_out_ = [held_out([0.5])]
    fit = fit_of({"Fx": with_errors, "Mz": without})
    assert fit.axes == {"Fx": with_errors.fitted_, "Mz": without.fitted_}
    assert fit.held_out == {"Fx": with_errors.held_out_}
