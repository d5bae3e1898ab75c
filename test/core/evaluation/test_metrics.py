# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from mapie.metrics import regression as mapie
from scipy import integrate, stats

from quadpi_core.evaluation import metrics
from quadpi_core.evaluation.metrics import MOST_BINS, RegimeBins, by_bin, round_edges

MEASURED = np.array([0.0, 1.0, 2.0, 5.0])
PREDICTED = np.array([0.0, 1.5, 2.0, 3.0])
LOWER = np.array([-1.0, 1.0, 2.5, 2.0])
UPPER = np.array([1.0, 2.0, 3.5, 4.0])


def test_coverage_counts_the_bounds_as_inside():
    assert metrics.picp(MEASURED, LOWER, UPPER) == 0.5


def test_width_and_its_share_of_the_training_range():
    assert metrics.mpiw(LOWER, UPPER) == 1.5
    assert metrics.nmpiw(LOWER, UPPER, training_range=10.0) == 0.15


def test_rmse_and_r_squared_by_hand():
    assert metrics.rmse(MEASURED, PREDICTED) == pytest.approx(np.sqrt(4.25 / 4))
    assert metrics.r_squared(MEASURED, PREDICTED) == pytest.approx(1 - 4.25 / 14.0)


def test_r_squared_of_a_constant_is_undefined():
    assert metrics.r_squared(np.full(5, 0.1), np.zeros(5)) is None


def test_winkler_adds_two_over_alpha_times_the_distance_outside():
    # Widths 2, 1, 1, 2; 0.5 below the third interval and 1 above the fourth; 2/α = 40 at 95 %.
    assert metrics.winkler(MEASURED, LOWER, UPPER, 0.95) == pytest.approx((6 + 40 * 1.5) / 4)


def test_winkler_is_best_for_the_true_quantiles():
    y = np.random.default_rng(0).standard_normal(20_000)
    half = stats.norm.ppf(0.975)

    def score(low, high):
        return metrics.winkler(y, np.full_like(y, low), np.full_like(y, high), 0.95)

    others = [
        score(-0.8 * half, 0.8 * half),
        score(-1.25 * half, 1.25 * half),
        score(-half + 0.5, half + 0.5),
    ]
    assert score(-half, half) < min(others)


@pytest.mark.parametrize("factor", [1e-3, 7.0, 1e4])
def test_metrics_scale_with_the_unit(factor):
    rng = np.random.default_rng(1)
    y, predicted = rng.standard_normal((2, 500))
    lower, upper = predicted - 1.0, predicted + 1.5
    scaled = [factor * value for value in (y, predicted, lower, upper)]
    assert metrics.picp(scaled[0], *scaled[2:]) == metrics.picp(y, lower, upper)
    assert metrics.mpiw(*scaled[2:]) == pytest.approx(factor * metrics.mpiw(lower, upper))
    assert metrics.rmse(*scaled[:2]) == pytest.approx(factor * metrics.rmse(y, predicted))
    assert metrics.r_squared(*scaled[:2]) == pytest.approx(metrics.r_squared(y, predicted))
    assert metrics.winkler(scaled[0], *scaled[2:], 0.9) == pytest.approx(
        factor * metrics.winkler(y, lower, upper, 0.9)
    )


def test_cwc_by_hand():
    # Coverage one half, width 0.15 of the range.
    assert metrics.cwc(MEASURED, LOWER, UPPER, 10.0, confidence=0.6) == pytest.approx(
        0.15 * (1 + np.exp(5.0))
    )
    assert metrics.cwc(MEASURED, LOWER, UPPER, 10.0, confidence=0.6, eta=10.0) == pytest.approx(
        0.15 * (1 + np.e)
    )
    assert metrics.cwc(MEASURED, LOWER, UPPER, 10.0, confidence=0.5) == pytest.approx(0.15)


