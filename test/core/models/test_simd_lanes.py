# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from fractions import Fraction

import numpy as np
from numba import njit

from quadpi_core.models.simd_lanes import LANES, fused, load, rectified, store


@njit
def product_and_sum(a, b, c):
    return fused(a, b, c)


@njit
def products_and_sums(a, table, out):
    store(out, 0, 0, fused(a, load(table, 0, 1), load(table, 1, 1)))


@njit
def larger_of_zero(table, out):
    store(out, 0, 0, rectified(load(table, 0, 0)))
    for k in range(LANES):
        out[1, k] = rectified(table[0, k])


def test_product_and_sum_are_rounded_once():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 1000))
    # All but the rounding of the product cancels.
    c = -(a * b)
    exact = [float(Fraction(x) * Fraction(y) + Fraction(z)) for x, y, z in zip(a, b, c, strict=True)]
    assert [product_and_sum(*row) for row in zip(a, b, c, strict=True)] == exact
    assert any(exact)


def test_each_lane_is_rounded_as_a_scalar_is():
    rng = np.random.default_rng(2)
    table, out = rng.normal(size=(3, LANES + 2)), np.zeros((1, LANES))
    for a in rng.normal(size=50):
        products_and_sums(a, table, out)
        scalars = [product_and_sum(a, table[0, 1 + k], table[1, 1 + k]) for k in range(LANES)]
        np.testing.assert_array_equal(out[0], scalars)


def test_rectified_keeps_what_is_not_a_number():
    table, out = np.linspace(-2.0, 2.0, LANES)[None].copy(), np.empty((2, LANES))
    table[0, :4] = np.nan, np.inf, -np.inf, -0.0
    larger_of_zero(table, out)
    np.testing.assert_array_equal(out[0], np.maximum(table[0], 0.0))
    np.testing.assert_array_equal(out[1], out[0])
