# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import pytest

from quadpi_core.evaluation.alarm_assessment import AlarmAssessment
from quadpi_core.report.evaluation_page import (
    alarm_lines,
    evaluation_summary,
    evaluation_verdict,
    write_evaluation_page,
)
from quadpi_core.report.table import percent

from .conftest import flight_result


@pytest.fixture
def page(case, read_page, tmp_path):
    path = tmp_path / "report.html"
    write_evaluation_page(path, case.evaluation, case.results, case.model, case.live)
    return read_page(path)


def test_every_figure_that_the_page_names_is_there(page):
    page.assert_needs_nothing_from_outside()
    named = {attributes["data-figure"] for _, attributes in page.tags if "data-figure" in attributes}
    flights = {attributes["value"] for tag, attributes in page.tags if tag == "option"}
    kinds = {attributes["data-kind"] for _, attributes in page.tags if "data-kind" in attributes}
    assert flights == {"slow", "mid", "fast<b>", ""}
    flights -= {""}
    assert named == set(page.figures()) == {"coverage", "alarm", "envelope", "residuals"}
    assert kinds == {"history"}
    drawn = [*page.figures().values(), *(page.figures(flight)["history"] for flight in flights)]
    assert all(panel["layers"] for figure in drawn for panel in figure["panels"])


def test_names_from_outside_are_escaped(page):
    assert "fast<b>" in page.text
    assert "new & fast" in page.text
    places = [k for k, own in enumerate(page.script_attributes) if "data-figures" in own]
    assert len(places) == 4
    assert all("<" not in page.scripts[place] for place in places)


def test_short_coverage_is_marked_and_only_there(page):
    short = [attributes for tag, attributes in page.tags if "short" in attributes.get("class", "").split()]
    # Six axes of the fast flight, in the overview, by group and by flight.
    assert len(short) == 18
    assert page.text.count("▼") == 18 + 1


def test_a_page_of_twenty_flights_is_three_megabytes_at_most(case, tmp_path):
    """Of a minute each: what a person evaluates at once has to open at once."""
    path, names = tmp_path / "report.html", [f"flight {k}" for k in range(20)]
    results = [flight_result(name, 3, k, samples=24_000) for k, name in enumerate(names)]
    metrics = case.evaluation.flights["slow"]
    evaluation = replace(case.evaluation, groups={}, flights=dict.fromkeys(names, metrics))
    write_evaluation_page(path, evaluation, results, case.model)
    assert 1e6 < path.stat().st_size < 3e6


def test_flights_without_a_group_are_shown_too(case, read_page, tmp_path):
    path = tmp_path / "report.html"
    evaluation = replace(case.evaluation, groups={})
    write_evaluation_page(path, evaluation, case.results, case.model)
    text = read_page(path).text
    assert "95\u00a0% prediction intervals, flight by flight." in text
    assert "slow" in text


def test_verdict_names_where_intervals_hold_and_how_badly_they_fail(case):
    axes = case.evaluation.groups["new & fast"].axes
    worst = min(axes, key=lambda axis: axes[axis].picp)
    low, high = axes[worst].picp_ci
    assert evaluation_verdict(case.evaluation) == (
        "95\u00a0% prediction intervals hold on known (in sample), and do not hold on new & fast "
        f"(6 of 6 axes; {worst} {percent(axes[worst].picp)}, "
        f"95 % confidence interval {percent(low)} to {percent(high)})."
    )


def test_verdict_lists_the_groups_on_which_intervals_hold(case):
    known = case.evaluation.groups["known"]
    evaluation = replace(case.evaluation, groups={"a": known, "b": known, "c": known})
    assert evaluation_verdict(evaluation) == (
        "95\u00a0% prediction intervals hold on a (in sample), b (in sample) and c (in sample)."
    )


def test_in_sample_is_said_of_a_part_of_a_group(case):
    flights = {**case.evaluation.flights}
    flights["mid"] = replace(flights["mid"], in_sample=False)
    verdict = evaluation_verdict(replace(case.evaluation, flights=flights))
    assert "hold on known (1 of 2 flights in sample), and" in verdict


def test_verdict_tells_the_least_coverage_that_is_still_called_holding(case, with_coverage):
    few = with_coverage(case.evaluation.groups["known"], "Mz", 0.94, [0.92, 0.96])
    assert evaluation_verdict(replace(case.evaluation, groups={"few": few})) == (
        "95\u00a0% prediction intervals hold on few (in sample; Mz 94.0 %, "
        "95 % confidence interval 92.0 % to 96.0 %)."
    )


def test_summary_marks_short_coverage(case, rendered):
    known, fast, alarm = rendered(evaluation_summary(case.evaluation)).split("new & fast")
    assert "flights of filtered signals" in alarm
    axes = [line for line in fast.splitlines() if line.strip().startswith(("F", "M"))]
    assert "▼" not in known
    assert len(axes) == 6
    assert all("▼" in line for line in axes)


def test_summary_fits_a_narrow_terminal(case, rendered):
    wide = {"picp": 0.9999, "picp_ci": [0.8, 0.949], "mpiw": 1e-5, "nmpiw": 1.6, "rmse": 1e-5}
    wide |= {"r2": -38.794, "n_eff": 12345.0}
    groups = {
        name: replace(part, axes={axis: replace(metrics, **wide) for axis, metrics in part.axes.items()})
        for name, part in case.evaluation.groups.items()
    }
    evaluation = replace(case.evaluation, groups=groups)
    assert "…" not in rendered(evaluation_summary(evaluation), width=80)


def test_alarms_are_counted_in_words():
    quiet = AlarmAssessment(
        false_alarms=0,
        hours_inside=0.005,
        false_alarms_per_hour=None,
        false_alarms_per_hour_bound=599.0,
        false_alarms_per_hour_interval=(0.0, 738.0),
        alarms_outside=0,
        hours_outside=0.0,
        hours_monitored=0.005,
        hours_flown=0.005,
        hours_recorded=0.005,
        not_judged_fraction=0.0,
        not_judged_reasons=(),
        flights_off=0,
        flights_undetected=0,
        detection_delay_s=None,
        auroc={"inputs": None, "width": 0.75},
    )
    assert alarm_lines(quiet) == [
        "0 false alarms in 18.0 s inside the envelope "
        "(too short for a rate; at most 599 per hour, at 95\u00a0%); "
        "area under the ROC curve for misses: width 0.75"
    ]
    loud = replace(
        quiet,
        false_alarms=1,
        hours_inside=0.5,
        false_alarms_per_hour=2.0,
        false_alarms_per_hour_bound=9.49,
        false_alarms_per_hour_interval=(0.0506, 11.1),
        alarms_outside=3,
        hours_outside=0.25,
        flights_off=1,
        detection_delay_s=0.474,
        auroc={},
    )
    assert alarm_lines(loud) == [
        "1 false alarm in 30.0 min inside the envelope "
        "(estimated: 2.00 per hour, 0.0506 to 11.1, at 95\u00a0%); "
        "3 alarms in 15.0 min outside the envelope; "
        "alarm on 1 of 1 flight in which the model is off, 0.47 s late"
    ]
