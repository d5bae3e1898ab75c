# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Intervals hold what they promise, for samples that go together."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.field.estimates import effective_pieces, jackknife, mean_of_pieces, slope_of_pieces


def autocorrelated(rng: np.random.Generator, count: int, keep: float) -> np.ndarray:
    values = rng.normal(size=count)
    for place in range(1, count):
        values[place] = keep * values[place - 1] + (1.0 - keep**2) ** 0.5 * values[place]
    return values


def test_intervals_of_autocorrelated_means_cover_the_truth():
    rng = np.random.default_rng(3)
    inside = 0
    for _ in range(400):
        values = 5.0 + autocorrelated(rng, 1000, 0.9)
        one = mean_of_pieces(values, np.arange(1000) // 100, "m/s")
        inside += one.low <= 5.0 <= one.high
    # Taken for independent, the samples would give intervals that cover 35 %.
    assert 0.92 <= inside / 400 <= 0.985


def test_the_mean_is_that_of_the_samples_and_what_is_not_finite_does_not_count():
    values = np.array([1.0, 2.0, np.nan, 3.0, 4.0, 5.0, 6.0])
    one = mean_of_pieces(values, np.arange(7), "V")
    assert one.value == pytest.approx(3.5)
    assert one.unit == "V"


def test_few_pieces_have_no_interval():
    one = mean_of_pieces(np.arange(8.0), np.arange(8) // 2, "")
    assert (one.value, one.low, one.high) == (3.5, None, None)
    assert one.reason == "too short for an interval"


def test_no_sample_is_not_identified():
    assert mean_of_pieces(np.full(3, np.nan), np.arange(3), "").reason == "not identified: no sample"


def test_a_slope_with_its_interval():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1.0, 1.0, 600)
    columns = np.column_stack([np.ones_like(x), x])
    one, fitted = slope_of_pieces(
        columns, 1.0 + 2.0 * x + rng.normal(0.0, 0.1, 600), np.arange(600) // 50, np.array([0.0, 1.0]), "1/s"
    )
    assert fitted == pytest.approx([1.0, 2.0], abs=0.02)
    assert one.low < 2.0 < one.high
    assert one.half_width == pytest.approx(2.2 * 0.1 / 600**0.5 / 0.577, rel=0.6)


def test_one_piece_with_all_information_leaves_one_degree_of_freedom():
    even, uneven = np.ones((10, 1)), np.array([[100.0]] + [[0.01]] * 9)
    assert effective_pieces(even)[0] == pytest.approx(10.0)
    assert effective_pieces(uneven)[0] == pytest.approx(1.0, abs=0.01)
    without = np.arange(10.0)[:, np.newaxis] / 10.0
    wide, narrow = (jackknife(np.array([0.45]), without, share)[1][0] for share in (uneven, even))
    assert wide > 4.0 * narrow
