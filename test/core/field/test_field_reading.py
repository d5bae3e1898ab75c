# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What is no flight of a multirotor is refused in one sentence; what no flight has is left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.field.airborne import flown
from quadpi_core.field.field_reading import read_field_log
from quadpi_core.reading_options import ReadingOptions

from ..logs.dataflash_writer import log as dataflash
from .stacks.test_ardupilot_stack import MORE
from .stacks.test_crazyflie_stack import MOTOR, STATE, usd

SPEEDS = [f"rpm.m{motor}" for motor in range(1, 5)]


def read(path: Path):
    return read_field_log(path, ReadingOptions())


def written(path: Path, names: list[str], rows: list[tuple[float, ...]]):
    path.write_bytes(usd(names, rows))
    return read(path)


@pytest.mark.parametrize(
    ("rpm", "is_kept"), [((1000, 1500, 1900), False), ((0, 1500, 1900), True), ((1000, 1500, 4000), True)]
)
def test_pulse_widths_are_no_rotor_speeds(tmp_path, rpm, is_kept):
    rows = [(30000.0,) * 4 + (float(value),) * 4 for value in rpm for _ in range(10)]
    log = written(tmp_path / "log00", [*MOTOR, *SPEEDS], rows)
    assert (log.rotor_speeds is not None) == is_kept
    assert any("pulse widths" in one.present for one in log.settings) != is_kept


def test_an_estimator_that_did_not_run_is_no_state(tmp_path):
    log = written(tmp_path / "log00", [*MOTOR, *STATE], [(30000.0,) * 4 + (0.0,) * 6] * 20)
    assert log.velocity is None
    assert log.position is None
    assert any(note.startswith("velocity is left out: it never changes") for note in log.notes)


def test_a_wild_sample_is_left_out_and_counted(tmp_path):
    names = ["gyro.x", "gyro.y", "gyro.z", "acc.x", "acc.y", "acc.z"]
    rows = [(0.0, 0.0, 0.0, 0.0, 0.0, 1.0)] * 50
    rows[20] = (1e7, 0.0, 0.0, 0.0, 0.0, 1.0)
    log = written(tmp_path / "log00", names, rows)
    assert len(log.imu) == 49
    assert any("imu: 1 of 50 samples are left out" in note for note in log.notes)


def test_attitudes_of_no_length_are_left_out(tmp_path):
    names = [*STATE, *(f"stateEstimate.q{axis}" for axis in "wxyz")]
    rows = [(*(0.1 * place,) * 6, float(place > 9), 0.0, 0.0, 0.0) for place in range(50)]
    log = written(tmp_path / "log00", names, rows)
    assert len(log.attitude) == 40
    assert any(note.startswith("attitude: 10 of 50 samples are left out") for note in log.notes)


def test_a_barometer_that_reads_nothing_gives_no_density(tmp_path):
    from quadpi_core.field.field_report import report_on

    path = tmp_path / "flight.bin"
    rows = [("MSG", 1, "ArduCopter V4.5.1 (abcdef)"), ("PARM", 1, "FRAME_CLASS", 1.0)]
    for now in range(100_000, 30_000_000, 100_000):
        wave = np.sin(now * 1e-6)
        rows += [
            ("IMU", now, 0, 0.1 * wave, 0.1, 0.1, -0.3 * wave, 0.1 * wave, -9.8),
            ("XKQ", now, 0, 1.0, 0.0, 0.0, 0.0),
            ("XKF1", now, 0, 5.0 * wave, 2.0, 3.0 * wave, 10.0, 20.0, -30.0 + 5.0 * wave),
            ("RCOU", now, *[1500] * 8),
            ("BARO", now, 0, 0.0, 0.0, 15.0),
        ]
    path.write_bytes(dataflash(MORE, rows))
    (flight,) = report_on([path], ReadingOptions()).flights
    assert flight.log.density is None
    assert any(note.startswith("density: 299 of 299 samples are left out") for note in flight.log.notes)


def test_two_vehicles_in_one_log_are_said(tmp_path, capsys):
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    from .stacks.test_telemetry_stack import telemetry

    path = tmp_path / "flight.tlog"
    path.write_bytes(telemetry(2, system=1) + telemetry(2, system=7, samples=100))
    log = read(path)
    assert "holds 2 vehicles; read is system 1" in log.notes
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("px4_sample_small.ulg", "MAV_TYPE 22 is a VTOL aircraft; `quadpi report` is for multirotors"),
        ("ardupilot_test.BIN", "is the firmware of planes; `quadpi report` is for multirotors"),
        ("ardupilot_vtol.tlog", "MAV_TYPE 1 is a fixed-wing aircraft; `quadpi report` is for multirotors"),
    ],
)
def test_real_logs_of_other_vehicles(shared_data: Path, name: str, said: str):
    with pytest.raises(LogError, match=said):
        read(shared_data / "logs" / name)


@pytest.mark.parametrize("folder", ["hostile", "reports"])
def test_damaged_files_are_read_or_refused_in_a_sentence(shared_data: Path, folder: str):
    sentences = {}
    for path in sorted((shared_data / folder).rglob("*")):
        if path.is_file() and path.suffix not in {".md", ".yaml", ".json", ".safetensors"}:
            try:
                log = read(path)
                assert all(np.isfinite(series.values).all() for series in log.series().values())
                flown(log)
            except QuadpiError as error:
                sentences[path.name] = str(error)
    assert all(name in sentence for name, sentence in sentences.items())
