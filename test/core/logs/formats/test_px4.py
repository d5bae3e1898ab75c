# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""PX4's logs: which instance, frame and stamp counts, which report is of which motor, files without end."""

from __future__ import annotations

import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("pyulog", reason="pyulog is not installed")
from quadpi_core.errors import LogError
from quadpi_core.flight import NOT_MEASURED, Recording
from quadpi_core.logs.formats.px4 import read_px4
from quadpi_core.vehicle import Vehicle

RAD_S = 2.0 * np.pi / 60.0
IMU = ("uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;", "Q6f")
ATTITUDE = ("uint64_t timestamp;uint64_t timestamp_sample;float[4] q;", "QQ4f")
LOCAL = (
    "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;float vx;float vy;float vz;"
    "bool xy_valid;bool z_valid;bool v_xy_valid;bool v_z_valid;",
    "QQ6f4?",
)
MOCAP = (
    "uint64_t timestamp;uint64_t timestamp_sample;float[3] position;float[4] q;uint8_t pose_frame;",
    "QQ7fB",
)
OLD_MOCAP = ("uint64_t timestamp;float x;float y;float z;float[4] q;uint8_t local_frame;", "Q7fB")
REPORT = "uint64_t timestamp;int32_t esc_rpm;uint8_t actuator_function;uint8_t[3] _padding0;"
ESCS = ("uint64_t timestamp;esc_report[8] esc;", "Q" + "QiB3x" * 8)
BATTERY = ("uint64_t timestamp;float voltage_v;", "Qf")
TIMES = range(10_000, 510_000, 5000)
LEVEL, TURNED = (1.0, 0.0, 0.0, 0.0), Rotation.from_euler("Z", 90.0, degrees=True).as_quat(scalar_first=True)
# Motors 1 to 4 of PX4's generic quadcopter.
CORNERS = ((1, 1), (-1, -1), (1, -1), (-1, 1))


def ulog(
    topics: dict[tuple[str, int], tuple[tuple[str, str], Sequence[tuple[Any, ...]]]],
    parameters: dict[str, float] | None = None,
    formats: dict[str, str] | None = None,
) -> bytes:
    """A ULog of topics (name, instance): (definition with its struct, rows).

    Source: docs.px4.io, "ULog File Format".
    """
    out = bytearray(b"ULog\x01\x12\x35\x01" + bytes(8))

    def put(kind: str, payload: bytes) -> None:
        out.extend(struct.pack("<HB", len(payload), ord(kind)) + payload)

    named = {
        "esc_report": REPORT,
        **{name: form[0] for (name, _), (form, _) in topics.items()},
        **(formats or {}),
    }
    for name, fields in named.items():
        put("F", f"{name}:{fields}".encode())
    for name, value in (parameters or {}).items():
        key = f"float {name}".encode()
        put("P", bytes((len(key),)) + key + struct.pack("<f", value))
    for number, (name, instance) in enumerate(topics):
        put("A", struct.pack("<BH", instance, number) + name.encode())
    for number, ((_, form), rows) in enumerate(topics.values()):
        for row in rows:
            put("D", struct.pack(f"<H{form}", number, *row))
    return bytes(out)


FLIGHT = {("sensor_combined", 0): (IMU, [(now, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8) for now in TIMES])}


@pytest.fixture
def read(tmp_path: Path, vehicle: Vehicle) -> Any:
    """read(topics, …) → the recording in a log of an IMU and these."""

    def recording(topics: Any = None, of: Vehicle | None = vehicle, **more: Any) -> Recording:
        path = tmp_path / "flight.ulg"
        path.write_bytes(ulog(FLIGHT | (topics or {}), **more))
        return read_px4(path, of)

    return recording


def state(valid: Sequence[bool] = (True,) * 4, sampled: int = 2000) -> Any:
    """Position and attitude, measured 2 ms before they were published."""
    return {
        ("vehicle_local_position", 0): (
            LOCAL,
            [
                (now, max(now - sampled, 0) * (sampled > 0), 1.0, 2.0, -3.0, 4.0, 5.0, 6.0, *valid)
                for now in TIMES
            ],
        ),
        ("vehicle_attitude", 0): (ATTITUDE, [(now, now, *TURNED) for now in TIMES]),
    }


