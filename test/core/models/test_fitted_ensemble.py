# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.random_ensembles import random_ensemble
from quadpi_core.config_schema import parse_config
from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.fitted_ensemble import FittedEnsemble, Scaling
from quadpi_core.models.kinds.bootstrap import FittedBootstrap
from quadpi_core.models.kinds.quality_driven import FittedQualityDriven

from .small_ensembles import REGRESSORS

KINDS = {"bootstrap": FittedBootstrap, "quality-driven": FittedQualityDriven}


@pytest.fixture(params=KINDS)
def ensemble(request: pytest.FixtureRequest, X: Array) -> FittedEnsemble:
    return random_ensemble(request.param, X, REGRESSORS, members=4, units=5)


def test_says_what_it_is_made_of(ensemble: FittedEnsemble) -> None:
    assert ensemble.terms == ["4 networks of 5 hidden units over", *map(str, REGRESSORS)]
    assert replace(ensemble, inputs=None).terms[1:] == ["column 0", "column 1"]


def test_takes_a_table_as_it_is(ensemble: FittedEnsemble, X: Array) -> None:
    table = np.column_stack((X[:, 0], np.abs(X[:, 1]) * X[:, 2]))
    for of_table, of_inputs in zip(
        replace(ensemble, inputs=None).centre_and_spread(table), ensemble.centre_and_spread(X), strict=True
    ):
        np.testing.assert_allclose(of_table, of_inputs, rtol=1e-12)


def test_stored_numbers_are_the_same(ensemble: FittedEnsemble, X: Array) -> None:
    data = json.loads(json.dumps(ensemble.to_json()))
    again = type(ensemble).stored(data, ensemble.arrays())
    assert type(again) is type(ensemble)
    for one, other in zip(again.centre_and_spread(X), ensemble.centre_and_spread(X), strict=True):
        np.testing.assert_array_equal(one, other)
    assert again.to_json() == ensemble.to_json()


@pytest.mark.parametrize(
    "changes",
    [
        {"inputs": ["u"]},
        {"inputs": ["u", "zeta"]},
        {"rms_spread": 0.0},
        {"rms_spread": float("inf")},
        {"floor": 0.0},
        {"rule": {"kind": "magic"}},
    ],
)
def test_numbers_that_no_fit_gives_are_refused(ensemble: FittedEnsemble, changes: dict[str, Any]) -> None:
    with pytest.raises(ModelError):
        type(ensemble).stored(ensemble.to_json() | changes, ensemble.arrays())


@pytest.mark.parametrize(
    ("method", "name", "value"),
    [
        ("bootstrap", "model_share", 0.0),
        ("bootstrap", "model_share", float("inf")),
        ("quality-driven", "outward", -1.0),
        ("quality-driven", "outward", float("inf")),
    ],
)
def test_weights_of_the_deviation_that_make_no_sense_are_refused(
    X: Array, method: str, name: str, value: float
) -> None:
    ensemble = random_ensemble(method, X, REGRESSORS)
    with pytest.raises(ModelError, match=name):
        KINDS[method].stored(ensemble.to_json() | {name: value}, ensemble.arrays())


def test_members_of_the_other_kind_are_refused(X: Array) -> None:
    bootstrap = random_ensemble("bootstrap", X, REGRESSORS)
    bounds = random_ensemble("quality-driven", X, REGRESSORS)
    with pytest.raises(ModelError, match="do not fit together"):
        FittedBootstrap.stored(bootstrap.to_json(), bootstrap.arrays() | bounds.arrays())
    with pytest.raises(ModelError, match="two bounds"):
        FittedQualityDriven.stored(bounds.to_json(), bootstrap.arrays())


@pytest.mark.parametrize("name", ["members.hidden_biases", "members.hidden_weights"])
def test_networks_of_which_something_is_missing_are_refused(ensemble: FittedEnsemble, name: str) -> None:
    arrays = ensemble.arrays()
    arrays[name] = arrays[name][:, 1:].copy()
    with pytest.raises(ModelError, match="networks of shapes"):
        type(ensemble).stored(ensemble.to_json(), arrays)


def test_a_single_member_has_no_deviation(ensemble: FittedEnsemble) -> None:
    single = replace(ensemble, members=ensemble.members[:1])
    with pytest.raises(ModelError):
        type(ensemble).stored(single.to_json(), single.arrays())


def test_standardised_samples_have_mean_zero_and_unit_scale() -> None:
    rng = np.random.default_rng(3)
    inputs = rng.normal([3.0, -7.0, 2.0], [0.5, 4.0, 0.0], size=(1000, 3))
    scaling = Scaling.of(inputs, rng.normal(size=1000))
    standardised = scaling.standardised(inputs)
    np.testing.assert_allclose(standardised.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(standardised.std(axis=0), [1.0, 1.0, 0.0], atol=1e-12)
    assert scaling.input_scale[2] == 1.0


def test_constant_target_is_refused() -> None:
    with pytest.raises(ModelError, match="constant"):
        Scaling.of(np.zeros((10, 2)), np.full(10, 3.0))


@pytest.mark.parametrize(
    "changes",
    [
        {"input_mean": [0.0]},
        {"input_scale": [1.0, 0.0]},
        {"input_scale": [1.0, -1.0]},
        {"input_scale": [1.0, float("inf")]},
        {"input_mean": [0.0, float("inf")]},
        {"target_scale": 0.0},
        {"target_scale": float("inf")},
        {"target_mean": float("nan")},
    ],
)
def test_scaling_that_no_samples_give_is_refused(changes: dict[str, object]) -> None:
    data = {"input_mean": [0.0] * 2, "input_scale": [1.0] * 2, "target_mean": 0.0, "target_scale": 1.0}
    with pytest.raises(ModelError):
        parse_config(Scaling, data | changes, "scaling", ModelError)
