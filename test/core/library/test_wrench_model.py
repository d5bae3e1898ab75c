# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Models by the protocol of scikit-learn: the bits of `quadpi identify`, folds by flight, refusals."""

from __future__ import annotations

import json
import pickle
import re
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.ensemble import RandomForestRegressor
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV, LeaveOneOut, cross_val_predict, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import check_estimator
from sklearn.utils.validation import check_is_fitted

import quadpi_core as qp
from quadpi_core.evaluation.metrics import r_squared
from quadpi_core.findings import DataQuality, Finding
from quadpi_core.flight import AXES
from quadpi_core.identification.found_wind import in_found_wind
from quadpi_core.models.interval_rules import WindDrag
from quadpi_core.paths import bags_directory

INPUTS = np.zeros((5, 19))


def test_the_bits_are_those_of_the_command_line(quadpi, quick, unseen, tmp_path):
    """Model folders, predictions, and the JSON of `quadpi evaluate`."""
    bags, table = sorted(bags_directory().glob("train_*.mcap")), tmp_path / "judged.json"
    identified = tmp_path / "identified"
    options = ("--vehicle", "bebop2", "--axes", "Fx,Fz", "--method", "polynomial", "-o", identified)
    assert quadpi("identify", *bags, *options).status == 0
    assert quick.save(tmp_path / "saved") is quick
    for name in ("model.json", "arrays.safetensors"):
        assert (tmp_path / "saved" / name).read_bytes() == (identified / name).read_bytes()
    read = qp.load_model(identified)
    assert np.array_equal(read.predict(unseen), quick.predict(unseen), equal_nan=True)
    assert np.array_equal(read.predict_interval(unseen), quick.predict_interval(unseen), equal_nan=True)
    unseen_bag = bags_directory() / "interpolation.mcap"
    assert quadpi("evaluate", identified, unseen_bag, "--json", table).status == 0
    said = json.loads(table.read_text())["flights"]["interpolation"]["axes"]
    rows = qp.evaluate(quick, unseen, by=None).rows
    assert [row.axis for row in rows] == list(said)
    for row in rows:
        own = said[row.axis]
        assert (row.coverage, row.width, row.n) == (own["picp"], own["mpiw"], own["n"])
        assert [row.low, row.high] == own["picp_ci"]
    assert quick.score(unseen) == np.mean([own["r2"] for own in said.values()])


def test_predictions_have_a_row_for_each_sample(quick, training, unseen):
    both = qp.Flights((*training[:2].prepared, *unseen.prepared), training.vehicle)
    predicted, interval = quick.predict(both), quick.predict_interval(both, confidence=0.9)
    assert predicted.shape == interval.lower.shape == interval.upper.shape == (len(both.time), 6)
    assert np.array_equal(predicted[both.labels == 2], quick.predict(unseen), equal_nan=True)
    held = [AXES.index(axis) for axis in quick.axes_]
    inside = (interval.lower < predicted) & (predicted < interval.upper)
    assert inside[:, held].all()
    for values in (predicted, *interval):
        assert np.array_equal(np.isnan(values).all(axis=0), ~np.isin(AXES, quick.axes_))
        assert np.isfinite(values[:, held]).all()
    narrower = quick.predict_interval(both, confidence=0.5)
    assert np.all((narrower.upper - narrower.lower)[:, held] < (interval.upper - interval.lower)[:, held])
    assert repr(interval) == f"Interval(lower=array{predicted.shape}, upper=array{predicted.shape})"
    scores = [r_squared(unseen.wrench[:, k], quick.predict(unseen)[:, k]) for k in held]
    assert quick.score(unseen) == np.mean(scores)


