# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Telemetry logs: whose packets count, and what damage costs."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.logs.formats.mavlink_tlog import read_tlog

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
pytest.importorskip("pyulog", reason="pyulog is not installed")
from quadpi_core.logs import read_recording
from quadpi_core.vehicle import Vehicle

START_US = 1_700_000_000_000_000


def record(packet: bytes, number: int) -> bytes:
    return (START_US + 10_000 * number).to_bytes(8, "big") + packet


def test_motion_capture_of_another_system_is_not_used(
    mavlink_sender: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    vehicle, other = mavlink_sender(system=1), mavlink_sender(system=9)
    log = b""
    for number in range(200):
        log += record(vehicle.packet("HIGHRES_IMU", 10_000 * number, *[0.1] * 13, 0x3F, 0), number)
        pose = (10_000 * number, [1.0, 0.0, 0.0, 0.0], 0.1 * number, 0.0, 0.0)
        log += record(other.packet("ATT_POS_MOCAP", *pose), number)
    path = tmp_path / "flight.tlog"
    path.write_bytes(log)
    with caplog.at_level(logging.INFO):
        recording = read_tlog(path, None)
    assert recording.pose is None
    assert "200 ATT_POS_MOCAP of other systems not used" in caplog.text


def test_a_log_of_damage_alone_is_refused(tmp_path: Path) -> None:
    """What looks like a stamp and a header everywhere, but no packet follows."""
    path = tmp_path / "flight.tlog"
    path.write_bytes((START_US.to_bytes(8, "big") + bytes([0xFD, 255, 0, 0, 0, 1, 1, 131, 0, 0])) * 1000)
    with pytest.raises(LogError, match=r"flight\.tlog: byte 0: no MAVLink packet in the whole file"):
        read_tlog(path, None)


def test_damage_between_records_costs_those_that_it_hits(
    mavlink_sender: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    whole = imu_log(mavlink_sender(), 10_000 * np.arange(100))
    path, size = tmp_path / "flight.tlog", len(whole) // 100
    path.write_bytes(whole[: 30 * size + 5] + whole[30 * size + 6 : -3])
    assert len(read_tlog(path, None).imu) == 98
    assert f"{2 * size - 4} bytes are passed over" in caplog.text


def test_telemetry_is_stamped_by_the_computer_that_wrote_it(
    flown: Any, written: dict[str, Path], vehicle: Vehicle
) -> None:
    recording = read_recording(written[".tlog"], vehicle)
    sent_ns = (1_690_000_000_000_000 + flown.time_us) * 1000
    assert recording.imu.time_ns == pytest.approx(sent_ns + 20_000_000, abs=300_000)


def imu_log(sender: Any, clocks_us: Any, name: str = "HIGHRES_IMU") -> bytes:
    """A record of an IMU every 10 ms, whatever its stamp."""
    fields: tuple[Any, ...] = (*[0.1] * 13, 0x3F, 0) if name == "HIGHRES_IMU" else (*[1] * 9, 0)
    unit = 1 if name == "HIGHRES_IMU" else 1000
    packets = (sender.packet(name, int(clock_us) // unit, *fields) for clock_us in clocks_us)
    return b"".join(record(packet, number) for number, packet in enumerate(packets))


@pytest.mark.parametrize(("back_s", "restarts"), [(9.9, False), (10.1, True)])
def test_a_clock_that_goes_back_by_ten_seconds_has_started_again(
    mavlink_sender: Any, tmp_path: Path, back_s: float, restarts: bool
) -> None:
    """Packets overtake each other by less."""
    before = 30_000_000 + 10_000 * np.arange(200)
    path = tmp_path / "flight.tlog"
    path.write_bytes(
        imu_log(mavlink_sender(), [*before, *(before[-1] - 1e6 * back_s + 10_000 * np.arange(50))])
    )
    said = list(map(str, read_tlog(path, None).quality.breaks))
    after_s = 1e-6 * before[-1] - back_s
    fall = f"topic imu: the clock falls from {1e-6 * before[-1]:.1f} to {after_s:.1f} s at IMU sample 200"
    assert said == ([fall] if restarts else [])


@pytest.mark.parametrize(("best", "used"), [(51, 51), (49, 100)])
def test_the_better_message_is_used_if_it_has_half_the_samples(
    mavlink_sender: Any, tmp_path: Path, best: int, used: int
) -> None:
    sender, path = mavlink_sender(), tmp_path / "flight.tlog"
    path.write_bytes(
        imu_log(sender, 10_000 * np.arange(100), "SCALED_IMU") + imu_log(sender, 10_000 * np.arange(best))
    )
    assert len(read_tlog(path, None).imu) == used


@pytest.mark.parametrize(
    ("mav_type", "message"),
    [
        (13, "MAV_TYPE 13 is a hexacopter; vehicle bebop2 has 4 rotors"),
        (20, "MAV_TYPE 20 is a VTOL aircraft"),
        (2, ""),
    ],
)
def test_a_vehicle_that_is_no_quadrotor_is_named(
    mavlink_sender: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture, mav_type: int, message: str
) -> None:
    sender, path = mavlink_sender(), tmp_path / "flight.tlog"
    heartbeat = record(sender.packet("HEARTBEAT", mav_type, 12, 0, 0, 4, 3), 0)
    path.write_bytes(heartbeat + imu_log(sender, 10_000 * np.arange(100)))
    if mav_type == 13:
        with pytest.raises(LogError, match=message):
            read_tlog(path, Vehicle.load("bebop2"))
        return
    assert len(read_tlog(path, None).imu) == 100
    assert message in caplog.text
    assert ("its rotors are not" in caplog.text) is bool(message)


def test_speeds_that_are_zero_throughout_name_the_parameter_of_telemetry(
    mavlink_sender: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    sender, path = mavlink_sender(), tmp_path / "flight.tlog"
    silent = [
        record(sender.packet("ESC_TELEMETRY_1_TO_4", [0] * 4, [0] * 4, [0] * 4, [0] * 4, [0] * 4, [n] * 4), n)
        for n in range(1, 50)
    ]
    heartbeat = record(sender.packet("HEARTBEAT", 2, 3, 0, 0, 4, 3), 0)
    path.write_bytes(heartbeat + imu_log(sender, 10_000 * np.arange(100)) + b"".join(silent))
    assert read_tlog(path, None).rotor_speeds is None
    assert "every rpm is zero: no telemetry: set SERVO_BLH_AUTO" in caplog.text


def test_messages_of_an_esc_that_is_offline_are_left_out_and_counted(
    mavlink_sender: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    sender, log = mavlink_sender(system=1), b""
    for n in range(200):
        log += record(sender.packet("HIGHRES_IMU", 10_000 * n, *[0.1] * 13, 0x3F, 0), n)
        if n in {50, 80}:
            online = 0b0111 if n == 50 else 0b1111
            log += record(sender.packet("ESC_INFO", 0, 0, 0, 4, 0, online, [0] * 4, [0] * 4, [0] * 4), n)
        log += record(sender.packet("ESC_STATUS", 0, 10_000 * n, [4000 + n] * 4, [0.0] * 4, [0.0] * 4), n)
    path = tmp_path / "flight.tlog"
    path.write_bytes(log)
    with caplog.at_level(logging.INFO):
        recording = read_tlog(path, None)
    assert [str(one) for one in recording.quality.left_out] == [
        "topic rotor_speeds: left out 30 of 200 samples in which an ESC is offline; the first is sample 50, "
        "at 0.500 s"
    ]
    assert len(recording.rotor_speeds) == 170
    assert "offline" not in caplog.text
