# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One table, drawn on the terminal, as HTML and as Markdown."""

from __future__ import annotations

import io
import re
from types import SimpleNamespace

import pytest
from rich.console import Console

from quadpi_core.models.ensemble import training_progress
from quadpi_core.parallel import Progress
from quadpi_core.report.page import Page
from quadpi_core.report.table import (
    Cell,
    Column,
    Mark,
    Table,
    markdown_table,
    progress_bar,
    soft,
    terminal_table,
)


@pytest.fixture
def table():
    columns = [
        Column("axis", is_text=True, is_section=True),
        Column("term", is_text=True, is_code=True),
        Column("PICP", "{:.1f}".format, group="all <flights>", colour="#0072b2"),
        Column("n", group="all <flights>"),
    ]
    rows = [
        [Cell("Fx", unit="N"), "a|b", Cell(93.25, Mark.SHORT), 12],
        [Cell("Fx", unit="N"), *soft("published", 95.0), None],
        [Cell("Fz", unit="N"), "c", 97.0, 1234],
    ]
    return Table(columns, rows, title="coverage", note="▼ too low")


def test_terminal_has_sections_and_shared_headings(table, rendered):
    lines = [line.strip() for line in rendered(terminal_table(table), width=60).splitlines()]
    title, _, group, heading, rule, *body = (line for line in lines)
    assert (title, group, heading.split()) == ("coverage", "all <flights>", ["term", "PICP", "n"])
    assert set(rule) == {"─"}
    assert [line.split() for line in body if line] == [
        ["Fx", "[N]"],
        ["a|b", "▼", "93.2", "12"],
        ["published", "95.0", "–"],
        ["Fz", "[N]"],
        ["c", "97.0", "1234"],
        ["▼", "too", "low"],
    ]


def test_on_a_narrow_terminal_text_gives_way_and_no_figure_loses_a_digit(rendered):
    columns = [Column("quantity", is_text=True), Column("found", "{:.7f}".format), Column("±", is_text=True)]
    table = Table(columns, [["a long name of a quantity", 0.1234567, "not ruled out: 5 to 7.5"]])
    assert "0.1234567" in rendered(terminal_table(table), width=32)


def test_markdown_has_every_column_and_escapes_bars(table):
    assert markdown_table(table).splitlines() == [
        "| axis | term | all <flights> PICP | all <flights> n |",
        "| :-- | :-- | --: | --: |",
        "| Fx [N] | `a\\|b` | ▼ 93.2 | 12 |",
        "|  | *`published`* | *95.0* |  |",
        "| Fz [N] | `c` | 97.0 | 1234 |",
    ]


def test_html_has_classes_for_what_stands_out(table, tmp_path, read_page):
    sections = {"table_of_flights": table, "flights": []}
    Page("", "", "", {}, {}, {}).write(tmp_path / "page.html", "simulation.html", **sections)
    tags = [attributes for tag, attributes in read_page(tmp_path / "page.html").tags if tag in {"th", "td"}]
    shared, headings, first, second = tags[:3], tags[3:7], tags[7:11], tags[11:15]
    assert shared == [{}, {}, {"class": "group", "colspan": "2", "style": "--group: #0072b2"}]
    assert [cell["class"].strip() for cell in headings] == ["text", "text", "start", ""]
    assert [cell["class"].strip() for cell in first] == ["text", "text", "start  short", ""]
    assert [cell["class"].strip() for cell in second] == ["text", "text soft", "start  soft", ""]


def test_a_repeated_value_is_left_out_below_the_same_values(markdown_cells):
    columns = [Column("flight", once=True), Column("model", once=True), Column("kind")]
    rows = [["a", "m", "x"], ["a", "m", "y"], ["b", "m", "x"], ["b", "n", "x"]]
    drawn = markdown_cells(Table(columns, rows))[1:]
    assert drawn == [["a", "m", "x"], ["", "", "y"], ["b", "m", "x"], ["", "n", "x"]]


def test_columns_can_be_left_out(table, markdown_cells):
    assert markdown_cells(table.without("term", "n"))[1] == ["Fx [N]", "▼ 93.2"]


def test_a_page_escapes_what_comes_from_outside(read_page, tmp_path):
    name = "<script>alert(1)</script>"
    page = Page(name, name, name, {name: name}, {name: name}, {})
    page.write(
        tmp_path / "page.html",
        "validation.html",
        **{"nominal": name, "realisations_shown": 1, "flights": [name]},
        tables=[Table([Column(name, group=name)], [[Cell(name, unit=name, detail=name)]], title=name)],
        by_flight=Table([Column(name, chooses_flight=True)], [[name]]),
    )
    read = read_page(tmp_path / "page.html")
    assert sum(tag == "script" for tag, _ in read.tags) == 3
    assert read.text.count(name) > 10


# Bars: what they show on a terminal, that they fit, and that nothing is drawn elsewhere.


EPOCH = SimpleNamespace(stage="members", epoch=12, epochs=50, loss=0.2134, coverage=0.9412)
FIRST = SimpleNamespace(stage="noise", epoch=1, epochs=50, loss=-1.5, coverage=None)

BARS = {
    "Training members .* 12 of 50 epochs · loss 0.213 · coverage 94.1% ": [training_progress(EPOCH)],
    "Training noise .* 1 of 50 epochs · loss -1.5 ": [training_progress(EPOCH), training_progress(FIRST)],
    "Identifying Fz .* 2 of 6 ": [Progress("Identifying Fz", 2, 6)],
    "Reading flights .* 3 of 7 ": [Progress("Reading flights", 2, 7), Progress("Reading flights", 3, 7)],
    "Flying .* 4 of 5 s · 1 of 2 flights ": [Progress("Flying", 4.2, 5.0, "s", "1 of 2 flights")],
    "Simulating .* hop ": [Progress("Simulating", note="hop")],
}


class Terminal(io.StringIO):
    """What is written to a terminal of 80 characters."""

    def isatty(self):
        return True


def drawn(file, steps):
    """What a bar leaves on a file when it ends, line by line."""
    with progress_bar(Console(file=file, width=80, force_terminal=True, color_system=None)) as report:
        for step in steps:
            report(step)
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", file.getvalue()).splitlines()


@pytest.mark.parametrize("shown", BARS)
def test_a_bar_fits_a_terminal_and_shows(shown):
    lines = drawn(Terminal(), BARS[shown])
    assert any(re.search(shown, line) for line in lines), lines
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize("shown", BARS)
def test_nothing_is_drawn_where_there_is_no_terminal(shown):
    """Also where colours are forced, as continuous integration may."""
    assert drawn(io.StringIO(), BARS[shown]) == []


def test_nothing_is_drawn_on_a_dumb_terminal(monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    assert drawn(Terminal(), [training_progress(EPOCH)]) == []
