# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.random_ensembles import FITTED, random_ensemble
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.fitted_ensemble import FittedEnsembles
from quadpi_core.models.interval_rules import NormalRule, TrainedRule
from quadpi_core.models.kinds.bootstrap import BootstrapAxis
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.models.regressors import Regressor, RegressorProgram

REGRESSORS = tuple(map(Regressor.parse, ("u", "|v|", "mu_z^2", "omega_avg*q", "U_r - U_q", "cos_theta")))


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
            axis: random_ensemble(method, X, REGRESSORS[:inputs], members=members, units=units, seed=units)
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


def test_confidence_widens_by_the_rule(X: Array) -> None:
    rules = {"Fx": NormalRule(), "Fz": TrainedRule(0.95)}
    axes = {axis: random_ensemble("bootstrap", X, REGRESSORS, rule=rule) for axis, rule in rules.items()}
    fitted = FITTED["bootstrap"](axes)
    factors = fitted.factors(0.95)
    np.testing.assert_allclose(factors, [1.959964, 0, 1.0, 0, 0, 0], atol=1e-6)
    narrow, wide = fitted.evaluate(X, factors), fitted.evaluate(X, 2.0 * factors)
    np.testing.assert_array_equal(narrow.predicted, wide.predicted)
    np.testing.assert_allclose(wide.upper - wide.lower, 2.0 * (narrow.upper - narrow.lower), rtol=1e-12)
    with pytest.raises(ModelError, match="trained for a confidence"):
        fitted.factors(0.9)


@pytest.mark.parametrize("output", [-2000.0, 2000.0])
def test_extreme_noise_is_finite(X: Array, output: float) -> None:
    ensemble: Any = random_ensemble("bootstrap", X, REGRESSORS)
    noise = replace(ensemble.noise, output_biases=np.array([[output]]))
    assert_equals_reference(FITTED["bootstrap"]({"Fx": replace(ensemble, noise=noise)}), X)


def test_samples_of_no_number_give_none(fitted: FittedEnsembles, X: Array) -> None:
    assert evaluate(fitted, X[:0]).predicted.shape == (0, 6)
