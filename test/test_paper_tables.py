# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The tool that renews docs/paper-tables.md, with tables that are made at once."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
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
def tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location("paper_tables", ROOT / "tools" / "paper_tables.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "paper_tables", module)
    spec.loader.exec_module(module)
    return module


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
    for name in named:
        assert "made up" in tool.replaced(tool.PAGE.read_text(), name, "made up")


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


def test_a_page_without_a_place_is_refused(tool: ModuleType) -> None:
    with pytest.raises(tool.TablesError, match="has 0 places"):
        tool.replaced(PAGE, "left-out", "")
    with pytest.raises(tool.TablesError, match="has 2 places"):
        tool.replaced(PAGE + PAGE, "tunnel", "")


def test_flights_of_a_group_are_known(tool: ModuleType) -> None:
    grouped = [speed for speeds in tool.GROUPS.values() for speed in speeds]
    assert sorted(grouped) == sorted(tool.FLIGHTS)
