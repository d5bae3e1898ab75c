# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Written pages in a real browser, from a file: what they draw, how they are used, and how they print."""

from __future__ import annotations

import base64
import json
import os
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.chromium import PROGRAM, Tab, chromium
from quadpi_core.evaluation.evaluate import judge
from quadpi_core.evaluation.evaluation_result import ComparedEvaluation, Comparison
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.paths import bags_directory
from quadpi_core.report.comparison_page import write_comparison_page
from quadpi_core.report.evaluation_page import write_evaluation_page
from quadpi_core.report.page import FlightFiles
from quadpi_core.report.simulation_page import write_simulation_page

from .circling import circle
from .test_simulation_page import planned

pytestmark = pytest.mark.skipif(PROGRAM is None, reason="no Chromium: apt-get install chromium")

MODEL_FOLDER = Path(__file__).resolve().parents[2] / "golden" / "model"
# Set to a folder, the tests leave a picture of a page there: `make pictures`.
PICTURES = os.environ.get("QUADPI_PICTURES")
HISTORY = '[data-kind="history"]'
COLOURS = "getComputedStyle(document.documentElement).getPropertyValue"


@pytest.fixture(scope="module")
def tab(tmp_path_factory) -> Iterator[Tab]:
    with chromium(tmp_path_factory.mktemp("chromium")) as tab:
        yield tab


@pytest.fixture
def opened(tab: Tab, case, tmp_path: Path) -> Tab:
    """The page of an evaluation, with a flight of a hostile name."""
    bags = {name: Path(f"bags/{name}.mcap") for name in ("slow", "fast<b>")}
    path = tmp_path / "page.html"
    files = FlightFiles(bags, [Path("my model")])
    write_evaluation_page(path, case.evaluation, case.results, case.model, case.live, files)
    return at(tab, path)


def at(tab: Tab, path: Path) -> Tab:
    tab.problems.clear()
    tab.resize(1300, 1000)
    tab.open(path.as_uri())
    tab.wait("document.querySelectorAll('.drawing > *').length > 0")
    return tab


def choose(tab: Tab, menu: str, value: str) -> None:
    tab.value(
        f"(() => {{ const one = document.getElementById('{menu}'); one.value = {value!r};"
        "one.dispatchEvent(new Event('change')); })()"
    )


def drawn(tab: Tab, place: str, what: str) -> int:
    """Number of lines or areas over all charts of a figure: `what` is true of a series or a band."""
    charts = f"quadpi.get(document.querySelector('{place}')).charts"
    return int(
        tab.value(
            f"{charts}.flatMap((one) => [...one.series.slice(1), ...one.bands])"
            f".filter((one) => {what}).length"
        )
    )


DASHED, HATCHED = "one.dash?.length", "one.fill?.() instanceof CanvasPattern"


def click(tab: Tab, place: str, share: float) -> None:
    """Into the first row of a figure, at a share of its width."""
    x, y = tab.value(
        f"(() => {{ const one = document.querySelector('{place} .u-over');"
        "one.scrollIntoView({block: 'center'}); const box = one.getBoundingClientRect();"
        f"return [box.left + {share} * (box.width - 1), box.top + 20]; }})()"
    )
    for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
        button = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
        tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button)


def test_it_draws_every_figure_without_an_error(opened):
    places, shown = opened.value(
        "['.figure', '.figure .drawing:has(canvas)'].map((one) => document.querySelectorAll(one).length)"
    )
    assert places == shown == 5
    limits = (
        "[...quadpi.values()].flatMap((one) => one.charts).flatMap(({scales}) => [scales.x, scales.y])"
        ".flatMap(({min, max}) => [min, max])"
    )
    assert opened.value(f"{limits}.every(Number.isFinite)")
    assert opened.value("document.querySelectorAll('main b:not([class])').length") == 10
    assert opened.problems == []


def test_two_flights_are_drawn_on_the_same_axes_and_differ_without_colour(opened):
    alone = drawn(opened, HISTORY, "true")
    assert drawn(opened, HISTORY, DASHED) == 0
    choose(opened, "beside", "fast<b>")
    assert drawn(opened, HISTORY, "true") == 2 * alone
    # In each of six axes: what was measured, what was predicted, and both bounds of the band.
    assert drawn(opened, HISTORY, DASHED) == 6 * 4
    assert drawn(opened, HISTORY, HATCHED) == 6
    legend = opened.value(f"document.querySelector('{HISTORY} .legend').textContent")
    assert "measured, slow" in legend
    assert "measured, fast<b>" in legend
    choose(opened, "beside", "")
    assert drawn(opened, HISTORY, DASHED) == 0


