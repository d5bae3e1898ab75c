# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speeds from commands: the lag, pauses, the battery, and the same bits however the commands come."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.flight import BatteryStream, ImuStream, MotorCommandStream, Recording
from quadpi_core.rotor_order import CommandedSpeeds, with_commanded_speeds
from quadpi_core.vehicle import Motors

LAG_S = 0.05
MOTORS = Motors(source="test", coefficients=((100.0, 1000.0, 200.0, 10.0, 20.0),) * 4, lag_s=LAG_S, volts=4.0)


def commands(u, step_s=0.01, start_ns=10**9):
    time_ns = start_ns + np.rint(1e9 * step_s * np.arange(len(u))).astype(np.int64)
    return MotorCommandStream(time_ns, np.tile(np.asarray(u, dtype=float)[:, np.newaxis], 4))


def settled(u, volts):
    return 100.0 + 1000.0 * u + 200.0 * u * u + 10.0 * volts + 20.0 * u * volts


def test_a_step_is_followed_with_the_lag():
    u = np.where(np.arange(200) < 100, 0.4, 0.6)
    speeds = CommandedSpeeds(MOTORS).take(commands(u)).speeds[:, 0]
    np.testing.assert_allclose(speeds[:100], settled(0.4, 4.0))
    # A straight line of 10 ms instead of the step: half of that later.
    after = 0.01 * np.arange(1, 101) - 0.005
    begin, end = settled(0.4, 4.0), settled(0.6, 4.0)
    np.testing.assert_allclose(speeds[100:], end + (begin - end) * np.exp(-after / LAG_S), rtol=2e-3)


def test_the_same_bits_one_by_one_and_at_once():
    rng = np.random.default_rng(3)
    stream = commands(rng.uniform(0.2, 0.8, 300))
    stream.time_ns[:] += rng.integers(0, 4_000_000, 300)
    battery = BatteryStream(stream.time_ns[::7] + 5, rng.uniform(3.4, 4.2, len(stream.time_ns[::7])))
    whole = CommandedSpeeds(MOTORS).take(stream, battery)
    single, place = CommandedSpeeds(MOTORS), 0
    for row in range(300):
        while place < len(battery) and battery.time_ns[place] < stream.time_ns[row]:
            single.take(stream.take(slice(0, 0)), battery.take(slice(place, place + 1)))
            place += 1
        one = single.take(stream.take(slice(row, row + 1)))
        assert one.speeds.tobytes() == whole.speeds[row].tobytes()


def test_a_motor_that_is_commanded_0_stands_and_a_pause_begins_anew():
    stream = commands([0.5, 0.5, 0.0])
    stream.time_ns[2] += 5 * 10**9
    speeds = CommandedSpeeds(MOTORS).take(stream).speeds[:, 0]
    np.testing.assert_allclose(speeds, [settled(0.5, 4.0), settled(0.5, 4.0), 0.0])


def test_a_stamp_that_does_not_rise_changes_nothing_until_the_clock_fell():
    stream = commands([0.5, 0.9, 0.5, 0.7])
    stream.time_ns[:] = [90 * 10**9, 90 * 10**9 - 1, 90 * 10**9 + 10**7, 10**9]
    speeds = CommandedSpeeds(MOTORS).take(stream).speeds[:, 0]
    np.testing.assert_allclose(speeds, [settled(u, 4.0) for u in (0.5, 0.5, 0.5, 0.7)])


def test_the_battery_counts_from_the_command_after_it():
    stream = commands([0.5] * 3, step_s=2.0)
    battery = BatteryStream(stream.time_ns[1:2] + 1, np.array([3.0]))
    speeds = CommandedSpeeds(MOTORS).take(stream, battery).speeds[:, 0]
    np.testing.assert_allclose(speeds, [settled(0.5, volts) for volts in (4.0, 4.0, 3.0)])


def test_speeds_are_stamped_later_by_the_dead_time():
    late = Motors(source="test", coefficients=MOTORS.coefficients, lag_s=0.0, dead_s=0.008)
    stream = commands([0.4, 0.6])
    told = CommandedSpeeds(late).take(stream)
    assert (told.time_ns - stream.time_ns).tolist() == [8_000_000] * 2
    np.testing.assert_allclose(told.speeds[:, 0], [settled(u, 1.0) for u in (0.4, 0.6)])


def test_commands_of_another_number_of_motors_are_refused():
    six = MotorCommandStream(np.array([10**9]), np.full((1, 6), 0.5))
    imu = ImuStream(np.array([10**9]), np.zeros((1, 3)), np.zeros((1, 3)))
    recording = Recording("log", "", "log.bin", imu, commands=six, command_source="test")
    with pytest.raises(LogError, match=r"log\.bin: topic motor_commands: 6 motors, .* knows 4"):
        with_commanded_speeds(recording, MOTORS)
