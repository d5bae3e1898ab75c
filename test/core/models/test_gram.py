# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from benchmarks.synthetic_inputs import smooth_inputs
from quadpi_core.models.candidate_pool import load_pools
from quadpi_core.models.gram import flight_grams
from quadpi_core.models.regressors import RegressorProgram


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


def test_total_square_is_about_the_mean() -> None:
    pool = load_pools("hdbeetle")["Fx"]
    program = RegressorProgram.compile(pool.fixed)
    target = 8.0 + np.random.default_rng(5).normal(size=500)
    (gram,) = flight_grams(program, smooth_inputs(500, seed=5), target, np.zeros(500, dtype=np.int64))
    assert gram.total_square == pytest.approx(500 * np.var(target), rel=1e-12)
