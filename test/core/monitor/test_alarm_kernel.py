# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How a sample changes the alarm: misses axis by axis, the ground, and when the model is not judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.alarm_limits import AlarmLimits
from quadpi_core.monitor.alarm import Alarm
from quadpi_core.monitor.alarm_log import reasons
from quadpi_core.monitor.preparation import (
    GYRO_FROZEN,
    ROTOR_DIFFERS,
    ROTOR_FROZEN,
    ROTOR_HALF,
    ROTOR_JUMPS,
    ROTOR_ZERO,
    STAMP_REPEATED,
)
from quadpi_core.results import (
    ACTIVE,
    BAD_DATA,
    EXTRAPOLATION,
    LEVEL_ALARM,
    LEVEL_OK,
    MISCOVERAGE,
    UNAVAILABLE,
    UNCALIBRATED,
    WAITING,
    WIND_UNKNOWN,
)
from test.core.monitor.alarm_samples import (
    ALLOWANCE,
    FX,
    FZ,
    LIMITS,
    MY,
    SETTINGS,
    Samples,
    U,
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
    assert "pitch moment outside its interval" in reasons(rows, raised)[0]


@pytest.mark.parametrize(("axis", "from_s"), [(FX, 3.0), (FZ, 0.0), (MY, 3.0)])
def test_misses_count_once_the_state_has_settled_those_of_fz_at_once(envelope, axis, from_s):
    samples = Samples(8.0)
    samples.measured[:, axis] = 2.0
    unsettled = samples.between(0.0, 3.0)
    samples.settled[unsettled] = False
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    seconds = 1e-9 * (rows.time_ns - samples.time_ns[0])
    assert np.all(rows.cause_health[seconds < 3.0, :2] == [ACTIVE, WAITING])
    assert np.all(rows.cause_health[seconds >= 3.0, :2] == ACTIVE)
    raised = seconds[np.argmax(rows.level == LEVEL_ALARM)]
    assert raised == pytest.approx(from_s + 1.0 / (1.0 - ALLOWANCE), abs=0.02)


@pytest.mark.parametrize(("axis", "from_s"), [(FX, 3.0), (1, 3.0), (FZ, 0.0), (MY, 0.0)])
def test_only_misses_of_horizontal_forces_wait_for_the_wind(envelope, axis, from_s):
    samples = Samples(8.0)
    samples.measured[:, axis] = 2.0
    samples.wind_unknown[samples.between(0.0, 3.0)] = True
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    seconds = 1e-9 * (rows.time_ns - samples.time_ns[0])
    assert np.all(rows.cause_health[:, :2] == ACTIVE)
    assert np.all((rows.why_not_judged == WIND_UNKNOWN) == (seconds < 3.0))
    assert reasons(rows, 0) == (
        "coverage not judged: the wind is not told yet, the horizontal forces are not judged: fly or turn "
        "(100 % of the time so far)",
    )
    raised = seconds[np.argmax(rows.level == LEVEL_ALARM)]
    assert raised == pytest.approx(from_s + 1.0 / (1.0 - ALLOWANCE), abs=0.02)


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


def test_misses_where_the_model_is_not_to_be_trusted_tell_nothing_of_the_vehicle(envelope):
    """While an input other than those of thrust raises EXTRAPOLATION; from its end on they count again."""
    samples = Samples(6.0)
    samples.measured[samples.between(1.5, 6.0), FX] = 2.0
    samples.inputs[samples.between(1.0, 4.0), U] = 1.8
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    seconds = 1e-9 * (rows.time_ns - rows.time_ns[0])
    assert not np.any(rows.causes[seconds < 4.0] & MISCOVERAGE)
    assert np.all(rows.causes[seconds > 5.2] & MISCOVERAGE)
    samples.inputs[samples.between(1.0, 4.0), U] = 0.0
    samples.inputs[samples.between(1.0, 4.0), INPUT_NAMES.index("omega_avg")] = 1.8
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    early = (rows.time_ns - rows.time_ns[0] > 2_700_000_000) & (
        rows.time_ns - rows.time_ns[0] < 4_000_000_000
    )
    assert np.all(rows.causes[early] == EXTRAPOLATION | MISCOVERAGE)


def take_off_and_land() -> Samples:
    """On the ground until 2 s with idling rotors, in the air until 6 s, down again; misfits all the time."""
    samples = Samples(9.0)
    samples.rotor_speeds[:] = 300.0
    samples.rotor_speeds[samples.between(2.0, 6.0)] = 1000.0
    samples.inputs[:, U] = 1.8
    samples.measured[:, FX] = 2.0
    return samples


def test_on_the_ground_the_model_is_not_judged(envelope):
    limits = replace(LIMITS, hover_rotor_speed=1000.0)
    rows = take_off_and_land().run(Alarm(envelope, limits, SETTINGS))
    seconds = 1e-9 * (rows.time_ns - rows.time_ns[0])
    on_ground = (seconds < 2.0) | (seconds > 6.31)
    assert not np.any(rows.causes[on_ground])
    assert np.all(rows.cause_health[on_ground, :2] == WAITING)
    in_flight = (seconds > 3.3) & (seconds < 6.0)
    assert np.all(rows.causes[in_flight] == EXTRAPOLATION)
    assert np.all(rows.cause_health[in_flight, :3] == 0)


def test_slow_rotors_in_a_fall_are_no_landing(envelope):
    limits = replace(LIMITS, hover_rotor_speed=1000.0)
    samples = take_off_and_land()
    samples.specific_force[samples.between(6.0, 9.0), 2] = -4.0
    rows = samples.run(Alarm(envelope, limits, SETTINGS))
    assert rows.causes[-1] == EXTRAPOLATION


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
    of_rotors = (
        ROTOR_FROZEN,
        ROTOR_HALF << 1,
        ROTOR_JUMPS << 3,
        ROTOR_DIFFERS,
        ROTOR_ZERO << 3,
        ROTOR_HALF << 2,
    )
    for fault, on_ground in ((STAMP_REPEATED, True), *((one, False) for one in (GYRO_FROZEN, *of_rotors))):
        samples = Samples(2.0)
        samples.faults[samples.between(1.0, 2.0)] = fault
        flying = samples.run(Alarm(envelope, LIMITS, SETTINGS))
        assert flying.causes[-1] == BAD_DATA
        standing = samples.run(Alarm(envelope, replace(LIMITS, hover_rotor_speed=1e3), SETTINGS))
        assert (standing.causes[-1] == BAD_DATA) == on_ground
    assert reasons(flying, len(flying) - 1) == ("rotor 3 reads half",)


def test_the_share_of_misses_forgets_within_two_seconds(envelope):
    samples = Samples(2.0)
    samples.measured[:, MY] = 2.0
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert rows.miss_share[-1, MY] == pytest.approx(1.0 - np.exp(-1.0), abs=0.03)


def test_a_model_is_not_judged_after_a_tenth_of_a_second_without_a_sample(envelope):
    samples = Samples(1.0)
    samples.usable[samples.between(0.45, 1.0)] = False
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    first = rows.time_ns[np.argmax(rows.cause_health[:, 0] == UNAVAILABLE)]
    assert 1e-9 * (first - samples.time_ns[0]) == pytest.approx(0.548, abs=1e-6)


def test_a_step_counts_for_20_ms_at_most(envelope):
    """So that of slow samples five are as much evidence as 0.1 s of fast ones."""
    samples = Samples(0.04)
    samples.time_ns[:] = samples.time_ns[0] + 50_000_000 * np.arange(20)
    samples.inputs[:, U] = 1.8
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    raised = rows.time_ns[np.argmax(rows.level == LEVEL_ALARM)]
    assert raised - samples.time_ns[0] == 5 * 50_000_000
