# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The whole story on the bundled flights, the live nodes included."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import scipy.io
from rich.console import Console

from quadpi_ros.demo import called_as, run_demo

# When the bundled flight `extrapolation` passes the range of its training by a tenth, at 7 m/s.
LEAVES_THE_ENVELOPE_S = 9.5
# Of each real flight, from its start: by then the fastest has passed the 12 m/s that tell the groups apart.
REAL_FLIGHT_S = 8.0


def test_the_command_that_is_offered_is_one_that_the_shell_finds(tmp_path, monkeypatch):
    """`make demo` runs what is in `.venv`, which is on nobody's path."""
    program = tmp_path / ".venv" / "bin" / "quadpi"
    program.parent.mkdir(parents=True)
    program.touch(mode=0o755)
    monkeypatch.setattr(sys, "executable", str(program.with_name("python")))
    monkeypatch.setenv("PATH", "/nowhere")
    assert called_as() == str(program)
    monkeypatch.chdir(tmp_path)
    assert called_as() == ".venv/bin/quadpi"
    monkeypatch.setenv("PATH", str(program.parent))
    assert called_as() == "quadpi"


@pytest.mark.slow
def test_demo_on_the_bundled_flights(tmp_path: Path) -> None:
    told = io.StringIO()
    run_demo(None, tmp_path / "out", 1.0, Console(file=told, width=200))
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert list(summary["groups"]) == ["identification", "interpolation", "extrapolation"]
    for group in ("identification", "interpolation"):
        assert all(axis["picp_ci"][1] > 0.95 for axis in summary["groups"][group]["axes"].values())
    live = summary["live"]
    # Four flights calibrate nothing: warning and alarm have the same limit.
    assert LEAVES_THE_ENVELOPE_S < live["warning_first_s"] < LEAVES_THE_ENVELOPE_S + 0.3
    assert live["alarm_first_s"] == live["warning_first_s"]
    assert 0.3 < live["alarm_fraction"] < 0.5
    # Not before the filter has begun; and a machine full of tests may drop some.
    assert live["predictions_out"] > 0.5 * live["samples_in"]
    assert "ALARM" in told.getvalue()
    assert f"first warning at {live['warning_first_s']:.1f} s" in told.getvalue()
    assert "extrapolation.mcap" in told.getvalue()
    # The page counts from the first prediction, a second into the flight.
    (offered,) = re.findall(r"add --at ([0-9.]+), .* ([0-9.]+) s into the flight", told.getvalue())
    assert float(offered[0]) + float(offered[1]) == pytest.approx(live["alarm_first_s"], abs=0.02)
    assert 0.5 < float(offered[1]) < 2.0
    page = (tmp_path / "out" / "report.html").read_text()
    assert len(page) < 3e6
    assert f"--model {tmp_path / 'out' / 'model'}" in page
    # Real logs with a nut near motor 3.
    assert "motor 3 (rear left) works harder than in earlier flights" in told.getvalue()
    assert (tmp_path / "out" / "real" / "report.html").exists()


@pytest.mark.slow
def test_demo_on_real_flights(shared_data: Path, tmp_path: Path) -> None:
    """The command of README, on the first seconds of the flights that it is for."""
    flights = tmp_path / "neurobem"
    flights.mkdir()
    for log in (shared_data / "neurobem").glob("*.mat"):
        matrix = scipy.io.loadmat(log)[log.stem]
        beginning = matrix[matrix[:, 0] < matrix[0, 0] + REAL_FLIGHT_S]
        scipy.io.savemat(flights / log.name, {log.stem: beginning})
    command = ["demo", "--data", str(tmp_path), "--rate", "1", "-o", str(tmp_path / "out")]
    result = subprocess.run(
        [sys.executable, "-m", "quadpi_core.cli", *command], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert {name: len(group["flights"]) for name, group in summary["groups"].items()} == {
        "identification": 3,
        "extrapolation": 1,
    }
    # Not before the filter has begun, a second into the flight; and a machine full of tests may drop some.
    assert summary["live"]["predictions_out"] > 0.5 * summary["live"]["samples_in"]
    assert summary["live"]["alarm_first_s"] is not None
    page = (tmp_path / "out" / "report.html").read_text()
    assert len(page) < 3e6
    assert f"--model {tmp_path / 'out' / 'model'}" in page
