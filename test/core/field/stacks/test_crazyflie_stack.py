# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Crazyflie's logs as they are: with or without IMU, and which variables are lacking."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.field.stacks.crazyflie_stack import read_crazyflie_field


def usd(names: list[str], rows: list[tuple[float, ...]]) -> bytes:
    """A log of version 2 with one event of floats, a sample each 10 ms."""
    head = b"\xbc" + struct.pack("<HH", 2, 1) + struct.pack("<H", 0) + b"fixedFrequency\0"
    head += struct.pack("<H", len(names)) + b"".join(f"{name}(f)\0".encode() for name in names)
    body = b"".join(
        struct.pack(f"<HQ{len(names)}f", 0, 10_000 * number, *row) for number, row in enumerate(rows)
    )
    return head + body + struct.pack("<I", zlib.crc32(head + body))


PWM = [f"pwm.m{motor}_pwm" for motor in range(1, 5)]
MOTOR = [f"motor.m{motor}" for motor in range(1, 5)]
STATE = [f"stateEstimate.{axis}" for axis in ("x", "y", "z", "vx", "vy", "vz")]


def test_commands_and_state_without_an_imu(tmp_path: Path):
    path = tmp_path / "log00"
    row = (*(6553.5, 13107.0, 19660.5, 26214.0), 3700.0, *(1.0, 2.0, 3.0, 0.1, 0.2, 0.3))
    path.write_bytes(usd([*PWM, "pm.vbatMV", *STATE], [row] * 10))
    log = read_crazyflie_field(path)
    assert log.imu is None
    assert log.commands.values[0] == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert log.battery.values[0, 0] == pytest.approx(3.7)
    assert log.position.values[0] == pytest.approx([2.0, 1.0, -3.0])
    assert log.velocity.values[0] == pytest.approx([0.2, 0.1, -0.3])
    lacking = {name for one in log.settings for name in one.parameter.split(", ")}
    assert {"gyro.x", "acc.z", "stateEstimate.qw", "rpm.m1"} <= lacking
    assert "pm.vbatMV" not in lacking


def test_what_the_motors_get_counts_before_what_the_controller_asks(tmp_path: Path):
    path = tmp_path / "log00"
    path.write_bytes(usd([*MOTOR, *PWM], [(60000.0,) * 4 + (30000.0,) * 4] * 10))
    log = read_crazyflie_field(path)
    assert log.commands.values[0] == pytest.approx([30000.0 / 65535.0] * 4)
    assert log.facts["commands"].startswith("pwm")


def test_units_of_the_imu(tmp_path: Path):
    path = tmp_path / "log00"
    names = ["gyro.x", "gyro.y", "gyro.z", "acc.x", "acc.y", "acc.z"]
    path.write_bytes(usd(names, [(180.0, 180.0, 180.0, 0.0, 0.5, 1.0)] * 10))
    rates, force = np.split(read_crazyflie_field(path).imu.values[0], 2)
    assert rates == pytest.approx([np.pi, -np.pi, -np.pi])
    assert force == pytest.approx([0.0, -0.5 * 9.80665, -9.80665])


def test_rotor_speeds_of_zero_are_none(tmp_path: Path):
    path = tmp_path / "log00"
    path.write_bytes(usd([*PWM, *(f"rpm.m{motor}" for motor in range(1, 5))], [(3e4,) * 4 + (0.0,) * 4] * 10))
    log = read_crazyflie_field(path)
    assert log.rotor_speeds is None
    assert any(one.parameter.startswith("rpm.m1") is False for one in log.settings)


def test_the_barometer_gives_the_density_of_the_air(tmp_path: Path):
    path = tmp_path / "log00"
    path.write_bytes(usd([*PWM, "baro.pressure", "baro.temp"], [(3e4,) * 4 + (1013.25, 15.0)] * 10))
    assert read_crazyflie_field(path).density.values[0, 0] == pytest.approx(1.225, rel=1e-3)
