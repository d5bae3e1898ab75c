# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""ArduPilot's logs as they are: outputs by motor, land detector, and what to set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpi_core.field.field_log import FieldLog
from quadpi_core.field.stacks.ardupilot_stack import read_ardupilot_field

from ...logs.dataflash_writer import log as dataflash
from ...logs.formats.test_ardupilot import FORMATS

MORE = {
    **FORMATS,
    "RCOU": ("QHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8"),
    "BARO": ("QBfff", "TimeUS,I,Alt,Press,Temp"),
    "EV": ("QB", "TimeUS,Id"),
    "MSG": ("QZ", "TimeUS,Message"),
}
TIMES = range(100_000, 20_000_000, 100_000)
PULSES = (1100, 1200, 1300, 1400, 1500, 1600, 1700, 1800)


@pytest.fixture
def read(tmp_path: Path) -> Any:
    """read(parameter=value, …) → the field log of twenty seconds, with further `records`."""

    def field_log(records: Any = (), **parameters: float) -> FieldLog:
        rows = [("PARM", 1, name, value) for name, value in parameters.items()]
        rows += [("MSG", 2, "ArduCopter V4.5.1 (abcdef)")]
        for now in TIMES:
            rows += [
                ("IMU", now, 0, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8),
                ("XKQ", now, 0, 1.0, 0.0, 0.0, 0.0),
                ("XKF1", now, 0, 1.0, 2.0, 3.0, 10.0, 20.0, -30.0),
                ("RCOU", now, *PULSES),
                ("BAT", now, 0, 15.0),
                ("BARO", now, 0, 0.0, 101325.0, 15.0),
            ]
        path = tmp_path / "flight.bin"
        path.write_bytes(dataflash(MORE, sorted([*rows, *records], key=lambda row: row[1])))
        return read_ardupilot_field(path)

    return field_log


def test_a_hexacopter_by_its_frame_class(read):
    log = read(FRAME_CLASS=2, FRAME_TYPE=1, MOT_PWM_MIN=1000, MOT_PWM_MAX=2000, MOT_THST_HOVER=0.37)
    assert (log.stack, log.frame, log.rotors) == ("ArduPilot", "hexacopter X", 6)
    assert log.firmware == "ArduCopter V4.5.1 (abcdef)"
    assert log.commands.values[0] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    assert log.velocity.values[0] == pytest.approx([1.0, 2.0, 3.0])
    assert log.density.values[0, 0] == pytest.approx(1.225, abs=1e-3)
    assert log.facts["hover thrust"] == "0.37 (MOT_THST_HOVER)"


def test_motors_that_are_assumed_are_said(read):
    log = read()
    assert log.rotors == 4
    assert log.notes[0].startswith("taken to have 4 motors")
    assert not any("taken to have" in note for note in read(FRAME_CLASS=1).notes)


def test_outputs_are_ordered_by_their_functions(read):
    functions = {"SERVO1_FUNCTION": 36, "SERVO2_FUNCTION": 35, "SERVO3_FUNCTION": 34, "SERVO4_FUNCTION": 33}
    log = read(FRAME_CLASS=1, FRAME_TYPE=1, MOT_PWM_MIN=1000, MOT_PWM_MAX=2000, **functions)
    assert log.commands.values[0] == pytest.approx([0.4, 0.3, 0.2, 0.1])
    assert np.array_equal(np.sign(log.places), [[1, 1, -1], [-1, -1, -1], [1, -1, 1], [-1, 1, 1]])


def test_rotors_of_an_h_frame_turn_the_other_way(read):
    h, x = (read(FRAME_CLASS=1, FRAME_TYPE=frame_type).places for frame_type in (3, 1))
    assert np.array_equal(h, x * [1.0, 1.0, -1.0])


def test_the_land_detector_holds_until_it_says_otherwise(read):
    log = read([("EV", 5_000_000, 28), ("EV", 15_000_000, 18)], FRAME_CLASS=1)
    assert log.landed.held(np.array([1.0, 10.0, 18.0]))[:, 0].tolist() == [1.0, 0.0, 1.0]


def test_settings_name_their_present_value_and_all_that_is_lacking_together(read):
    batches = {"INS_LOG_BAT_OPT": 0, "INS_LOG_BAT_MASK": 0}
    settings = read(LOG_BITMASK=176126, SERVO_BLH_AUTO=0, **batches).settings
    assert [one.parameter for one in settings] == ["LOG_BITMASK", "SERVO_BLH_AUTO", "INS_LOG_BAT_OPT"]
    assert settings[0].sentence().startswith("LOG_BITMASK is 176126: set it to 438271, for the state")
    assert settings[1].sentence().startswith("SERVO_BLH_AUTO is 0: set it to 1, with the telemetry wire")
    assert settings[2].sentence().startswith("INS_LOG_BAT_OPT is 0: set it to 1, with INS_LOG_BAT_MASK 1")
    (check,) = read(LOG_BITMASK=438271, SERVO_BLH_AUTO=1).settings
    assert check.sentence().startswith("SERVO_BLH_AUTO is 1: check the telemetry wire")


def test_telemetry_of_zeros_is_none(read):
    escs = [("ESC", now, number, 0.0) for now in TIMES for number in range(4)]
    assert read(escs, FRAME_CLASS=1).rotor_speeds is None


def test_telemetry_by_the_outputs_of_the_motors(read):
    escs = [("ESC", now, number, 1000.0 * (1 + number)) for now in TIMES for number in range(4)]
    speeds = read(escs, FRAME_CLASS=1).rotor_speeds
    assert speeds.values[0] * 60.0 / (2.0 * np.pi) == pytest.approx([1000.0, 2000.0, 3000.0, 4000.0])


@pytest.mark.parametrize(
    ("parameters", "said"), [({"Q_ENABLE": 1}, "Q_ENABLE 1 is a VTOL"), ({"FRAME_CLASS": 6}, "a helicopter")]
)
def test_no_multirotor_is_named(read, parameters, said):
    assert said in read(**parameters).no_multirotor


def test_hexacopters_numbered_clockwise_are_placed(shared_data):
    """Of motor 1, front right and counterclockwise, the loss rolls right, pitches down and yaws left."""
    log = read_ardupilot_field(shared_data / "rrc_sitl" / "hexa-x_m1.bin")
    assert log.motor(1) == "motor 1 (front right)"
    after = log.imu.during(17.05, 17.25).values[:, :3].mean(axis=0)
    assert np.array_equal(
        np.sign(after), [np.sign(log.places[0, 1]), -np.sign(log.places[0, 0]), log.places[0, 2]]
    )