def test_cross_validation_is_by_flight(training):
    model = qp.WrenchModel(Ridge(), axes=["Fz"])
    scores = cross_val_score(model, training, cv=LeaveOneOut())
    apart = [
        model.fit(training[[k for k in range(4) if k != left]]).score(training[left]) for left in range(4)
    ]
    assert scores.tolist() == apart
    assert cross_val_score(model, training, cv=4, scoring=lambda m, X: m.score(X)).tolist() == apart


def test_cross_validated_predictions_are_refused(training, quick):
    """scikit-learn would put rows of samples in the places of flights."""
    with pytest.raises(qp.QuadpiError, match="cross_val_predict counts flights: loop over flights") as caught:
        cross_val_predict(qp.WrenchModel("polynomial", axes=["Fz"]), training, cv=LeaveOneOut())
    assert "\n" not in str(caught.value)
    assert quick.score([training[0], training[1]]) == quick.score(training[:2])


def test_grid_search_and_clones(training):
    model = qp.WrenchModel(Ridge(), axes=["Fx"], confidence=0.9)
    copy = clone(model)
    assert copy.get_params(deep=False).keys() == model.get_params(deep=False).keys()
    assert copy.estimator is not model.estimator
    assert copy.confidence == 0.9
    search = GridSearchCV(model, {"estimator__alpha": [1e-6, 1e6]}, cv=LeaveOneOut()).fit(training)
    assert search.best_params_ == {"estimator__alpha": 1e-6}
    assert search.best_estimator_.model_.flights[0].name == "train_1"
    assert clone(search.best_estimator_.set_params(estimator__alpha=2.0)).estimator.alpha == 2.0


def test_parameters_are_set_by_name():
    model = qp.WrenchModel()
    assert model.set_params(estimator=Ridge(), estimator__alpha=3.0) is model
    assert model.get_params()["estimator__alpha"] == 3.0
    with pytest.raises(qp.QuadpiError, match="unknown parameter 'alpha'; known: estimator, confidence"):
        model.set_params(alpha=1.0)
    assert repr(qp.WrenchModel(confidence=None)) == "<WrenchModel physical, confidence None, not fitted>"
    with pytest.raises(ValueError, match="unknown parameter 'estimator__alpha'"):
        qp.WrenchModel().set_params(estimator__alpha=1.0)
    named = clone(qp.WrenchModel("polynomial").set_params(estimator__max_terms=3))
    assert (named.estimator.max_terms, named.get_params()["estimator__max_terms"]) == (3, 3)