def test_a_state_is_stamped_when_it_was_measured(read):
    odometry = read(state()).odometry
    assert odometry.time_ns[0] == 1000 * (TIMES[1] - 2000)
    assert odometry.position[0] == pytest.approx([1.0, 2.0, -3.0])
    # North is on the left of a nose that points east.
    assert odometry.velocity[0] == pytest.approx([5.0, -4.0, 6.0], abs=1e-6)
    assert odometry.rates[0] == pytest.approx([0.1, 0.2, 0.3])
    # Older releases leave that stamp zero.
    assert read(state(sampled=0)).odometry.time_ns[0] == 1000 * TIMES[0]


@pytest.mark.parametrize("place", range(4))
def test_positions_that_are_not_valid_are_left_out(read, place, caplog):
    valid = [True] * 4
    valid[place] = False
    alone = read(state(valid)).odometry
    assert "topic odometry: 100 of 100 positions are not valid" in caplog.text
    # The attitude is left, by its own stamps, as where no position is logged.
    assert np.unique(alone.deviation[:, [0, 2]]).tolist() == [NOT_MEASURED]
    assert alone.attitude[0] == pytest.approx(TURNED)
    attitude = {topic: rows for topic, rows in state().items() if topic[0] == "vehicle_attitude"}
    np.testing.assert_array_equal(read(attitude).odometry.time_ns, alone.time_ns)


def test_only_the_first_instance_of_a_topic_counts(tmp_path):
    """Whichever is logged first."""
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog({("sensor_combined", 1): (IMU, [(now, *[9.0] * 6) for now in TIMES]), **FLIGHT}))
    assert read_px4(path, None).imu.angular_velocity.max() == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("form", "frame", "used"),
    [
        (MOCAP, 1, True),
        (MOCAP, 2, True),
        (MOCAP, 3, False),
        (OLD_MOCAP, 0, True),
        (OLD_MOCAP, 1, True),
        (OLD_MOCAP, 2, False),
    ],
)
def test_motion_capture_is_used_in_ned_and_frd_by_the_numbers_of_either_release(
    read, form, frame, used, caplog
):
    sampled = () if form is OLD_MOCAP else (TIMES[0] - 5000,)
    rows = [(now, *sampled, 1.0, 2.0, -3.0, *TURNED, frame) for now in TIMES[:1]]
    pose = read({("vehicle_visual_odometry", 0): (form, rows)}).pose
    assert ("is in a frame that is neither NED nor FRD" in caplog.text) is not used
    if not used:
        assert pose is None
        return
    assert pose.time_ns.tolist() == [1000 * (sampled[0] if sampled else TIMES[0])]
    assert pose.position[0] == pytest.approx([1.0, 2.0, -3.0])
    assert pose.attitude[0] == pytest.approx(TURNED)


def test_a_pose_in_another_frame_costs_no_other(read, caplog):
    rows = [(now, now, 1.0, 2.0, -3.0, *LEVEL, 77 if now == TIMES[9] else 1) for now in TIMES]
    assert len(read({("vehicle_mocap_odometry", 0): (MOCAP, rows)}).pose) == 99
    assert "left out 1 of 100, vehicle_mocap_odometry is in a frame" in caplog.text


def test_poses_without_an_attitude_are_left_out(read, caplog):
    rows = [(now, now, 1.0, 2.0, -3.0, *(LEVEL if now > TIMES[9] else (np.nan,) * 4), 1) for now in TIMES]
    assert len(read({("vehicle_mocap_odometry", 0): (MOCAP, rows)}).pose) == 90
    assert "topic mocap/pose: 10 of 100 have no attitude" in caplog.text


RPM = (1000, -2000, 3000, 4000)


def escs(functions: Sequence[int], rpm: Sequence[int] = RPM) -> Any:
    reports: list[int] = []
    for speed, function in zip((*rpm, 0, 0, 0, 0), (*functions, 0, 0, 0, 0), strict=True):
        reports += [TIMES[0], speed, function]
    return {("esc_status", 0): (ESCS, [(now, *reports) for now in TIMES])}


