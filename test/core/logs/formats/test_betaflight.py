# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Betaflight's logs: which of several flights is read, in which units, and what is said of the rest."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpi_core.errors import LogError, VehicleError
from quadpi_core.flight import Recording
from quadpi_core.frames import roll_pitch_yaw_from_quaternion
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs import decode_recording, read_recording
from quadpi_core.logs.formats.betaflight import read_betaflight
from quadpi_core.logs.importing import import_logs
from quadpi_core.paths import bags_directory
from quadpi_core.rotor_order import RotorOrder
from quadpi_core.vehicle import Vehicle

from ..blackbox_writer import PLAIN, intra, log, signed

RAD_S = 2.0 * np.pi / 60.0
GYRO, ACCELERATION, ERPM = (
    [f"{name}[{axis}]" for axis in range(count)]
    for name, count in (("gyroADC", 3), ("accSmooth", 3), ("eRPM", 4))
)
SENSORS = [*GYRO, *ACCELERATION]
VALUES = (100, -200, 300, 0, 0, 2048, 10, 20, 30, 40)


def frames(count: int, values: tuple[int, ...] = VALUES, *, every: int = 32) -> list[bytes]:
    return [intra(every * k, 1000 + 500 * k, b"".join(map(signed, values))) for k in range(count)]


def flight(*parts: bytes, names: list[str] | None = None, **headers: object) -> bytes:
    fields = PLAIN | dict.fromkeys([*SENSORS, *ERPM] if names is None else names, (0, 0, 0, 0))
    known = {"acc_1G": 2048, "dshot_bidir": 1, "motor_poles": 14, **headers}
    return log(fields, parts, more=[f"{name}:{value}" for name, value in known.items() if value is not None])


@pytest.fixture
def read(tmp_path: Path, vehicle: Vehicle) -> Any:
    """read(content) → the recording in such a file."""

    def recording(content: bytes, of: Vehicle | None = vehicle) -> Recording:
        path = tmp_path / "flight.bbl"
        path.write_bytes(content)
        return read_betaflight(path, of)

    return recording


def test_units_and_axes(read):
    """deg/s and counts in forward-left-up; hundreds of eRPM of 7 pole pairs, motors in neurobem's order."""
    recording = read(flight(*frames(4)))
    assert recording.imu.angular_velocity[0] == pytest.approx(np.radians([100.0, 200.0, -300.0]))
    assert recording.imu.specific_force[0] == pytest.approx([0.0, 0.0, -9.80665])
    assert recording.rotor_speeds.speeds[0] == pytest.approx(np.array([10, 20, 30, 40]) * 100.0 / 7 * RAD_S)
    assert recording.imu.time_ns.tolist() == [10**6, 1_500_000, 2 * 10**6, 2_500_000]


def test_counts_of_the_gyro_are_scaled_as_the_headers_say(read):
    """The scale is the bits of a float; at high resolution a count is a tenth."""
    bits = struct.unpack("<I", struct.pack("<f", 0.5))[0]
    for headers, scale in (
        ({"gyro_scale": f"0x{bits:08x}"}, 0.5),
        ({"gyro_scale": f"0x{bits:08x}", "blackbox_high_resolution": 1}, 0.05),
        ({"blackbox_high_resolution": 0}, 1.0),
    ):
        found = read(flight(*frames(3), **headers)).imu.angular_velocity[0, 0]
        assert found == pytest.approx(np.radians(100.0 * scale))


@pytest.mark.parametrize("one_g", [None, 0, -1])
def test_counts_of_the_accelerometer_need_their_scale(read, one_g):
    with pytest.raises(LogError, match=r"flight\.bbl: the header acc_1G is missing: nothing says how many"):
        read(flight(*frames(3), acc_1G=one_g))


def test_the_flight_with_most_frames_is_read_and_the_others_said(read, caplog):
    content = flight(*frames(3)) + flight(*frames(5)) + flight(*frames(4))
    assert len(read(content).imu) == 5
    assert "holds 3 flights; read is the longest, number 2" in caplog.text


def test_each_flight_of_a_file_has_its_bag_and_its_number(tmp_path, vehicle, caplog):
    path = tmp_path / "LOG00001.BBL"
    counts = (300, 500, 0, 400)
    parts = [frames(count, (k, *VALUES[1:6])) for k, count in enumerate(counts)]
    path.write_bytes(b"".join(flight(*part, names=SENSORS) for part in parts))
    imported = import_logs([path], vehicle, tmp_path / "bags")
    assert [flight.bag.name for flight in imported] == [f"LOG00001_{n}.mcap" for n in (1, 2, 4)]
    assert [flight.imu_samples for flight in imported] == [300, 500, 400]
    second = path.with_name("LOG00001.BBL#2")
    assert read_recording(second, vehicle).imu.angular_velocity[0, 0] == pytest.approx(np.radians(1.0))
    bag = read_recording(tmp_path / "bags" / "LOG00001_2.mcap", vehicle)
    np.testing.assert_array_equal(bag.imu.time_ns, read_recording(second, vehicle).imu.time_ns)
    assert len(read_recording(path, vehicle).imu) == 500
    assert "holds 3 flights; read is the longest, number 2: `LOG00001.BBL#1` is the first" in caplog.text
    (one,) = import_logs([second], vehicle, tmp_path / "one")
    assert one.bag.name == "LOG00001_2.mcap"
    for number, message in (
        (3, "no frame of flight 3 can be read"),
        (5, "holds 4 flights, none of number 5"),
    ):
        with pytest.raises(LogError, match=message):
            read_recording(f"{path}#{number}", vehicle)


