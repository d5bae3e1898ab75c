# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from quadpi_core.monitor.health import Latency, TopicHealth


def take(health: TopicHealth, start_s: float, rate_hz: float, samples: int) -> float:
    for index in range(samples):
        health.take(round(1e9 * (start_s + index / rate_hz)))
    return start_s + samples / rate_hz


def test_rates_by_arrival_and_by_stamps_differ():
    health = TopicHealth(500.0)
    take(health, 10.0, 500.0, 400)
    report = health.report(2.0)
    assert report.samples == report.total == 400
    assert report.rate_hz == 200.0
    assert report.stamp_rate_hz == pytest.approx(500.0)
    assert report.gaps == 0
    assert report.newest_ns == round(1e9 * (10.0 + 399 / 500.0))


def test_a_gap_is_counted_and_not_part_of_the_rate():
    health = TopicHealth(500.0)
    end_s = take(health, 0.0, 500.0, 200)
    take(health, end_s + 0.1, 500.0, 200)
    report = health.report(1.0)
    assert report.gaps == 1
    assert report.longest_gap_s == pytest.approx(0.102)
    assert report.stamp_rate_hz == pytest.approx(500.0)
    assert health.report(1.0).gaps == 0


def test_a_topic_far_slower_than_its_nominal_rate_has_the_rate_of_its_stamps():
    health = TopicHealth(500.0)
    take(health, 0.0, 100.0, 100)
    assert health.report(1.0).stamp_rate_hz == pytest.approx(100.0)


def test_without_a_nominal_rate_the_usual_step_tells_a_gap():
    health = TopicHealth()
    end_s = take(health, 0.0, 120.0, 120)
    assert health.report(1.0).gaps == 0
    take(health, end_s + 0.5, 120.0, 60)
    assert health.report(1.0).gaps == 1


def test_refusals_are_counted_by_reason_and_bounded():
    health = TopicHealth()
    assert health.silent
    for index in range(100):
        health.refuse(f"reason {index}")
    assert not health.silent
    assert health.unread
    report = health.report(1.0)
    assert not health.unread
    assert report.refused_now == sum(report.refused.values()) == 100
    assert len(report.refused) <= 17
    assert health.silent
    assert health.report(1.0).refused_now == 0


def test_stamps_that_do_not_advance_count_as_arrived_only():
    health = TopicHealth(500.0)
    for _ in range(10):
        health.take(1_000)
    report = health.report(1.0)
    assert report.samples == 10
    assert report.stamp_rate_hz is None


def test_latency_skips_samples_without_a_result():
    latency = Latency()
    assert latency.report(0) is None
    for stamp in range(100):
        latency.arrived(stamp, 1_000_000 * stamp)
    for stamp in range(0, 100, 2):
        latency.published(stamp, 1_000_000 * stamp + 3_000_000)
    latency.published(5, 0)
    report = latency.report(None)
    assert report.arrival == pytest.approx((3e-3, 3e-3))
    assert report.stamp is None
    assert latency.report(0) is None


@pytest.mark.parametrize(
    ("ahead_s", "expected_s"), [(1000.0, 7e-3), (1001.0, 1.007), (1010.0, None), (999.0, None)]
)
def test_latency_from_the_stamp_where_both_are_of_one_clock(ahead_s, expected_s):
    latency = Latency()
    monotonic_ns, stamp_ns = 5_000_000_000, 1_005_000_000_000
    for sample in range(10):
        at_ns = 1_000_000 * sample
        latency.arrived(stamp_ns + at_ns, monotonic_ns + at_ns + 4_000_000)
        latency.published(stamp_ns + at_ns, monotonic_ns + at_ns + 7_000_000)
    report = latency.report(round(1e9 * ahead_s))
    assert report.arrival == pytest.approx((3e-3, 3e-3))
    if expected_s is None:
        assert report.stamp is None
    else:
        assert report.stamp == pytest.approx((expected_s, expected_s))