@pytest.mark.parametrize("std", [1e-3, 0.7, 30.0])
def test_crps_is_the_integral_that_defines_it(std):
    for measured in (-2.0, 0.3, 5.0):
        mean = 0.4

        def integrand(x, mean=mean, measured=measured):
            return (stats.norm.cdf(x, mean, std) - (x >= measured)) ** 2

        points = sorted({mean - 12 * std, mean, mean + 12 * std, measured})
        expected = sum(
            integrate.quad(integrand, low, high, epsabs=1e-13, epsrel=1e-13, limit=200)[0]
            for low, high in pairwise(points)
        )
        score = metrics.crps_normal(np.array([measured]), np.array([mean]), np.array([std]))
        assert score == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_crps_without_spread_is_the_absolute_error():
    assert metrics.crps_normal(MEASURED, PREDICTED, np.zeros(4)) == np.mean(np.abs(MEASURED - PREDICTED))


def test_implied_std_gives_the_interval_back():
    std = np.array([0.5, 2.0])
    lower, upper = stats.norm.interval(0.9, loc=1.0, scale=std)
    np.testing.assert_allclose(metrics.implied_std(lower, upper, 0.9), std)


def test_an_established_library_agrees():
    rng = np.random.default_rng(2)
    y = rng.standard_normal(3000)
    levels = np.array([0.5, 0.8, 0.9, 0.95, 0.99])
    half = rng.uniform(0.1, 2.0, 3000)[:, None] * stats.norm.ppf(0.5 + levels / 2)
    lower, upper = 0.3 * y[:, None] - half, 0.3 * y[:, None] + 1.3 * half
    bounds = np.stack((lower, upper), axis=1)
    coverage = mapie.regression_coverage_score(y, bounds)
    width = mapie.regression_mean_width_score(bounds)
    for k, level in enumerate(levels):
        assert metrics.picp(y, lower[:, k], upper[:, k]) == pytest.approx(coverage[k], abs=1e-9)
        assert metrics.mpiw(lower[:, k], upper[:, k]) == pytest.approx(width[k], abs=1e-9)
        assert metrics.winkler(y, lower[:, k], upper[:, k], level) == pytest.approx(
            mapie.regression_mwi_score(y, bounds[:, :, [k]], level), abs=1e-9
        )


@pytest.mark.parametrize(
    ("lowest", "highest", "edges"),
    [
        (0.02, 14.26, [0, 2, 4, 6, 8, 10, 12, 14, 16]),
        (0.0, 3.0, [0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5]),
        (-0.12, 0.2, [-0.15, -0.1, -0.05, 0, 0.05, 0.1, 0.15, 0.2, 0.25]),
        (812.0, 1790.0, [800, 1000, 1200, 1400, 1600, 1800]),
        (3.0, 3.0, [3.0, 3.1]),
    ],
)
def test_edges_are_round_numbers(lowest, highest, edges):
    assert round_edges(np.array([lowest, highest])).tolist() == edges


@pytest.mark.parametrize("seed", range(200))
def test_edges_span_any_values_in_few_equal_bins(seed):
    rng = np.random.default_rng(seed)
    values = 10.0 ** rng.uniform(-6, 6) * (rng.normal() * 3.0 + rng.random(50))
    edges = round_edges(values)
    assert edges[0] <= values.min()
    assert values.max() <= edges[-1]
    assert 2 <= len(edges) <= MOST_BINS + 1
    np.testing.assert_allclose(np.diff(edges), edges[1] - edges[0])


def test_bins_are_closed_below_and_null_where_empty():
    values, inside = np.array([0.0, 0.5, 1.0, 2.9]), np.array([True, False, True, True])
    bins = by_bin(values, inside, np.array([1.0, 3.0, 5.0, 7.0]), np.array([0.0, 1.0, 2.0, 3.0, 4.0]))
    assert bins == RegimeBins([2, 1, 1, 0], [0.5, 1.0, 1.0, None], [2.0, 5.0, 7.0, None])
