# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""DataFlash logs of any age: which instance, which kind of attitude and which speed controller counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.errors import LogError
from quadpi_core.flight import NOT_MEASURED, Recording
from quadpi_core.logs.formats.ardupilot import read_ardupilot
from quadpi_core.vehicle import Vehicle

from ..dataflash_writer import log

RAD_S = 2.0 * np.pi / 60.0
FORMATS = {
    "PARM": ("QNf", "TimeUS,Name,Value"),
    "IMU": ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ATT": ("Qccc", "TimeUS,Roll,Pitch,Yaw"),
    "XKQ": ("QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"),
    "NKQ": ("QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"),
    "XKF1": ("QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
    "EKF1": ("Qffffff", "TimeUS,VN,VE,VD,PN,PE,PD"),
    "ESC": ("QBf", "TimeUS,Instance,RPM"),
    "CESC": ("QBf", "TimeUS,Id,RPM"),
    **{f"ESC{number}": ("Qf", "TimeUS,RPM") for number in range(1, 5)},
    "BAT": ("QBf", "TimeUS,Instance,Volt"),
    "RCOU": ("QHHHHH", "TimeUS,C1,C2,C3,C4,C5"),
    "CURR": ("Qf", "TimeUS,Volt"),
}
STEP_US, SAMPLES = 5000, 100
TIMES = range(STEP_US, STEP_US * (SAMPLES + 1), STEP_US)
IMU = [("IMU", now, 0, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8) for now in TIMES]
STATE = (1.0, 2.0, 3.0, 10.0, 20.0, -30.0)
STATES = [("XKF1", now, 0, *STATE) for now in TIMES]
# Yaw of a quarter turn to the right.
TURNED = tuple(Rotation.from_euler("Z", 90.0, degrees=True).as_quat(scalar_first=True).tolist())
LEVEL = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture
def read(tmp_path: Path, vehicle: Vehicle) -> Any:
    """read(records, …) → the recording in a log of them."""

    def recording(*records: Any, of: Vehicle | None = vehicle) -> Recording:
        path = tmp_path / "flight.bin"
        path.write_bytes(
            log(FORMATS, sorted((row for rows in records for row in rows), key=lambda row: row[1]))
        )
        return read_ardupilot(path, of)

    return recording


def test_the_first_imu_and_the_first_core_that_logs_count(read):
    """Logs of several IMUs and of EKF lanes that were switched hold others beside them."""
    others = [("IMU", now, 1, *[9.0] * 6) for now in TIMES]
    lanes = [("XKF1", now, lane, *np.add(STATE, lane)) for now in TIMES for lane in (1, 2)]
    attitudes = [("XKQ", now, lane, *(TURNED if lane == 1 else LEVEL)) for now in TIMES for lane in (1, 2)]
    recording = read(IMU, others, lanes, attitudes)
    assert len(recording.imu) == SAMPLES
    assert recording.imu.angular_velocity[0] == pytest.approx([0.1, 0.2, 0.3])
    assert recording.odometry.position[0] == pytest.approx([11.0, 21.0, -29.0])
    assert recording.odometry.attitude[0] == pytest.approx(TURNED)
    # North is on the left of a nose that points east.
    assert recording.odometry.velocity[0] == pytest.approx([3.0, -2.0, 4.0], abs=1e-6)


def test_without_a_position_the_attitude_is_the_state(read):
    alone = read(IMU, [("XKQ", now, 0, *TURNED) for now in TIMES]).odometry
    assert alone.attitude[0] == pytest.approx(TURNED)
    assert alone.rates[0] == pytest.approx([0.1, 0.2, 0.3])
    assert np.unique(alone.deviation[:, [0, 2]]).tolist() == [NOT_MEASURED]


def test_euler_angles_are_degrees_where_nothing_better_is_logged(read):
    angles = [("ATT", now, 1000, -2000, 9000) for now in TIMES]
    recording = read(IMU, angles, [("EKF1", now, *STATE) for now in TIMES])
    expected = Rotation.from_euler("ZYX", [90.0, -20.0, 10.0], degrees=True).as_quat(scalar_first=True)
    assert np.abs(recording.odometry.attitude @ expected) == pytest.approx(np.ones(SAMPLES))


@pytest.mark.parametrize(("every", "best"), [(2, TURNED), (3, LEVEL)])
def test_the_better_kind_of_attitude_counts_if_it_has_half_the_samples(read, every, best):
    quaternions = [("XKQ", now, 0, *TURNED) for now in TIMES[::every]]
    angles = [("ATT", now, 0, 0, 0) for now in TIMES]
    recording = read(IMU, STATES, quaternions, angles)
    assert recording.odometry.attitude[0] == pytest.approx(best)


def test_what_is_no_attitude_is_passed_over(read):
    """Before the EKF has started its quaternion is zero."""
    quaternions = [("XKQ", now, 0, *(LEVEL if now > TIMES[9] else (0.0,) * 4)) for now in TIMES]
    odometry = read(IMU, STATES, quaternions).odometry
    assert len(odometry) == SAMPLES - 10
    assert odometry.time_ns[0] == 1000 * TIMES[10]


RPM = (6000.0, 7000.0, 8000.0, 9000.0)
ESCS = [("ESC", now, number, rpm) for now in TIMES for number, rpm in enumerate(RPM)]
# Motors 1 to 4 of ArduPilot's quad X: front right, rear left, front left, rear right.
CORNERS = ((1, 1), (-1, -1), (1, -1), (-1, 1))
BETAFLIGHT = ((-1, 1), (1, 1), (-1, -1), (1, -1))


def parameters(**values: float) -> list[tuple[str, int, str, float]]:
    return [("PARM", 1, name, value) for name, value in values.items()]


def corners(vehicle: Vehicle, recording: Recording) -> dict[tuple[float, float], float]:
    """Speed in rpm of the rotor in each corner."""
    places = [tuple(np.sign(place[:2])) for place in vehicle.rotor_positions]
    return dict(zip(places, (recording.rotor_speeds.speeds[0] / RAD_S).tolist(), strict=True))


@pytest.mark.parametrize(("frame", "layout"), [(1.0, CORNERS), (3.0, CORNERS), (12.0, BETAFLIGHT)])
def test_the_frame_type_says_where_the_motors_are(read, vehicle, frame, layout, caplog):
    found = corners(vehicle, read(IMU, parameters(FRAME_TYPE=frame), ESCS))
    assert found == pytest.approx(dict(zip(layout, RPM, strict=True)))
    assert "taken as quad-x" not in caplog.text


def test_the_functions_of_the_outputs_say_which_drives_which_motor(read, vehicle):
    """Output 1 drives motor 3, and so on; functions of motors count from 33."""
    functions = {
        f"SERVO{output}_FUNCTION": 32.0 + motor for output, motor in enumerate((3, 1, 4, 2), start=1)
    }
    found = corners(vehicle, read(IMU, parameters(FRAME_TYPE=1.0, **functions), ESCS))
    assert found == pytest.approx(dict(zip([CORNERS[motor - 1] for motor in (3, 1, 4, 2)], RPM, strict=True)))


def test_speeds_of_controllers_that_have_a_name_each(read, vehicle, caplog):
    """Logs before 2021; without parameters they are motors 1 to 4 of quad X, which is said."""
    named = [(f"ESC{number + 1}", now, rpm) for now in TIMES for number, rpm in enumerate(RPM)]
    assert corners(vehicle, read(IMU, named)) == pytest.approx(dict(zip(CORNERS, RPM, strict=True)))
    assert "the log says nothing of the frame; its motors are taken as quad-x" in caplog.text
    read(IMU, named, parameters(FRAME_TYPE=0.0))
    assert "left out, the vehicle's rotors are not those of a frame quad-plus" in caplog.text
    read(IMU, named, parameters(FRAME_TYPE=7.0))
    assert "the log says FRAME_TYPE 7 of the frame" in caplog.text


def test_without_a_vehicle_the_frame_says_how_many_rotors(read):
    escs = [("ESC", now, number, 6000.0) for now in TIMES for number in range(6)]
    recording = read(IMU, parameters(FRAME_CLASS=2.0, FRAME_TYPE=7.0), escs, of=None)
    assert recording.rotor_speeds.speeds.shape[1] == 6


def test_a_controller_that_is_not_logged_leaves_no_rotor_speeds(read, caplog):
    three = [row for row in ESCS if row[2] != 2]
    assert read(IMU, parameters(FRAME_TYPE=1.0), three).rotor_speeds is None
    assert "topic rotor_speeds: left out, speed controllers 3 are not logged" in caplog.text


def test_controllers_on_can_had_records_of_their_own(read, vehicle):
    """Beside empty ones of the others."""
    can = [("CESC", now, number, rpm) for now in TIMES for number, rpm in enumerate(RPM)]
    silent = [("ESC", now, number, 0.0) for now in TIMES for number in range(4)]
    found = corners(vehicle, read(IMU, parameters(FRAME_TYPE=1.0), silent, can))
    assert found == pytest.approx(dict(zip(CORNERS, RPM, strict=True)))


def test_speeds_that_are_zero_throughout_name_the_parameter_of_telemetry(read, caplog):
    silent = [("ESC", now, number, 0.0) for now in TIMES for number in range(4)]
    assert read(IMU, parameters(FRAME_TYPE=1.0), silent).rotor_speeds is None
    assert "topic rotor_speeds: left out, every rpm is zero: no telemetry: set SERVO_BLH_AUTO" in caplog.text


@pytest.mark.parametrize(
    ("frame", "name"), [(2.0, "a hexacopter"), (3.0, "an octocopter"), (7.0, "a tricopter")]
)
def test_another_multicopter_is_refused_by_name(read, frame, name):
    with pytest.raises(LogError, match=f"FRAME_CLASS {frame:.0f} is {name}; vehicle neurobem has 4 rotors"):
        read(IMU, parameters(FRAME_CLASS=frame), ESCS)


def test_of_a_helicopter_the_sensors_are_read_and_the_rotors_are_not(read, caplog):
    assert read(IMU, parameters(FRAME_CLASS=float("nan")), ESCS).rotor_speeds is not None
    recording = read(IMU, parameters(FRAME_CLASS=6.0), ESCS)
    assert (len(recording.imu) > 0, recording.rotor_speeds) == (True, None)
    assert "FRAME_CLASS 6 is a helicopter" in caplog.text


def test_a_function_of_an_output_that_changes_in_flight_is_that_of_the_beginning(read, vehicle):
    """As in a test that takes a motor away."""
    functions = {f"SERVO{output}_FUNCTION": 32.0 + output for output in range(1, 5)}
    changed = [*parameters(FRAME_TYPE=1.0, **functions), ("PARM", 2, "SERVO3_FUNCTION", 1.0)]
    assert corners(vehicle, read(IMU, changed, ESCS)) == pytest.approx(dict(zip(CORNERS, RPM, strict=True)))


def test_pulses_of_the_motors_are_commands(read, vehicle):
    """Motors 1 to 4 on outputs 2 to 5."""
    functions = {f"SERVO{output}_FUNCTION": 31.0 + output for output in range(2, 6)}
    rows = [("RCOU", now, 1500, 1100, 1200, 1300, 1400) for now in TIMES]
    found = read(IMU, parameters(FRAME_TYPE=1.0, **functions), rows)
    of_corner = dict(zip(CORNERS, (0.1, 0.2, 0.3, 0.4), strict=True))
    wanted = [of_corner[tuple(np.sign(place[:2]).astype(int))] for place in vehicle.rotor_positions]
    np.testing.assert_allclose(found.commands.commands[0], wanted)
    assert found.command_source == "mavros_rc_out"


@pytest.mark.parametrize("rows", [[("BAT", 1, 0, 12.5), ("BAT", 2, 1, 3.3)], [("CURR", 1, 12.5)]])
def test_the_voltage_is_that_of_the_first_battery(read, rows):
    battery = read(IMU, rows).battery
    assert (battery.time_ns.tolist(), battery.voltage.tolist()) == ([1000], [12.5])


def test_a_log_without_an_imu_is_refused(read, vehicle):
    with pytest.raises(
        LogError, match=r"flight\.bin: topic imu: the log holds no samples of gyro and acc.* \(IMU\)"
    ):
        read(STATES)
    bare = read(IMU, ESCS, of=None)
    assert (bare.vehicle, bare.odometry, bare.battery) == ("", None, None)
    assert len(read(IMU, ESCS, of=replace(vehicle, pole_pairs=None)).rotor_speeds) == SAMPLES
