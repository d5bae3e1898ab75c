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
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.fitted_ensemble import FittedEnsembles, Scaling
from quadpi_core.models.interval_rules import NormalRule
from quadpi_core.models.kinds.bootstrap import BootstrapAxis
from quadpi_core.models.model_kind import Evaluation, StoredAxes
from quadpi_core.models.regressors import Regressor, RegressorProgram

from .small_fits import REGRESSORS

EACH = pytest.mark.parametrize("method", FITTED)


def stored(method: str, X: Array) -> StoredAxes:
    """What a folder keeps of an ensemble with random weights."""
    axis = random_ensemble(method, X, REGRESSORS, members=4, units=5)
    kept = FITTED[method]({"Fx": axis}).store()
    return replace(kept, entries=json.loads(json.dumps(kept.entries)), arrays=dict(kept.arrays))


@EACH
def test_stored_numbers_are_the_same(method: str, X: Array) -> None:
    kept = stored(method, X)
    read = FITTED[method].read(kept)
    assert read.axes["Fx"].terms == ["4 networks of 5 hidden units over", *map(str, REGRESSORS)]
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


PRODUCTS = tuple(map(Regressor.parse, ("u", "|v|", "mu_z^2", "omega_avg*q", "U_r - U_q", "cos_theta")))


def evaluate(fitted: FittedEnsembles, X: Array, confidence: float = 0.95) -> Evaluation:
    return fitted.evaluate(X, fitted.factors(confidence))


def reference(ensemble: Any, X: Array) -> tuple[Array, Array]:
    """Centre and spread (N,) in numpy."""
    scaling = ensemble.scaling
    features = scaling.standardised(RegressorProgram.compile(ensemble.inputs).evaluate(X))
    outputs = ensemble.members.outputs(features)
    mean, deviation = outputs.mean(axis=0), outputs.std(axis=0, ddof=1)
    if isinstance(ensemble, BootstrapAxis):
        noise = np.logaddexp(0.0, ensemble.noise.outputs(features)[0, :, 0]) + ensemble.floor
        spread = np.sqrt(ensemble.model_share * deviation[:, 0] ** 2 + noise**2)
    else:
        half = 0.5 * (mean[:, 1] - mean[:, 0]) + ensemble.outward * deviation.mean(axis=1)
        spread = np.maximum(np.abs(half), ensemble.floor)
    return scaling.target_mean + scaling.target_scale * mean.mean(axis=1), scaling.target_scale * spread


def assert_equals_reference(fitted: FittedEnsembles, X: Array) -> None:
    evaluation = evaluate(fitted, X)
    factor = NormalRule().factor(0.95)
    for axis, ensemble in fitted.axes.items():
        k = AXES.index(axis)
        centre, spread = reference(ensemble, X)
        expected = {
            "predicted": centre,
            "lower": centre - factor * spread,
            "upper": centre + factor * spread,
            "leverage": np.zeros(len(X)),
            "relative_width": spread / ensemble.rms_spread,
        }
        for name, values in expected.items():
            np.testing.assert_allclose(
                getattr(evaluation, name)[:, k], values, rtol=1e-11, atol=1e-11, err_msg=f"{axis} {name}"
            )


def assert_same(one: Evaluation, other: Evaluation) -> None:
    for name in Evaluation._fields:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_equals_numpy(fitted: FittedEnsembles, X: Array) -> None:
    assert_equals_reference(fitted, X)


@pytest.mark.parametrize("method", ["bootstrap", "quality-driven"])
def test_axes_need_not_be_of_one_size(method: str, X: Array) -> None:
    sizes = {"Fy": (1, 2, 1), "Fz": (6, 13, 7), "Mx": (3, 10, 33), "Mz": (2, 3, 50)}
    fitted = FITTED[method](
        {
            axis: random_ensemble(method, X, PRODUCTS[:inputs], members=members, units=units, seed=units)
            for axis, (inputs, members, units) in sizes.items()
        }
    )
    assert_equals_reference(fitted, X)
    evaluation = evaluate(fitted, X)
    for name in Evaluation._fields:
        assert np.all(getattr(evaluation, name)[:, [0, 4]] == 0.0)


@pytest.mark.parametrize("block", [1, 2, 15, 16, 17, 255, 256, 257])
def test_blocks_give_the_same_bits_as_the_whole(fitted: FittedEnsembles, X: Array, block: int) -> None:
    factors = fitted.factors(0.95)
    parts = [fitted.evaluate(X[start : start + block], factors) for start in range(0, len(X), block)]
    joined = Evaluation(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in Evaluation._fields)
    )
    assert_same(joined, fitted.evaluate(X, factors))


@pytest.mark.parametrize("broken", [np.nan, np.inf])
@pytest.mark.parametrize("samples", [1, 40])
def test_what_is_not_finite_shows_and_stays_where_it_is(
    fitted: FittedEnsembles, X: Array, broken: float, samples: int
) -> None:
    inputs = X[:samples].copy()
    inputs[samples // 2] = broken
    evaluation = evaluate(fitted, inputs)
    finite = np.isfinite(evaluation.lower + evaluation.upper)
    assert not finite[samples // 2].any()
    assert np.delete(finite, samples // 2, axis=0).all()


@pytest.mark.parametrize("output", [-2000.0, 2000.0])
def test_extreme_noise_is_finite(X: Array, output: float) -> None:
    ensemble: Any = random_ensemble("bootstrap", X, PRODUCTS)
    noise = replace(ensemble.noise, output_biases=np.array([[output]]))
    assert_equals_reference(FITTED["bootstrap"]({"Fx": replace(ensemble, noise=noise)}), X)


def test_samples_of_no_number_give_none(fitted: FittedEnsembles, X: Array) -> None:
    assert evaluate(fitted, X[:0]).predicted.shape == (0, 6)
