# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A rotor whose thrust is gone has stopped, whatever its telemetry says; zeros alone are bad data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.monitor import alarm_kernel
from quadpi_core.monitor.alarm import Alarm
from quadpi_core.monitor.alarm_log import reasons
from quadpi_core.monitor.preparation import ROTOR_DIFFERS, ROTOR_FROZEN, ROTOR_JUMPS, ROTOR_ZERO
from quadpi_core.results import BAD_DATA, LEVEL_ALARM, MISCOVERAGE
from quadpi_core.vehicle import Vehicle
from test.core.monitor.alarm_samples import LIMITS, SETTINGS, Samples

HOVER_RAD_S = 700.0
BEBOP = Vehicle.load("bebop2")
THRUST_N = BEBOP.mass_kg * BEBOP.gravity_m_s2 / 4.0
LIMITS_OF_BEBOP = replace(LIMITS, miscoverage_s=np.full(6, 100.0), hover_rotor_speed=HOVER_RAD_S)


def hovering(lost: float = 0.0, rotor: int = 2, shown=(1.0, 1.0, 1.0), until_s: float = 4.0) -> Samples:
    """Hover in a steady wind; at 2 s a rotor loses a share of its thrust, seen in Fz, Mx and My by shares."""
    samples = Samples(4.0)
    samples.rotor_speeds[:] = HOVER_RAD_S
    x, y, _ = BEBOP.rotor_positions[rotor]
    samples.measured[:, [2, 3, 4]] = [-4.0 * THRUST_N + 0.3, 0.02, -0.01]
    change = lost * THRUST_N * np.array(shown) * [1.0, y, -x]
    samples.measured[samples.between(2.0, until_s), 2:5] += change
    return samples


def reading_zero(samples: Samples, rotor: int, start_s: float, stop_s: float) -> Samples:
    window = samples.between(start_s, stop_s)
    samples.rotor_speeds[window, rotor] = 0.0
    samples.faults[window] |= ROTOR_ZERO << rotor
    return samples


def watched(envelope, samples: Samples, block: int | None = None):
    return samples.run(Alarm(envelope, LIMITS_OF_BEBOP, SETTINGS, vehicle=BEBOP), block)


def alarms(rows) -> list[tuple[float, int, tuple[str, ...]]]:
    """Seconds, causes and reasons of the rows at alarm level."""
    return [
        (1e-9 * (rows.time_ns[k] - 1_000_000_000), int(rows.causes[k]), reasons(rows, k))
        for k in np.flatnonzero(rows.level == LEVEL_ALARM)
    ]


@pytest.mark.parametrize("rotor", range(4))
@pytest.mark.parametrize("telemetry", ["goes on", "reads 0", "fails as well"])
def test_a_rotor_without_thrust_has_stopped(envelope, rotor: int, telemetry: str):
    samples = hovering(1.0, rotor)
    if telemetry == "reads 0":
        reading_zero(samples, rotor, 2.0, 4.0)
    elif telemetry == "fails as well":
        for fault in (ROTOR_FROZEN, ROTOR_DIFFERS):
            samples.faults[samples.between(2.05, 4.0)] |= fault << rotor
    rows = watched(envelope, samples)
    seconds, _, words = alarms(rows)[0]
    lasts = alarm_kernel.SILENT_LOST_S if telemetry == "reads 0" else alarm_kernel.LOST_S
    assert seconds == pytest.approx(2.0 + lasts.value, abs=0.01)
    assert f"rotor {rotor + 1} stopped" in words
    assert not np.any(rows.causes[rows.time_ns > 3_060_000_000] & BAD_DATA)
    np.testing.assert_array_equal(watched(envelope, samples, 7).stopped, rows.stopped)


@pytest.mark.parametrize("seconds", [0.006, 0.03, 1.5])
def test_zeros_of_the_telemetry_alone_are_bad_data(envelope, seconds: float):
    rows = watched(envelope, reading_zero(hovering(), 1, 2.0, 2.0 + seconds))
    first, causes, words = alarms(rows)[0]
    assert first == pytest.approx(2.25, abs=0.02)
    assert (causes, words) == (BAD_DATA, ("rotor 2 reads 0",))
    assert not np.any(rows.stopped)


