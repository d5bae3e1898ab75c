# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a search: it says what was found, needs nothing from outside, and draws what is there."""

from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from quadpi_core.discrepancy.discrepancy_result import study_json
from quadpi_core.discrepancy.other_simulations import CallableSimulation
from quadpi_core.discrepancy.result_verdicts import judge_unexplained
from quadpi_core.report.discrepancy_page import discrepancy_summary, write_discrepancy_page


@pytest.fixture(scope="module")
def page_file(found, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "page.html"
    write_discrepancy_page(path, found)
    return path


def test_everything_stands_on_it(page_file, read_page, found):
    page = read_page(page_file)
    page.assert_needs_nothing_from_outside()
    for words in (
        "Add what is missing: bebop2 lacks body drag",
        "Evidence",
        "What would change the verdict",
        "Where",
        "What",
        "Before and after",
        "What is left",
        "Flown again",
    ):
        assert words in page.text
    (drag,) = found.discovery.effects
    for parameter in drag.parameters:
        assert parameter.name in page.text
    for part in found.where.telling:
        assert part.conditions in page.text


DOUBTED = (judge_unexplained(0.5),)


@pytest.mark.parametrize(
    ("changes", "first"),
    [
        ({"effects": ()}, "Keep the simulation. No missing effect was found"),
        (
            {"effects": (), "candidates": (), "within_intervals": ("wind",)},
            "Keep the simulation for flights like these: the intervals of bebop2 hold all axes of",
        ),
        ({"checks": DOUBTED, "effects": ()}, "Add nothing yet: bebop2 lacks something"),
        ({"checks": DOUBTED}, "Add nothing yet: bebop2 lacks something"),
        ({"rivals": ("wind",)}, "Fly forward flight to decide: bebop2 lacks body drag (or wind)"),
    ],
)
def test_the_first_words_say_what_to_do(found, rendered, changes, first):
    (drag,) = found.discovery.effects
    if "rivals" in changes:
        changes = {"effects": (replace(drag, **changes, shown_by=("forward flight",)),)}
    summary = rendered(discrepancy_summary(replace(found, discovery=replace(found.discovery, **changes))))
    assert " ".join(summary.split()).startswith(first)


def test_code_that_ran_is_named(found, read_page, rendered, tmp_path):
    code = "mine:wrench of mine.py, named by addition.json"
    simulation = CallableSimulation("mine:wrench", found.simulation.vehicle, np.zeros_like, code=code)
    study = replace(found, simulation=simulation)
    write_discrepancy_page(tmp_path / "page.html", study)
    assert f"Code that ran: {code}." in rendered(discrepancy_summary(study))
    assert code in read_page(tmp_path / "page.html").text
    assert study_json(study)["code"] == code
    assert study_json(found)["code"] is None


def test_figures_of_every_flight(page_file, read_page, found):
    page = read_page(page_file)
    assert set(page.figures()) == {"profiles", "maps", "gap"}
    for own in found.where.residuals:
        assert [len(panel["layers"]) for panel in page.figures(own.flight)["residual"]["panels"]] == [3] * 6
    gap = page.figures()["gap"]["panels"]
    assert {layer["name"] for panel in gap for layer in panel["layers"]} == {
        "before",
        "after",
        "floor",
    }


def test_every_candidate_has_its_reason(page_file, read_page, found):
    page = read_page(page_file).text
    console = Console(width=80, file=StringIO())
    console.print(discrepancy_summary(found))
    shown = " ".join(console.file.getvalue().split())
    judgements = found.discovery.found.judgements
    for own in judgements:
        assert own.reason.sentence in page
    assert "accepted" in shown
    assert shown.count("rejected") <= 3
    assert judgements[0].label in shown


def test_a_gap_hardly_above_the_floor_has_no_closed_share(found, rendered):
    floor = np.ones(6)
    before = np.sqrt([1.04, 1.06, 2.0, 2.0, 2.0, 2.0])
    after = np.sqrt([1.0, 1.03, 1.0, 2.0, 0.9, 1.25])
    gap = found.discovery.gap._replace(before=before, after=after, floor=floor)
    shown = rendered(discrepancy_summary(replace(found, discovery=replace(found.discovery, gap=gap))))
    rows = {
        line.split()[0]: line.split()[5:]
        for line in shown.splitlines()
        if line.split()[1:2] in (["N"], ["Nm"])
    }
    closed = {axis: " ".join(cells) for axis, cells in rows.items()}
    assert closed == {
        "Fx": "–",
        "Fy": "50.0 %",
        "Fz": "100.0 %",
        "Mx": "0.0 %",
        "My": "100.0 %",
        "Mz": "75.0 %",
    }