def test_flights_with_a_flaw_are_left_out(training):
    quality = DataQuality(findings=(Finding("a test", "imu", "says so", leave_out=True),))
    flawed = replace(training.prepared[3], quality=quality)
    given = qp.Flights((*training.prepared[:3], flawed), training.vehicle)
    with pytest.warns(UserWarning, match="flight train_4 left out: .*keep_flawed=True learns from it"):
        model = qp.WrenchModel("polynomial", axes=["Fz"]).fit(given)
    assert model.left_out_ == ("train_4",)
    assert [flight.name for flight in model.model_.flights] == ["train_1", "train_2", "train_3"]
    kept = qp.WrenchModel("polynomial", axes=["Fz"], keep_flawed=True).fit(given)
    assert len(kept.model_.flights) == 4


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda m, _: m.predict(INPUTS),
            r"flights: expected Flights, found an array \(5, 19\).*load_flights",
        ),
        (lambda m, _: m.fit(INPUTS, INPUTS[:, 0]), "flights: expected Flights.*Flights.from_arrays"),
        (lambda m, f: m.fit(f, INPUTS), "y: expected None, as flights hold the wrench"),
        (lambda m, f: m.predict_interval(f, 1.5), "confidence 1.5 is not between 0 and 1"),
        (lambda m, f: m.predict_interval(f, "high"), "confidence: expected a finite number, found str"),
        (lambda _, f: qp.WrenchModel().predict(f), r"not fitted: call fit\(flights\) first"),
        (lambda _, f: qp.WrenchModel("physics").fit(f), r"'physics' is not known.*did you mean `physical`\?"),
        (lambda _, f: qp.WrenchModel(estimator=Ridge).fit(f), "estimator: expected .* the class Ridge$"),
        (lambda _, f: qp.WrenchModel(axes="Fx").fit(f), "axes: expected a list of names, found 'Fx'"),
        (lambda _, f: qp.WrenchModel(axes=[]).fit(f), "axes: expected some of Fx, Fy.* found none; None is"),
        (lambda m, f: qp.WrenchModel(m).fit(f), "estimator: expected the name of a kind.* WrenchModel$"),
        (
            lambda m, f: make_pipeline(StandardScaler(), m).fit(f),
            r"flights: no array, so steps before WrenchModel cannot .*WrenchModel\(estimator=make_pipeline",
        ),
        (lambda _, f: qp.WrenchModel(axes=[5]).fit(f), "axes, entry 1: expected str, found int 5"),
        (lambda _, f: qp.WrenchModel(keep_flawed="no").fit(f), "keep_flawed: expected bool, found str 'no'"),
        (lambda m, f: m.plot(f, axes=5), "axes: expected 2 of matplotlib, found int 5"),
        (
            lambda _, f: qp.WrenchModel("polynomial").fit(f),
            "too few flights: 1 given, 2 or more needed to calibrate$",
        ),
        (
            lambda m, f: m.predict(qp.Flights(f.prepared, f.vehicle, 50.0)),
            "low-passed at 50 Hz, the model at 30",
        ),
        (lambda m, f: m.plot(qp.Flights((*f.prepared, *other_name(f)), f.vehicle)), "expected one to draw"),
    ],
)
def test_a_plausible_mistake_is_one_clear_line(quick, unseen, call, message):
    with pytest.raises(qp.QuadpiError, match=message) as caught:
        call(quick, unseen)
    assert "\n" not in str(caught.value)


def other_name(flights):
    return [replace(flights.prepared[0], name="other", sha256="")]


def test_a_model_that_was_read_has_parameters_of_its_own(quick, training, tmp_path):
    pickle.loads(pickle.dumps(quick)).save(tmp_path / "saved")
    read = qp.load_model(tmp_path / "saved")
    assert read.get_params(deep=False) | {"candidates": None, "keep_flawed": None} == {
        "estimator": "polynomial",
        "confidence": 0.95,
        "candidates": None,
        "axes": ["Fx", "Fz"],
        "keep_flawed": None,
    }
    for model in (read, clone(read)):
        with pytest.raises(qp.QuadpiError, match="estimator polynomial: read from a folder") as caught:
            model.fit(training)
        assert "\n" not in str(caught.value)
    assert repr(read) == repr(quick) == repr(read.set_params(confidence=0.5))
    assert read.set_params(estimator="polynomial").fit(training).confidence == 0.5


def test_they_show_themselves(quick, unseen):
    assert repr(quick) == "<WrenchModel polynomial, confidence 0.95: bebop2, Fx Fz, 4 flights>"
    assert repr(qp.WrenchModel(RandomForestRegressor())) == (
        "<WrenchModel RandomForestRegressor, confidence 0.95, not fitted>"
    )
    page = quick._repr_html_()
    assert "intervals calibrated on 4 of 4 flights" in page
    assert re.search(r"<td>Fz</td><td>\d\d\.\d%</td>", page)
    drawn = quick.plot(unseen)
    assert [own.get_ylabel() for own in drawn] == ["Fx [N]", "Fz [N]"]


class OfTables(qp.WrenchModel):
    """Says that it takes tables, or scikit-learn would check next to nothing."""

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = True
        return tags


