# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Misses of the interval, axis by axis."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.monitor.alarm import Alarm
from quadpi_core.monitor.alarm_log import reasons
from quadpi_core.results import ACTIVE, LEVEL_ALARM, LEVEL_OK, MISCOVERAGE, WAITING
from test.core.monitor.alarm_samples import (
    ALLOWANCE,
    FX,
    LIMITS,
    MY,
    SETTINGS,
    Samples,
    changes,
    missing_shares,
)


def test_misses_beyond_the_allowance_raise_the_axis_when_their_sum_reaches_its_limit(envelope):
    samples = Samples(10.0)
    missing_shares(samples, MY, 0.5, 2.0, 10.0)
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    raised = int(np.argmax(rows.level == LEVEL_ALARM))
    seconds = 1e-9 * (rows.time_ns[raised] - samples.time_ns[0])
    assert seconds == pytest.approx(2.0 + 1.0 / (0.5 - ALLOWANCE), abs=0.02)
    assert rows.causes[raised] == MISCOVERAGE
    assert np.argmax(rows.miscoverage[raised]) == MY
    assert rows.miss_share[-1, MY] == pytest.approx(0.5, abs=0.05)
    assert "My outside its interval" in reasons(rows, raised)[0]


def test_misses_count_once_the_state_has_settled(envelope):
    samples = Samples(8.0)
    samples.measured[:, MY] = 2.0
    unsettled = samples.between(0.0, 3.0)
    samples.settled[unsettled] = False
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    seconds = 1e-9 * (rows.time_ns - samples.time_ns[0])
    assert np.all(rows.cause_health[seconds < 3.0, :2] == [ACTIVE, WAITING])
    assert np.all(rows.cause_health[seconds >= 3.0, :2] == ACTIVE)
    raised = seconds[np.argmax(rows.level == LEVEL_ALARM)]
    assert raised == pytest.approx(3.0 + 1.0 / (1.0 - ALLOWANCE), abs=0.02)


def test_an_alarm_stands_while_the_state_settles_anew(envelope):
    samples = Samples(8.0)
    samples.measured[samples.between(0.0, 3.0), MY] = 2.0
    samples.settled[samples.between(3.0, 6.0)] = False
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    seconds = 1e-9 * (rows.time_ns - samples.time_ns[0])
    assert np.all(rows.level[(seconds > 2.0) & (seconds < 6.0)] == LEVEL_ALARM)


def test_allowed_misses_raise_nothing_however_long(envelope):
    samples = Samples(120.0)
    missing_shares(samples, FX, 0.1, 0.0, 120.0)
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert not np.any(rows.causes)


def test_miscoverage_clears_within_bounded_time(envelope):
    samples = Samples(60.0)
    samples.measured[samples.between(1.0, 41.0), FX] = 2.0
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    # From one and a half limits down to a quarter, at the allowance.
    cleared = 41.0 + 1.25 / ALLOWANCE
    assert changes(rows)[-1][0] == pytest.approx(cleared, abs=0.05)
    assert changes(rows)[-1][1] == LEVEL_OK


def test_axes_that_the_model_does_not_hold_are_not_tested(envelope):
    samples = Samples(5.0)
    samples.measured[:, MY] = 2.0
    held = np.arange(6) != MY
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS, held))
    assert not np.any(rows.causes)


def test_the_interval_of_the_calibration_counts_not_the_one_that_goes_out(envelope):
    samples = Samples(5.0)
    samples.measured[:, FX] = 1.5
    assert MISCOVERAGE in samples.run(Alarm(envelope, LIMITS, SETTINGS)).causes
    wider = Alarm(envelope, LIMITS, SETTINGS, interval_ratio=np.full(6, 2.0))
    assert MISCOVERAGE not in samples.run(wider).causes
