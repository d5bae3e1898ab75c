# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The committed trace of state, prediction and alarm, and the summary of what differs from it."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np

FOLDER = Path(__file__).resolve().parent


def test_replay_gives_the_golden_trace(tool: ModuleType):
    changes = tool.compare(tool.read(FOLDER), tool.make_trace(FOLDER / "model"))
    assert not changes, "\n".join(["this is meant to be? then `make golden`", *changes])


def test_the_trace_flies_raises_the_alarm_and_has_no_holes(tool):
    """What a trace of nothing would not show."""
    trace = tool.read(FOLDER)
    assert trace.keys() == {"state", "prediction", "alarm"}
    assert np.ptp(trace["state"]["velocity_u"]) > 10.0
    for name in ("state", "prediction"):
        np.testing.assert_allclose(np.diff(trace[name]["t_s"]), 0.1, atol=0.01)
    assert set(trace["alarm"]["level"]) >= {0.0, 2.0}


def example():
    time = np.round(np.arange(0.0, 2.0, 0.1), 6)
    return {
        "state": {"t_s": time, "u": np.sin(time), "w": np.where(time < 0.5, np.nan, time)},
        "alarm": {"t_s": time, "level": np.zeros(20), "inputs": np.array([""] * 19 + ["mu_x"])},
    }


def test_equal_traces_have_no_difference_also_once_written_and_read(tool, tmp_path):
    tool.write(example(), tmp_path)
    found = tool.read(tmp_path)
    assert tool.compare(example(), found) == []
    first = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    tool.write(found, tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == first


def test_rounding_is_no_difference(tool):
    found = example()
    found["state"]["u"] = found["state"]["u"] * (1.0 + 1e-9)
    assert tool.compare(example(), found) == []


def test_a_change_says_which_quantity_where_and_how_much(tool):
    found = example()
    found["state"]["u"][5:7] += [0.25, 0.5]
    found["alarm"]["inputs"] = np.array([""] * 18 + ["mu_x; p", "mu_x"])
    assert tool.compare(example(), found) == [
        "alarm: inputs: 1 of 20 rows: from t = 1.8 s on: nothing → mu_x; p",
        "state: u: 2 of 20 rows: from t = 0.5 s on, at most 0.5 (0.564642 → 1.06464 at t = 0.6 s), "
        "0.0375 on average",
    ]


def test_numbers_that_come_or_go_are_differences(tool):
    found = example()
    found["state"]["w"][0] = 0.0
    found["state"]["u"][3] = np.nan
    changes = tool.compare(example(), found)
    assert [line.partition(" rows")[0] for line in changes] == ["state: u: 1 of 20", "state: w: 1 of 20"]


def test_rows_columns_and_tables_of_one_trace_alone_are_named(tool):
    found = example()
    found["state"] = {name: column[:-3] for name, column in found["state"].items()}
    found["alarm"]["health"] = found["alarm"].pop("level")
    found["events"] = example()["state"]
    assert tool.compare(example(), found) == [
        "events: only in the new trace",
        "alarm: health: only in the new trace",
        "alarm: level: only in the golden trace",
        "state: 3 of 20 rows only in the golden trace, from t = 1.7 s on",
    ]


def test_files_are_left_alone_where_nothing_changed(tool, tmp_path, monkeypatch, capsys):
    """Another processor rounds differently: the last digit of a file may differ, and that is no change."""
    (tmp_path / "model").mkdir()
    tool.write(example(), tmp_path)
    before = {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in tmp_path.glob("*.csv")}
    rounded = example()
    rounded["state"]["u"] = rounded["state"]["u"] * (1.0 + 1e-5)
    monkeypatch.setattr(tool, "FOLDER", tmp_path)
    monkeypatch.setattr(tool, "make_trace", lambda _: rounded)
    assert tool.main([]) == 0
    assert capsys.readouterr().out == "the golden trace is as it was\n"
    assert {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in tmp_path.glob("*.csv")} == before

    rounded["state"]["u"] = rounded["state"]["u"] + 0.5
    assert tool.main([]) == 0
    assert "state: u: 20 of 20 rows" in capsys.readouterr().out
    assert tool.compare(rounded, tool.read(tmp_path)) == []
