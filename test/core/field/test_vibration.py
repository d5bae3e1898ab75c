# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Vibration of exact flights, as logged and as ArduPilot measures it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.field.airborne import flown
from quadpi_core.field.field_log import Series
from quadpi_core.field.field_report import report_on
from quadpi_core.field.vibration import Vibration, vibration_of
from quadpi_core.reading_options import ReadingOptions

from .field_examples import AIRBORNE, example


def test_vibration_is_what_is_faster_than_manoeuvres():
    log = example()
    shaken = log.imu.values.copy()
    shaken[:, 5] += 3.0 * np.sin(2.0 * np.pi * 60.0 * log.imu.time)
    found = vibration_of(replace(log, imu=replace(log.imu, values=shaken)), flown(log))
    assert isinstance(found, Vibration)
    assert found.force[2].value == pytest.approx(3.0 / 2.0**0.5, rel=0.02)
    assert max(one.value for one in found.force[:2]) < 0.2


def test_vibration_that_comes_and_goes_has_a_wide_interval():
    """For the half of the flight, or all along: the root of the mean square, and what pieces tell of it."""
    log, widths = example(), []
    for until in (30.0, 60.0):
        shaken = log.imu.values.copy()
        shaken[:, 5] += np.where(log.imu.time < until, 3.0, 0.0) * np.sin(2.0 * np.pi * 60.0 * log.imu.time)
        found = vibration_of(replace(log, imu=replace(log.imu, values=shaken)), flown(log))
        widths.append(found.force[2].half_width / found.force[2].value)
        assert found.force[2].low <= 3.0 / 2.0**0.5 * (until / 60.0) ** 0.5 <= found.force[2].high
    assert widths[0] > 0.3
    assert widths[1] < 0.02


def test_vibration_needs_a_fast_imu():
    log = example()
    slow = Series(log.imu.time[::20], log.imu.values[::20])
    assert vibration_of(replace(log, imu=slow), flown(log)) == "the IMU is logged at 10 Hz"


def test_vibe_is_what_a_twentieth_of_the_flight_exceeds():
    """On the ground, where the vehicle is carried and dropped, it does not count."""
    time = np.arange(0.0, 60.0, 0.1)
    aloft = (time > AIRBORNE[0] + 1.0) & (time < AIRBORNE[1] - 1.0)
    level = np.where(aloft, np.where(time % 10.0 < 2.0, 40.0, 5.0), 500.0)
    log = example(imu=None, vibe=Series(time, level[:, np.newaxis] * np.array([0.1, 0.5, 1.0])))
    found = vibration_of(log, flown(log))
    assert found == Vibration(vibe=pytest.approx((4.0, 20.0, 40.0)))
    assert found.worst == ("z", pytest.approx(40.0))


def test_vibe_of_a_real_log(shared_data: Path):
    (flight,) = report_on([shared_data / "rrc_propeller" / "hover_good_1.BIN"], ReadingOptions()).flights
    assert isinstance(flight.vibration, Vibration)
    assert all(0.0 < one < 60.0 for one in flight.vibration.vibe)
    assert flight.looked_at()["vibration"] == ""
