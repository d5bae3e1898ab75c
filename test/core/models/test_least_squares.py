# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.synthetic_inputs import smooth_inputs
from quadpi_core.errors import ModelError
from quadpi_core.models.fitted_polynomial import FittedPolynomials, PolynomialAxis
from quadpi_core.models.interval_rules import NormalRule
from quadpi_core.models.least_squares import Gram, fit_coefficients, flight_grams, huber, identifiable
from quadpi_core.models.regressors import Regressor, RegressorProgram, load_pools


@pytest.mark.parametrize("count", [7, 384, 2 * 2048 + 1])
def test_one_pass_equals_the_products_of_the_whole_matrix(count: int) -> None:
    pool = load_pools("hdbeetle")["Fx"]
    program = RegressorProgram.compile((*pool.fixed, *pool.candidates))
    inputs = smooth_inputs(count, seed=1)
    rng = np.random.default_rng(2)
    target = rng.normal(size=count)
    groups = rng.integers(0, 3, size=count)
    groups[:3] = 0, 1, 2
    grams = flight_grams(program, inputs, target, groups)
    assert len(grams) == 3
    Z = program.evaluate(inputs)
    for group, gram in enumerate(grams):
        own, own_target = Z[groups == group], target[groups == group]
        scale = np.sqrt(np.diag(own.T @ own))
        np.testing.assert_allclose(gram.matrix / np.outer(scale, scale), own.T @ own / np.outer(scale, scale))
        np.testing.assert_allclose(gram.moment / scale, own.T @ own_target / scale, rtol=1e-9, atol=1e-12)
        assert gram.square == pytest.approx(own_target @ own_target)
        assert gram.count == len(own_target)


def test_sums_differences_and_errors_of_foreign_coefficients() -> None:
    pool = load_pools("bebop2_simulation")["Mx"]
    program = RegressorProgram.compile(pool.candidates)
    inputs = smooth_inputs(600, seed=3, vehicle_name="bebop2")
    rng = np.random.default_rng(4)
    target = 3.0 + rng.normal(size=600)
    groups = np.arange(600) // 200
    first, second, third = flight_grams(program, inputs, target, groups)
    (whole,) = flight_grams(program, inputs, target, np.zeros(600, dtype=np.int64))
    scale = np.sqrt(np.outer(np.diag(whole.matrix), np.diag(whole.matrix)))
    np.testing.assert_allclose((first + second + third).matrix / scale, whole.matrix / scale, atol=1e-14)
    np.testing.assert_allclose((whole - third).matrix / scale, (first + second).matrix / scale, atol=1e-14)
    assert (whole - third).count == 400

    active = [0, 5, 2]
    coefficients = rng.normal(size=3)
    residual = target - program.evaluate(inputs)[:, active] @ coefficients
    assert whole.residual_square(active, coefficients) == pytest.approx(residual @ residual)


TRUE = np.array([2.0, -1.0, 0.5])
NOISE = 0.1


@pytest.fixture
def samples():
    rng = np.random.default_rng(0)
    Z = np.column_stack((np.ones(20_000), rng.normal(size=(20_000, 2))))
    return Z, Z @ TRUE + rng.normal(0.0, NOISE, len(Z))


def least_squares(Z, y):
    return fit_coefficients(Gram(Z.T @ Z, Z.T @ y, float(y @ y), len(y)), [0, 1, 2])


def test_without_wild_samples_it_is_least_squares_bit_for_bit(samples):
    Z, y = samples
    plain = least_squares(Z, y)
    for robust, least in zip(huber(Z, y, *plain), plain, strict=True):
        np.testing.assert_array_equal(robust, least)


@pytest.mark.parametrize("size", [1e2, 1e4])
def test_wild_samples_pull_no_more_than_the_bound(samples, size):
    """200 of 20 000 samples, all wild in one direction where the regressors are large."""
    Z, y = samples
    wild = np.argsort(Z[:, 1])[-200:]
    spoilt = y.copy()
    spoilt[wild] += size
    robust, _ = huber(Z, spoilt, *least_squares(Z, spoilt))
    plain, _ = least_squares(Z, spoilt)
    pull = np.linalg.norm(Z[wild], axis=1).sum() * 6.0 * NOISE / len(y)
    assert np.abs(robust - TRUE).max() < 1.5 * pull
    assert np.abs(plain - TRUE).max() > 10.0 * pull


def test_terms_that_only_wild_samples_tell_apart_are_refused(samples):
    Z, y = samples
    alike, spoilt = Z[:, [0, 1, 1]].copy(), y.copy()
    alike[:2, 2] += 1e-3
    spoilt[:2] += (1e12, -1e12)
    with pytest.raises(ModelError, match=r"differ in wild samples alone, with residuals up to 1e\+12"):
        huber(alike, spoilt, np.zeros(3), np.eye(3))


def test_the_bound_is_six_deviations_by_the_median():
    """Of a mean of ±1, and of one wild sample, which pulls as if it were 6 · 1.4826 away."""
    y = np.append(np.tile([-1.0, 1.0], 500), 1e6)
    Z = np.ones((len(y), 1))
    plain = fit_coefficients(Gram(Z.T @ Z, Z.T @ y, float(y @ y), len(y)), [0])
    robust, _ = huber(Z, y, *plain)
    assert robust[0] == pytest.approx(6.0 * 1.4826 / 1000.0, rel=0.02)


def test_a_fit_without_a_solution_says_what_cannot_be_identified():
    refusal = r"^Fx cannot be identified .*\(Singular matrix\): `quadpi info`"
    with pytest.raises(ModelError, match=refusal), identifiable("Fx"):
        np.linalg.inv(np.zeros((2, 2)))


# Stored polynomials that no fit gives; what they predict is in test_aerodynamic.py.


TERMS = tuple(map(Regressor.parse, ("bias", "|v|*w")))
MODEL = FittedPolynomials({"Fx": PolynomialAxis(TERMS, np.ones(2), np.eye(2), 2.0, 0.1, NormalRule(), 1.0)})


def test_what_was_stored_is_read() -> None:
    stored = MODEL.store()
    assert list(stored.entries["Fx"]) == ["regressors", "inflation", "growth", "rule", "rms_spread"]
    assert stored.entries["Fx"]["regressors"] == MODEL.axes["Fx"].terms == ["bias", "|v|*w"]
    assert FittedPolynomials.read(stored).axes["Fx"].regressors == TERMS


@pytest.mark.parametrize(
    ("entry", "arrays", "message"),
    [
        ({"regressors": ["bias"]}, {}, "shapes do not fit the 1 regressors"),
        ({"regressors": ["bias", "zeta"]}, {}, "zeta"),
        ({"inflation": -1.0}, {}, "`inflation` must be a number not below 0"),
        ({"rms_spread": 0.5}, {}, "`rms_spread` must be a number not below 1"),
        ({}, {"Fx.coefficients": np.ones(3)}, "shapes do not fit the 2 regressors"),
        ({}, {"Fx.whitening": np.ones(2)}, "shapes do not fit the 2 regressors"),
    ],
)
def test_numbers_that_no_fit_gives_are_refused(entry: Any, arrays: Any, message: str) -> None:
    stored = MODEL.store()
    entries = {"Fx": {**stored.entries["Fx"], **entry}}
    with pytest.raises(ModelError, match=f"^Fx: .*{message}"):
        FittedPolynomials.read(replace(stored, entries=entries, arrays={**stored.arrays, **arrays}))
