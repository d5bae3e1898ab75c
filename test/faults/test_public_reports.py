# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Small recordings after public bug reports give the right values that their README says."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.flight import NOT_MEASURED, Recording
from quadpi_core.logs import read_recording
from quadpi_core.logs.importing import Imported, import_logs
from quadpi_core.monitor.preparation import Preparation, fault_words
from quadpi_core.screening.consistency import checked
from quadpi_core.signals.chain import ROTOR_SPEEDS
from quadpi_core.vehicle import Vehicle
from test.core.monitor.conftest import fly


@pytest.fixture
def report(shared_data: Path) -> Callable[[str], Path]:
    """report(name) → the folder of that case; the test skips where it is absent."""

    def folder(name: str) -> Path:
        path = shared_data / "reports" / name
        if not path.is_dir():
            pytest.skip(f"no case {path}")
        return path

    return folder


def test_a_crazyflie_s_log_that_ends_at_power_off(report, caplog):
    recording = read_recording(report("crazyflie_usd_power_off") / "log07", Vehicle.load("bebop2"))
    assert len(recording.imu) == len(recording.rotor_speeds) == 1999
    assert np.ptp(recording.imu.time_ns) == pytest.approx(1998 * 2_000_000, rel=1e-3)
    assert "cut off in the record from byte 100071" in caplog.text


def test_a_bag_that_was_reindexed_without_a_storage_identifier(report):
    recording = read_recording(report("bag_reindexed_on_humble") / "bag", Vehicle.load("bebop2"))
    assert [stream.topic for stream in recording.streams()] == ["imu", "rotor_speeds", "mocap/pose"]
    assert np.ptp(recording.imu.time_ns) == pytest.approx(6.0e9, rel=1e-3)


def test_a_table_with_spaces_after_the_commas_of_its_heading(report):
    case = report("csv_space_after_comma")
    recording = read_recording(case / "flight.csv", Vehicle.load("bebop2"), case / "mapping.yaml")
    assert [len(stream) for stream in recording.streams()] == [1000, 1000, 1000]


def test_a_table_with_a_state_that_lacks_its_position(report):
    case = report("table_velocity_without_position")
    state = read_recording(case / "flight.csv", Vehicle.load("bebop2"), case / "mapping.yaml").odometry
    assert [(column == NOT_MEASURED).all() for column in state.deviation.T] == [True, False, False]
    assert np.abs(state.velocity).max() > 0.0


@pytest.fixture
def imported(report, tmp_path) -> Callable[[str], tuple[Imported, Recording]]:
    """imported(case/file) → what `import` says of it, and the bag that it writes."""

    def run(case: str) -> tuple[Imported, Recording]:
        folder, _, file = case.partition("/")
        (said,) = import_logs([report(folder) / file], Vehicle.load("bebop2"), tmp_path / "out")
        return said, read_recording(said.bag, None)

    return run


def test_a_sample_stored_twice_is_dropped_and_counted(imported):
    said, flight = imported("bag_one_duplicate_imu_sample/flight.mcap")
    assert len(flight.imu) == said.imu_samples == 3000
    assert [(one.samples, one.first, one.limit) for one in said.quality.left_out] == [
        (1, 701, "whose stamp repeats")
    ]


def test_poses_without_a_quaternion_are_dropped_and_counted(imported):
    said, flight = imported("bag_zero_quaternion_while_hidden/flight.mcap")
    assert said.imu_samples == 3000
    (one,) = said.quality.left_out
    assert (one.topic, one.samples) == ("mocap/pose", 60)
    seconds = 1e-9 * (flight.pose.time_ns - flight.imu.time_ns[0])
    assert not np.any((seconds > 3.0) & (seconds < 3.49))
    assert seconds[-1] - seconds[0] > 5.9


def test_of_two_boots_in_one_log_the_longest_is_read(imported):
    said, flight = imported("dataflash_clock_restarts/flight.BIN")
    assert len(flight.imu) == 3001
    assert 1e-9 * (flight.imu.time_ns[[0, -1]]) == pytest.approx([25.0, 37.0])
    assert all(np.all(stream.time_ns >= flight.imu.time_ns[0]) for stream in flight.streams())
    first, used = said.quality.sentences()
    assert first == "topic imu: the clock falls from 28.0 to 25.0 s at IMU sample 2000"
    assert "the longest of 2 runs, 12.0 of 20.0 s" in used