def test_a_log_of_one_flight_has_none_of_a_number(vehicle):
    bag = bags_directory() / "interpolation.mcap"
    with pytest.raises(
        LogError, match=r"interpolation\.mcap: a bag .* holds one flight, and none of a number"
    ):
        read_recording(f"{bag}#2", vehicle)


def test_a_flight_whose_headers_are_broken_is_passed_over(read, caplog):
    broken = flight(*frames(9)).replace(b"Field I encoding", b"Field I encodin_")
    assert len(read(broken + flight(*frames(3))).imu) == 3
    assert "flight 1: its header `Field I encoding` has 1 entries" in caplog.text
    with pytest.raises(LogError, match=r"flight\.bbl: no frame of a flight can be read"):
        read(broken)


@pytest.mark.parametrize(("others", "frames_read"), [(99, 2), (100, 1)])
def test_of_many_flights_the_hundred_largest_are_looked_at(read, others, frames_read):
    """The one with most frames is the smallest here: the headers of the others are longer."""
    long = flight(*frames(1), note="x" * 4000)
    assert len(read(long * others + flight(*frames(2))).imu) == frames_read


def test_what_is_missing_is_said(read, caplog):
    content = flight(*frames(3), *frames(6, every=32)[4:])
    assert len(read(content).imu) == 5
    assert "flight 1: about 1 frames are damaged or were not logged" in caplog.text
    read(content[: -len("End of log") - 3])
    assert "flight 1: it has no end: the file is cut off, or the battery was pulled" in caplog.text


@pytest.mark.parametrize(("names", "topic"), [(ERPM, "imu"), (SENSORS, None)])
def test_fields_that_were_not_logged(read, names, topic, caplog):
    values = tuple(VALUES[[*SENSORS, *ERPM].index(name)] for name in names)
    content = flight(*frames(3, values), names=names)
    if topic:
        with pytest.raises(
            LogError, match=r"topic imu: the log holds no samples .*\(gyroADC and accSmooth\)"
        ):
            read(content)
        return
    assert read(content).rotor_speeds is None
    assert "bidirectional DShot was on, but eRPM is not among the logged fields" in caplog.text


def test_electrical_speeds_need_pole_pairs(read, vehicle, caplog):
    with pytest.raises(VehicleError, match="pole_pairs"):
        read(flight(*frames(3), motor_poles=None), replace(vehicle, pole_pairs=None))
    assert read(flight(*frames(3), motor_poles=None), None).rotor_speeds is None
    assert "topic rotor_speeds: left out, electrical speeds need the vehicle's pole pairs" in caplog.text


def test_more_motors_than_four_are_read_by_their_order(tmp_path, vehicle):
    """Betaflight's frames of six are not known: the order is given. Without a vehicle all are read."""
    erpm = [f"eRPM[{motor}]" for motor in range(6)]
    path = tmp_path / "flight.bbl"
    path.write_bytes(flight(*frames(400, (*VALUES, 50, 60)), names=[*SENSORS, *erpm]))
    six = replace(
        vehicle,
        rotor_positions=np.vstack((vehicle.rotor_positions, vehicle.rotor_positions[:2])),
        rotor_spins=np.append(vehicle.rotor_spins, vehicle.rotor_spins[:2]),
    )
    expected = np.array([10, 20, 30, 40, 50, 60]) * 100.0 / 7 * RAD_S
    speeds = read_betaflight(path, six, RotorOrder((5, 4, 3, 2, 1, 0))).rotor_speeds.speeds[0]
    assert speeds == pytest.approx(expected[::-1])
    assert read_betaflight(path, None).rotor_speeds.speeds[0] == pytest.approx(expected)
    with pytest.raises(
        LogError, match=r"flight\.bbl: the vehicle's rotors are not those of a frame betaflight"
    ):
        read_betaflight(path, six)
    with pytest.raises(LogError, match=r"flight\.bbl: field eRPM: of 6 motors, .* names number 7"):
        read_betaflight(path, vehicle, RotorOrder((0, 1, 2, 6)))
    mapping = tmp_path / "three.yaml"
    mapping.write_text("rotors: [1, 2, 3]\n")
    with pytest.raises(LogError, match=r"flight\.bbl: topic rotor_speeds: 3 rotors, vehicle neurobem has 4"):
        decode_recording(path, vehicle, mapping)


