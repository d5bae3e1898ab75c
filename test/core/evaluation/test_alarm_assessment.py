# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which alarms count as false, and of how much flight a rate is stated."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.evaluation.alarm_assessment import SIGNALS, FlightAlarm, assess
from quadpi_core.paths import bags_directory
from quadpi_core.report.evaluation_page import alarm_lines
from quadpi_core.report.table import number
from quadpi_core.results import JUDGED, NO_SAMPLES

RATE_HZ = 50
GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "model"


def flight(duration_s: float, *, raised=(), outside=(), missed=(), unknown=()) -> FlightAlarm:
    """A flight with spans (from, to) in seconds of alarm, of inputs outside, of misses, of nothing known."""
    time = np.arange(0.0, duration_s, 1.0 / RATE_HZ)

    def within(spans):
        return np.any([(time >= start) & (time < end) for start, end in spans] or [time < 0.0], axis=0)

    misses = np.repeat(within(missed)[:, None], 6, axis=1)
    scores = {name: np.zeros(len(time)) for name in SIGNALS}
    why = np.where(within(unknown), NO_SAMPLES, JUDGED)
    levels = np.stack((within(raised), *np.zeros((3, len(time)), dtype=bool)), axis=1)
    return FlightAlarm(time, scores, levels, misses, why, within(outside))


def test_an_alarm_outside_the_envelope_is_not_false_and_counts_apart():
    found = assess([flight(120.0, raised=[(20.0, 25.0), (40.0, 41.0)], outside=[(19.0, 26.0)])])
    assert (found.false_alarms, found.alarms_outside) == (1, 1)
    assert 3600.0 * found.hours_outside == pytest.approx(7.0)
    assert 3600.0 * found.hours_inside == pytest.approx(113.0, abs=0.1)
    assert found.false_alarms_per_hour == pytest.approx(3600.0 / 113.0, rel=1e-3)


def test_an_alarm_while_the_model_is_off_is_neither():
    found = assess([flight(120.0, raised=[(21.0, 25.0)], missed=[(20.0, 26.0)])])
    assert (found.false_alarms, found.alarms_outside, found.flights_off) == (0, 0, 1)
    assert found.hours_inside < found.hours_monitored


@pytest.mark.parametrize(("duration_s", "stated"), [(59.0, False), (62.0, True)])
def test_a_rate_takes_a_minute(duration_s, stated):
    found = assess([flight(duration_s, raised=[(5.0, 6.0)])])
    assert found.false_alarms == 1
    assert (found.false_alarms_per_hour is not None) is stated
    (sentence,) = alarm_lines(found)
    assert ("too short for a rate" in sentence) is not stated
    # Exact Poisson bound of one event: 4.74 over the time.
    assert found.false_alarms_per_hour_bound == pytest.approx(4.744 / found.hours_inside, rel=1e-3)
    # Exact Poisson interval of one event: 0.0253 to 5.572.
    low, high = found.false_alarms_per_hour_interval
    assert (low, high) == pytest.approx((0.0253 / found.hours_inside, 5.572 / found.hours_inside), rel=1e-3)
    at_most = f"at most {number(found.false_alarms_per_hour_bound)} per hour"
    estimated = f"estimated: {number(1.0 / found.hours_inside)} per hour, {number(low)} to {number(high)}, at"
    assert (estimated if stated else at_most) in sentence


def test_flights_add_up_to_a_minute_and_what_was_not_monitored_does_not_count():
    half = flight(35.0)
    assert assess([half]).false_alarms_per_hour is None
    assert assess([half, half]).false_alarms_per_hour == 0.0
    blind = flight(70.0, unknown=[(10.0, 50.0)])
    assert assess([blind]).false_alarms_per_hour is None
    assert 3600.0 * assess([blind]).hours_monitored == pytest.approx(30.0, abs=0.1)


def test_what_is_not_judged_is_said_for_all_flights_together():
    blind = replace(flight(70.0, unknown=[(10.0, 15.0)]), recorded_s=100.0)
    found = assess([blind, flight(100.0)])
    assert found.not_judged_fraction == pytest.approx(35.0 / 200.0, abs=1e-3)
    begun = "15.0 % state or rotor speeds have not begun, 2.5 % no usable samples"
    assert f"not judged for 17.5 % of the time: {begun}" in alarm_lines(found)[0]


def test_the_bundled_flight_that_leaves_the_envelope_raises_no_false_alarm(quadpi, tmp_path):
    data = tmp_path / "data.json"
    ran = quadpi("evaluate", GOLDEN, bags_directory() / "extrapolation.mcap", "--json", data)
    assert (ran.status, ran.errors) == (0, "")
    alarm = json.loads(data.read_text())["groups"]["all"]["alarm"]
    assert alarm["false_alarms"] == 0
    assert alarm["alarms_outside"] > 0
    assert alarm["false_alarms_per_hour"] is None
    assert "too short for a rate" in ran.output


@pytest.mark.parametrize(("missed_s", "off"), [(1.4, 0), (1.6, 1)])
def test_a_model_is_off_where_it_misses_more_than_half_of_three_seconds(missed_s, off):
    assert assess([flight(60.0, missed=[(20.0, 20.0 + missed_s)])]).flights_off == off
