# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tables without a mapping, and bags, as field logs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="pyarrow is not installed")
from quadpi_core.errors import LogError
from quadpi_core.field.other_logs import field_log_of, read_other
from quadpi_core.flight import BatteryStream
from quadpi_core.logs import read_recording
from quadpi_core.paths import bags_directory
from quadpi_core.reading_options import ReadingOptions
from quadpi_core.vehicle import Vehicle

SENSORS = (
    "gyro_x [rad/s]",
    "gyro_y [rad/s]",
    "gyro_z [rad/s]",
    "acc_x [m/s2]",
    "acc_y [m/s2]",
    "acc_z [m/s2]",
)


def table(path: Path, names: list[str], values: list[float]) -> Path:
    """A table of 200 rows at 100 Hz, whose further columns hold these values throughout."""
    rows = [[0.01 * row, 0.1, 0.2, 0.3, 0.0, 0.5, 9.8, *values] for row in range(200)]
    lines = [
        ",".join(("time", *SENSORS, *names)),
        *(",".join(f"{value:.6g}" for value in row) for row in rows),
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def read(path: Path, **options):
    return read_other(path, ReadingOptions(**options), None)


def test_a_table_without_mapping_is_read_by_its_names(tmp_path):
    names = ["pwm_m1", "pwm_m2", "pwm_m3", "pwm_m4", "vbat"]
    log = read(table(tmp_path / "flight.csv", names, [10000.0, 20000.0, 30000.0, 65000.0, 3.7]))
    assert log.commands.values[0] == pytest.approx(np.array([10000, 20000, 30000, 65000]) / 65535)
    assert log.battery.values[0, 0] == pytest.approx(3.7)
    assert log.imu.values[0] == pytest.approx([0.1, -0.2, -0.3, 0.0, -0.5, -9.8])
    assert any("guessed from names" in note for note in log.notes)
    assert any(note == "commands are pwm_m1 to pwm_m4, taken as 0 to 65535" for note in log.notes)


@pytest.mark.parametrize(
    ("value", "share"), [(0.4, 0.4), (40.0, 0.4), (848.0, 0.4002), (1400.0, 0.4), (26214.0, 0.4)]
)
def test_the_range_of_commands_is_told_by_their_size(tmp_path, value, share):
    """Shares, per cent, DShot, pulses in µs, 16 bits."""
    log = read(table(tmp_path / "flight.csv", [f"motor_{k}" for k in range(1, 7)], [value] * 6))
    assert log.commands.values[0] == pytest.approx([share] * 6, abs=1e-3)
    assert log.rotors == 6


def test_commands_of_no_known_scale_are_said_and_left_out(tmp_path):
    log = read(table(tmp_path / "flight.csv", [f"motor_{k}" for k in range(1, 5)], [74000.0] * 4))
    assert log.commands is None
    assert "motor_1 to motor_4 reach 74000: no scale of commands, which are left out" in log.notes


@pytest.mark.parametrize("shift_s", [0.0, -1.0])
def test_samples_before_the_last_one_are_said(tmp_path, shift_s):
    """Two logs in one file begin anew in its middle."""
    path = table(tmp_path / "flight.csv", [], [])
    head, *rows = path.read_text().splitlines()
    rows = [row.split(",", 1) for row in rows]
    later = [
        f"{float(time) + (shift_s if row >= 100 else 0.0):.6g},{rest}"
        for row, (time, rest) in enumerate(rows)
    ]
    path.write_text("\n".join([head, *later]) + "\n")
    said = [note for note in read(path).notes if "stamped before the last one" in note]
    assert said == [
        "imu: 100 of 200 samples left out: stale, not finite, or stamped before the last one"
    ] * bool(shift_s)


def test_rotor_speeds_are_no_commands(tmp_path):
    log = read(table(tmp_path / "flight.csv", [f"rpm_{k}" for k in range(1, 5)], [12000.0] * 4))
    assert log.commands is None
    assert log.rotor_speeds.values[0] == pytest.approx([12000.0 * np.pi / 30.0] * 4)


def test_electrical_speeds_without_poles_are_kept_as_they_are(tmp_path):
    log = read(table(tmp_path / "flight.csv", [f"erpm_{k}" for k in range(1, 5)], [60000.0] * 4))
    assert log.rotor_speeds.values[0] == pytest.approx([60000.0 * np.pi / 30.0] * 4)
    assert any("electrical" in note for note in log.notes)


def test_of_poles_alone_electrical_speeds_of_any_number_of_rotors_are_those_of_the_motors(tmp_path):
    erpm = [7000.0 * (1 + rotor) for rotor in range(6)]
    path = table(tmp_path / "flight.csv", [f"erpm_{k}" for k in range(1, 7)], erpm)
    mapping = tmp_path / "hexa.yaml"
    mapping.write_text(
        "time: {columns: [time], unit: s}\nbody: frd\nworld: ned\n"
        "angular_velocity: {columns: [gyro_x, gyro_y, gyro_z], unit: rad/s}\n"
        "acceleration: {columns: [acc_x, acc_y, acc_z], unit: m/s2, axes: body, gravity: included}\n"
        "rotor_speeds: {columns: [erpm_1, erpm_2, erpm_3, erpm_4, erpm_5, erpm_6], unit: erpm}\n"
    )
    log = read_other(path, ReadingOptions(mapping=mapping), 7)
    assert log.rotor_speeds.values[0] == pytest.approx(np.array(erpm) * np.pi / 210.0)
    assert not any("electrical" in note for note in log.notes)
    assert "vehicle" not in log.facts


def test_a_table_without_gyro_says_what_to_name(tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("time,altitude\n" + "".join(f"{0.01 * row},1.0\n" for row in range(50)))
    with pytest.raises(
        LogError, match=r"flight.csv: its columns do not tell gyro and accelerometer; .*altitude"
    ):
        read(path)


def test_a_bag_of_electrical_speeds_and_no_vehicle_is_read(shared_data):
    log = read(shared_data / "reports" / "bag_standard_types_other_names" / "flight.mcap")
    assert log.rotor_speeds is not None
    assert any(note.startswith("rotor speeds are electrical") for note in log.notes)
    assert log.settings[0].parameter == "pairs of poles"
    by_poles = read_other(Path(log.source), ReadingOptions(), 7)
    np.testing.assert_allclose(7.0 * by_poles.rotor_speeds.values, log.rotor_speeds.values)
    assert "pairs of poles" not in [one.parameter for one in by_poles.settings]
    assert by_poles.facts == {}
    assert "pairs of poles" not in [
        one.parameter for one in read(bags_directory() / "interpolation.mcap").settings
    ]


def test_a_bag_names_its_vehicle():
    log = read(bags_directory() / "interpolation.mcap")
    assert log.facts["vehicle"] == "bebop2"
    assert log.stack == "bag"
    assert log.rotor_speeds.values.shape[1] == 4
    assert log.attitude is not None


def test_a_battery_that_reads_nothing_is_none():
    recording = read_recording(bags_directory() / "interpolation.mcap", Vehicle.load("bebop2"))
    times = recording.imu.time_ns[:3]
    assert field_log_of(replace(recording, battery=BatteryStream(times, np.zeros(3)))).battery is None
    volts = field_log_of(
        replace(recording, battery=BatteryStream(times, np.array([0.0, 15.0, 15.1])))
    ).battery
    assert volts.values.ravel().tolist() == [15.0, 15.1]
