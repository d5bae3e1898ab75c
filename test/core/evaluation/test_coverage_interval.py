# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from quadpi_core.evaluation.coverage_interval import (
    autocovariance,
    block_bootstrap_variance,
    block_length,
    clopper_pearson,
    coverage_interval,
    effective_sample_size,
    integrated_time,
    split_by_group,
)

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


def test_blocks_of_one_sample_give_the_variance_of_independent_samples():
    x = np.random.default_rng(1).standard_normal(400)
    assert block_bootstrap_variance([x], 1)[0] == pytest.approx(np.var(x) / 400)


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


def test_split_keeps_the_order_of_samples():
    first, second = split_by_group([1, 2, 3, 4, 5], ["b", "a", "b", "a", "b"])
    assert first.tolist() == [2, 4]
    assert second.tolist() == [1, 3, 5]


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
