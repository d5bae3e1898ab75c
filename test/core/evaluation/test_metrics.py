# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from mapie.metrics import regression as mapie
from scipy import integrate, stats
from scipy.signal import lfilter

from quadpi_core.evaluation import metrics
from quadpi_core.evaluation.metrics import (
    RegimeBins,
    autocovariance,
    block_bootstrap_variance,
    block_length,
    by_bin,
    clopper_pearson,
    coverage_interval,
    effective_sample_size,
    integrated_time,
    round_edges,
)

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


def test_edges_span_any_values_in_few_equal_bins():
    for seed in range(200):
        rng = np.random.default_rng(seed)
        values = 10.0 ** rng.uniform(-6, 6) * (rng.normal() * 3.0 + rng.random(50))
        edges = round_edges(values)
        assert edges[0] <= values.min(), seed
        assert values.max() <= edges[-1], seed
        assert 2 <= len(edges) <= 9, seed
        np.testing.assert_allclose(np.diff(edges), edges[1] - edges[0], err_msg=str(seed))


def test_bins_are_closed_below_and_null_where_empty():
    values, inside = np.array([0.0, 0.5, 1.0, 2.9]), np.array([True, False, True, True])
    bins = by_bin(values, inside, np.array([1.0, 3.0, 5.0, 7.0]), np.array([0.0, 1.0, 2.0, 3.0, 4.0]))
    assert bins == RegimeBins([2, 1, 1, 0], [0.5, 1.0, 1.0, None], [2.0, 5.0, 7.0, None])


HALF_WIDTH = stats.norm.ppf(0.975)


def ar1(rho, samples, rng):
    noise = rng.standard_normal(samples + 2000)
    return lfilter([np.sqrt(1 - rho**2)], [1, -rho], noise)[2000:]


def test_closed_form_equals_the_bootstrap_by_resampling():
    rng = np.random.default_rng(0)
    flights = [ar1(0.8, 300, rng), ar1(0.8, 200, rng)]
    block, replicates = 20, 20_000
    total = np.zeros(replicates)
    for x in flights:
        starts = rng.integers(0, len(x), (replicates, len(x) // block, 1))
        total += x[(starts + np.arange(block)) % len(x)].sum(axis=(1, 2))
    variance, _ = block_bootstrap_variance(flights, block)
    assert variance == pytest.approx(np.var(total / 500), rel=0.05)


def test_block_length_grows_with_correlation_and_stays_below_a_fifth_of_a_flight():
    rng = np.random.default_rng(2)
    lengths = [block_length([ar1(rho, 5000, rng)]) for rho in (0.0, 0.9, 0.99)]
    assert lengths[0] < 10 < lengths[1] < lengths[2] <= 1000


def test_clopper_pearson_against_the_beta_quantiles_of_nine_in_ten():
    low, high = clopper_pearson(0.9, 10, 0.95)
    assert (low, high) == pytest.approx((0.5550, 0.9975), abs=1e-4)
    exact = stats.binomtest(9, 10).proportion_ci(0.95, method="exact")
    assert (low, high) == pytest.approx((exact.low, exact.high))


@pytest.mark.parametrize("covered", [True, False])
def test_complete_coverage_does_not_pretend_certainty(covered):
    errors = ar1(0.98, 5000, np.random.default_rng(3))
    low, high = coverage_interval(np.full(5000, covered), errors)
    assert (low, high) == clopper_pearson(float(covered), effective_sample_size(errors), 0.95)
    assert 0.02 < high - low < 0.2
    assert (high == 1.0) if covered else (low == 0.0)


@pytest.mark.parametrize("size", [1, 2, 3, 7, 30])
def test_few_samples_give_an_interval_around_the_coverage(size):
    errors = np.random.default_rng(4).standard_normal(size)
    for inside in (errors > 0.3, errors < 2.0):
        low, high = coverage_interval(inside, errors)
        assert 0.0 <= low <= inside.mean() <= high <= 1.0
        assert high - low > 0.1


def test_is_the_same_each_time_and_independent_of_the_order_of_flights():
    rng = np.random.default_rng(5)
    first, second = ar1(0.9, 800, rng), ar1(0.9, 500, rng)
    labels = np.repeat([0, 1], [800, 500])
    forward = np.concatenate((first, second))
    backward = np.concatenate((second, first))
    one = coverage_interval(np.abs(forward) < HALF_WIDTH, forward, labels)
    other = coverage_interval(np.abs(backward) < HALF_WIDTH, backward, 1 - labels[::-1])
    assert one == pytest.approx(other, rel=1e-9)
    assert one == coverage_interval(np.abs(forward) < HALF_WIDTH, forward, labels)


@pytest.mark.slow
@pytest.mark.parametrize(("rho", "flights"), [(0.0, 1), (0.9, 1), (0.98, 1), (0.98, 4)])
def test_covers_the_true_coverage_of_autocorrelated_flights(rho, flights):
    """Nominal 95 %; the binomial interval, which takes samples for independent, does not come near."""
    rng = np.random.default_rng(6)
    trials, samples = 300, 10_000
    labels = np.repeat(np.arange(flights), samples)
    hits = binomial_hits = 0
    for _ in range(trials):
        errors = np.concatenate([ar1(rho, samples, rng) for _ in range(flights)])
        inside = np.abs(errors) < HALF_WIDTH
        low, high = coverage_interval(inside, errors, labels)
        hits += low <= 0.95 <= high
        low, high = clopper_pearson(inside.mean(), inside.size, 0.95)
        binomial_hits += low <= 0.95 <= high
    assert 0.89 < hits / trials <= 0.995
    if rho >= 0.9:
        assert binomial_hits / trials < 0.7


def ar1_flights(rho, shape, seed):
    """Stationary AR(1) series of unit variance along the last axis."""
    burn_in = 2000
    noise = np.random.default_rng(seed).standard_normal((*shape[:-1], shape[-1] + burn_in))
    return lfilter([np.sqrt(1 - rho**2)], [1, -rho], noise, axis=-1)[..., burn_in:]


def test_autocovariance_by_hand_pools_flights_without_pairs_across():
    pooled = autocovariance([np.array([1.0, -1.0, 2.0]), np.array([3.0, 1.0])])
    assert pooled == pytest.approx(np.array([1 + 1 + 4 + 9 + 1, -1 - 2 + 3, 2]) / 5)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, 0.98])
