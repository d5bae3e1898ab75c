# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.signal import lfilter

from quadpi_core.evaluation.autocorrelation import (
    autocovariance,
    effective_sample_size,
    integrated_time,
    split_by_group,
)


def ar1(rho, shape, seed):
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
    estimates = [effective_sample_size(x) for x in ar1(rho, (20, samples), seed=3)]
    assert np.mean(estimates) == pytest.approx(samples * (1 - rho) / (1 + rho), rel=0.08)


def test_flights_of_one_process_are_worth_the_sum_of_their_samples():
    x = ar1(0.9, (8, 5000), seed=4)
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
    x = ar1(0.9, (3000,), seed=6)
    assert integrated_time(scale * x) == pytest.approx(integrated_time(x))


@pytest.mark.parametrize("size", [1, 2, 50])
def test_a_constant_series_is_worth_one_sample(size):
    assert effective_sample_size(np.full(size, 0.1)) == 1.0


def test_negative_correlation_never_claims_more_than_the_samples():
    assert effective_sample_size(ar1(-0.8, (5000,), seed=7)) == 5000
