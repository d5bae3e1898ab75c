# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Logs of ArduPilot, PX4, Betaflight and telemetry: values against a known flight, damage, and real logs."""

from __future__ import annotations

import contextlib
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
pytest.importorskip("pyulog", reason="pyulog is not installed")
from benchmarks.fuzzing import flight_logs
from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.flight import Recording
from quadpi_core.logs import identify_format, read_recording
from quadpi_core.logs.bags import read_bag
from quadpi_core.logs.importing import import_logs
from quadpi_core.vehicle import Vehicle

RAD_S = 2 * np.pi / 60
DESCRIPTIONS = {".BIN": "ArduPilot", ".ulg": "PX4", ".tlog": "MAVLink", ".bbl": "Betaflight"}
# Counts of a gyro in deg/s, of an accelerometer with 2048 to one g, of hundreds of eRPM with 7 pole pairs.
TOLERANCES = {".bbl": (0.5 * np.pi / 180, 9.8 / 2048, 7.2 * RAD_S)}


@pytest.mark.parametrize("suffix", DESCRIPTIONS)
def test_every_format_is_recognised_by_its_content(suffix: str, written: dict[str, Path]) -> None:
    renamed = written[suffix].rename(written[suffix].with_suffix(".log"))
    assert identify_format(renamed).description.startswith(DESCRIPTIONS[suffix])


@pytest.mark.parametrize("suffix", DESCRIPTIONS)
def test_imu_and_rotor_speeds(suffix: str, flown: Any, written: dict[str, Path], vehicle: Vehicle) -> None:
    recording = read_recording(written[suffix], vehicle)
    gyro, force, speed = TOLERANCES.get(suffix, (1e-6, 1e-5, 1e-3))
    assert recording.name == "flight"
    assert len(recording.imu) == len(flown.time_us)
    assert recording.imu.angular_velocity == pytest.approx(flown.rates, abs=gyro)
    assert recording.imu.specific_force == pytest.approx(flown.force, abs=force)
    assert recording.rotor_speeds
    assert recording.rotor_speeds.speeds == pytest.approx(flown.rpm * RAD_S, abs=speed)
    stamps = recording.imu.time_ns - recording.imu.time_ns[0]
    expected = (flown.time_us - flown.time_us[0]) * 1000
    assert np.abs(stamps - expected).max() < (150_000 if suffix == ".tlog" else 1)
    assert recording.rotor_speeds.time_ns[0] == pytest.approx(recording.imu.time_ns[0], abs=1000)


@pytest.mark.parametrize("suffix", [".BIN", ".ulg", ".tlog"])
def test_the_autopilot_s_own_state(
    suffix: str, flown: Any, written: dict[str, Path], vehicle: Vehicle
) -> None:
    state = read_recording(written[suffix], vehicle).odometry
    assert state
    assert len(state) == len(flown.time_us)
    turn = Rotation.from_quat(flown.attitude, scalar_first=True)
    assert state.position == pytest.approx(flown.position, abs=1e-5)
    assert np.abs(np.sum(state.attitude * flown.attitude, axis=1)) == pytest.approx(1.0)
    assert state.velocity == pytest.approx(turn.inv().apply(flown.velocity_world), abs=1e-5)
    assert state.rates == pytest.approx(flown.rates, abs=1e-6)


@pytest.mark.parametrize("write", [flight_logs.dataflash, flight_logs.ulog])
def test_no_state_is_made_up_where_the_attitude_is_missing(write, tmp_path, flown, vehicle, caplog) -> None:
    attitude = flown.attitude.copy()
    attitude[80:120] = 0.0
    path = tmp_path / "flight"
    path.write_bytes(write(flown._replace(attitude=attitude)))
    state = read_recording(path, vehicle).odometry
    after = (state.time_ns - flown.time_us[0] * 1000) // 5_000_000
    assert sorted(set(range(200)) - set(after.tolist())) == list(range(80, 120))
    assert "topic odometry: 40 of 200 have no attitude" in caplog.text


@pytest.mark.parametrize("suffix", [".ulg", ".tlog"])
def test_motion_capture(suffix: str, flown: Any, written: dict[str, Path], vehicle: Vehicle) -> None:
    recording = read_recording(written[suffix], vehicle)
    assert recording.pose
    assert recording.pose.position == pytest.approx(flown.position, abs=1e-6)
    assert recording.pose.attitude == pytest.approx(flown.attitude, abs=1e-6)
    # By when it was measured, not when it was published.
    assert recording.pose.time_ns == pytest.approx(recording.imu.time_ns, abs=1000)


