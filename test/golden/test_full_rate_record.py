# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records of replays at full rate: what they hold, and what counts as a difference."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

GOLDEN = Path(__file__).resolve().parent / "model"


@pytest.fixture
def recorded(tool, tmp_path, monkeypatch):
    """A record of one bundled flight by the golden model."""
    shutil.copytree(GOLDEN, tmp_path / "models" / "bebop2-polynomial")
    monkeypatch.setattr(tool, "METHODS", ("polynomial",))
    (bundled,) = (own for own in tool.recorded() if own.vehicle == "bebop2")
    monkeypatch.setattr(tool, "recorded", lambda: [replace(bundled, replayed=("interpolation.mcap",))])
    assert tool.record(tmp_path) == ["bebop2-interpolation-polynomial.npz"]
    return tmp_path


def test_a_record_holds_every_sample_and_one_changed_bit_of_a_flag_is_told(tool, recorded, capsys):
    (path,) = recorded.glob("*.npz")
    tables = tool.read(path)
    assert np.median(np.diff(tables["prediction"]["t_s"])) < 0.01
    assert {"predicted_Fx", "lower_Mz", "upper_Mz"} <= tables["prediction"].keys()
    assert {"level", "cause_evidence_0", "reasons"} <= tables["alarm"].keys()
    other = recorded / "other"
    other.mkdir()
    shutil.copy(path, other)
    assert tool.main(["compare", str(recorded), str(other)]) == 0
    assert capsys.readouterr().out == "nothing differs\n"

    columns = {f"{name}/{column}": own for name, table in tables.items() for column, own in table.items()}
    columns["alarm/level"] = columns["alarm/level"] ^ (np.arange(len(columns["alarm/level"])) == 3)
    columns["prediction/predicted_Fx"] = columns["prediction/predicted_Fx"] * (1.0 + 1e-8)
    columns["prediction/predicted_Fy"] = columns["prediction/predicted_Fy"] * (1.0 + 1e-13)
    np.savez(other / path.name, **columns)
    assert tool.main(["compare", str(recorded), str(other)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(": ")[1:3] for line in lines] == [["alarm", "level"], ["prediction", "predicted_Fx"]]


def test_a_file_of_one_record_alone_is_a_difference_and_no_record_is_refused(tool, tmp_path):
    folders = tmp_path / "old", tmp_path / "new", tmp_path / "empty"
    for folder, name in zip(folders, ("hop", "hover", None), strict=True):
        folder.mkdir()
        if name:
            np.savez(folder / f"{name}.npz", x=np.zeros(3))
    alone = [f"{name}.npz: only in one of the two" for name in ("hop", "hover")]
    assert tool.compare(*folders[:2]) == alone
    with pytest.raises(SystemExit, match="empty: holds no record"):
        tool.compare(folders[0], folders[2])
