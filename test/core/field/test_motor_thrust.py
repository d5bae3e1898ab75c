# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speed by command from thrust alone: up to a scale, as flights with tachometers show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.field.airborne import flown
from quadpi_core.field.field_log import Series
from quadpi_core.field.field_reading import read_field_log
from quadpi_core.field.motor_model import identified_motors, motors_by_thrust
from quadpi_core.reading_options import ReadingOptions
from quadpi_core.vehicle import Vehicle

from .field_examples import HOVER, example

VEHICLE = Vehicle.load("neurobem")


def curve(motors, u, volts):
    """Speeds (N, R) at commands (N,) and a voltage."""
    terms = np.stack([np.ones_like(u), u, u * u, np.full_like(u, volts), u * volts], axis=1)
    return terms @ np.array(motors.coefficients).T


def test_thrust_tells_speed_up_to_a_scale():
    """Of the example, thrust is in proportion to the square of the command, whatever the voltage."""
    log = example()
    found = motors_by_thrust([(log, flown(log))], "test", VEHICLE)
    assert not isinstance(found, str), found
    motors, each = found
    u = np.linspace(0.9, 1.1, 5) * HOVER
    speeds = curve(motors, u, 15.5)[:, 0]
    np.testing.assert_allclose(speeds / speeds[2], u / HOVER, rtol=0.02)
    k = (VEHICLE.thrust_coefficient or 0.02) * VEHICLE.air_density_kg_m3 * np.pi * VEHICLE.rotor_radius_m**4
    assert 4.0 * k * speeds[2] ** 2 == pytest.approx(VEHICLE.mass_kg * 9.80665, rel=0.05)
    assert (each, motors.error) == ({}, ())


def test_the_fastest_rotor_stays_below_the_vehicles_largest_speed():
    slow = replace(VEHICLE, rotor_speed_max_rad_s=500.0)
    log = example()
    found = motors_by_thrust([(log, flown(log))], "test", slow)
    assert not isinstance(found, str)
    assert curve(found[0], log.commands.values.max(keepdims=True)[0], 15.5).max() == pytest.approx(
        450.0, rel=0.05
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"imu": None}, "has not both commands and IMU"),
        (
            {"commands": Series(np.arange(0.0, 60.0, 0.1), np.full((600, 4), 0.4))},
            "logged at 10 Hz",
        ),
        ({"commands": Series(np.arange(0.0, 60.0, 0.01), np.full((6000, 6), 0.4))}, "commands of 6 motors"),
        ({"commands": Series(np.arange(0.0, 6.0, 0.01), np.full((600, 4), 0.4))}, "flight is too short"),
        ({"battery": Series(np.arange(59.0, 60.0, 0.01), np.full((100, 1), 15.5))}, "flight is too short"),
    ],
)
def test_what_is_lacking_is_said(changes, said):
    log, flight = example(**changes), flown(example())
    assert said in motors_by_thrust([(log, flight)], "test", VEHICLE)


def test_real_flights_have_the_slope_that_their_tachometers_read(shared_data: Path):
    """On flights other than those that the weight of the prior was set on."""
    paths = sorted((shared_data / "imrc_brushless").glob("eckart*"))[7:14]
    logs = [read_field_log(path, ReadingOptions()) for path in paths]
    known = [(log, flown(log)) for log in logs]
    by_thrust = motors_by_thrust(known, "crazyflie pwm", Vehicle.load("crazyflie_rpm"))
    measured = identified_motors(known, "crazyflie pwm")
    assert not isinstance(by_thrust, str)
    assert not isinstance(measured, str)
    u = np.array([0.38, 0.41, 0.44])
    slopes = []
    for motors, _ in (by_thrust, measured):
        speeds = curve(motors, u, 3.7).mean(axis=1)
        slopes.append((speeds[2] - speeds[0]) / speeds[1])
    assert slopes[0] == pytest.approx(slopes[1], rel=0.15)