def test_a_moment_gives_the_command_that_shows_it(opened):
    choose(opened, "beside", "fast<b>")
    click(opened, HISTORY, 0.5)
    opened.wait("!document.getElementById('moment').hidden")
    said = opened.value("[...document.querySelectorAll('#moments code')].map((one) => one.textContent)")
    match = re.fullmatch(r"quadpi view bags/slow\.mcap --model 'my model' --at ([\d.]+)", said[0])
    # Half of the 7.5 s of the flight.
    assert match
    assert float(match[1]) == pytest.approx(3.75, abs=0.05)
    assert said[1] == f"quadpi view 'bags/fast<b>.mcap' --model 'my model' --at {match[1]}"
    assert opened.value("document.querySelector('#moments a').href") == f"http://127.0.0.1:8710/#t={match[1]}"
    opened.value("document.getElementById('close').click()")
    assert opened.value("document.getElementById('moment').hidden")


def test_a_moment_of_the_live_replay_is_in_the_time_of_the_flight(tab, case, tmp_path):
    path = tmp_path / "page.html"
    live = replace(case.live, begins_s=1.0)
    files = FlightFiles({"fast<b>": Path("fast.mcap")})
    write_evaluation_page(path, case.evaluation, case.results, case.model, live, files)
    at(tab, path)
    click(tab, '[data-figure="alarm"]', 1.0)
    shown = tab.wait("document.querySelector('#moments code')?.textContent")
    assert float(shown.rpartition(" ")[2]) == pytest.approx(case.results[2].time[-1], abs=0.05)


def test_keys_move_zoom_and_choose(opened):
    opened.value(f"document.querySelector('{HISTORY} .drawing').focus()")
    limits = (
        f"(({{min, max}}) => [min, max])(quadpi.get(document.querySelector('{HISTORY}')).charts[5].scales.x)"
    )
    whole = opened.value(limits)
    opened.press("ArrowRight")
    said = opened.value(f"document.querySelector('{HISTORY} .readout').textContent")
    assert said.startswith("3.82 s, Fx [N]")
    assert "prediction interval" in said
    opened.press("ArrowDown")
    assert "Fy [N]" in opened.value(f"document.querySelector('{HISTORY} .readout').textContent")
    opened.press("+")
    opened.wait(f"{limits}[1] - {limits}[0] < 5")
    opened.press("Enter")
    assert not opened.value("document.getElementById('moment').hidden")
    opened.press("Escape")
    opened.wait(f"JSON.stringify({limits}) === '{json.dumps(whole, separators=(',', ':'))}'")


def test_two_models_are_drawn_on_the_same_axes(tab, case, tmp_path):
    path, whole = tmp_path / "page.html", vars(case.evaluation)
    models = {
        name: ComparedEvaluation(**whole | {"model": f"{name}@1"}, settings="default", cutoff_hz=30.0)
        for name in ("one", "two<i>")
    }
    groups = {name: part.flights for name, part in case.evaluation.groups.items()}
    comparison = Comparison("0", "v", 0.95, False, groups, models)
    results = dict.fromkeys(models, case.results)
    write_comparison_page(path, comparison, results, dict.fromkeys(models, case.model))
    at(tab, path)
    place = '[data-kind="intervals"]'
    assert tab.value("document.getElementById('beside').disabled")
    choose(tab, "model", "one")
    assert tab.value(f"document.querySelector('{place} .legend').textContent").count("interval") == 1
    choose(tab, "beside", "two<i>")
    assert "predicted, two<i>" in tab.value(f"document.querySelector('{place} .legend').textContent")
    assert drawn(tab, place, HATCHED) == 6
    choose(tab, "model", "")
    assert drawn(tab, place, HATCHED) == 0
    assert tab.problems == []


def test_a_path_in_space_is_turned(tab, tmp_path):
    path = tmp_path / "page.html"
    write_simulation_page(path, [(planned("round"), circle("round"))])
    at(tab, path)
    shown = "document.querySelector('.space svg').outerHTML"
    before = tab.value(shown)
    assert "NaN" not in before
    tab.value("document.querySelector('.space').focus()")
    tab.press("ArrowRight")
    assert tab.value(shown) != before
    tab.press("ArrowLeft")
    assert tab.value(shown) == before
    assert tab.problems == []


