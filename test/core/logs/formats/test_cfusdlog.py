# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The Crazyflie uSD log reader: physics of the real flights, both versions, damaged files."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.flight import Recording
from quadpi_core.frames import rotate_body_to_world, rotate_world_to_body
from quadpi_core.logs import read_recording
from quadpi_core.logs.formats.cfusdlog import decode_events
from quadpi_core.vehicle import Motors, Vehicle

INERTIAL = ["gyro.x(f)", "gyro.y(f)", "gyro.z(f)", "acc.x(f)", "acc.y(f)", "acc.z(f)", "pm.vbatMV(H)"]
ROTORS = [f"rpm.m{i}(H)" for i in (1, 2, 3, 4)]


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle.load("crazyflie_rpm")


@pytest.fixture(scope="module")
def flight(shared_data: Path, vehicle: Vehicle) -> Recording:
    return read_recording(shared_data / "imrc_brushless" / "eckart17", vehicle)


def smooth(values: np.ndarray, width: int = 25) -> np.ndarray:
    kernel = np.ones(width) / width
    return np.stack([np.convolve(column, kernel, mode="same") for column in values.T], axis=1)


def test_every_flight_is_read(shared_data: Path, vehicle: Vehicle):
    paths = sorted((shared_data / "imrc_brushless").iterdir())
    recordings = [read_recording(path, vehicle) for path in paths]
    assert len(recordings) == 20
    for recording in recordings:
        topics = [stream.topic for stream in recording.streams()]
        assert topics == ["imu", "rotor_speeds", "mocap/pose", "odometry"]
        seconds = (recording.imu.time_ns[-1] - recording.imu.time_ns[0]) * 1e-9
        assert 480 < len(recording.imu) / seconds < 520
        assert 90 < len(recording.pose) / seconds < 110


def test_hover_thrust_points_up(flight: Recording):
    assert np.median(flight.imu.specific_force[:, 2]) == pytest.approx(-9.81, abs=0.4)
    assert np.all(np.abs(flight.imu.specific_force[:, :2]).max(axis=0) < 1.0)


def test_thrust_follows_rotor_speeds(flight: Recording, vehicle: Vehicle):
    squares = np.sum(flight.rotor_speeds.speeds**2, axis=1)
    thrust = -vehicle.mass_kg * flight.imu.specific_force[:, 2]
    assert thrust @ squares / (squares @ squares) == pytest.approx(3.70e-8, rel=0.03)


def test_velocity_is_the_derivative_of_position(flight: Recording):
    odometry = flight.odometry
    time = odometry.time_ns * 1e-9
    velocity = rotate_body_to_world(odometry.attitude, odometry.velocity)
    derivative = smooth(np.gradient(odometry.position, time, axis=0))
    assert np.corrcoef(smooth(velocity).ravel(), derivative.ravel())[0, 1] > 0.99


def test_specific_force_is_acceleration_without_gravity(flight: Recording, vehicle: Vehicle):
    odometry = flight.odometry
    velocity = rotate_body_to_world(odometry.attitude, odometry.velocity)
    acceleration = np.gradient(smooth(velocity), odometry.time_ns * 1e-9, axis=0)
    expected = rotate_world_to_body(odometry.attitude, acceleration - [0.0, 0.0, vehicle.gravity_m_s2])
    measured = smooth(flight.imu.specific_force)[200:-200]
    assert np.corrcoef(measured[:, 2], smooth(expected)[200:-200, 2])[0, 1] > 0.7


def test_estimate_follows_motion_capture(flight: Recording):
    nearest = np.searchsorted(flight.odometry.time_ns, flight.pose.time_ns).clip(0, len(flight.odometry) - 1)
    assert np.abs(flight.odometry.position[nearest] - flight.pose.position).max() < 0.02
    alignment = np.abs(np.sum(flight.odometry.attitude[nearest] * flight.pose.attitude, axis=1))
    assert np.median(alignment) > 0.999


