# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The whole story on the bundled flights, the live nodes included."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

pytest.importorskip("quadpi.msg", reason="the quadpi messages are not built")

from quadpi_ros.demo import run_demo

# When the bundled flight `extrapolation` passes the range of its training by a tenth, at 7 m/s.
LEAVES_THE_ENVELOPE_S = 9.5


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
    assert live["predictions_out"] > 0.9 * live["samples_in"]
    assert "ALARM" in told.getvalue()
    assert f"first warning at {live['warning_first_s']:.1f} s" in told.getvalue()
    assert "extrapolation.mcap" in told.getvalue()
    assert (tmp_path / "out" / "report.html").stat().st_size > 4e6
