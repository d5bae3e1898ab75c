# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""When the model is not judged, and what the alarm says of itself and of sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core.models.alarm_limits import AlarmLimits
from quadpi_core.models.envelope import Envelope
from quadpi_core.monitor.alarm import Alarm
from quadpi_core.monitor.alarm_log import reasons
from quadpi_core.monitor.data_quality import GYRO_FROZEN, ROTOR_HALF, STAMP_REPEATED
from quadpi_core.results import BAD_DATA, EXTRAPOLATION, MISCOVERAGE, UNAVAILABLE, UNCALIBRATED, WAITING
from test.core.monitor.alarm_samples import FX, LIMITS, OMEGA, SETTINGS, Samples, U


def take_off_and_land() -> Samples:
    """On the ground until 2 s with idling rotors, in the air until 6 s, down again; misfits all the time."""
    samples = Samples(9.0)
    samples.inputs[:, OMEGA] = 300.0
    samples.inputs[samples.between(2.0, 6.0), OMEGA] = 1000.0
    samples.inputs[:, U] = 1.8
    samples.measured[:, FX] = 2.0
    return samples


def wide(envelope: Envelope) -> Envelope:
    upper = envelope.upper.copy()
    upper[OMEGA] = 2000.0
    return replace(envelope, upper=upper)


def test_on_the_ground_the_model_is_not_judged(envelope):
    limits = replace(LIMITS, hover_rotor_speed=1000.0)
    rows = take_off_and_land().run(Alarm(wide(envelope), limits, SETTINGS))
    seconds = 1e-9 * (rows.time_ns - rows.time_ns[0])
    on_ground = (seconds < 2.0) | (seconds > 6.31)
    assert not np.any(rows.causes[on_ground])
    assert np.all(rows.cause_health[on_ground, :2] == WAITING)
    in_flight = (seconds > 3.3) & (seconds < 6.0)
    assert np.all(rows.causes[in_flight] == EXTRAPOLATION | MISCOVERAGE)
    assert np.all(rows.cause_health[in_flight] == 0)


def test_slow_rotors_in_a_fast_descent_are_no_landing(envelope):
    limits = replace(LIMITS, hover_rotor_speed=1000.0)
    samples = take_off_and_land()
    samples.velocity[:, 2] = 4.0
    rows = samples.run(Alarm(wide(envelope), limits, SETTINGS))
    assert rows.causes[-1] == EXTRAPOLATION | MISCOVERAGE


def test_health_without_samples_and_without_calibration(envelope):
    samples = Samples(2.0)
    samples.usable[samples.between(1.0, 1.5)] = False
    rows = samples.run(Alarm(envelope, AlarmLimits(), SETTINGS))
    seconds = 1e-9 * (rows.time_ns - rows.time_ns[0])
    silent = (seconds > 1.1) & (seconds < 1.499)
    assert np.all(rows.cause_health[silent, :2] == UNAVAILABLE)
    assert np.all(rows.cause_health[(seconds < 0.99) | (seconds > 1.51), :2] == UNCALIBRATED)
    assert np.all(rows.cause_health[:, 2] == 0)


def test_faults_of_samples_that_are_used_raise_bad_data_in_flight_only(envelope):
    for fault, on_ground in ((STAMP_REPEATED, True), (GYRO_FROZEN, False), (ROTOR_HALF << 2, False)):
        samples = Samples(2.0)
        samples.faults[samples.between(1.0, 2.0)] = fault
        flying = samples.run(Alarm(envelope, LIMITS, SETTINGS))
        assert flying.causes[-1] == BAD_DATA
        standing = samples.run(Alarm(envelope, replace(LIMITS, hover_rotor_speed=1e3), SETTINGS))
        assert (standing.causes[-1] == BAD_DATA) == on_ground
    assert reasons(flying, len(flying) - 1) == ("rotor 3 reads half",)
