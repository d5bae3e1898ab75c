# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The frame of every page: whole and self-contained, whatever text from outside it shows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jinja2 import UndefinedError

from quadpi_core.errors import OutputError
from quadpi_core.report.page import Figure, FlightFiles, Line, Page, Panel, Scale
from quadpi_core.report.table import Column, Table
from quadpi_core.version import __version__

HOSTILE = '</script><script>alert(1)</script> & "<b>" {{ title }}'
SECTIONS = {"table_of_flights": Table([Column("flight")], [["hop"]]), "flights": ["hop"]}


def figure_of(name):
    line = Line(name, "model-1", np.arange(2.0), np.array([3.0, 4.0]))
    return Figure("A line", [Panel([line], Scale("time [s]"), Scale("height [m]"), 100.0)])


@pytest.fixture
def page():
    figure = figure_of("flown")
    return Page(
        "A title", "does it hold?", "It holds.", {"vehicle": "bebop2"}, {"Term": "meaning"}, {"hop": figure}
    )


@pytest.fixture
def written(tmp_path, read_page):
    """written(page) → what a reader of the page sees; the sections are those of a simulation."""

    def write(page):
        page.write(tmp_path / "page.html", "simulation.html", **SECTIONS)
        return read_page(tmp_path / "page.html")

    return write


def test_question_verdict_facts_definitions_and_version_are_on_it(page, written):
    shown = written(page)
    shown.assert_needs_nothing_from_outside()
    for text in (
        "A title",
        "does it hold?",
        "It holds.",
        "vehicle",
        "bebop2",
        "Term",
        "meaning",
        __version__,
    ):
        assert text in shown.text


def test_text_from_outside_stays_text(page, written):
    hostile = replace(
        page, title=HOSTILE, verdict=HOSTILE, facts={HOSTILE: HOSTILE}, definitions={HOSTILE: HOSTILE}
    )
    shown = written(hostile)
    assert len(shown.scripts) == len(written(page).scripts)
    assert shown.text.count(HOSTILE) == 6
    assert shown.text.index(HOSTILE) < shown.text.index("does it hold?")


def test_figures_are_those_that_were_given_and_cannot_end_their_script(page, written):
    figure = figure_of(HOSTILE)
    shown = written(replace(page, figures={HOSTILE: figure}, flight_figures={HOSTILE: {"hop": figure}}))
    for figures in (shown.figures(), shown.figures(HOSTILE)):
        (drawn,) = figures.values()
        assert drawn["panels"][0]["layers"][0]["name"] == HOSTILE
    assert list(shown.figures()) == [HOSTILE]


def test_commands_are_quoted_for_a_shell_and_cannot_end_their_script(page, written):
    bag = Path("my bags") / "</script>; rm -rf $HOME.mcap"
    shown = written(replace(page, files=FlightFiles({"hop": bag}, [Path("a'b")], "my.yaml")))
    assert shown.commands == {
        "hop": """quadpi view 'my bags/</script>; rm -rf $HOME.mcap' --model 'a'"'"'b' --vehicle my.yaml"""
    }
    assert len(shown.scripts) == len(written(page).scripts)
    assert written(page).commands == {}


def test_a_page_that_fails_leaves_the_old_one(page, tmp_path):
    path = tmp_path / "page.html"
    path.write_text("old")
    with pytest.raises(UndefinedError, match="flights"):
        page.write(path, "simulation.html", table_of_flights=SECTIONS["table_of_flights"])
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]
    assert path.read_text() == "old"
    with pytest.raises(OutputError, match=r"page\.html/deeper: cannot be written"):
        page.write(path / "deeper", "simulation.html", **SECTIONS)