@pytest.mark.parametrize("width", [1920, 1024, 768, 390])
def test_it_fits_screens_from_a_phone_to_a_desk(opened, width):
    opened.resize(width, 900)
    opened.wait(f"document.querySelector('{HISTORY} .uplot').getBoundingClientRect().width <= {width}")
    assert opened.value("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_colours_of_all_pages_have_the_contrast_of_wcag_aa(opened, theme):
    """Of written pages and of the live one: texts 4.5, lines of charts 3."""
    opened.value(f"document.documentElement.dataset.theme = '{theme}'")

    def colour(name: str) -> str:
        return name if name.startswith("#") else str(opened.value(f"{COLOURS}('--{name}').trim()"))

    on_grounds = [(text, ground) for text in ("ink", "soft", "miss") for ground in ("paper", "ground")]
    words = (*((state, "#ffffff") for state in ("trusted", "alarm", "none")), ("warning", "#14191f"))
    for text, ground in (*on_grounds, *words, ("miss", "short-ground")):
        assert contrast(colour(text), colour(ground)) >= 4.5, (text, ground)
    states = (f"{state}-line" for state in ("trusted", "warning", "alarm", "none"))
    models = (f"model-{k}" for k in range(1, 8))
    for line in ("measured", "predicted", "band", "slow", "fast", *states, *models):
        assert contrast(colour(line), colour("paper")) >= 3.0, line


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours #rrggbb (WCAG 2.1)."""

    def luminance(colour: str) -> float:
        parts = np.array([int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)])
        linear = np.where(parts <= 0.03928, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    dark, bright = sorted((luminance(one), luminance(other)))
    return (bright + 0.05) / (dark + 0.05)


def test_print_is_light_whole_and_without_controls(opened):
    opened.value("document.documentElement.dataset.theme = 'dark'")
    opened.call("Emulation.setEmulatedMedia", media="print")
    try:
        assert opened.value(f"{COLOURS}('--paper').trim()") == "#ffffff"
        controls = "document.querySelectorAll('button:not(td button, .legend button), select, #moment')"
        assert opened.value(f"[...{controls}].filter((one) => one.checkVisibility()).length") == 0
        assert (
            opened.value(f"document.querySelector('{HISTORY}').previousElementSibling.textContent") == "slow"
        )
    finally:
        opened.call("Emulation.setEmulatedMedia", media="")
    opened.value("window.printed = []")
    folded = "document.querySelectorAll('details:not([open])').length"
    width = f"document.querySelector('{HISTORY} .uplot').offsetWidth"
    opened.value(f"addEventListener('beforeprint', () => printed.push({folded}, {width}))")
    answer = opened.call("Page.printToPDF", preferCSSPageSize=True)
    pdf = base64.b64decode(answer["data"])
    assert pdf.startswith(b"%PDF")
    # Everything was open and as wide as the sheet; afterwards it is as before.
    assert opened.value("printed") == [0, 720]
    assert opened.value("document.querySelectorAll('details[open]').length") == 0
    assert opened.problems == []


@pytest.mark.skipif(not PICTURES, reason="pictures are made by `make pictures`")
def test_pictures_for_the_documents(tab, tmp_path):
    """Two bundled flights over each other: one like those that the model knows, and one that leaves them."""
    model = AerodynamicModel.load(MODEL_FOLDER)
    bags = [bags_directory() / f"{name}.mcap" for name in ("interpolation", "extrapolation")]
    flights = prepare_flights(bags, model.load_vehicle(), model.cutoff_hz)
    groups = {flight.name: [flight.name] for flight in flights}
    results, evaluation = judge(model, flights, groups, model.confidence)
    path = tmp_path / "page.html"
    write_evaluation_page(path, evaluation, results, model)
    at(tab, path)
    tab.resize(1100, 900)
    choose(tab, "beside", "extrapolation")
    # The other sections would push it out of the picture.
    others = f"[...document.querySelectorAll('section')].filter((one) => !one.querySelector('{HISTORY}'))"
    tab.value(f"{others}.forEach((one) => one.remove())")
    (Path(PICTURES or "") / "report.webp").write_bytes(tab.picture())
