# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Blackbox logs as they are: commands by the range of the headers, battery by the firmware, what to set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpi_core.field.field_log import FieldLog
from quadpi_core.field.stacks.betaflight_stack import read_betaflight_field

from ...logs.formats.test_betaflight import ERPM, SENSORS, flight, frames

MOTORS = [f"motor[{motor}]" for motor in range(4)]
VALUES = (100, -200, 300, 0, 0, 2048)
HEADERS = {"motorOutput": "158,2047", "Firmware revision": "Betaflight 4.5.1 (abc) STM32F7", "P interval": 16}


@pytest.fixture
def read(tmp_path: Path) -> Any:
    """read(names, values, header=value, …) → the field log."""

    def field_log(
        names: list[str], values: tuple[int, ...], poles: int | None = None, **headers: object
    ) -> FieldLog:
        path = tmp_path / "flight.bbl"
        content = flight(*frames(400, (*VALUES, *values)), names=[*SENSORS, *names], **HEADERS | headers)
        path.write_bytes(content)
        return read_betaflight_field(path, None, poles)

    return field_log


def test_commands_battery_and_speeds(read):
    values = (158, 2047, 1103, 0, 1680, 30, 60, 90, 120)
    log = read([*MOTORS, "vbatLatest", *ERPM], values, motor_poles=14)
    assert (log.stack, log.frame, log.rotors) == ("Betaflight", "quadcopter", 4)
    assert log.firmware.startswith("Betaflight 4.5.1")
    assert log.commands.values[0] == pytest.approx([0.0, 1.0, 945 / 1889, 0.0])
    assert log.battery.values[0, 0] == pytest.approx(16.8)
    assert log.rotor_speeds.values[0] == pytest.approx(np.array([3e3, 6e3, 9e3, 12e3]) * 2 * np.pi / 60 / 7)
    assert log.imu.values[0, 5] == pytest.approx(-9.80665)
    assert [one.parameter for one in log.settings] == ["attitude and velocity"]
    assert log.settings[0].wanted.startswith("nothing: ")


def test_what_is_not_logged_is_named_with_what_logs_it(read):
    log = read(MOTORS, (200,) * 4, dshot_bidir=0, fields_disabled_mask=512)
    said = [one.sentence() for one in log.settings]
    assert any(sentence.startswith("dshot_bidir is 0: `set dshot_bidir = ON`") for sentence in said)
    assert any("fields_disabled_mask 512" in sentence and "BATTERY" in sentence for sentence in said)
    bidirectional = read(MOTORS, (200,) * 4, dshot_bidir=1).settings
    assert any("RPM is not logged (dshot_bidir is 1" in one.sentence() for one in bidirectional)


def test_electrical_speeds_without_poles_are_no_lack_of_a_field(read):
    log = read([*MOTORS, *ERPM], (*(200,) * 4, 30, 60, 90, 120), dshot_bidir=1, motor_poles=0)
    assert log.rotor_speeds is None
    assert "motor_poles is not in the log, which has electrical speeds" in log.settings[0].sentence()


def test_poles_that_the_user_knows_count_where_the_log_has_none(read):
    log = read([*MOTORS, *ERPM], (*(200,) * 4, 30, 60, 90, 120), poles=7, dshot_bidir=1, motor_poles=0)
    assert log.rotor_speeds.values[0] == pytest.approx(np.array([3e3, 6e3, 9e3, 12e3]) * 2 * np.pi / 60 / 7)
    told = read([*MOTORS, *ERPM], (*(200,) * 4, 30, 60, 90, 120), poles=6, motor_poles=14)
    assert np.array_equal(told.rotor_speeds.values, log.rotor_speeds.values)


def test_a_firmware_that_logs_what_the_converter_reads_gives_no_volts(read):
    revision = {"Firmware revision": "Betaflight 3.0.1 (abc)"}
    assert read([*MOTORS, "vbatLatest"], (*(200,) * 4, 1680), **revision).battery is None


def test_motors_are_counted(tmp_path):
    names = [f"motor[{motor}]" for motor in range(6)]
    path = tmp_path / "six.bbl"
    content = flight(*frames(400, (*VALUES, *(200,) * 6)), names=[*SENSORS, *names], **HEADERS)
    path.write_bytes(content)
    log = read_betaflight_field(path)
    assert (log.frame, log.rotors, log.places) == ("hexacopter", 6, None)