def corners(vehicle: Vehicle, recording: Recording) -> dict[tuple[float, float], float]:
    """Speed in rpm of the rotor in each corner."""
    places = [tuple(np.sign(place[:2])) for place in vehicle.rotor_positions]
    return dict(zip(places, (recording.rotor_speeds.speeds[0] / RAD_S).tolist(), strict=True))


@pytest.mark.parametrize("functions", [(0, 0, 0, 0), (101, 102, 103, 104), (104, 101, 103, 102)])
def test_the_function_of_a_report_says_which_motor_it_is_of(read, vehicle, functions, caplog):
    """Functions of motors count from 101; releases before 1.12 have none, and report in their order."""
    found = corners(vehicle, read(escs(functions)))
    motors = [function - 101 for function in functions] if any(functions) else range(4)
    assert found == pytest.approx({CORNERS[motor]: abs(rpm) for motor, rpm in zip(motors, RPM, strict=True)})
    assert "no rotor positions in the log; its motors are taken as quad-x" in caplog.text


def test_without_a_vehicle_the_log_says_how_many_rotors(read):
    recording = read(escs((0, 0, 0, 0)), of=None, parameters={"CA_ROTOR_COUNT": 6.0})
    assert recording.rotor_speeds.speeds.shape[1] == 6


def test_positions_of_motors_in_the_log_count(read, vehicle, caplog):
    """Here those of a frame that is turned by half against the generic one."""
    places = {
        f"CA_ROTOR{motor}_P{axis}": -1.0 * value
        for motor, corner in enumerate(CORNERS)
        for axis, value in zip("XY", corner, strict=True)
    }
    found = corners(vehicle, read(escs((101, 102, 103, 104)), parameters=places))
    assert found == pytest.approx({(-x, -y): abs(rpm) for (x, y), rpm in zip(CORNERS, RPM, strict=True)})
    assert "quad X" not in caplog.text


def test_speeds_that_say_nothing_are_left_out(read, caplog):
    assert read(escs((101, 102, 103, 104), (0, 0, 0, 0))).rotor_speeds is None
    assert (
        "topic rotor_speeds: left out, every rpm of esc_status is zero: no telemetry: set DSHOT_TEL_CFG"
        in caplog.text
    )


STATUS = "uint64_t timestamp;uint16_t esc_online_flags;esc_report[8] esc;", "QH" + "QiB3x" * 8


def statuses(online: Sequence[int], rpm: Sequence[int] = RPM) -> Any:
    """Rows of esc_status, each ESC of which has reported anew."""
    return STATUS, [
        (now, flags, *(n for k in range(8) for n in (now, (*rpm, 0, 0, 0, 0)[k], 101 + k if k < 4 else 0)))
        for now, flags in zip(TIMES, online, strict=True)
    ]


def test_messages_of_an_esc_that_is_offline_are_left_out_and_counted(read):
    recording = read({("esc_status", 0): statuses([15] * 40 + [7] * 3 + [15] * 57)})
    assert len(recording.rotor_speeds) == 97
    assert [str(left) for left in recording.quality.left_out] == [
        "topic rotor_speeds: left out 3 of 100 samples in which an ESC is offline; the first is sample 40, "
        "at 0.200 s"
    ]


def test_online_flags_that_a_driver_never_sets_say_nothing(read):
    assert len(read({("esc_status", 0): statuses([0] * 100)}).rotor_speeds) == 100


def test_an_esc_that_never_answers_reads_0(read):
    """So that the check of the flight names it: nothing is left of its samples otherwise."""
    recording = read({("esc_status", 0): statuses([13] * 100, (1000, 0, 3000, 4000))})
    assert len(recording.rotor_speeds) == 100
    assert np.count_nonzero(recording.rotor_speeds.speeds, axis=0).tolist().count(0) == 1


def test_of_instances_the_first_one_with_speeds_counts(read, vehicle, caplog):
    topics = {("esc_status", 0): statuses([0] * 100, (0,) * 4), ("esc_status", 1): statuses([15] * 100)}
    assert corners(vehicle, read(topics))[1, 1] == pytest.approx(1000.0)
    assert "esc_status: instance 1 is read, those before it are empty" in caplog.text