# Checks that do not apply, with the reason; those of FLIGHTS that fit flights, for flights, are below.
FLIGHTS = "X are flights: an array of numbers is refused, in one line that says what to call"
NO_TABLES = "as FLIGHTS; it looks for another refusal of such a table than that"
DO_NOT_APPLY = dict.fromkeys(
    [
        "check_complex_data",
        "check_dict_unchanged",
        "check_dont_overwrite_parameters",
        "check_dtype_object",
        "check_estimators_dtypes",
        "check_estimators_fit_returns_self",
        "check_estimators_overwrite_params",
        "check_estimators_pickle",
        "check_f_contiguous_array_estimator",
        "check_fit1d",
        "check_fit2d_1feature",
        "check_fit2d_1sample",
        "check_fit2d_predict1d",
        "check_fit_check_is_fitted",
        "check_fit_idempotent",
        "check_fit_score_takes_y",
        "check_methods_sample_order_invariance",
        "check_methods_subset_invariance",
        "check_n_features_in",
        "check_n_features_in_after_fitting",
        "check_pipeline_consistency",
        "check_readonly_memmap_input",
        "check_regressor_data_not_an_array",
        "check_regressor_multioutput",
        "check_regressors_int",
        "check_regressors_no_decision_function",
        "check_supervised_y_2d",
    ],
    FLIGHTS,
) | dict.fromkeys(
    [
        "check_estimator_sparse_array",
        "check_estimator_sparse_matrix",
        "check_estimator_sparse_tag",
        "check_estimators_empty_data_messages",
        "check_estimators_nan_inf",
        "check_positive_only_tag_during_fit",
        "check_regressors_train",
        "check_supervised_y_no_nan",
    ],
    NO_TABLES,
)
DO_NOT_APPLY["check_estimators_unfitted"] = "predict before fit raises ModelError, as all of the package does"


def test_what_scikit_learn_checks():
    """Every check passes or is listed with its reason; none is listed that passes."""
    results = check_estimator(OfTables("polynomial"), on_fail=None, on_skip=None)
    failed = {one["check_name"]: str(one["exception"]) for one in results if one["status"] == "failed"}
    assert failed.keys() == DO_NOT_APPLY.keys() & {one["check_name"] for one in results}
    for name, message in failed.items():
        assert DO_NOT_APPLY[name] != FLIGHTS or "expected Flights, found" in message, (name, message)
    passed = {one["check_name"] for one in results if one["status"] == "passed"}
    assert {"check_estimator_cloneable", "check_get_params_invariance", "check_set_params"} <= passed
    assert "check_no_attributes_set_in_init" in passed


def test_the_same_checks_on_flights(training, unseen):
    """Fitting returns the model, changes no argument, forgets the last fit; a pickle says the same."""
    model = qp.WrenchModel("polynomial", axes=["Fz"])
    before = dict(vars(model))
    assert model.fit(training) is model
    assert {name: vars(model)[name] for name in before} == before
    first = model.predict(unseen)
    assert np.array_equal(model.fit(training[:2]).fit(training).predict(unseen), first, equal_nan=True)
    assert np.array_equal(pickle.loads(pickle.dumps(model)).predict(unseen), first, equal_nan=True)


def test_scikit_learn_knows_what_is_fitted(quick):
    check_is_fitted(quick)


def test_flights_in_a_wind_that_nothing_measures_are_judged_in_that_of_drag(quick, unseen):
    drag = WindDrag(per_mass_x_1_s=0.3, per_mass_y_1_s=0.3, noise_x_m_s2=0.1, noise_y_m_s2=0.1, wind_m_s=6.0)
    one = replace(unseen.prepared[0], wind_unknown=True)
    flights = replace(unseen, prepared=(one,))
    model = copy(quick)
    model.model_ = replace(quick.model_, wind=drag)
    found = in_found_wind(one, drag, unseen.vehicle)
    expected = model.model_.evaluate(found).predicted
    held = np.isin(AXES, quick.axes_)
    np.testing.assert_array_equal(model.predict(flights)[:, held], expected[:, held])
    assert not np.allclose(expected, quick.model_.evaluate(one).predicted)