def test_standard_types_on_other_names_are_found(report, quadpi, tmp_path, caplog):
    bag = report("bag_standard_types_other_names") / "flight.mcap"
    named = ("--topics", "imu=/mavros/imu/data", "mocap/pose=/vrpn_client_node/quad/pose")
    mapping = tmp_path / "names.yaml"
    mapping.write_text("imu: {topic: /mavros/imu/data}\nmocap: {topic: /vrpn_client_node/quad/pose}\n")
    for options in ((), named, ("--mapping", mapping)):
        result = quadpi("import", bag, "--vehicle", "bebop2", "-o", tmp_path / "out", *options)
        assert result.status == 0, result.errors
        assert "3000 IMU samples; topics imu, rotor_speeds, mocap/pose" in result.output
        assert ("read by its type" in caplog.text) == (options == ())
        caplog.clear()


def test_a_speed_controller_that_never_answers(report):
    case = report("esc_without_telemetry")
    vehicle = Vehicle.load("bebop2")
    recording = checked(read_recording(case / "flight.csv", vehicle, case / "mapping.yaml"), vehicle)
    (finding,) = recording.quality.sentences()
    assert finding.startswith("topic rotor_speeds: rotor 2 reads 0 rad/s from 0.00 to 6.00 s in flight")
    assert finding.endswith("its sensor fails; leave this flight out")


def test_rotor_speeds_in_hundreds_of_electrical_revolutions(report):
    case = report("erpm_in_hundreds")
    vehicle = Vehicle.load("bebop2")
    recording = checked(read_recording(case / "flight.csv", vehicle, case / "mapping.yaml"), vehicle)
    assert list(recording.quality.sentences()) == []
    assert len(recording.rotor_speeds) == 1500
    # Nor in flight, where three rotors read the same for the first half second.
    samples = fly(3.0, vehicle)
    samples.values[:, ROTOR_SPEEDS] = recording.rotor_speeds.speeds[: len(samples.time_ns)]
    faults = Preparation(vehicle, 500.0, 30.0).step(*samples).verdicts["faults"]
    assert not any("frozen" in word for bits in set(faults.tolist()) for word in fault_words(bits))


def test_a_speed_controller_of_px4_whose_telemetry_drops_out(report):
    pytest.importorskip("pyulog", reason="pyulog is not installed")
    recording = read_recording(report("px4_esc_drop_outs") / "flight.ulg", Vehicle.load("bebop2"))
    (left,) = recording.quality.left_out
    assert (left.limit, left.samples, left.of) == ("in which an ESC is offline", 48, 800)
    assert recording.rotor_speeds.speeds.min() > 450.0


def test_an_empty_first_instance_of_px4_s_esc_status(report, caplog):
    pytest.importorskip("pyulog", reason="pyulog is not installed")
    rotors = read_recording(
        report("px4_esc_status_second_instance") / "flight.ulg", Vehicle.load("bebop2")
    ).rotor_speeds
    assert len(rotors) == 800
    assert np.median(np.diff(rotors.time_ns)) == 10_000_000
    assert rotors.speeds[0] == pytest.approx([694.7] * 4, abs=0.3)
    assert "esc_status: instance 1 is read" in caplog.text


def test_motion_capture_of_a_clock_5_s_ahead_is_named_and_aligned(report, quadpi, tmp_path):
    bag = report("mocap_clock_5_s_off") / "flight.mcap"
    said = re.compile(r"gyro and attitude disagree: the stamps look \+(5\.00|4\.99)\d s off")
    vehicle = ("--vehicle", "bebop2")
    for result in (quadpi("import", bag, *vehicle, "-o", tmp_path / "out"), quadpi("info", bag, *vehicle)):
        assert result.status == 0, result.errors
        assert said.search(" ".join(result.output.split()))
    result = quadpi("import", bag, *vehicle, "-o", tmp_path / "aligned", "--align")
    assert result.status == 0, result.errors
    assert re.search(r"mocap/pose moved by -(5000|4999)\.\d ms", result.output)
    assert "disagree" not in result.output
    # The only flight: nothing is left to identify on.
    result = quadpi("identify", bag, *vehicle, "-o", tmp_path / "model")
    assert result.status == 2
    assert said.search(result.errors)
    assert result.errors.count("\n") == 1
