# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Past errors of a flight move the centre of its intervals, and make them narrower."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from quadpi_core.flight import AXES
from quadpi_core.identification.identify import LeftErrors, calibrate_centre
from quadpi_core.models.interval_rules import DELAY_S, MEMORIES_S, FlightErrors, delay
from quadpi_core.monitor.adaptive import AdaptiveIntervals

RATE_HZ = 500.0
SAMPLES = 10_000


def errors(seed, constant=0.0, memory_s=0.5):
    """Errors (N, 6) of a flight, of standard deviation one, that last."""
    noise = np.random.default_rng(seed).standard_normal((SAMPLES, len(AXES)))
    rho = np.exp(-1.0 / (memory_s * RATE_HZ))
    return constant + np.sqrt(1.0 - rho**2) * lfilter([1.0], [1.0, -rho], noise, axis=0)


def of_flight(own, inside=True):
    return {
        axis: FlightErrors(own[:, k], np.full(len(own), 4.0), np.full(len(own), inside))
        for k, axis in enumerate(AXES)
    }


@pytest.fixture(scope="module")
def learned():
    flights = [of_flight(errors(seed, constant)) for seed, constant in enumerate((-2.0, -1.0, 0.0, 1.0, 2.0))]
    centre = calibrate_centre([LeftErrors(RATE_HZ, flight) for flight in flights], 0.95)
    assert centre is not None
    return centre


def bounds(intervals, own, blocks=(SAMPLES,)):
    """Lower and upper bounds (N, 6) about errors whose own interval is −4 to 4."""
    ends = np.cumsum(blocks)
    parts = [
        intervals.step(own[start:end], np.full_like(own[start:end], -4.0), np.full_like(own[start:end], 4.0))
        for start, end in zip(ends - blocks, ends, strict=True)
    ]
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))


def winkler(own, lower, upper):
    off = np.maximum(lower - own, own - upper)
    return float(np.mean(upper - lower + 40.0 * np.maximum(off, 0.0)))


def test_intervals_of_a_new_flight_are_narrower_and_cover(learned):
    own = errors(99, constant=1.5)
    still = bounds(AdaptiveIntervals(0.95, RATE_HZ), own)
    moved = bounds(AdaptiveIntervals(0.95, RATE_HZ, learned), own)
    assert winkler(own, *moved) < 0.6 * winkler(own, *still)
    assert np.mean((moved[0] <= own) & (own <= moved[1])) == pytest.approx(0.95, abs=0.01)
    assert all(moved.narrower < 0.5 for moved in learned.axes.values())


def test_an_error_counts_after_the_delay_of_the_low_pass(learned):
    own, other = errors(98), errors(98)
    other[400] += 3.0
    first, second = (bounds(AdaptiveIntervals(0.95, RATE_HZ, learned), of) for of in (own, other))
    centres = [0.5 * (lower + upper) for lower, upper in (first, second)]
    differ = np.flatnonzero(np.any(np.abs(centres[0] - centres[1]) > 1e-9, axis=1))
    assert differ[0] == 400 + delay(RATE_HZ)
    assert delay(RATE_HZ) / RATE_HZ == pytest.approx(DELAY_S)
    assert [delay(rate_hz) for rate_hz in (10.0, 50.0, 100.0, 1000.0)] == [1, 1, 2, 14]


def test_blocks_of_any_length_give_the_same_bits(learned):
    own = errors(97)
    whole = bounds(AdaptiveIntervals(0.95, RATE_HZ, learned), own)
    parts = bounds(AdaptiveIntervals(0.95, RATE_HZ, learned), own, (1,) * 70 + (930, 9000))
    np.testing.assert_array_equal(whole, parts)


def test_reset_forgets_the_flight(learned):
    own, intervals = errors(96), AdaptiveIntervals(0.95, RATE_HZ, learned)
    first = bounds(intervals, own)
    intervals.reset()
    np.testing.assert_array_equal(first, bounds(intervals, own))


def test_what_is_not_known_leaves_the_centre(learned):
    intervals = AdaptiveIntervals(0.95, RATE_HZ, learned)
    bounds(intervals, errors(95, constant=2.0))
    bounds(intervals, np.full((delay(RATE_HZ), 6), np.nan), (delay(RATE_HZ),))
    lower, upper = bounds(intervals, np.full((500, 6), np.nan), (500,))
    np.testing.assert_array_equal(lower, np.broadcast_to(lower[0], lower.shape))
    assert np.all(0.5 * (lower + upper) > 0.5)


def test_nothing_is_learned_of_flights_outside_the_range_of_the_others():
    flights = [LeftErrors(RATE_HZ, of_flight(errors(seed), inside=False)) for seed in range(3)]
    assert calibrate_centre(flights, 0.95) is None
    assert calibrate_centre([], 0.95) is None


def test_samples_far_apart_teach_no_short_means():
    flights = [LeftErrors(20.0, of_flight(errors(seed)[::25])) for seed in range(5)]
    centre = calibrate_centre(flights, 0.95)
    assert centre is not None
    for moved in centre.axes.values():
        np.testing.assert_array_equal(moved.coefficients != 0.0, np.array(MEMORIES_S) >= 0.02)