def test_what_is_missing_is_said(written: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    imported = import_logs([written[".bbl"]], vehicle, tmp_path / "out")
    assert imported[0].missing == (
        "neither pose nor odometry: rules out everything that needs velocity or attitude",
    )
    imported = import_logs([written[".ulg"]], vehicle, tmp_path / "out")
    assert imported[0].missing == ()
    bag = read_bag(imported[0].bag, vehicle)
    assert [stream.topic for stream in bag.streams()] == ["imu", "rotor_speeds", "mocap/pose", "odometry"]


@pytest.mark.parametrize("suffix", DESCRIPTIONS)
def test_a_mapping_file_gives_another_order(
    suffix: str, written: dict[str, Path], vehicle: Vehicle, tmp_path: Path
) -> None:
    mapping = tmp_path / "order.yaml"
    mapping.write_text("rotors: [4, 3, 2, 1]")
    usual = read_recording(written[suffix], vehicle).rotor_speeds
    other = read_recording(written[suffix], vehicle, mapping).rotor_speeds
    assert usual
    assert other
    assert np.sort(other.speeds[5]) == pytest.approx(np.sort(usual.speeds[5]))
    assert not np.allclose(other.speeds, usual.speeds)


@pytest.mark.parametrize("suffix", DESCRIPTIONS)
def test_a_log_that_is_cut_off_is_read_up_to_there(
    suffix: str, written: dict[str, Path], vehicle: Vehicle, caplog: pytest.LogCaptureFixture
) -> None:
    data = written[suffix].read_bytes()
    written[suffix].write_bytes(data[: len(data) * 2 // 3])
    recording = read_recording(written[suffix], vehicle)
    assert 120 <= len(recording.imu) <= 135
    assert any(word in caplog.text for word in ("cut off", "damaged"))


@pytest.mark.parametrize("suffix", DESCRIPTIONS)
def test_a_log_cut_anywhere_is_read_up_to_there_or_says_what_it_lacks(
    suffix: str, written: dict[str, Path], vehicle: Vehicle
) -> None:
    data, whole = written[suffix].read_bytes(), read_recording(written[suffix], vehicle).imu
    for length in np.random.default_rng(6).integers(1, len(data), 20).tolist():
        written[suffix].write_bytes(data[:length])
        try:
            imu = read_recording(written[suffix], vehicle).imu
        except LogError:
            # Nothing but headers is left.
            assert length < 0.4 * len(data)
            continue
        assert abs(len(imu) / len(whole) - length / len(data)) < 0.4
        np.testing.assert_array_equal(imu.specific_force, whole.specific_force[: len(imu)])


@pytest.mark.parametrize("suffix", DESCRIPTIONS)
def test_damage_in_the_middle_costs_little_else(
    suffix: str, written: dict[str, Path], vehicle: Vehicle, caplog: pytest.LogCaptureFixture
) -> None:
    data = bytearray(written[suffix].read_bytes())
    middle = len(data) // 2
    data[middle : middle + 30] = b"\x5a" * 30
    written[suffix].write_bytes(data)
    recording = read_recording(written[suffix], vehicle)
    assert len(recording.imu) >= 190
    assert caplog.text


@pytest.mark.parametrize("suffix", DESCRIPTIONS)
@pytest.mark.parametrize("content", [b"\x00", b"garbage" * 200])
def test_what_is_no_log_is_refused_in_one_line(
    suffix: str, content: bytes, tmp_path: Path, vehicle: Vehicle
) -> None:
    path = tmp_path / f"flight{suffix}"
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"flight\S+: byte 0: no") as refused:
        read_recording(path, vehicle)
    assert "\n" not in str(refused.value)


@pytest.mark.slow
@settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_no_damage_gives_a_traceback(
    autopilot_logs: dict[str, bytes], vehicle: Vehicle, tmp_path_factory: pytest.TempPathFactory, data: Any
) -> None:
    logging.disable(logging.WARNING)
    suffix = data.draw(st.sampled_from(sorted(autopilot_logs)))
    log = bytearray(autopilot_logs[suffix][: 1 << 14])
    for place in data.draw(st.lists(st.integers(0, len(log) - 1), max_size=8)):
        log[place] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("fuzz") / f"flight{suffix}"
    path.write_bytes(log[: data.draw(st.integers(1, len(log)))])
    try:
        with contextlib.suppress(QuadpiError):
            read_recording(path, vehicle).check()
    finally:
        logging.disable(logging.NOTSET)


BESIDE = ("battery", "pressure", "temperature")
REAL = {
    "ardupilot_copter_2014.BIN": ("imu", "odometry", "motor_commands", *BESIDE),
    "ardupilot_test.BIN": ("imu", "odometry", *BESIDE),
    "ardupilot_vtol.tlog": ("imu", "odometry", "pressure", "temperature"),
    "betaflight_error_recovery.bbl": ("imu", "motor_commands"),
    "px4_sample_small.ulg": ("imu", "odometry", *BESIDE),
}


@pytest.mark.parametrize("name", REAL)
def test_real_logs(name: str, shared_data: Path, vehicle: Vehicle, tmp_path: Path) -> None:
    (imported,) = import_logs([shared_data / "logs" / name], vehicle, tmp_path)
    assert imported.topics == REAL[name]
    assert any("no rotor speeds" in sentence for sentence in imported.missing)
    recording: Recording = read_bag(imported.bag, vehicle)
    # All of them stand or fly level: gravity is up in forward-right-down axes.
    assert np.median(recording.imu.specific_force[:, 2]) == pytest.approx(-9.8, abs=0.6)
