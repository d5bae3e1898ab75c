# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.identification.alarm_calibration import (
    Tail,
    lasting_maximum,
    sums_of_misses,
    tails_of_misses,
)

PERSISTENCE_S, RELEASE_S = 0.1, 0.5
STEP_S = 0.01


@pytest.mark.parametrize("flights", [12, 40])
def test_the_chances_of_a_tail_hold_the_truth(flights):
    random, held = np.random.default_rng(6), 0
    for _ in range(300):
        tail = Tail.from_flights(random.exponential(size=flights))
        low, high = np.quantile(tail.chances(6.0, random), (0.025, 0.975))
        held += low <= np.exp(-6.0) <= high
    assert held >= 275


@pytest.mark.parametrize(
    ("pulses", "expected"),
    [
        ([(1.0, 0.08, 5.0)], 0.0),
        ([(1.0, 0.3, 5.0)], 5.0),
        ([(1.0, 0.3, 3.0), (2.0, 0.08, 9.0)], 3.0),
        # The second comes before the first has drained.
        ([(1.0, 0.08, 5.0), (1.1, 0.08, 5.0)], 5.0),
        ([(1.0, 0.08, 5.0), (2.0, 0.08, 5.0)], 0.0),
    ],
)
def test_only_what_lasts_counts(pulses, expected):
    time = np.arange(0.0, 4.0, STEP_S)
    values = np.zeros(len(time))
    for start, length, height in pulses:
        values[(time >= start - 1e-9) & (time < start + length - 1e-9)] = height
    assert lasting_maximum(values, time, PERSISTENCE_S, RELEASE_S) == pytest.approx(expected, abs=1e-6)


def test_the_sequential_test_rises_by_misses_beyond_the_allowed_share():
    time = np.arange(0.0, 2.0, STEP_S)
    miss = np.zeros((len(time), 6))
    miss[100:, 1] = 1.0
    miss[:, 2] = np.nan
    sums = sums_of_misses(time, miss, 0.1)
    assert sums[-1] == pytest.approx([0.0, 0.9 * 100 * STEP_S, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("flights", [8, 12, 40])
def test_a_limit_is_passed_as_often_as_stated_by_what_flights_say_of_the_tail(flights):
    """Of means that flights may have drawn, each followed to the limit."""
    random = np.random.default_rng(2)
    drawn = random.exponential(0.4, (20_000, flights)).mean(axis=1)
    limits = [Tail(0.3, float(mean), 0.25, 1000, flights).limit(0.002) for mean in drawn]
    assert np.mean(0.25 * np.exp(-(np.array(limits) - 0.3) / 0.4)) == pytest.approx(0.002, rel=0.15)


@pytest.mark.parametrize("flights", [8, 12, 40])
def test_one_more_flight_goes_beyond_the_limit_as_often_as_stated(flights):
    """Of flights whose farthest go exponentially far, by mean excesses about the usual one."""
    random, usual = np.random.default_rng(3), 0.75
    means = usual * 6 / random.gamma(6, size=(4000, 1))
    drawn = 2.0 + means * random.exponential(size=(4000, flights + 1))
    passed = sum(one[-1] > Tail.from_flights(one[:-1]).with_usual(usual).limit(0.01) for one in drawn)
    assert 0.004 < passed / len(drawn) < 0.015


def test_the_usual_excess_counts_as_six_flights():
    tail = Tail.from_flights(np.full(40, 2.0)).with_usual(0.75)
    assert (tail.start, tail.count, tail.draws, tail.share) == (2.0, 10, 16, 0.25)
    assert tail.mean == pytest.approx((10 * 0.02 + 6 * 0.75) / 16)


def test_the_farthest_five_of_few_flights_are_its_tail():
    assert [Tail.from_flights(np.arange(float(n))).count for n in (8, 12, 24)] == [4, 5, 6]


def test_axes_share_the_shape_of_their_tails():
    one, other = np.linspace(1.0, 2.0, 12), np.full(12, 3.0)
    alone = Tail.from_flights(one)
    tails = tails_of_misses(np.stack([one, other], axis=1))
    part = 0.5 * (alone.mean / alone.start + 0.02 / 3.0)
    assert [tail.mean for tail in tails] == pytest.approx([alone.mean, 3.0 * part])
    assert {tail.draws for tail in tails} == {5 + 6}


def test_more_alarms_than_one_a_flight_leave_the_start_of_the_tail():
    tail = Tail.from_flights(np.linspace(1.0, 2.0, 12))
    assert tail.limit(5.0) == tail.start < tail.limit(0.1)
