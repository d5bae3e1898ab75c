# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""docs/add-a-data-set.md: its files are valid and its commands do what it says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from typer.testing import CliRunner

from quadpi_core.cli import app
from quadpi_core.logs import read_recording
from quadpi_core.logs.mapping import UNITS

GUIDE = (Path(__file__).parents[3] / "docs" / "add-a-data-set.md").read_text()


@pytest.fixture
def data_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the guide's vehicle and mapping, and a table with the mapping's columns."""
    for name, text in re.findall(r"```yaml\n# (\S+)\n(.*?)```", GUIDE, flags=re.DOTALL):
        (tmp_path / name).write_text(text)
    samples = 400
    constant = {"az": 9.81, "qw": 1.0, "z": 1.0, "voltage": 16_000.0} | {
        f"m{i}": 70_000.0 for i in (1, 2, 3, 4)
    }
    names = ("wx", "wy", "wz", "ax", "ay", "x", "y", "qx", "qy", "qz", *constant)
    rng = np.random.default_rng(1)
    noise = {name: rng.normal(0.0, 1e-3, samples) for name in names}
    columns = {name: constant.get(name, 0.0) + noise[name] for name in names}
    columns["t"] = np.arange(samples) / 200.0
    pyarrow.csv.write_csv(pa.table(columns), tmp_path / "flight.csv")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_commands_run_as_written(data_set: Path):
    commands = re.findall(r"^    quadpi (.*)$", GUIDE, flags=re.MULTILINE)
    assert len(commands) == 2
    for command in commands:
        result = CliRunner().invoke(app, command.split())
        assert result.exit_code == 0, result.output
    recording = read_recording(data_set / "bags" / "flight.mcap", None)
    assert recording.vehicle == "my-quad"
    assert recording.rotor_speeds.speeds.mean() == pytest.approx(70_000.0 / 7 * np.pi / 30.0)
    assert recording.imu.specific_force[:, 2].mean() == pytest.approx(-9.81, abs=1e-3)
    assert recording.pose.position[:, 2].mean() == pytest.approx(-1.0, abs=1e-3)


def test_every_signal_and_unit_is_explained():
    for signal, units in UNITS.items():
        assert f"`{signal}`" in GUIDE
        if signal not in {"position", "velocity", "mocap_position", "wind"}:
            assert all(f"`{unit}`" in GUIDE for unit in units)
