# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Thrust and inertia from motors: of exact motion behind a lag, in closed loop, and where it is not told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from quadpi_core.field.airborne import Flown, Stretch, flown
from quadpi_core.field.field_log import FieldLog, Series, places_of
from quadpi_core.field.inertia import identify_body, rotors_of
from quadpi_core.rotor_order import LAYOUTS
from quadpi_core.vehicle import Vehicle

BEBOP = Vehicle.load("bebop2")
FULL_N, INERTIA, LAG_S = 6.0, (2.1e-3, 1.7e-3), 0.04
STILL = [np.zeros(2)]
# Of commands, whose power is taken as 1.7, where thrust goes with the square.
BY_COMMAND = 0.85


def flight(
    lag_s: float = LAG_S,
    shaken: float = 0.02,
    noise: float = 0.01,
    answered: float = 0.0,
    measured: bool = False,
) -> tuple[FieldLog, Flown]:
    """Commands behind a lag turn the vehicle; what air adds slowly, Nm, is answered by commands."""
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 60.0, 0.002)
    mean = np.sqrt(BEBOP.mass_kg * BEBOP.gravity_m_s2 / 4.0 / FULL_N)
    signs = np.sign(BEBOP.rotor_positions[:, :2])
    roll, pitch, climb = (
        sum(np.sin(2.0 * np.pi * hz * time + rng.uniform(0.0, 6.0)) for hz in rng.uniform(0.5, 2.5, 4))
        for _ in range(3)
    )
    commands = mean * (1.0 + shaken * (signs[:, :1] * roll + signs[:, 1:] * pitch + climb)).T
    keep = np.exp(-0.002 / lag_s)
    speeds = lfilter([1.0 - keep], [1.0, -keep], commands, axis=0, zi=keep * commands[:1])[0]
    thrust = FULL_N * speeds**2
    turning = np.stack([-thrust @ BEBOP.rotor_positions[:, 1], thrust @ BEBOP.rotor_positions[:, 0]], axis=1)
    if answered:
        air = answered * np.sin(2.0 * np.pi * 1.1 * time + 1.0)[:, np.newaxis]
        steep = mean * 2.0 * FULL_N * np.abs(BEBOP.rotor_positions[:, :2]).sum(axis=0)[::-1]
        commands += air * 0.97 * (signs[:, 1] / steep[0] - signs[:, 0] / steep[1])
        turning += 0.03 * air
    turning /= INERTIA
    rates = np.zeros((len(time), 3))
    rates[:, :2] = 0.002 * np.cumsum(turning, axis=0) + rng.normal(0.0, noise, turning.shape)
    force = np.zeros((len(time), 3))
    force[:, 2] = -thrust.sum(axis=1) / BEBOP.mass_kg + rng.normal(0.0, 0.3, len(time))
    log = FieldLog(
        name="f", source="f", stack="test", imu=Series(time, np.hstack([rates, force])),
        commands=Series(time, commands), rotor_speeds=Series(time, 900.0 * speeds) if measured else None,
    )  # fmt: skip
    return log, flown(log)


def test_exact_motion_tells_inertia_thrust_and_lag():
    found = identify_body([flight()], BEBOP, STILL)
    for one, true in zip(found.inertia, INERTIA, strict=True):
        assert one.value == pytest.approx(BY_COMMAND * true, rel=0.04)
        assert one.low < true < one.high
    assert found.thrust.value == pytest.approx(BEBOP.mass_kg * BEBOP.gravity_m_s2 / 4.0, rel=0.02)
    assert found.lag.value == pytest.approx(LAG_S, abs=0.004)


def test_measured_rotor_speeds_tell_inertia_closer_than_commands():
    found = identify_body([flight(measured=True)], BEBOP, STILL)
    for one, true in zip(found.inertia, INERTIA, strict=True):
        assert one.value == pytest.approx(true, rel=0.03)
        assert 0.15 < one.half_width / one.value < 0.17
        assert one.reason == "thrust taken to grow with the power 1.7 to 2.3 of rotor speed"
    assert found.lag.reason.endswith("by measured rotor speeds")