def test_rotors_agree_with_the_moments(shared_data: Path, vehicle: Vehicle):
    """Place and spin of each rotor must give the sign of its share of roll, pitch and yaw moments."""
    coefficients = np.zeros((3, 4))
    for number in (17, 18, 19, 20, 21):
        flight = read_recording(shared_data / "imrc_brushless" / f"eckart{number}", vehicle)
        rates = flight.imu.angular_velocity
        moments = np.gradient(rates, flight.imu.time_ns * 1e-9, axis=0) @ vehicle.inertia.T
        squares = flight.rotor_speeds.speeds**2
        fast_moments, fast_squares = (
            smooth(values, 9) - smooth(values, 121) for values in (moments, squares)
        )
        coefficients += np.linalg.lstsq(fast_squares[150:-150], fast_moments[150:-150], rcond=None)[0].T
    roll, pitch, yaw = np.sign(coefficients)
    np.testing.assert_array_equal(roll, np.sign(-vehicle.rotor_positions[:, 1]))
    np.testing.assert_array_equal(pitch, np.sign(vehicle.rotor_positions[:, 0]))
    np.testing.assert_array_equal(yaw, -vehicle.rotor_spins)


def write_log(
    path: Path, events: dict[int, tuple[str, list[str]]], records: list[tuple], version: int = 2
) -> Path:
    """Encode records (event id, ticks, values…) as the firmware does."""
    data = struct.pack("<BHH", 0xBC, version, len(events))
    for event_id, (name, variables) in events.items():
        data += struct.pack("<H", event_id) + name.encode() + b"\0" + struct.pack("<H", len(variables))
        data += b"".join(variable.encode() + b"\0" for variable in variables)
    for event_id, ticks, *values in records:
        letters = "".join(variable[-2] for variable in events[event_id][1])
        data += struct.pack("<H" + {1: "I", 2: "Q"}[version] + letters, event_id, ticks, *values)
    path.write_bytes(data + struct.pack("<I", zlib.crc32(data)))
    return path


EVENTS = {65535: ("fixedFrequency", INERTIAL), 3: ("rotors", ROTORS)}
RECORDS = [
    (65535, 2000, 90.0, 180.0, 0.0, 0.0, 0.5, 1.0, 3700),
    (3, 3000, 6000, 6000, 0, 12000),
    (65535, 4000, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 3690),
    (3, 5000, 6000, 6000, 0, 12000),
]


@pytest.mark.parametrize(("version", "tick_ns"), [(1, 1_000_000), (2, 1_000)])
def test_units_and_clocks(tmp_path: Path, vehicle: Vehicle, version: int, tick_ns: int):
    recording = read_recording(write_log(tmp_path / "log00", EVENTS, RECORDS, version), vehicle)
    np.testing.assert_array_equal(recording.imu.time_ns, np.array([2000, 4000]) * tick_ns)
    np.testing.assert_array_equal(recording.rotor_speeds.time_ns, np.array([3000, 5000]) * tick_ns)
    np.testing.assert_allclose(recording.imu.angular_velocity[0], [np.pi / 2, -np.pi, 0.0])
    np.testing.assert_allclose(recording.imu.specific_force[0], [0.0, -0.5 * 9.80665, -9.80665])
    np.testing.assert_allclose(
        recording.rotor_speeds.speeds[0], np.array([6000, 6000, 0, 12000]) * np.pi / 30
    )
    np.testing.assert_allclose(recording.battery.voltage, [3.7, 3.69])
    assert recording.pose is None
    assert recording.odometry is None


