# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The tool that renews the tables of results/alarm.md, in its short form."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.replay import replay
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle

ROOT = Path(__file__).resolve().parents[2]
PAGE = "By hand.\n\n<!-- table: rates -->\n<!-- end -->\n\n<!-- table: signals -->\n\nold\n\n<!-- end -->\n"


def rows_of(page: str) -> list[list[str]]:
    """Cells of the rows of tables, headings and rules left out."""
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| ")]
    return [row for row, after in zip(rows, [*rows[1:], [""]], strict=True) if ":--" not in row[0] + after[0]]


def test_the_page_has_a_place_for_each_table(tool: ModuleType) -> None:
    named = re.findall(r"^<!-- table: (\S+) -->$", tool.PAGE.read_text(), flags=re.MULTILINE)
    # Renewed by change_tables.py and sound_flights.py.
    others = ["changes", "apart", "sound"]
    assert sorted(named) == sorted([*tool.TABLES, *others])


@pytest.mark.parametrize("kind", ["alike", "varied"])
def test_a_seed_gives_its_flight_and_another_seed_another(tool: ModuleType, kind: str) -> None:
    one, again, other = (tool.random_plan("a", kind, seed, 30.0) for seed in ((1, 2), (1, 2), (1, 3)))
    assert one == again
    assert one.motion != other.motion


def test_interval_of_a_count(tool: ModuleType) -> None:
    assert tool.poisson_interval(0) == pytest.approx((0.0, 3.689), abs=1e-3)
    assert tool.poisson_interval(10) == pytest.approx((4.795, 18.390), abs=1e-3)


def test_alarms_of_a_bag_are_counted_and_warnings_last_longer(tool: ModuleType, tmp_path: Path) -> None:
    model = AerodynamicModel.load(ROOT / "test" / "golden" / "model")
    # Limits beyond those of the warning, as calibration gives them, and an alarm of EXTRAPOLATION alone.
    envelope, limits = model.envelope, model.alarm_limits
    model = replace(
        model,
        envelope=replace(
            envelope,
            margin=2.0 * envelope.margin,
            leverage_limit=3.0 * envelope.leverage_limit,
            width_limit=1.5 * envelope.width_limit,
        ),
        alarm_limits=replace(limits, miscoverage_s=1e3 * limits.miscoverage_s),
    )
    out = tmp_path / "out.mcap"
    vehicle, bag = Vehicle.load("bebop2"), bags_directory() / "extrapolation.mcap"
    summary = replay(model, vehicle, bag, out)
    counts = tool.count_alarms(out)
    assert sum(counts.alarms) == summary.events
    # The flight leaves its training twice, not at its start.
    assert counts.alarms[0] == 2
    assert counts.early == 0
    assert summary.alarm_fraction * counts.hours < counts.warned < 0.5 * counts.hours


@pytest.mark.slow
def test_short_form_of_the_rates(tool: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    monkeypatch.setattr(tool, "MANY", 3)
    monkeypatch.setattr(tool, "FEW", 2)
    monkeypatch.setattr(tool, "FIRST_SEED", 5)
    short = ["--seeds", "2", "--flights", "1", "--flight-s", "12"]
    tool.main(["--page", str(page), "--work", str(tmp_path), "--only", "rates", *short])
    rows = rows_of(page.read_text())
    expected = [[kind, n, m] for kind in ("alike", "varied") for n in "32" for m in ("5", "6", "all")]
    assert [row[:3] for row in rows] == expected
    for one, two, both in zip(rows[0::3], rows[1::3], rows[2::3], strict=True):
        assert int(one[4]) + int(two[4]) == int(both[4])
        assert float(both[3]) == pytest.approx(2 * 12 / 3600, abs=0.01)
    assert "\nold\n" in page.read_text()


@pytest.mark.slow
def test_short_form_of_the_signals(
    tool: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE)

    def bundled(job: object) -> list[object]:
        names = [f"train_{k}" for k in (1, 2, 3, 4)], ["extrapolation"]
        learned, judged = (
            job.prepared([bags_directory() / f"{name}.mcap" for name in part], "bebop2")  # type: ignore[attr-defined]
            for part in names
        )
        return [tool.Case("bundled", "bebop2", learned, judged)]

    monkeypatch.setattr(tool, "simulated_cases", bundled)
    tool.main(
        [
            "--page",
            str(page),
            "--work",
            str(tmp_path),
            "--data",
            str(tmp_path),
            "--only",
            "signals",
            "--no-ensembles",
        ]
    )
    assert "no rows of real flights" in capsys.readouterr().out
    assert "\nold\n" not in page.read_text()
    case, mean = rows_of(page.read_text())
    assert (case[0], mean[0]) == ("bundled", "mean")
    assert mean[2:] == case[2:]
    # The flight leaves the envelope and is missed there, which every signal sees.
    assert all(float(area) > 0.8 for area in case[2:])
