# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The tool that renews the table of vehicles in results/rollouts.md."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

from quadpi_core.evaluation.evaluate import FlightRolloutMetrics, TubeMetrics


def test_a_row_for_each_horizon_in_the_order_of_the_quantities(tool: ModuleType) -> None:
    def metrics(rms: float) -> TubeMetrics:
        return TubeMetrics(rms, 0.9512, 2.0 * rms, 0.9, 1.0, 0.9, 1.0, 0.9, 3.0 * rms)

    names = ("position_m", "velocity_m_s", "attitude_deg", "rates_rad_s")
    horizons = {
        horizon: {name: metrics(scale * (k + 1)) for k, name in enumerate(names)}
        for horizon, scale in (("0.01", 0.1), ("0.1", 1.0), ("0.5", 10.0))
    }
    rows = tool.rows(
        "a flight", FlightRolloutMetrics(100, 0, position_measured=True, in_sample=False, horizons=horizons)
    )
    assert [row[:3] for row in rows] == [
        ["a flight", "0.1 s", "1.00, 2.00, 3.00, 4.00"],
        ["a flight", "0.5 s", "10.0, 20.0, 30.0, 40.0"],
    ]
    assert rows[0][3:] == ["95.1, 95.1, 95.1, 95.1", "2.00, 4.00, 6.00, 8.00", "3.00, 6.00, 9.00, 12.0"]


def test_the_page_has_a_place_for_the_table(tool: ModuleType) -> None:
    assert tool.PAGE.read_text().count("<!-- table: vehicles -->") == 1


def test_logs_that_cannot_be_read_are_said(tool: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / "own" / name).write_bytes(b"")
    data_set = tool.DataSet("Own", "own/*", "bebop2")
    rows, said = tool.predicted(data_set, tmp_path, tmp_path / "work")
    assert rows == []
    assert said == ["Own: not read: a, b (a: the file is empty).", "Own: 0 flights, 3 are needed."]
