# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Coverage of adaptive intervals on what a flight, or an opponent, may throw at them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from quadpi_core.errors import ModelError
from quadpi_core.monitor.adaptive import GAIN_PER_S, LARGEST_CHANGE, AdaptiveIntervals

RATE_HZ = 500.0
SECONDS = 60.0
SAMPLES = round(SECONDS * RATE_HZ)
TIME = np.arange(SAMPLES) / RATE_HZ
AXES = 6


def adapt(errors, half_width=1.0, confidence=0.95, centre=0.0):
    """Which samples (N, 6) were inside, and the half widths."""
    errors = np.tile(errors[:, None], AXES) if errors.ndim == 1 else errors
    lower = np.broadcast_to(centre - half_width, errors.shape)
    upper = np.broadcast_to(centre + half_width, errors.shape)
    low, high = AdaptiveIntervals(confidence, RATE_HZ).step(centre + errors, lower, upper)
    measured = centre + errors
    return (low <= measured) & (measured <= high), 0.5 * (high - low)


def bound(samples):
    """Largest difference between the share of misses and its nominal value after a number of samples."""
    step = GAIN_PER_S / RATE_HZ
    return (np.log(LARGEST_CHANGE) + step) / (step * samples)


def correlated(seed, lag_s=0.3):
    """Errors as flights show them: standard deviation one, correlated over `lag_s`."""
    noise = np.random.default_rng(seed).standard_normal(SAMPLES)
    rho = np.exp(-1.0 / (lag_s * RATE_HZ))
    return np.sqrt(1.0 - rho**2) * lfilter([1.0], [1.0, -rho], noise)


def sequences():
    noise = np.random.default_rng(0).standard_normal(SAMPLES)
    jumps = np.where(TIME < 20.0, 0.3, np.where(TIME < 25.0, 30.0, 1.0))
    return {
        "white noise": 0.5 * noise,
        "correlated": correlated(1),
        "growing a hundredfold": correlated(2) * 100.0 ** (TIME / SECONDS),
        "shrinking a hundredfold": correlated(3) * 100.0 ** (-TIME / SECONDS),
        "sudden jumps": correlated(4) * jumps,
        "constant error": np.full(SAMPLES, 7.0),
        "bias that changes its sign": 5.0 * np.sign(np.sin(2.0 * np.pi * 0.5 * TIME)),
        "every second sample large": np.where(np.arange(SAMPLES) % 2, 40.0, 0.01),
        "bursts": np.where((TIME % 10.0) < 0.4, 50.0, 0.05) * np.sign(noise),
        "heavy tails": np.clip(np.random.default_rng(5).standard_cauchy(SAMPLES), -999.0, 999.0),
        "frozen sensor": np.where((TIME > 20.0) & (TIME < 40.0), 3.0 * np.sin(TIME), 0.4 * noise),
        "sorted": np.sort(np.abs(correlated(6))),
        "sorted downwards": -np.sort(-np.abs(correlated(7))),
    }


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.99])
@pytest.mark.parametrize("name", sequences())
def test_coverage_is_within_the_bound_on_any_sequence(name, confidence):
    errors = sequences()[name]
    # Numbers too small to follow add coverage only.
    errors = np.where(np.abs(errors) < 1.0 / LARGEST_CHANGE, 1.0 / LARGEST_CHANGE, errors)
    inside, half = adapt(errors, confidence=confidence)
    assert np.all(np.isfinite(half))
    count = np.arange(1, SAMPLES + 1)
    missed = np.cumsum(~inside[:, 0]) / count
    assert np.all(np.abs(missed - (1.0 - confidence)) <= bound(count))
    # What the factor did, the misses did: the sum behind the bound is exact.
    travel = np.log(half[-1, 0]) / (GAIN_PER_S / RATE_HZ)
    assert np.count_nonzero(~inside[:-1, 0]) - (1.0 - confidence) * (SAMPLES - 1) == pytest.approx(
        travel, abs=1e-6
    )


@pytest.mark.parametrize(
    "name", sorted(set(sequences()) - {"growing a hundredfold", "shrinking a hundredfold"})
)
def test_a_minute_is_enough_for_two_percent(name):
    inside, _ = adapt(sequences()[name])
    assert 0.93 <= inside.mean() <= 0.97


