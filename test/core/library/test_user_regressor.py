# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Regressors of a user's own: calibrated by flight, judged like kinds of model, stored as numbers."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.ensemble import (
    BaggingRegressor,
    ExtraTreesRegressor,
    GradientBoostingRegressor,
    RandomForestRegressor,
)
from sklearn.linear_model import Lasso, LinearRegression, Ridge
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler
from sklearn.svm import SVR
from sklearn.tree import DecisionTreeRegressor

import quadpi_core as qp
from quadpi_core.errors import ModelError
from quadpi_core.library.user_regressor import StoredRegressor, stored_form
from quadpi_core.models.interval_rules import FlightErrors, calibrate, inside_range


@pytest.fixture(scope="module")
def scaled(training) -> qp.WrenchModel:
    return qp.WrenchModel(make_pipeline(StandardScaler(), Ridge()), axes=["Fx", "Fz"]).fit(training)


class Mean:
    """Knows no scikit-learn: predicts the mean."""

    def __init__(self):
        self.fits = 0

    def fit(self, _X, y):
        self.fits += 1
        self.mean = y.mean()

    def predict(self, X):
        return np.full((len(X), 1), self.mean)


def test_intervals_are_calibrated_on_flights_left_out(training, unseen):
    """By the rules of the package: the width is what covers flights that the regressor did not see."""
    regressor = Mean()
    model = qp.WrenchModel(regressor, axes=["Fx"]).fit(training)
    assert regressor.fits == 0
    X, y = [own.inputs for own in training], [own.wrench[:, 0] for own in training]
    held_out, trained = [], []
    for k in range(4):
        others = np.concatenate([y[j] for j in range(4) if j != k]).mean()
        inside = inside_range(X[k], of=np.concatenate([X[j] for j in range(4) if j != k]))
        held_out.append(FlightErrors(y[k] - others, np.ones(len(y[k])), inside))
        everywhere = np.ones(len(y[k]), dtype=bool)
        trained.append(FlightErrors(y[k] - np.concatenate(y).mean(), np.ones(len(y[k])), everywhere))
    half = calibrate(held_out, trained).factor(0.9)
    interval = model.predict_interval(unseen, confidence=0.9)
    assert np.allclose(interval.upper[:, 0] - interval.lower[:, 0], 2.0 * half, rtol=1e-12)
    assert np.allclose(model.predict(unseen)[:, 0], np.concatenate(y).mean(), rtol=1e-12)
    assert np.isnan(model.predict(unseen)[:, 1:]).all()


def test_most_of_an_unseen_flight_is_covered(scaled, unseen):
    table = qp.evaluate(scaled, unseen, by=None, confidence=0.95)
    assert all(0.9 < row.coverage <= 1.0 for row in table.rows)
    assert scaled.score(unseen) > 0.8
    assert "intervals calibrated on" in scaled._repr_html_()


def test_it_is_stored_as_numbers(scaled, unseen, tmp_path):
    scaled.save(tmp_path / "own")
    assert sorted(file.name for file in (tmp_path / "own").iterdir()) == ["arrays.safetensors", "model.json"]
    read = qp.load_model(tmp_path / "own")
    assert repr(read) == "<WrenchModel Pipeline, confidence 0.95: bebop2, Fx Fz, 4 flights>"
    assert np.allclose(read.predict(unseen), scaled.predict(unseen), rtol=0.0, atol=1e-8, equal_nan=True)
    assert np.allclose(
        read.predict_interval(unseen, 0.9),
        scaled.predict_interval(unseen, 0.9),
        rtol=0.0,
        atol=1e-8,
        equal_nan=True,
    )
    again = read.save(tmp_path / "again")
    stored = qp.load_model(tmp_path / "again").predict(unseen)
    assert np.array_equal(stored, again.predict(unseen), equal_nan=True)
    with pytest.raises(qp.QuadpiError, match="estimator Pipeline: read from a folder"):
        read.fit(unseen)


def test_a_folder_that_was_altered_is_refused(scaled, tmp_path):
    scaled.save(tmp_path / "own")
    for old, new, message in (
        ('"form": "affine"', '"form": "pickle"', "unknown form of a regressor 'pickle'"),
        ('"form": "affine"', '"form": "trees"', "trees: expected arrays feature, threshold"),
        ('"vehicle": "bebop2"', '"vehicle": 3', "`vehicle` must be text, found 3"),
    ):
        altered, file = tmp_path / "altered", "model.json"
        altered.mkdir(exist_ok=True)
        text = (tmp_path / "own" / file).read_text()
        assert old in text
        (altered / file).write_text(text.replace(old, new))
        (altered / "arrays.safetensors").write_bytes((tmp_path / "own" / "arrays.safetensors").read_bytes())
        with pytest.raises(qp.QuadpiError, match=message):
            qp.load_model(altered)


class NotFinite(Mean):
    def predict(self, X):
        return np.where(np.arange(len(X)) == 7, np.nan, self.mean)


class Words(Mean):
    def predict(self, X):
        return len(X) * ["much"]


class Picky(Mean):
    def fit(self, _X, _y):
        raise ValueError("expected alpha > 0,\nfound -1")


class TooFew(Mean):
    def predict(self, _X):
        return np.zeros(3)


@pytest.mark.parametrize(
    ("regressor", "flights", "message"),
    [
        (NotFinite(), 4, "NotFinite: sample 7: prediction is not finite"),
        (TooFew(), 4, r"TooFew: predicts an array \(3,\) of float64 for \d+ samples"),
        (Words(), 4, r"Words: predicts an array \(\d+,\) of <U4 for \d+ samples"),
        (Picky(), 4, "estimator Picky: ValueError: expected alpha > 0, found -1$"),
        (Mean(), 1, "too few flights: 1 given, 2 or more needed to calibrate"),
    ],
)
def test_what_cannot_be_used_is_refused(training, regressor, flights, message):
    with pytest.raises(qp.QuadpiError, match=message):
        qp.WrenchModel(regressor, axes=["Fx"]).fit(training[:flights])


def test_another_vehicle_is_refused(scaled):
    others = qp.Flights(scaled_flights(scaled), qp.Vehicle.load("neurobem"))
    with pytest.raises(qp.QuadpiError, match="the model is of vehicle bebop2"):
        scaled.predict(others)


def scaled_flights(_):
    from quadpi_core.paths import bags_directory

    return qp.load_flights(bags_directory() / "train_1.mcap", "bebop2").prepared


# Regressors as arrays: what can be stored predicts the same, the rest is refused, damaged arrays too.


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