def test_speeds_of_a_dead_tachometer_leave_the_commands():
    log, aloft = flight()
    dead = replace(log, rotor_speeds=Series(log.imu.time, np.ones((len(log.imu.time), 4))))
    assert identify_body([(dead, aloft)], BEBOP, STILL) == identify_body([(log, aloft)], BEBOP, STILL)


def test_slow_moments_of_air_that_commands_answer_are_no_inertia():
    """Of the lowest octave, which they turn hardly, motors explain 5 and 32 %."""
    for one, true in zip(identify_body([flight(answered=0.02)], BEBOP, STILL).inertia, INERTIA, strict=True):
        assert one.low < true < one.high
        assert one.value == pytest.approx(BY_COMMAND * true, rel=0.1)


def test_octaves_that_differ_are_in_the_interval():
    same, other = (identify_body([flight(answered=own)], BEBOP, STILL).inertia[1] for own in (0.0, 0.004))
    assert other.half_width / other.value > 1.02 * same.half_width / same.value


def test_what_is_lacking_is_said():
    log, aloft = flight()
    said = [
        (identify_body([(replace(log, commands=None), aloft)], BEBOP, STILL), "both commands and IMU"),
        (identify_body([(log, replace(aloft, stretches=(Stretch(0.0, 15.0),)))], BEBOP, STILL), "takes 30 s"),
    ]
    for found, words in said:
        assert all(one.value is None and words in one.reason for one in found.inertia)


def test_one_octave_alone_has_the_spread_of_others_in_its_interval():
    """With so noisy a gyro one octave tells inertia about x, and two about y."""
    alone, both = identify_body([flight(noise=0.5)], BEBOP, STILL).inertia
    assert alone.half_width / alone.value == pytest.approx(np.hypot(0.294, 0.14), abs=0.01)
    assert both.half_width / both.value < 0.305


@pytest.mark.parametrize(("lag_s", "is_told"), [(0.13, True), (0.2, False)])
def test_a_lag_that_no_motor_has_tells_no_inertia(lag_s: float, is_told: bool):
    found = identify_body([flight(lag_s)], BEBOP, STILL)
    assert (found.lag.value is not None) == is_told
    assert is_told or "beyond 0.005 to 0.14 s" in found.inertia[0].reason


@pytest.mark.parametrize("layout", LAYOUTS)
def test_rotors_of_any_frame_come_in_the_order_of_the_log(layout: str):
    places = places_of(LAYOUTS[layout])
    own = places[np.random.default_rng(1).permutation(len(places))]
    spins = np.where(own[:, 2] == 0.0, 1.0, own[:, 2])
    vehicle = replace(BEBOP, rotor_positions=own * [0.2, 0.2, 0.0], rotor_spins=spins)
    found = rotors_of(FieldLog("f", "f", "test", places=places), vehicle)
    assert found[:, :2] == pytest.approx(0.2 * places[:, :2])
    assert layout == "betaflight" or np.array_equal(found[:, 2], places[:, 2])


def test_motors_are_told_by_their_corners_where_the_log_knows_them():
    log, aloft = flight()
    order, corners = [3, 1, 0, 2], np.sign(BEBOP.rotor_positions)
    other = replace(
        log, commands=Series(log.commands.time, log.commands.values[:, order]), places=corners[order]
    )
    found, told = (identify_body([(one, aloft)], BEBOP, STILL) for one in (other, log))
    assert [one.value for one in found.inertia] == pytest.approx([one.value for one in told.inertia])


def test_motors_in_another_order_are_no_inertia():
    log, aloft = flight()
    swapped = replace(log, commands=Series(log.commands.time, log.commands.values[:, [3, 2, 1, 0]]))
    assert "vehicle file's order" in identify_body([(swapped, aloft)], BEBOP, STILL).inertia[0].reason


def test_a_flight_of_25_s_at_once_is_long_enough():
    log, aloft = flight()
    parts = tuple(Stretch(begin, begin + 25.0) for begin in (0.0, 30.0))
    assert identify_body([(log, replace(aloft, stretches=parts))], BEBOP, STILL).inertia[0].value is not None


