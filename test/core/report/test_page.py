# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The frame of every page: whole and self-contained, whatever text from outside it shows."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jinja2 import UndefinedError

from quadpi_core.errors import OutputError
from quadpi_core.report import ASSETS
from quadpi_core.report.page import (
    DASHES,
    PAGE_VALUES,
    Band,
    Figure,
    FlightFiles,
    Layer,
    Limit,
    Line,
    Page,
    Panel,
    Points,
    Scale,
    bins_of,
    figures_as_json,
    thinned,
)
from quadpi_core.report.table import Column, Table, number, percent
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


# Records of figures: every kind of layer and of dash is drawn by the page's scripts.


def test_the_scripts_draw_every_kind_of_layer_and_dash():
    script = (ASSETS / "figures.js").read_text()
    for layer in Layer.__subclasses__():
        painted = re.search(rf"^  {layer.kind}\(c, layer\) \{{", script, re.MULTILINE)
        assert painted or f'layer.kind === "{layer.kind}"' in script, layer
        assert re.search(rf"\b{layer.kind}: ", script), layer
    (dashes,) = re.findall(r"DASHES = \{(.*?)\}", (ASSETS / "drawing.js").read_text())
    assert set(re.findall(r'(\w+|""): \[', dashes)) == {dash or '""' for dash in DASHES}


@pytest.mark.parametrize(
    ("fraction", "text"),
    [(0.95, "95.0 %"), (1.0, "100.0 %"), (0.99991, "> 99.9 %"), (0.0, "0.0 %"), (1e-5, "< 0.1 %")],
)
def test_percent_never_rounds_to_certainty(fraction, text):
    assert percent(fraction) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.4, "0.400"), (469.2, "469"), (999.7, "1000"), (38779, "38779"), (1.2e-5, "1.20e-05")],
)
def test_numbers_have_three_digits(value, text):
    assert number(value) == text


# What a page holds of a figure: every peak, every array once, and no more values than it has room for.


def read(figures):
    """The figures of a page with numbers in the place of arrays, as a browser reads them."""
    held = json.loads(figures_as_json(figures, 10))

    def unpacked(array):
        if isinstance(array, list):
            return np.array([np.nan if value is None else value for value in array])
        if "count" in array:
            return np.linspace(array["from"], array["to"], array["count"])
        codes = np.frombuffer(base64.b64decode(array["data"]), "<u2")
        return np.where(codes == 65535, np.nan, array["low"] + array["step"] * codes.astype(float))

    def filled(value):
        if isinstance(value, list):
            return [filled(part) for part in value]
        if isinstance(value, dict):
            return (
                unpacked(held["arrays"][value["array"]])
                if "array" in value
                else {key: filled(part) for key, part in value.items()}
            )
        return value

    return filled(held["figures"]), held["arrays"]


def one_panel(*layers, over_time=False):
    return {
        "a": Figure("label", [Panel(layers, Scale("x"), Scale("y", low=0.0), 100.0)], over_time=over_time)
    }


def drawn(layer, bins):
    """A layer over time as a page of so many parts draws it."""
    return thinned(one_panel(layer, over_time=True)["a"], bins).panels[0].layers[0]


def test_blocks_keep_every_peak():
    time, y = np.arange(100_000) / 400.0, np.sin(np.arange(100_000) / 3000)
    y[[137, 51_234, 99_999]] = 40.0, -40.0, 9.0
    found = drawn(Line("a", "ink", time, y), 200)
    assert len(found.x) == 200
    assert (found.high[0], found.y[102], found.high[-1]) == (40.0, -40.0, 9.0)
    for k, start in enumerate(range(0, 100_000, 500)):
        part = slice(start, start + 500)
        assert (found.y[k], found.high[k]) == (y[part].min(), y[part].max())
        assert time[part][0] <= found.x[k] <= time[part][-1]


def test_a_band_keeps_the_lowest_of_its_lower_and_the_highest_of_its_upper_bound():
    low, high = np.zeros(1000), np.ones(1000)
    low[301], high[702] = -5.0, 5.0
    found = drawn(Band("a", "ink", np.arange(1000.0), low, high), 10)
    assert (found.low.min(), found.high.max()) == (-5.0, 5.0)
    assert (found.low.max(), found.high.min()) == (0.0, 1.0)


@pytest.mark.parametrize("size", [1, 2, 19, 20])
def test_a_short_signal_stays_whole(size):
    line = Line("a", "ink", np.arange(float(size)), np.arange(float(size)))
    assert drawn(line, 10) is line


def test_what_has_gaps_or_holds_until_the_next_stays_whole():
    x = np.arange(1000.0)
    for line in (Line("a", "ink", x, np.where(x == 5.0, np.nan, x)), Line("a", "ink", x, x, stepped=True)):
        assert drawn(line, 10) is line
    # So does a figure that is not over time.
    figures, _ = read(one_panel(Line("a", "ink", x, x)))
    assert len(figures["a"]["panels"][0]["layers"][0]["x"]) == 1000


@pytest.mark.parametrize(
    ("lines", "bins"), [(0, 4000), (87, 4000), (100, PAGE_VALUES // 200), (500, 700), (9000, 150)]
)
def test_pages_of_many_lines_draw_fewer_values_of_each(lines, bins):
    line = Line("a", "ink", np.zeros(2), np.zeros(2))
    assert bins_of([*one_panel(*[line] * lines, over_time=True).values(), *one_panel(line).values()]) == bins


def test_arrays_are_read_as_they_were_written():
    rng = np.random.default_rng(0)
    time, noise, few = np.arange(500) / 50.0, rng.normal(0.0, 3.0, 500), np.array([1.0, np.nan, -0.25])
    noise[7] = np.nan
    lines = Line("a", "ink", time, noise), Line("b", "ink", few, few)
    figures, arrays = read(one_panel(*lines))
    first, second = figures["a"]["panels"][0]["layers"]
    np.testing.assert_allclose(first["x"], time, atol=1e-9)
    # Sixteen bits: a step is a 65534th of the extent.
    np.testing.assert_allclose(first["y"], noise, atol=0.51 * np.ptp(noise[8:]) / 60_000)
    np.testing.assert_array_equal(second["x"], few)
    assert arrays[0] == {"from": 0.0, "to": time[-1], "count": 500}


@pytest.mark.parametrize("values", [np.zeros(50), np.full(50, np.nan), np.full(50, 1e-300), np.empty(0)])
def test_signals_without_an_extent(values):
    figures, _ = read(one_panel(Line("a", "ink", values, values)))
    np.testing.assert_allclose(figures["a"]["panels"][0]["layers"][0]["y"], values, atol=1e-290)


def test_an_array_is_stored_once():
    time = np.random.default_rng(0).uniform(size=100)
    _, arrays = read(one_panel(*(Line(name, "ink", time, time + k) for k, name in enumerate("abc"))))
    assert len(arrays) == 1 + 3 - 1


def test_what_is_unset_is_left_out_and_zero_is_not():
    points = Points("p", "ink", np.zeros(2), np.ones(2), error=np.array([[0.0, 2.0], [0.5, 1.5]]))
    figures, _ = read(one_panel(Limit("", "ink", 0.0), points))
    panel = figures["a"]["panels"][0]
    limit, drawn = panel["layers"]
    assert limit == {"kind": "limit", "colour": "ink", "at": 0.0, "dash": "dashed"}
    assert panel["y"] == {"title": "y", "low": 0.0}
    assert [end.tolist() for end in drawn["error"]] == [[0.0, 0.5], [2.0, 1.5]]
    assert "hollow" not in drawn
