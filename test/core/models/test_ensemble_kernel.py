# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.random_ensembles import random_ensemble
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.ensemble_kernel import CompiledEnsembles
from quadpi_core.models.fitted_ensemble import FittedEnsemble
from quadpi_core.models.interval_rules import NormalRule, TrainedRule
from quadpi_core.models.model_kind import Evaluation, interval_factors
from quadpi_core.models.regressors import Regressor

REGRESSORS = tuple(map(Regressor.parse, ("u", "|v|", "mu_z^2", "omega_avg*q", "U_r - U_q", "cos_theta")))


def evaluate(fitted: dict[str, FittedEnsemble], X: Array, confidence: float = 0.95) -> Evaluation:
    compiled = CompiledEnsembles.pack(fitted)
    return compiled.evaluate(X, interval_factors(fitted, confidence))


def assert_equals_reference(fitted: dict[str, FittedEnsemble], X: Array) -> None:
    evaluation = evaluate(fitted, X)
    factor = NormalRule().factor(0.95)
    for axis, ensemble in fitted.items():
        k = AXES.index(axis)
        centre, spread = ensemble.centre_and_spread(X)
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


def test_equals_numpy(fitted: dict[str, FittedEnsemble], X: Array) -> None:
    assert_equals_reference(fitted, X)


@pytest.mark.parametrize("method", ["bootstrap", "quality-driven"])
def test_axes_need_not_be_of_one_size(method: str, X: Array) -> None:
    sizes = {"Fy": (1, 2, 1), "Fz": (6, 13, 7), "Mx": (3, 10, 33), "Mz": (2, 3, 50)}
    fitted = {
        axis: random_ensemble(method, X, REGRESSORS[:inputs], members=members, units=units, seed=units)
        for axis, (inputs, members, units) in sizes.items()
    }
    assert_equals_reference(fitted, X)
    evaluation = evaluate(fitted, X)
    for name in Evaluation._fields:
        assert np.all(getattr(evaluation, name)[:, [0, 4]] == 0.0)


@pytest.mark.parametrize("block", [1, 2, 15, 16, 17, 255, 256, 257])
def test_blocks_give_the_same_bits_as_the_whole(
    fitted: dict[str, FittedEnsemble], X: Array, block: int
) -> None:
    compiled = CompiledEnsembles.pack(fitted)
    factors = interval_factors(fitted, 0.95)
    parts = [compiled.evaluate(X[start : start + block], factors) for start in range(0, len(X), block)]
    joined = Evaluation(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in Evaluation._fields)
    )
    assert_same(joined, compiled.evaluate(X, factors))


@pytest.mark.parametrize("broken", [np.nan, np.inf])
@pytest.mark.parametrize("samples", [1, 40])
def test_what_is_not_finite_shows_and_stays_where_it_is(
    fitted: dict[str, FittedEnsemble], X: Array, broken: float, samples: int
) -> None:
    inputs = X[:samples].copy()
    inputs[samples // 2] = broken
    evaluation = evaluate(fitted, inputs)
    finite = np.isfinite(evaluation.lower + evaluation.upper)
    assert not finite[samples // 2].any()
    assert np.delete(finite, samples // 2, axis=0).all()


def test_confidence_widens_by_the_rule(X: Array) -> None:
    rules = {"Fx": NormalRule(), "Fz": TrainedRule(0.95)}
    fitted = {axis: random_ensemble("bootstrap", X, REGRESSORS, rule=rule) for axis, rule in rules.items()}
    compiled = CompiledEnsembles.pack(fitted)
    factors = interval_factors(fitted, 0.95)
    np.testing.assert_allclose(factors, [1.959964, 0, 1.0, 0, 0, 0], atol=1e-6)
    narrow, wide = compiled.evaluate(X, factors), compiled.evaluate(X, 2.0 * factors)
    np.testing.assert_array_equal(narrow.predicted, wide.predicted)
    np.testing.assert_allclose(wide.upper - wide.lower, 2.0 * (narrow.upper - narrow.lower), rtol=1e-12)
    with pytest.raises(ModelError, match="trained for a confidence"):
        interval_factors(fitted, 0.9)


@pytest.mark.parametrize("output", [-2000.0, 2000.0])
def test_extreme_noise_is_finite(X: Array, output: float) -> None:
    ensemble = random_ensemble("bootstrap", X, REGRESSORS)
    noise = replace(ensemble.noise, output_biases=np.array([[output]]))
    assert_equals_reference({"Fx": replace(ensemble, noise=noise)}, X)


def test_samples_of_no_number_give_none(fitted: dict[str, FittedEnsemble], X: Array) -> None:
    assert evaluate(fitted, X[:0]).predicted.shape == (0, 6)


def test_networks_over_a_table_are_no_model_of_a_vehicle(X: Array) -> None:
    ensemble = random_ensemble("bootstrap", X, REGRESSORS)
    with pytest.raises(ModelError, match="Fy: networks over the columns of a table"):
        CompiledEnsembles.pack({"Fy": replace(ensemble, inputs=None)})
