# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Motors in a vehicle file: kept, and refused where they are none."""

from __future__ import annotations

import pytest

from quadpi_core.errors import VehicleError
from quadpi_core.vehicle import Motors, Vehicle

LAG_S = 0.05
MOTORS = Motors(source="test", coefficients=((100.0, 1000.0, 200.0, 10.0, 20.0),) * 4, lag_s=LAG_S, volts=4.0)


def test_a_vehicle_file_keeps_them():
    vehicle = Vehicle.from_content(
        {**Vehicle.load("neurobem").to_file(), "motors": MOTORS.to_file()}, "mine", "a file"
    )
    assert vehicle.motors == MOTORS
    assert vehicle.fingerprint == Vehicle.load("neurobem").fingerprint
    assert "motors" not in Vehicle.load("neurobem").to_file()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"coefficients": [[1.0] * 5] * 3}, "each of the 4 rotors"),
        ({"coefficients": [[1.0] * 4] * 4}, "5 numbers for each rotor"),
        ({"coefficients": [[float("inf")] * 5] * 4}, "must be a number"),
        ({"lag_s": 3.0}, "`lag_s`"),
    ],
)
def test_what_is_no_motor_is_refused(change, said):
    content = {**Vehicle.load("neurobem").to_file(), "motors": {**MOTORS.to_file(), **change}}
    with pytest.raises(VehicleError, match=said):
        Vehicle.from_content(content, "mine", "a file")
