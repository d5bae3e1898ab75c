# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The tool that renews results/paper-tables.md, with tables that are made at once."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from quadpi_core.evaluation.evaluation_result import AxisMetrics
from quadpi_core.report.table import Column, Table, markdown_table

PAGE = """# Tables

By hand.

<!-- table: tunnel -->
<!-- end -->

Also by hand, 95 \\1 %.

<!-- table: neurobem -->

old

<!-- end -->
"""


@pytest.fixture
def renew(tool: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., str]:
    """renew(option, …) → the page after a run on tables that say their name."""
    page, data = tmp_path / "page.md", tmp_path / "data"
    page.write_text(PAGE)
    monkeypatch.setattr(tool, "TABLES", {"tunnel": lambda _: "| \\1 |", "neurobem": lambda _: "| real |"})
    monkeypatch.setattr(tool, "stamp", lambda: "a version")

    def run(*options: str) -> str:
        arguments = ["paper_tables.py", "--page", str(page), "--work", str(tmp_path), "--data", str(data)]
        monkeypatch.setattr(sys, "argv", [*arguments, *options])
        tool.main()
        return page.read_text()

    return run


def test_the_page_has_a_place_for_each_table(tool: ModuleType) -> None:
    named = re.findall(r"^<!-- table: (\S+) -->$", tool.PAGE.read_text(), flags=re.MULTILINE)
    assert sorted(named) == sorted(tool.TABLES)


def test_what_stands_between_the_marks_is_replaced_and_nothing_else(
    renew: Callable[..., str], tmp_path: Path
) -> None:
    (tmp_path / "data" / "neurobem").mkdir(parents=True)
    expected = PAGE.replace("tunnel -->\n", "tunnel -->\n\n| \\1 |\n\n*a version*\n\n")
    expected = expected.replace("old", "| real |\n\n*a version*")
    assert renew() == expected
    assert renew() == expected
    assert renew("--only", "neurobem") == expected


def test_tables_of_real_flights_stay_where_there_are_none(
    renew: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    page = renew()
    assert "| \\1 |" in page
    assert "\nold\n" in page
    assert "table neurobem stays as it is: no flights" in capsys.readouterr().out


def test_a_command_that_fails_leaves_the_page_as_it_was(
    tool: ModuleType, renew: Callable[..., str], tmp_path: Path
) -> None:
    def fails(job: object) -> str:
        job.quadpi("info", tmp_path / "absent.mcap")  # type: ignore[attr-defined]
        return ""

    tool.TABLES["tunnel"] = fails
    with pytest.raises(SystemExit, match=r"error: quadpi info: quadpi: .*absent.mcap"):
        renew()
    assert (tmp_path / "page.md").read_text() == PAGE


def test_what_has_one_thread_is_a_new_process(tool: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    assert tool.in_one_thread(os.getenv, "OMP_NUM_THREADS") == "1"
    assert tool.in_one_thread(os.getpid) != os.getpid()


def test_tables_of_the_simulation_are_made_from_what_is_found(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Each settings in its folder, and those of the polynomials from the models that were kept there."""
    called: list[tuple[object, ...]] = []

    def work(function: Callable[..., object], *arguments: object) -> SimpleNamespace:
        called.append((function.__name__, *arguments))
        return SimpleNamespace(result=SimpleNamespace(flights={"a": None, "b": None}))

    monkeypatch.setattr(tool, "in_one_thread", work)
    for name in ("validation_table", "tunnel_table"):
        monkeypatch.setattr(tool, name, lambda *_: Table([Column("n")], [[1]]))
    job = tool.Job(tmp_path, tmp_path, 5)
    page = tool.validation(job)
    assert page.startswith("Realisations of the noise: 5, on each of 2 flights.\n\n**Forces**\n\n| n |")
    assert "**Moments**" in page
    assert tool.tunnel(job).startswith("| n |")
    assert called == [
        ("validate", "paper", 5, tmp_path / "validation-paper"),
        ("validate", "default", 5, tmp_path / "validation-default"),
        ("tunnel_comparison", tmp_path / "tunnel"),
    ]


def test_flights_of_a_group_are_known(tool: ModuleType) -> None:
    grouped = [speed for speeds in tool.GROUPS.values() for speed in speeds]
    assert sorted(grouped) == sorted(tool.FLIGHTS)


def metrics(picp: float, mpiw: float, rmse: float) -> AxisMetrics:
    """Of an axis, with no more than the tables show."""
    known = {"picp": picp, "mpiw": mpiw, "rmse": rmse}
    return AxisMetrics(**{field.name: known.get(field.name) for field in fields(AxisMetrics)})  # type: ignore[arg-type]


@pytest.fixture
def left_out(tool: ModuleType) -> list[Any]:
    """A model of both axes and one of Fz on two flights, with intervals of two kinds."""
    both = {"Fx": metrics(0.9, 2.0, 0.5), "Fz": metrics(0.99, 8.0, 1.0)}
    wider = {"Fx": metrics(0.96, 4.0, 0.5), "Fz": metrics(0.99, 8.0, 1.0)}
    return [
        tool.LeftOut(flight, model, kind, 0.95, axes)
        for flight, whole in (("3 m/s", both), ("8 m/s", wider))
        for model, axes in (("poly", whole), ("net", {"Fz": metrics(0.5, 1.0, 1.0)}))
        for kind in ("fixed", "adaptive")
    ]


def cells(drawn: str) -> list[list[str]]:
    """The rows of a table in Markdown, without heading and rule."""
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in drawn.splitlines()[2:]]


def test_width_is_that_of_an_ideal_interval_for_normal_errors(left_out: list[Any]) -> None:
    # 2 · 1.95996 · rmse is the width that covers 95 %.
    assert left_out[0].width_ratio("Fx") == pytest.approx(2.0 / (2.0 * 1.95996 * 0.5), rel=1e-5)


def test_flights_left_out_are_shown_by_model_and_kind_of_interval(
    tool: ModuleType, left_out: list[Any]
) -> None:
    rows = cells(markdown_table(tool.left_out_table(left_out)))
    assert rows[0] == ["3 m/s", "poly", "fixed", "90.0 · 1.02", "99.0 · 2.04"]
    assert rows[1] == ["", "", "adaptive", "90.0 · 1.02", "99.0 · 2.04"]
    assert rows[2] == ["", "net", "fixed", "", "50.0 · 0.26"]
    assert [row[0] for row in rows if row[0]] == ["3 m/s", "8 m/s"]


def test_summary_has_the_least_coverage_and_the_largest_width(tool: ModuleType, left_out: list[Any]) -> None:
    rows = cells(markdown_table(tool.left_out_summary(left_out)))
    assert rows[0] == ["poly", "fixed", "90.0 / 93.0 · 2.04", "99.0 / 99.0 · 2.04"]
    assert [row[:3] for row in rows[1:]] == [
        ["", "adaptive", rows[0][2]],
        ["net", "fixed", ""],
        ["", "adaptive", ""],
    ]