@pytest.mark.parametrize("outside", [True, False])
def test_opponent_who_knows_the_factor_cannot_break_the_bound(outside):
    adaptive = AdaptiveIntervals(0.95, RATE_HZ)
    missed = 0
    one = np.ones((1, AXES))
    for n in range(1, 20_001):
        share = 1.001 if outside else 0.999
        error = np.clip(share * adaptive.factor, 1.0 / LARGEST_CHANGE, LARGEST_CHANGE)[None]
        low, high = adaptive.step(error, -one, one)
        missed += not low[0, 0] <= error[0, 0] <= high[0, 0]
        assert abs(missed / n - 0.05) <= bound(n)
    assert bound(n) < 0.04


def test_errors_beyond_all_measure_leave_a_finite_factor_that_recovers():
    errors = 0.5 * np.random.default_rng(8).standard_normal(SAMPLES)
    errors[1000:6000] = 1e12
    errors[6000:11000] = 0.0
    inside, half = adapt(errors)
    assert half.max() == pytest.approx(1000.0, rel=0.02)
    assert half.min() > 0.98 / LARGEST_CHANGE
    assert np.mean(inside[20_000:]) == pytest.approx(0.95, abs=0.02)


def test_interval_of_a_sample_rests_on_the_past_only():
    errors = correlated(9)
    inside, half = adapt(errors)
    changed = errors.copy()
    changed[500:] *= 100.0
    _, other = adapt(changed)
    np.testing.assert_array_equal(half[:501], other[:501])
    assert half[0, 0] == 1.0
    assert not np.array_equal(half[501:], other[501:])
    assert np.any(~inside)


def test_the_factor_doubles_in_0_07_s_of_misses_and_halves_in_1_4_s_without_any():
    one, adaptive = np.ones((1, AXES)), AdaptiveIntervals(0.95, RATE_HZ)
    for error, seconds, factor in ((500.0, np.log(2.0) / (10.0 * 0.95), 2.0), (0.01, np.log(2.0) / 0.5, 1.0)):
        for _ in range(round(seconds * RATE_HZ)):
            adaptive.step(error * one, -one, one)
        np.testing.assert_allclose(adaptive.factor, factor, rtol=0.01)


def test_axes_are_apart_and_the_interval_stays_about_its_centre():
    scales = np.array([0.1, 0.5, 1.0, 2.0, 5.0, 20.0])
    errors = correlated(10)[:, None] * scales
    _, half = adapt(errors, centre=3.0)
    alone, _ = adapt(errors[:, 3], centre=3.0)
    assert np.all(np.diff(half[SAMPLES // 2 :].mean(axis=0)) > 0.0)
    together, _ = adapt(errors, centre=3.0)
    np.testing.assert_array_equal(together[:, 3], alone[:, 0])
    low, high = AdaptiveIntervals(0.95, RATE_HZ).step(
        3.0 + errors, np.full_like(errors, 2.0), np.full_like(errors, 4.0)
    )
    np.testing.assert_allclose(0.5 * (low + high), 3.0, rtol=1e-12)


def test_what_is_not_finite_or_has_no_width_leaves_the_factor():
    one = np.ones((1, AXES))
    adaptive = AdaptiveIntervals(0.95, RATE_HZ)
    for measured, lower, upper in (
        (np.nan * one, -one, one),
        (np.inf * one, -one, one),
        (one, -np.inf * one, one),
        (one, -one, np.nan * one),
        (one, -one, -one),
    ):
        adaptive.step(measured, lower, upper)
        assert np.all(adaptive.factor == 1.0)
    low, high = adaptive.step(3.0 * one, -1e308 * one, 1e308 * one)
    np.testing.assert_array_equal([low, high], [-1e308 * one, 1e308 * one])


@pytest.mark.parametrize(
    "settings", [(1.0, 500.0), (0.0, 500.0), (0.95, 0.0), (0.95, np.nan), (0.95, 500.0, None, -1.0)]
)
def test_impossible_settings_are_refused(settings):
    with pytest.raises(ModelError, match=r"confidence|rate_hz|gain_per_s"):
        AdaptiveIntervals(*settings)
