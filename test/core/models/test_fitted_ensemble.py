# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.random_ensembles import FITTED, random_ensemble
from quadpi_core.config_schema import parse_config
from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.fitted_ensemble import Scaling
from quadpi_core.models.model_kind import StoredAxes

from .small_fits import REGRESSORS

EACH = pytest.mark.parametrize("method", FITTED)


def stored(method: str, X: Array) -> StoredAxes:
    """What a folder keeps of an ensemble with random weights."""
    axis = random_ensemble(method, X, REGRESSORS, members=4, units=5)
    kept = FITTED[method]({"Fx": axis}).store()
    return replace(kept, entries=json.loads(json.dumps(kept.entries)), arrays=dict(kept.arrays))


@EACH
def test_says_what_it_is_made_of(method: str, X: Array) -> None:
    ensemble = random_ensemble(method, X, REGRESSORS, members=4, units=5)
    assert ensemble.terms == ["4 networks of 5 hidden units over", *map(str, REGRESSORS)]


@EACH
def test_stored_numbers_are_the_same(method: str, X: Array) -> None:
    kept = stored(method, X)
    read = FITTED[method].read(kept)
    own = FITTED[method]({"Fx": random_ensemble(method, X, REGRESSORS, members=4, units=5)})
    for one, other in zip(read.evaluate(X, np.ones(6)), own.evaluate(X, np.ones(6)), strict=True):
        np.testing.assert_array_equal(one, other)
    assert read.store().entries == kept.entries


@EACH
@pytest.mark.parametrize(
    "changes",
    [
        {"inputs": ["u"]},
        {"inputs": ["u", "zeta"]},
        {"inputs": None},
        {"rms_spread": 0.0},
        {"rms_spread": float("inf")},
        {"floor": 0.0},
        {"rule": {"kind": "magic"}},
    ],
)
def test_numbers_that_no_fit_gives_are_refused(method: str, X: Array, changes: dict[str, Any]) -> None:
    kept = stored(method, X)
    with pytest.raises(ModelError, match=r"^Fx: "):
        FITTED[method].read(replace(kept, entries={"Fx": {**kept.entries["Fx"], **changes}}))


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
    kept = stored(method, X)
    with pytest.raises(ModelError, match=f"Fx: .*{name}"):
        FITTED[method].read(replace(kept, entries={"Fx": {**kept.entries["Fx"], name: value}}))


def test_members_of_the_other_kind_are_refused(X: Array) -> None:
    bootstrap, bounds = stored("bootstrap", X), stored("quality-driven", X)
    with pytest.raises(ModelError, match="do not fit together"):
        FITTED["bootstrap"].read(replace(bootstrap, arrays={**bootstrap.arrays, **bounds.arrays}))
    with pytest.raises(ModelError, match="two bounds"):
        FITTED["quality-driven"].read(replace(bounds, arrays=bootstrap.arrays))


@EACH
@pytest.mark.parametrize("name", ["hidden_biases", "hidden_weights"])
def test_networks_of_which_something_is_missing_are_refused(method: str, X: Array, name: str) -> None:
    kept = stored(method, X)
    place = f"Fx.members.{name}"
    short = {**kept.arrays, place: kept.arrays[place][:, 1:].copy()}
    with pytest.raises(ModelError, match="networks of shapes"):
        FITTED[method].read(replace(kept, arrays=short))
    del short[place]
    with pytest.raises(ModelError, match=f"networks without {name}"):
        FITTED[method].read(replace(kept, arrays=short))


@EACH
def test_a_single_member_has_no_deviation(method: str, X: Array) -> None:
    ensemble = random_ensemble(method, X, REGRESSORS, members=4, units=5)
    with pytest.raises(ValueError, match="a single member"):
        replace(ensemble, members=ensemble.members[:1])


def test_standardised_samples_have_mean_zero_and_unit_scale() -> None:
    rng = np.random.default_rng(3)
    inputs = rng.normal([3.0, -7.0, 2.0], [0.5, 4.0, 0.0], size=(1000, 3))
    scaling = Scaling.from_samples(inputs, rng.normal(size=1000))
    standardised = scaling.standardised(inputs)
    np.testing.assert_allclose(standardised.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(standardised.std(axis=0), [1.0, 1.0, 0.0], atol=1e-12)
    assert scaling.input_scale[2] == 1.0


def test_constant_target_is_refused() -> None:
    with pytest.raises(ModelError, match="constant"):
        Scaling.from_samples(np.zeros((10, 2)), np.full(10, 3.0))


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