@pytest.mark.parametrize(
    ("share", "stopped"),
    [
        (0.98 * alarm_kernel.LOST_SHARE.value, False),
        (1.02 * alarm_kernel.LOST_SHARE.value, True),
        (0.95 * alarm_kernel.LOST_MOST.value, True),
        # The mean follows while this lasts.
        (1.25 * alarm_kernel.LOST_MOST.value, False),
    ],
)
@pytest.mark.parametrize("shown", range(3))
def test_every_axis_must_show_half_of_the_loss_and_no_more_than_twice(envelope, shown, share, stopped):
    shares = np.ones(3)
    shares[shown] = share
    assert np.any(watched(envelope, hovering(1.0, shown=shares, until_s=2.07)).stopped) == stopped


@pytest.mark.parametrize(("factor", "stopped"), [(0.9, False), (1.1, True)])
def test_a_loss_must_last(envelope, factor: float, stopped: bool):
    samples = hovering(1.0, until_s=2.0 + factor * alarm_kernel.LOST_S.value)
    assert np.any(watched(envelope, samples).stopped) == stopped


@pytest.mark.parametrize(("factor", "stopped"), [(0.9, True), (1.1, False)])
def test_a_rotor_whose_speed_swings_tells_by_its_readings_alone(envelope, factor: float, stopped: bool):
    """In fast turns it is told to slow down: without a reading, a loss of thrust is no stop."""
    samples = hovering(1.0, until_s=2.15)
    swing = 1.0 + factor * alarm_kernel.STEADY_SHARE.value * (-1.0) ** np.arange(len(samples.time_ns))
    samples.rotor_speeds[:, 2] *= np.sqrt(swing)
    assert np.any(watched(envelope, reading_zero(samples, 2, 2.0, 2.15)).stopped) == stopped


@pytest.mark.parametrize(("factor", "stopped"), [(0.95, False), (1.05, True)])
def test_a_rotor_without_a_reading_may_slow_down_with_the_others(envelope, factor: float, stopped: bool):
    samples = hovering(1.0, until_s=2.15)
    slow = samples.between(2.0, 2.15)
    share = factor * alarm_kernel.TOGETHER_SHARE.value
    samples.rotor_speeds[slow] *= np.sqrt(share)
    for k in (0, 1, 3):  # what they lose is measured
        x, y, _ = BEBOP.rotor_positions[k]
        samples.measured[slow, 2:5] += (1.0 - share) * THRUST_N * np.array([1.0, y, -x])
    assert np.any(watched(envelope, reading_zero(samples, 2, 2.0, 2.15)).stopped) == stopped


@pytest.mark.parametrize("fault", [ROTOR_FROZEN, ROTOR_JUMPS])
def test_sensors_of_other_rotors_are_judged_while_one_is_stopped(envelope, fault: int):
    samples = hovering(1.0)
    samples.faults[samples.between(2.5, 4.0)] |= fault << 1 | fault << 2
    rows = watched(envelope, samples)
    assert rows.stopped[-1] == 1 << 2
    assert rows.faults[-1] == fault << 1
    assert rows.causes[-1] == MISCOVERAGE | BAD_DATA


def test_readings_that_come_back_tell_of_no_loss(envelope):
    """A sensor that reads half for a while: its return looks as if thrust were lost."""
    samples = hovering()
    samples.rotor_speeds[samples.between(1.0, 2.0), 0] *= 0.5
    for second in (1.0, 2.0):
        samples.faults[round(500 * second)] |= ROTOR_JUMPS
    assert not np.any(watched(envelope, samples).stopped)


def test_a_rotor_whose_thrust_is_back_turns_again(envelope):
    samples = hovering(1.0, until_s=2.5)
    rows = watched(envelope, samples)
    assert MISCOVERAGE in rows.causes[rows.time_ns < 3_600_000_000]
    assert not np.any(rows.stopped[rows.time_ns > 4_200_000_000])
