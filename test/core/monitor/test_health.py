# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Counts, rates and latencies; silence by a steady clock, and the alarm that says it without a sample."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.flight import NO_STAMP
from quadpi_core.messages.result_messages import pack_alarms, unpack_alarms
from quadpi_core.monitor import Monitor
from quadpi_core.monitor.alarm_log import Explained
from quadpi_core.monitor.health import Arrived, Latency, Silence, TopicHealth, lack
from quadpi_core.monitor.pairing import Pairing
from quadpi_core.results import BAD_DATA, LEVEL_ALARM, UNAVAILABLE

from .conftest import RATE_HZ

MS = 1_000_000


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
    ("stamp_s", "comparable"),
    [(7e-3, True), (1.007, True), (-0.011, False), (-0.009, True), (4.9, True), (5.1, False)],
)
def test_latency_from_the_stamp_where_both_are_of_one_clock(stamp_s, comparable):
    """Results before their stamps or long after are of another."""
    latency = Latency()
    monotonic_ns, stamp_ns = 5_000_000_000, 1_005_000_000_000
    for sample in range(10):
        at_ns = 1_000_000 * sample
        latency.arrived(stamp_ns + at_ns, monotonic_ns + at_ns + 4_000_000)
        latency.published(stamp_ns + at_ns, monotonic_ns + at_ns + 7_000_000)
    report = latency.report(round(1e9 * (999.993 + stamp_s)))
    assert report.arrival == pytest.approx((3e-3, 3e-3))
    assert report.stamp == (pytest.approx((stamp_s, stamp_s), rel=1e-6) if comparable else None)


def test_latency_is_that_of_the_last_4096_results():
    latency = Latency()
    for stamp in range(4196):
        latency.arrived(stamp, 0)
        latency.published(stamp, 10**9 if stamp < 100 else 10**6)
    assert latency.report(None).arrival == pytest.approx((1e-3, 1e-3))


@pytest.mark.parametrize(("steps", "gaps"), [(2.4, 0), (2.6, 1)])
@pytest.mark.parametrize("nominal_hz", [100.0, None])
def test_a_step_of_two_and_a_half_is_a_gap(steps, gaps, nominal_hz):
    health = TopicHealth(nominal_hz)
    for time_ns in range(0, 100 * MS, 10 * MS):
        health.take(time_ns)
    health.report(1.0)
    health.take(90 * MS + round(10 * MS * steps))
    assert health.report(1.0).gaps == gaps


class Watched:
    """A pairing, a clock and what is said of them every tenth of a second."""

    def __init__(self) -> None:
        self.pairing, self.silence = Pairing(), Silence()
        self.now_s, self.stamp_ns = 100.0, 1_700_000_000_000_000_000
        self.silence.follow(self.now_s, self.pairing.arrived)

    def wait(self, seconds: float, *topics: str) -> tuple[str, ...]:
        """Go on with those topics; what is said at the end."""
        for _ in range(round(10.0 * seconds)):
            for _ in range(20):
                self.stamp_ns += 5 * MS
                if "imu" in topics:
                    self.pairing.add_imu(self.stamp_ns, np.zeros(3))
                if "state" in topics:
                    level = np.array([1.0, 0.0, 0.0, 0.0])
                    self.pairing.add_state(self.stamp_ns, np.zeros(3), level, np.zeros(3))
                if "rotors" in topics:
                    self.pairing.add_rotor_speeds(self.stamp_ns, np.ones(4))
                self.pairing.take()
            self.now_s += 0.1
            self.silence.follow(self.now_s, self.pairing.arrived)
        return self.silence.reasons


ALL = ("imu", "state", "rotors")


def test_what_never_came_and_what_stopped_is_told_apart() -> None:
    watched = Watched()
    assert watched.wait(0.2) == ()
    assert watched.wait(0.2) == ("no imu yet", "no rotor speeds yet")
    assert watched.wait(0.4, "imu", "rotors") == ("no state yet",)
    assert watched.wait(0.4, *ALL) == ("no sample is complete yet",)
    assert watched.wait(1.5, *ALL) == ()
    assert watched.wait(0.2) == ()
    assert watched.wait(0.2) == ("no imu for 0.4 s", "no rotor speeds for 0.4 s")
    assert watched.silence.elapsed_s == pytest.approx(0.4)
    assert watched.wait(0.1, *ALL) == ()


def test_what_is_missing_while_the_imu_goes_on_is_said_by_the_samples() -> None:
    """They are given up and judged: that is no silence."""
    watched = Watched()
    watched.wait(1.5, *ALL)
    assert watched.wait(1.0, "imu", "state") == ()
    assert watched.pairing.counts.dropped > 0


def test_a_sensor_that_lacks_is_said_by_its_stamps() -> None:
    assert lack("motion capture", NO_STAMP, 10**9) == ["no motion capture yet"]
    assert lack("motion capture", 10**9, 31 * 10**8) == ["no motion capture for 2.1 s"]
    assert lack("motion capture", 10**9, 10**9 + 10**8) == lack("motion capture", 10**18, 10**9) == []
    assert lack("odometry", 0, 7_200 * 10**9) == ["no odometry for 7200 s, or its clock differs"]


def test_stamps_that_stand_still_are_silence() -> None:
    watched = Watched()
    watched.wait(1.5, *ALL)
    last_ns = watched.stamp_ns
    for _ in range(4):
        watched.pairing.add_imu(last_ns, np.zeros(3))
        told = watched.wait(0.1)
    assert told == ("no imu for 0.4 s", "no rotor speeds for 0.4 s")


def test_a_process_that_was_held_up_does_not_blame_the_sensors() -> None:
    silence = Silence()
    silence.follow(0.0, Arrived(1, 1, 1, 1))
    silence.follow(5.0, Arrived(1, 1, 1, 1))
    assert silence.reasons == ()


def test_an_alarm_without_a_sample_says_bad_data_and_changes_nothing(model, vehicle, samples) -> None:
    whole = Monitor(model, vehicle, RATE_HZ)
    expected = whole.step(*samples)[1]
    interrupted, rows = Monitor(model, vehicle, RATE_HZ), []
    for part in (slice(0, 2000), slice(2000, None)):
        rows.append(interrupted.step(*(column[part] for column in samples))[1])
        told = interrupted.alarm_without_sample(int(samples.time_ns[part][-1]) + 400 * MS)
    np.testing.assert_array_equal(np.concatenate([row.time_ns for row in rows]), expected.time_ns)
    np.testing.assert_array_equal(np.concatenate([row.leverage for row in rows]), expected.leverage)
    assert interrupted.events == whole.events
    reported = unpack_alarms(pack_alarms(told, [("no imu for 0.4 s",)]))
    assert reported.time_ns.tolist() == [int(samples.time_ns[-1]) + 400 * MS]
    assert reported.level.tolist() == [LEVEL_ALARM]
    assert reported.causes.tolist() == [BAD_DATA]
    assert reported.cause_health.tolist() == [[UNAVAILABLE] * 4]
    assert reported.reasons == [("no imu for 0.4 s",)]
    assert not reported.of_samples.any()
    assert unpack_alarms(pack_alarms(expected, Explained().rows(expected))).of_samples.all()
    assert len(reported.where(reported.of_samples).reasons) == 0