def test_effective_sample_size_of_ar1_is_near_theory(rho):
    samples = 40_000
    estimates = [effective_sample_size(x) for x in ar1_flights(rho, (20, samples), seed=3)]
    assert np.mean(estimates) == pytest.approx(samples * (1 - rho) / (1 + rho), rel=0.08)


def test_flights_of_one_process_are_worth_the_sum_of_their_samples():
    x = ar1_flights(0.9, (8, 5000), seed=4)
    labels = np.repeat(np.arange(8), 5000)
    assert effective_sample_size(x.ravel(), labels) == pytest.approx(8 * 5000 * 0.1 / 1.9, rel=0.15)


def test_a_difference_between_flights_counts_as_correlation():
    x = np.random.default_rng(5).standard_normal((4, 5000))
    labels = np.repeat(np.arange(4), 5000)
    offset = x + np.array([[-3.0], [-1.0], [1.0], [3.0]])
    assert effective_sample_size(x.ravel(), labels) > 15_000
    assert effective_sample_size(offset.ravel(), labels) < 40


@pytest.mark.parametrize("scale", [1e-200, 1.0, 1e200])
def test_unit_does_not_matter(scale):
    x = ar1_flights(0.9, (3000,), seed=6)
    assert integrated_time(scale * x) == pytest.approx(integrated_time(x))


@pytest.mark.parametrize("size", [1, 2, 50])
def test_a_constant_series_is_worth_one_sample(size):
    assert effective_sample_size(np.full(size, 0.1)) == 1.0


def test_negative_correlation_never_claims_more_than_the_samples():
    assert effective_sample_size(ar1_flights(-0.8, (5000,), seed=7)) == 5000


def test_a_block_is_a_fifth_of_a_flight_at_most():
    assert block_length([np.arange(1000.0)]) == 200
