# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Regressors as arrays: what can be stored predicts the same, the rest is refused, damaged arrays too."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.ensemble import (
    BaggingRegressor,
    ExtraTreesRegressor,
    GradientBoostingRegressor,
    RandomForestRegressor,
)
from sklearn.linear_model import Lasso, LinearRegression
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler
from sklearn.svm import SVR
from sklearn.tree import DecisionTreeRegressor

from quadpi_core.errors import ModelError
from quadpi_core.library.user_regressor import StoredRegressor, stored_form

RNG = np.random.default_rng(0)
X = RNG.normal(size=(400, 19)) * np.logspace(-3, 3, 19)
Y = X[:, 9] + np.abs(X[:, 8]) + 0.1 * RNG.normal(size=400)
UNSEEN = RNG.normal(size=(300, 19)) * np.logspace(-3, 3, 19)


@pytest.mark.parametrize(
    ("regressor", "form"),
    [
        (LinearRegression(), "affine"),
        (Lasso(0.01), "affine"),
        (make_pipeline(StandardScaler(), LinearRegression()), "affine"),
        (DecisionTreeRegressor(max_depth=1), "trees"),
        (DecisionTreeRegressor(), "trees"),
        (RandomForestRegressor(10), "trees"),
        (ExtraTreesRegressor(10), "trees"),
        (BaggingRegressor(n_estimators=5), "trees"),
        (GradientBoostingRegressor(n_estimators=30), "trees"),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, str) else value,
)
def test_what_can_be_stored_predicts_the_same(regressor, form):
    stored = stored_form(regressor.fit(X, Y), X, "own")
    assert stored.form == form
    read = StoredRegressor.stored(form, stored.arrays())
    assert np.allclose(read.predict(UNSEEN), regressor.predict(UNSEEN), rtol=0.0, atol=1e-8)
    assert stored_form(read, X, "own") is read


@pytest.mark.parametrize(
    "regressor",
    [
        SVR(),
        KNeighborsRegressor(),
        MLPRegressor(hidden_layer_sizes=(4,), max_iter=5),
        make_pipeline(PolynomialFeatures(2), LinearRegression()),
        make_pipeline(StandardScaler(), RandomForestRegressor(3)),
        BaggingRegressor(n_estimators=3, max_features=5),
    ],
    ids=lambda regressor: type(regressor).__name__,
)
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
def test_anything_else_is_refused_in_one_line(regressor):
    with pytest.raises(ModelError, match="estimator own: neither affine nor made of trees") as caught:
        stored_form(regressor.fit(X, Y), X, "own")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "change",
    [
        {"left": -1.0},
        {"right": 1e6},
        {"feature": 19.0},
        {"roots": -1.0},
        {"roots": 1e6},
        {"value": np.zeros(2)},
        {"constant": np.zeros(2)},
        {"feature": np.array(1.0)},
        {"feature": 1.5},
        {"roots": 0.5},
        {"left": np.array([1.0, 1.5, *[6.0] * 5])},
        {"right": np.array([4.0, 3.0, *[np.nan] * 5])},
    ],
)
def test_arrays_that_are_no_trees_are_refused(change):
    arrays = stored_form(DecisionTreeRegressor(max_depth=2).fit(X, Y), X, "own").arrays()
    for name, value in change.items():
        arrays[name] = value if isinstance(value, np.ndarray) else np.full_like(arrays[name], value)
    with pytest.raises(ModelError, match="trees: arrays that are no decision trees"):
        StoredRegressor.stored("trees", arrays)


def test_it_cannot_be_fitted_again():
    stored = stored_form(LinearRegression().fit(X, Y), X, "own")
    with pytest.raises(ModelError, match="cannot be fitted again"):
        stored.fit(X, Y)
    with pytest.raises(ModelError, match=r"affine: coefficients of shape \(3,\)"):
        StoredRegressor.stored("affine", {"coefficients": np.zeros(3)})