OMEGA, EXT_POS, EXT_ATT = (
    [f"{name}[{axis}]" for axis in range(count)]
    for name, count in (("omega", 4), ("extPos", 3), ("extAtt", 3))
)


def with_poses(*poses: tuple[int, ...], omega: tuple[int, ...] = (1, -2, 3, 4)) -> bytes:
    """A log as INDIflight's, one frame for each pose [mm, mrad]."""
    parts = [
        intra(32 * k, 1000 + 500 * k, b"".join(map(signed, (*VALUES[:6], *omega, *pose))))
        for k, pose in enumerate(poses)
    ]
    return flight(*parts, names=[*SENSORS, *OMEGA, *EXT_POS, *EXT_ATT])


def test_rotor_speeds_in_rad_s_need_no_pole_pairs(read, vehicle):
    """INDIflight's, in neurobem's order, whichever way a rotor turns."""
    content = with_poses((0, 0, -1000, 0, 0, 0), (0, 0, -1001, 0, 0, 0))
    for of in (vehicle, replace(vehicle, pole_pairs=None), None):
        assert read(content, of).rotor_speeds.speeds.tolist() == 2 * [[1.0, 2.0, 3.0, 4.0]]


def test_rotor_speeds_in_rad_s_follow_a_mapping(tmp_path, vehicle):
    path = tmp_path / "flight.bfl"
    path.write_bytes(with_poses((0, 0, -1000, 0, 0, 0)))
    recording = read_betaflight(path, vehicle, RotorOrder((3, 0, 1, 2)))
    assert recording.rotor_speeds.speeds.tolist() == [[4.0, 1.0, 2.0, 3.0]]


def test_a_pose_of_motion_capture_counts_once(read):
    """mm, mrad of roll, pitch and yaw, forward-right-down in north-east-down, held until the next comes."""
    first, second = (100, -200, -3000, 0, 0, 1571), (100, -200, -3000, 500, 0, 1571)
    poses = read(with_poses(first, first, second, second)).pose
    assert poses.time_ns.tolist() == [10**6, 2 * 10**6]
    assert poses.position[0] == pytest.approx([0.1, -0.2, -3.0])
    angles = [roll_pitch_yaw_from_quaternion(attitude) for attitude in poses.attitude]
    assert np.array(angles) == pytest.approx(np.array([[0.0, 0.0, 1.571], [0.5, 0.0, 1.571]]))
    assert read(flight(*frames(3))).pose is None


def test_flights_that_were_thrown_and_caught(shared_data):
    """Gyro, specific force, rotor speeds and motion capture of a real flight belong to one motion."""
    thrown = Vehicle.load("indiflight")
    (flown,) = prepare_flights([shared_data / "indiflight" / "LOG00267.BFL"], thrown)
    squares = np.square(flown.inputs[:, INPUT_NAMES.index("omega_avg")])
    thrust_n_s2 = -float(flown.wrench[:, 2] @ squares) / float(squares @ squares) / 4.0
    assert thrust_n_s2 == pytest.approx(2.7e-7, rel=0.05)
    # For a second the motors of a vehicle that is thrown idle, and then catch it.
    caught = flown.time >= flown.time[0] + 1.2
    for column, (control, least) in enumerate({"U_p": 0.7, "U_q": 0.7, "U_r": -0.6}.items()):
        turned = flown.inputs[caught, INPUT_NAMES.index(control)]
        correlation = np.corrcoef(flown.wrench[caught, 3 + column], turned)[0, 1]
        assert correlation * np.sign(least) > abs(least), control


def test_other_pole_pairs_than_the_log_says_are_noted(read, vehicle, caplog):
    """The log's count."""
    own, other = (read(flight(*frames(3)), replace(vehicle, pole_pairs=pairs)) for pairs in (7, 6))
    assert np.array_equal(own.rotor_speeds.speeds, other.rotor_speeds.speeds)
    assert "motor_poles is 14, the vehicle file says 12; the log counts" in caplog.text


def test_electrical_speeds_that_are_zero_throughout_name_the_setting(read, caplog):
    assert read(flight(*frames(3, (*VALUES[:6], 0, 0, 0, 0)))).rotor_speeds is None
    assert "every eRPM is zero: no telemetry: `set dshot_bidir = ON`" in caplog.text


def test_a_log_of_six_motors_is_refused_by_name(read):
    motors = [f"motor[{number}]" for number in range(6)]
    with pytest.raises(LogError, match=r"a log of 6 motors is a hexacopter; vehicle .* has 4 rotors"):
        read(flight(*frames(3, (*VALUES, *[1000] * 6)), names=[*SENSORS, *ERPM, *motors]))