def test_what_is_cut_off_at_power_off_is_read_up_to_there(tmp_path: Path, caplog):
    """At every byte of the last records, also where four are left, as many as a checksum has."""
    data = write_log(tmp_path / "log00", EVENTS, RECORDS).read_bytes()[:-4]
    for lost in range(72):
        caplog.clear()
        events = decode_events("log00", data[: len(data) - lost])
        whole = 4 - int(np.searchsorted([0, 18, 54, 72], lost))
        counts = [len(events[name].time_ns) for name in ("fixedFrequency", "rotors")]
        assert counts == [(whole + 1) // 2, whole // 2], lost
        assert "log00: the file is cut off in the record from byte" in caplog.text, lost


def test_zeros_that_fill_the_card_behind_the_cut_are_no_records(tmp_path: Path, caplog):
    events = {0: EVENTS[65535], 3: EVENTS[3]}
    records = [(0 if event == 65535 else event, *values) for event, *values in RECORDS]
    data = write_log(tmp_path / "log00", events, records).read_bytes()[:-7] + bytes(4096)
    counts = [len(event.time_ns) for event in decode_events("log00", data).values()]
    assert counts == [2, 1]
    assert "cut off in the record" in caplog.text


def test_a_cut_before_the_first_record_is_one_error(tmp_path: Path, vehicle: Vehicle):
    path = write_log(tmp_path / "log00", EVENTS, RECORDS)
    data = path.read_bytes()
    for length in range(1, 160, 7):
        path.write_bytes(data[:length])
        with pytest.raises(LogError, match="log00"):
            read_recording(path, vehicle)


def test_changed_value_fails_the_checksum(tmp_path: Path, vehicle: Vehicle):
    path = write_log(tmp_path / "log00", EVENTS, RECORDS)
    data = bytearray(path.read_bytes())
    data[-8] ^= 1
    path.write_bytes(data)
    with pytest.raises(LogError, match="checksum does not match"):
        read_recording(path, vehicle)


def test_what_is_behind_an_undefined_event_is_left_out_and_said(tmp_path: Path, vehicle: Vehicle, caplog):
    path = write_log(tmp_path / "log00", EVENTS, RECORDS)
    data = path.read_bytes()
    path.write_bytes(data.replace(struct.pack("<HQ", 3, 5000), struct.pack("<HQ", 4, 5000)))
    recording = read_recording(path, vehicle)
    assert (len(recording.imu), len(recording.rotor_speeds)) == (2, 1)
    assert f"damaged from byte {data.index(struct.pack('<HQ', 3, 5000))} on" in caplog.text


def test_unknown_version_is_refused(tmp_path: Path, vehicle: Vehicle):
    path = write_log(tmp_path / "log00", EVENTS, RECORDS)
    data = bytearray(path.read_bytes())
    data[1] = 7
    path.write_bytes(data)
    with pytest.raises(LogError, match="version 7 is not known"):
        read_recording(path, vehicle)


def test_log_without_imu_says_what_it_has(tmp_path: Path, vehicle: Vehicle):
    path = write_log(tmp_path / "log00", {3: ("rotors", ROTORS)}, [RECORDS[1]])
    with pytest.raises(LogError, match=r"needs gyro and acc in one event; it logs rpm\.m1, rpm\.m2"):
        read_recording(path, vehicle)


def test_repeated_stamp_is_named(tmp_path: Path, vehicle: Vehicle):
    path = write_log(tmp_path / "log00", EVENTS, [*RECORDS, RECORDS[2]])
    said = read_recording(path, vehicle).quality.left_out[0]
    assert (said.topic, said.limit, said.first) == ("imu", "whose stamp repeats", 2)


def test_commands_are_those_behind_the_compensation_of_the_battery(tmp_path: Path, vehicle: Vehicle):
    """`pwm` before `motor`; of a vehicle that has motors, rotor speeds are made of them."""
    pwm, motor = (
        [f"{name}{i}{end}(H)" for i in (1, 2, 3, 4)] for name, end in (("pwm.m", "_pwm"), ("motor.m", ""))
    )
    events = {**EVENTS, 4: ("pwm", pwm), 5: ("motor", motor)}
    sent = [
        (4, 3000, 13107, 26214, 39321, 52428),
        (5, 3000, 1, 2, 3, 4),
        (4, 5000, 13107, 26214, 39321, 52428),
    ]
    path = write_log(tmp_path / "log00", events, sorted(RECORDS + sent, key=lambda row: row[1]))
    recording = read_recording(path, vehicle)
    np.testing.assert_allclose(recording.commands.commands[0], [0.2, 0.4, 0.6, 0.8])
    assert (recording.command_source, recording.commanded) == ("crazyflie pwm", False)
    motors = Motors(source="crazyflie pwm", coefficients=((0.0, 1000.0, 0.0, 100.0, 0.0),) * 4, lag_s=0.0)
    told = read_recording(path, replace(vehicle, motors=motors))
    np.testing.assert_allclose(told.rotor_speeds.speeds[0], [570.0, 770.0, 970.0, 1170.0])
    np.testing.assert_allclose(told.rotor_speeds.speeds[1], [569.0, 769.0, 969.0, 1169.0])
    assert told.commanded
    other = replace(motors, source="px4_motors")
    with pytest.raises(LogError, match=r"are of crazyflie pwm, and the vehicle's motors .* of px4_motors"):
        read_recording(path, replace(vehicle, motors=other))