@pytest.mark.parametrize(
    ("parameters", "refused"),
    [
        ({"CA_ROTOR_COUNT": 6.0}, "CA_ROTOR_COUNT 6 is a hexacopter; vehicle neurobem has 4 rotors"),
        ({"MAV_TYPE": 14.0}, "MAV_TYPE 14 is an octocopter; vehicle neurobem has 4 rotors"),
        ({"CA_ROTOR_COUNT": 4.0, "MAV_TYPE": 13.0}, None),
        ({"CA_ROTOR_COUNT": float("nan"), "CA_AIRFRAME": float("inf")}, None),
    ],
)
def test_another_multicopter_is_refused_by_name(read, parameters, refused):
    if refused is None:
        assert len(read(parameters=parameters).imu) == 100
        return
    with pytest.raises(LogError, match=refused):
        read(parameters=parameters)


@pytest.mark.parametrize("parameters", [{"CA_AIRFRAME": 2.0, "CA_ROTOR_COUNT": 4.0}, {"MAV_TYPE": 22.0}])
def test_of_a_vtol_the_sensors_are_read_and_the_rotors_are_not(read, parameters, caplog):
    recording = read(escs((101, 102, 103, 104)), parameters=parameters)
    assert len(recording.imu) == 100
    assert recording.rotor_speeds is None
    assert "VTOL" in caplog.text
    assert "rules out identification, prediction and replay" in caplog.text


def test_voltage(read):
    battery = read({("battery_status", 0): (BATTERY, [(7, 12.5), (9, 12.25)])}).battery
    assert (battery.time_ns.tolist(), battery.voltage.tolist()) == ([7000, 9000], [12.5, 12.25])


def test_what_ends_pyulog_is_one_error(tmp_path, monkeypatch):
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog({}))

    def broken(*_: Any) -> Any:
        raise ValueError("a size of -1")

    monkeypatch.setitem(sys.modules, "pyulog", SimpleNamespace(ULog=broken))
    with pytest.raises(LogError, match=r"flight\.ulg: cannot be read: a size of -1"):
        read_px4(path, None)


def test_a_parameter_that_is_no_number_is_as_none(read, tmp_path, vehicle, caplog):
    """Damage in the type of a parameter leaves bytes."""
    read(escs((101, 102, 103, 104)), parameters={f"CA_ROTOR{motor}_PX": 1.0 for motor in range(4)})
    path = tmp_path / "flight.ulg"
    path.write_bytes(path.read_bytes().replace(b"float CA_ROTOR0_PX", b"fl\xffat CA_ROTOR0_PX"))
    assert read_px4(path, vehicle).rotor_speeds is not None
    assert "its motors are taken as quad-x" in caplog.text


def test_the_library_that_the_format_needs_is_named(read, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(LogError, match=r"needs pyulog.*pip install quadpi-monitor\[logs\]"):
        read()


def test_what_is_no_ulog_and_a_log_without_an_imu_are_refused(tmp_path):
    path = tmp_path / "flight.ulg"
    path.write_bytes(b"ULog")
    with pytest.raises(LogError, match=r"flight\.ulg: byte 0: not a ULog file"):
        read_px4(path, None)
    path.write_bytes(ulog({("battery_status", 0): (BATTERY, [(7, 12.5)])}))
    with pytest.raises(LogError, match=r"topic imu: the log holds no samples .* \(sensor_combined\)"):
        read_px4(path, None)


def test_commands_by_motor_come_in_the_order_of_the_rotors(read, vehicle):
    """Of motors that are not driven the command is not a number."""
    motors = ("uint64_t timestamp;uint64_t timestamp_sample;float[12] control;", "QQ12f")
    rows = [(now, now - 1, 0.1, 0.2, 0.3, 0.4, *[float("nan")] * 8) for now in TIMES]
    found = read({("actuator_motors", 0): (motors, rows)})
    of_corner = dict(zip(CORNERS, (0.1, 0.2, 0.3, 0.4), strict=True))
    wanted = [of_corner[tuple(np.sign(place[:2]).astype(int))] for place in vehicle.rotor_positions]
    np.testing.assert_allclose(found.commands.commands[0], wanted, atol=1e-6)
    assert (found.commands.time_ns[0], found.command_source) == (1000 * (TIMES[0] - 1), "px4_motors")
