# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import replace

import pytest

from quadpi_core.report.evaluation_page import write_report
from quadpi_core.report.evaluation_sections import verdict
from quadpi_core.report.style import percent


@pytest.fixture
def page(case, read_page, tmp_path):
    path = tmp_path / "report.html"
    write_report(path, case.evaluation, case.results, case.model, case.live)
    return read_page(path)


def test_page_needs_nothing_from_outside(page):
    page.assert_needs_nothing_from_outside()


def test_every_figure_that_the_page_names_is_there(page):
    figures = json.loads(page.scripts[1])
    named = {attributes["data-figure"] for _, attributes in page.tags if "data-figure" in attributes}
    flights = {attributes["value"] for tag, attributes in page.tags if tag == "option"}
    kinds = {attributes["data-kind"] for _, attributes in page.tags if "data-kind" in attributes}
    assert flights == {"slow", "mid", "fast<b>"}
    assert named | {f"{kind} {flight}" for kind in kinds for flight in flights} == set(figures)
    assert all(figure["data"] for figure in figures.values())


def test_names_from_outside_are_escaped(page):
    assert "fast<b>" in page.text
    assert "new & fast" in page.text
    assert "<" not in page.scripts[1]


def test_short_coverage_is_marked_and_only_there(page):
    short = [attributes for tag, attributes in page.tags if attributes.get("class") == "start short"]
    # Six axes of the fast flight, in the overview, by group and by flight.
    assert len(short) == 18
    assert page.text.count("▼") == 18 + 1


def test_page_stays_small_and_is_written_whole(case, tmp_path):
    path = tmp_path / "new" / "report.html"
    write_report(path, case.evaluation, case.results, case.model)
    assert path.stat().st_size < 8e6
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]


def test_a_page_that_fails_leaves_the_old_one(case, tmp_path):
    path = tmp_path / "report.html"
    path.write_text("old")
    flights = {name: part for name, part in case.evaluation.flights.items() if name != "slow"}
    broken = replace(case.evaluation, flights=flights)
    with pytest.raises(KeyError):
        write_report(path, broken, case.results, case.model)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_flights_without_a_group_are_shown_too(case, read_page, tmp_path):
    path = tmp_path / "report.html"
    evaluation = replace(case.evaluation, groups={})
    write_report(path, evaluation, case.results, case.model)
    text = read_page(path).text
    assert "95 % prediction intervals, flight by flight." in text
    assert "slow" in text


def test_verdict_names_where_intervals_hold_and_how_badly_they_fail(case):
    axes = case.evaluation.groups["new & fast"].axes
    worst = min(axes, key=lambda axis: axes[axis].picp)
    low, high = axes[worst].picp_ci
    assert verdict(case.evaluation, ["slow", "mid", "another"]) == (
        "95 % prediction intervals hold on known (in sample), and do not hold on new & fast "
        f"(6 of 6 axes; {worst} {percent(axes[worst].picp)}, {percent(low)} to {percent(high)})."
    )


def test_verdict_lists_the_groups_on_which_intervals_hold(case):
    known = case.evaluation.groups["known"]
    evaluation = replace(case.evaluation, groups={"a": known, "b": known, "c": known})
    assert verdict(evaluation, []) == "95 % prediction intervals hold on a, b and c."


def test_verdict_tells_the_least_coverage_that_is_still_called_holding(case, with_coverage):
    few = with_coverage(case.evaluation.groups["known"], "Mz", 0.94, [0.92, 0.96])
    assert verdict(replace(case.evaluation, groups={"few": few}), []) == (
        "95 % prediction intervals hold on few (Mz 94.0 %, 92.0 % to 96.0 %)."
    )