def test_the_power_of_thrust_is_in_the_interval_of_inertia_and_the_bias_in_that_of_thrust():
    found = identify_body([flight()], BEBOP, STILL)
    assert 0.29 < found.inertia[0].half_width / found.inertia[0].value < 0.31
    weight = BEBOP.mass_kg * BEBOP.gravity_m_s2 / 4.0
    assert 0.0305 < found.thrust.half_width / weight < 0.04


def with_state(log: FieldLog, bias: float, axis: int = 2, lean_deg: float = 0.0, ahead=0.0) -> FieldLog:
    """Flight in a steady lean, its velocity by the accelerometer, which then has a bias along an axis."""
    time, values, half = log.imu.time, log.imu.values.copy(), np.deg2rad(0.5 * lean_deg)
    vertical = np.cos(2.0 * half) * values[:, 5] - np.sin(2.0 * half) * values[:, 3]
    down = np.cumsum(vertical + 9.80665) * 0.002
    values[:, 3 + axis] += bias
    velocity = np.column_stack([ahead * np.ones(len(time)), np.zeros(len(time)), down])
    leaning = np.tile([np.cos(half), 0.0, np.sin(half), 0.0], (len(time), 1))
    rows = slice(None, None, 100)
    return replace(
        log,
        imu=Series(time, values),
        attitude=Series(time[rows], leaning[rows]),
        velocity=Series(time[rows], velocity[rows]),
    )


@pytest.mark.parametrize("bias", [-0.3, 0.0, 0.3])
def test_a_state_tells_the_bias_of_the_accelerometer(bias):
    log, aloft = flight()
    found = identify_body([(with_state(log, bias), aloft)], BEBOP, STILL).thrust
    assert found.value == pytest.approx(BEBOP.mass_kg * BEBOP.gravity_m_s2 / 4.0, rel=0.01)
    assert 0.006 < found.half_width / found.value < 0.012


@pytest.mark.parametrize(("lean_deg", "half"), [(20, 0.012), (45, 0.022), (85, 0.031)])
@pytest.mark.parametrize("bias", [-0.3, 0.2])
def test_in_a_steady_lean_a_bias_along_x_is_in_the_interval(lean_deg: float, half: float, bias: float):
    log, aloft = flight()
    found = identify_body([(with_state(log, bias, 0, lean_deg), aloft)], BEBOP, STILL).thrust
    assert found.low < BEBOP.mass_kg * BEBOP.gravity_m_s2 / 4.0 < found.high
    assert found.half_width / found.value == pytest.approx(half, abs=0.002)


@pytest.mark.parametrize(("bias", "is_one"), [(0.9, True), (1.2, False), (-1.2, False)])
def test_a_state_and_an_accelerometer_that_contradict_each_other_tell_nothing(bias: float, is_one: bool):
    log, aloft = flight()
    thrust = identify_body([(with_state(log, bias), aloft)], BEBOP, STILL).thrust
    assert ("m/s² along the vertical: one is wrong" in thrust.reason) != is_one


def test_a_thrust_that_one_speed_does_not_tell_asks_for_others():
    log, aloft = flight()
    steady, hardly = (
        identify_body([(with_state(log, 0.0, ahead=ahead), aloft)], BEBOP, STILL)
        for ahead in (8.0, 8.0 + np.random.default_rng(0).normal(0.0, 0.1, len(log.imu.time)))
    )
    assert steady.thrust.reason.endswith("hover, and fly at several speeds")
    assert steady.inertia[0].value is None
    assert hardly.thrust.low < BEBOP.mass_kg * BEBOP.gravity_m_s2 / 4.0 < hardly.thrust.high


@pytest.mark.parametrize(("noise", "is_told"), [(0.1, True), (0.2, False)])
def test_an_inertia_that_motors_hardly_explain_is_not_told(noise, is_told):
    """Hardly shaken, and with a gyro so noisy that they explain 95 and 84 % of an octave at most."""
    one = identify_body([flight(shaken=0.002, noise=noise)], BEBOP, STILL).inertia[0]
    assert (one.value is not None) == is_told
    assert ("% of how it turns, of 85 needed" in one.reason) != is_told
