# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""PX4's logs as they are: any number of rotors, commands of any release, and what to set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pyulog", reason="pyulog is not installed")
from quadpi_core.field.field_log import FieldLog
from quadpi_core.field.stacks.px4_stack import read_px4_field

from ...logs.formats.test_px4 import ATTITUDE, BATTERY, IMU, LEVEL, LOCAL, ulog

TIMES = range(1_000_000, 11_000_000, 50_000)
MOTORS = ("uint64_t timestamp;uint64_t timestamp_sample;float[12] control;", "QQ12f")
OUTPUTS = ("uint64_t timestamp;uint32_t noutputs;float[16] output;", "QI16f")
AIR = ("uint64_t timestamp;float rho;", "Qf")
LANDED = ("uint64_t timestamp;bool landed;", "Q?")
NONE = float("nan")


def topics(rotors: int = 6) -> dict[Any, Any]:
    control = [0.1 * (1 + rotor) for rotor in range(rotors)] + [NONE] * (12 - rotors)
    return {
        ("sensor_combined", 0): (IMU, [(now, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8) for now in TIMES]),
        ("vehicle_attitude", 0): (ATTITUDE, [(now, now, *LEVEL) for now in TIMES]),
        ("vehicle_local_position", 0): (
            LOCAL,
            [(now, now, 1.0, 2.0, -3.0, 4.0, 5.0, 6.0, True, True, now < 9_000_000, True) for now in TIMES],
        ),
        ("actuator_motors", 0): (MOTORS, [(now, now, *control) for now in TIMES]),
        ("battery_status", 0): (BATTERY, [(now, 15.5) for now in TIMES]),
        ("vehicle_air_data", 0): (AIR, [(now, 1.1) for now in TIMES]),
        ("vehicle_land_detected", 0): (LANDED, [(now, now < 3_000_000) for now in TIMES]),
    }


@pytest.fixture
def read(tmp_path: Path) -> Any:
    """read(topics, parameter=value, …) → the field log."""

    def field_log(content: dict[Any, Any], **parameters: float) -> FieldLog:
        path = tmp_path / "flight.ulg"
        path.write_bytes(ulog(content, parameters))
        return read_px4_field(path)

    return field_log


def test_a_hexacopter_at_the_rates_of_a_default_log(read):
    log = read(topics(), CA_ROTOR_COUNT=6, SDLOG_PROFILE=1, DSHOT_TEL_CFG=0, MPC_THR_HOVER=0.42)
    assert (log.stack, log.frame, log.rotors, log.no_multirotor) == ("PX4", "hexacopter", 6, "")
    assert log.commands.values[0] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    assert log.imu.values[0] == pytest.approx([0.1, 0.2, 0.3, 0.0, 0.0, -9.8])
    assert log.imu.rate_hz == pytest.approx(20.0)
    assert log.density.values[0, 0] == pytest.approx(1.1)
    assert log.landed.values[0, 0] == 1.0
    assert log.facts["hover thrust"] == "0.42 (MPC_THR_HOVER)"


def test_velocities_that_are_not_valid_are_left_out(read):
    log = read(topics())
    assert log.velocity.time[-1] == pytest.approx(8.0, abs=0.1)
    assert log.position.time[-1] == pytest.approx(10.0, abs=0.1)


def test_settings_name_their_present_value(read):
    said = [one.sentence() for one in read(topics(), SDLOG_PROFILE=1, DSHOT_TEL_CFG=0).settings]
    assert any(sentence.startswith("SDLOG_PROFILE is 1: set it to 25") for sentence in said)
    assert any(sentence.startswith("DSHOT_TEL_CFG is 0: set it to the port") for sentence in said)
    full = [one.parameter for one in read(topics(), SDLOG_PROFILE=25).settings]
    assert full == ["DSHOT_TEL_CFG"]


@pytest.mark.parametrize(
    ("ends", "share"),
    [((1000.0, 1900.0), 0.9), ((0.0, 1799.1), 0.9), ((0.0, 7371.9), 0.9)],
    ids=["pulses", "DShot", "DroneCAN"],
)
def test_outputs_of_older_releases_are_commands(read, ends, share):
    """Of several drivers the one whose outputs move turns the motors."""
    content = topics()
    del content["actuator_motors", 0]
    still, low, high = [1500.0] * 16, [ends[0]] * 16, [ends[1]] * 16
    content["actuator_outputs", 0] = (OUTPUTS, [(now, 16, *still) for now in TIMES])
    rows = [(now, 16, *(high if 3_000_000 < now < 8_000_000 else low)) for now in TIMES]
    content["actuator_outputs", 1] = (OUTPUTS, rows)
    log = read(content, MAV_TYPE=2)
    assert log.rotors == 4
    assert log.commands.values[100] == pytest.approx([share] * 4, abs=1e-3)
    assert log.commands.values[0] == pytest.approx([0.0] * 4)
    assert "actuator_outputs" in log.notes[0]


def test_a_vtol_is_named(read):
    assert read(topics(), MAV_TYPE=22).no_multirotor == "MAV_TYPE 22 is a VTOL aircraft"


def test_places_and_spins_of_rotors_are_those_of_the_parameters(read):
    places = {f"CA_ROTOR{k}_P{axis}": 0.11 * (1 if k < 2 else -1) for k in range(4) for axis in "XY"}
    log = read(topics(4), CA_ROTOR_COUNT=4, CA_ROTOR0_KM=0.05, CA_ROTOR3_KM=-0.05, **places)
    assert np.array_equal(np.sign(log.places), [[1, 1, -1], [1, 1, 0], [-1, -1, 0], [-1, -1, 1]])
    unset = read(topics(4), CA_ROTOR_COUNT=4, CA_ROTOR0_KM=0.05, **dict.fromkeys(places, 0.0))
    assert unset.places is None
