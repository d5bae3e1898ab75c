# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The evaluation of one model: tables for the terminal, and a self-contained page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Group, RenderableType
from rich.text import Text

from quadpi_core.evaluation.alarm_assessment import AlarmAssessment
from quadpi_core.evaluation.evaluation_result import (
    AxisMetrics,
    Evaluation,
    FlightEvaluation,
    FlightResult,
    GroupEvaluation,
)
from quadpi_core.flight import AXES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.alarm_limits import BOUND_CONFIDENCE
from quadpi_core.models.interval_rules import LevelSupport
from quadpi_core.report.evaluation_figures import (
    Holding,
    LiveReplay,
    alarm_figure,
    axis_coverages,
    coverage_figure,
    envelope_figure,
    joint_verdict,
    listing,
    residual_figure,
    time_history_figure,
)
from quadpi_core.report.info_tables import held_out_table, selection_table
from quadpi_core.report.page import Figure, FlightFiles, Page, flight_remarks
from quadpi_core.report.table import (
    Cell,
    Column,
    Mark,
    Table,
    Value,
    count,
    group_colours,
    nominal,
    number,
    percent,
    percent_range,
    terminal_table,
    text_columns,
    unit,
)
from quadpi_core.results import UNCALIBRATED_WORDS

_UNGROUPED = "flights in no group"
# Metrics that a terminal of 80 characters has no room for.
_NOT_ON_TERMINAL = ("Winkler", "n")


def metrics_table(
    parts: Mapping[str, GroupEvaluation] | Mapping[str, FlightEvaluation], confidence: float, kind: str
) -> Table:
    """All metrics by axis of groups or flights.

    Args:
        parts: by name.
        confidence: nominal coverage; an axis that covers less beyond chance is marked.
        kind: heading of the column of names, such as "flight".
    """
    columns = [
        *(*text_columns(kind, once=True), *text_columns("axis")),
        *(Column("PICP", percent), Column("95 % CI", is_soft=True)),
        *(Column("MPIW", number), Column("NMPIW", percent), Column("RMSE", number)),
        *(Column("R²", "{:.3f}".format), Column("Winkler", number), Column("n", count)),
        Column("n_eff", number),
    ]
    rows = [
        [
            name,
            axis_cell(axis),
            coverage_cell(metrics, confidence),
            percent_range(metrics.picp_ci),
            *(metrics.mpiw, metrics.nmpiw, metrics.rmse, metrics.r2),
            *(metrics.winkler, metrics.n, metrics.n_eff),
        ]
        for name, part in parts.items()
        for axis, metrics in part.axes.items()
    ]
    return Table(columns, rows)


def axis_cell(axis: str) -> Cell:
    """An axis of the wrench with its unit."""
    return Cell(axis, unit=unit(axis))


def coverage_cell(metrics: AxisMetrics, confidence: float) -> Cell:
    """The coverage of an axis, marked where it is too low beyond chance."""
    return Cell(metrics.picp, Mark.SHORT if metrics.covers_too_little(confidence) else None)


def evaluation_summary(evaluation: Evaluation) -> Group:
    """Coverage and width per axis for the terminal, a table per group.

    The columns fit a terminal of 80 characters; the JSON and the page hold every metric.
    """
    confidence = evaluation.confidence
    intervals = "adaptive prediction intervals" if evaluation.adaptive else "prediction intervals"
    shown: list[RenderableType] = [
        Text(f"{evaluation.model}: {percent(confidence)} {intervals}", style="bold")
    ]
    if evaluation.force_bandwidth_hz is not None:
        shown.append(Text(force_bandwidth_note(evaluation.force_bandwidth_hz), style="dim"))
    if evaluation.support is not None:
        shown.append(support_text(evaluation.support))
    for name, part in evaluation.groups.items():
        table = metrics_table({name: part}, confidence, "group")
        shown.append(terminal_table(table.without("group", *_NOT_ON_TERMINAL, title=name)))
        shown += [Text(line, style="dim") for line in (f"alarm of {name}:", *alarm_lines(part.alarm))]
    parts = evaluation.groups.values()
    if any(metrics.covers_too_little(confidence) for part in parts for metrics in part.axes.values()):
        shown.append(Text(short_coverage_note(confidence), style="dim"))
    return Group(*shown)


def support_text(support: LevelSupport) -> Text:
    """Which level the flights of a model support; yellow where more is asked."""
    return Text(support.sentence(), style="dim" if support.is_supported else "yellow")


def force_bandwidth_note(bandwidth_hz: float) -> str:
    """That predicted forces were smoothed before they were judged, and why."""
    return (
        f"the measured forces of the flights that it was identified on end at {bandwidth_hz:g} Hz: predicted "
        "forces are judged smoothed alike"
    )


def short_coverage_note(confidence: float) -> str:
    """What the mark at a coverage means."""
    return f"▼ the confidence interval of the coverage lies below {percent(confidence)}"


def alarm_lines(alarm: AlarmAssessment | None) -> list[str]:
    """False alarms, detection, how well signals separate misses; how flights differ; what CHANGE says."""
    if alarm is None:
        return ["not assessed, as flights of filtered signals are among them, which no monitor has"]
    parts = []
    if alarm.hours_inside > 0.0:
        rate, ends = alarm.false_alarms_per_hour, alarm.false_alarms_per_hour_interval
        stated, sure = "too short for a rate", nominal(BOUND_CONFIDENCE.value)
        if rate is not None and ends is not None:
            stated = f"estimated: {number(rate)} per hour, {number(ends[0])} to {number(ends[1])}, at {sure}"
        elif (bound := alarm.false_alarms_per_hour_bound) is not None:
            stated += f"; at most {number(bound)} per hour, at {sure}"
        false = _count(alarm.false_alarms, "false alarm")
        parts.append(f"{false} in {_duration(alarm.hours_inside)} inside the envelope ({stated})")
    if alarm.hours_outside > 0.0:
        outside = _count(alarm.alarms_outside, "alarm")
        parts.append(f"{outside} in {_duration(alarm.hours_outside)} outside the envelope")
    if alarm.flights_off:
        found = alarm.flights_off - alarm.flights_undetected
        flights = _count(alarm.flights_off, "flight")
        late = "" if alarm.detection_delay_s is None else f", {alarm.detection_delay_s:.2f} s late"
        parts.append(f"alarm on {found} of {flights} in which the model is off{late}")
    if alarm.flights_changed_bound is not None:
        judged, most = _count(alarm.flights_judged, "flight"), percent(alarm.flights_changed_bound)
        share = f"at most {most} of such flights, at {nominal(BOUND_CONFIDENCE.value)}"
        parts.append(f"CHANGE on {alarm.flights_changed} of {judged} ({share})")
    known = [f"{name} {area:.2f}" for name, area in alarm.auroc.items() if area is not None]
    if known:
        parts.append(f"area under the ROC curve for misses: {', '.join(known)}")
    if alarm.not_judged_reasons:
        why = ", ".join(f"{percent(part.fraction)} {part.reason}" for part in alarm.not_judged_reasons)
        parts.append(f"not judged for {percent(alarm.not_judged_fraction)} of the time: {why}")
    said = [*(f"flights differ: {one}" for one in alarm.differences), *alarm.changes]
    word = UNCALIBRATED_WORDS.split(":")[0]
    return ["; ".join(parts), *said, *([UNCALIBRATED_WORDS] if any(word in one for one in said) else [])]


def _count(value: int, what: str) -> str:
    return f"{value} {what}" if value == 1 else f"{value} {what}s"


def _duration(hours: float) -> str:
    minutes = 60.0 * hours
    return f"{number(60.0 * minutes)} s" if minutes < 2.0 else f"{number(minutes)} min"


def evaluation_verdict(evaluation: Evaluation) -> str:
    """The page's headline: on which groups the intervals hold, are not shown to hold, and do not hold.

    A group of flights that the model was identified on is marked "in sample": there the intervals hold by
    construction. The axis of the lowest coverage is named with its numbers, unless all axes reach the nominal
    coverage.
    """
    confidence = evaluation.confidence
    groups: dict[Holding, list[str]] = {}
    for group, part in evaluation.groups.items():
        holding, axes = joint_verdict(axis_coverages(part.axes), confidence)
        known = len(evaluation.in_sample(group))
        of = "" if known == len(part.flights) else f"{known} of {len(part.flights)} flights "
        remarks = [f"{of}in sample"] if known else []
        if holding is not Holding.HOLDS:
            remarks.append(f"{len(axes)} of {len(part.axes)} axes")
        if holding is not Holding.HOLDS or axes[0].estimate < confidence:
            remarks.append(axes[0].sentence())
        groups.setdefault(holding, []).append(f"{group} ({'; '.join(remarks)})" if remarks else group)
    if not groups:
        return f"{nominal(confidence)} prediction intervals, flight by flight."
    clauses = [f"{holding.value} on {listing(groups[holding])}" for holding in Holding if holding in groups]
    return f"{nominal(confidence)} prediction intervals {', and '.join(clauses)}."


def write_evaluation_page(
    path: Path,
    evaluation: Evaluation,
    results: Sequence[FlightResult],
    model: AerodynamicModel,
    live: LiveReplay | None = None,
    files: FlightFiles | None = None,
) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        evaluation: of the model.
        results: the flights that were evaluated, at least one.
        model: that was evaluated; gives training flights, envelope and selection log.
        live: the alarms of the live nodes for one of the flights.
        files: of flights and model, to look at moments in `quadpi view`.

    Raises:
        OutputError: if `path` cannot be written.
    """
    confidence = evaluation.confidence
    by_name = {result.name: result for result in results}
    groups = {name: [by_name[flight] for flight in part.flights] for name, part in evaluation.groups.items()}
    grouped = {flight.name for flights in groups.values() for flight in flights}
    if rest := [result for result in results if result.name not in grouped]:
        groups[_UNGROUPED] = rest
    axes = [axis for axis in AXES if all(axis in result.axes for result in results)]
    figures = {
        "envelope": envelope_figure(groups, model.envelope),
        "residuals": residual_figure(groups, axes, confidence),
    }
    if evaluation.groups:
        figures["coverage"] = coverage_figure(evaluation)
    if live is not None:
        figures["alarm"] = alarm_figure(live, by_name.get(live.flight))
    histories = _histories(groups, evaluation)
    Page(
        title=f"quadpi: {evaluation.model}",
        about="how far can this model be trusted?",
        verdict=evaluation_verdict(evaluation),
        facts={
            "model": evaluation.model,
            "vehicle": evaluation.vehicle,
            "settings": model.settings,
            "low-pass": f"{model.cutoff_hz:g} Hz",
            "identified on": f"{len(model.flights)} flights",
            "evaluated on": f"{len(evaluation.flights)} flights",
        }
        | ({} if (support := evaluation.support) is None else {"level": support.sentence()})
        | ({} if (hz := evaluation.force_bandwidth_hz) is None else {"forces": force_bandwidth_note(hz)}),
        definitions=metric_definitions(evaluation),
        figures=figures,
        flight_figures={name: {"history": figure} for name, figure in histories.items()},
        files=files or FlightFiles(),
        remarks=flight_remarks(evaluation.data_quality, evaluation.left_out),
    ).write(
        path,
        "evaluation.html",
        nominal=nominal(confidence),
        coverage=_coverage_table(evaluation) if evaluation.groups else None,
        alarms={name: alarm_lines(own.alarm) for name, own in evaluation.groups.items()},
        by_group=metrics_table(evaluation.groups, confidence, "group"),
        by_flight=metrics_table(evaluation.flights, confidence, "flight"),
        live=live,
        flights={group: [flight.name for flight in flights] for group, flights in groups.items()},
        training=", ".join(f"{flight.name} ({flight.samples} samples)" for flight in model.flights),
        calibration=f"{model.calibration().capitalize()}; {model.alarm_limits.sentence()}",
        held_out=held_out_table(model),
        terms=_terms(model),
    )


def _histories(groups: Mapping[str, Sequence[FlightResult]], evaluation: Evaluation) -> dict[str, Figure]:
    """A time history of each flight; a flight of several groups has the colour of the first."""
    figures: dict[str, Figure] = {}
    for (_, colour), flights in zip(group_colours(groups).items(), groups.values(), strict=True):
        for flight in flights:
            if flight.name not in figures:
                metrics = evaluation.flights[flight.name].axes
                figures[flight.name] = time_history_figure(flight, metrics, colour)
    return figures


def _coverage_table(evaluation: Evaluation) -> Table:
    """Coverage and width of each axis, the groups side by side."""
    groups = evaluation.groups
    columns = [Column("axis", is_text=True)]
    for group, colour in group_colours(groups).items():
        columns += [
            Column("PICP", percent, group=group, colour=colour),
            Column("95 % CI", group=group, is_soft=True),
            Column("MPIW", number, group=group),
        ]
    rows = []
    for axis in (axis for axis in AXES if any(axis in part.axes for part in groups.values())):
        row: list[Cell | Value] = [axis_cell(axis)]
        for part in groups.values():
            metrics = part.axes.get(axis)
            if metrics is None:
                row += [None, "", ""]
            else:
                row += [coverage_cell(metrics, evaluation.confidence), percent_range(metrics.picp_ci)]
                row.append(metrics.mpiw)
        rows.append(row)
    return Table(columns, rows)


def _terms(model: AerodynamicModel) -> dict[str, Table | str]:
    """The terms or inputs of each axis, by a heading with their number."""
    terms: dict[str, Table | str] = {}
    for axis in model.axes:
        names = model.fitted.axes[axis].terms
        if log := model.selection[axis]:
            terms[f"{axis}: {len(names)} terms"] = selection_table(log)
        else:
            terms[f"{axis}: {model.kind.label}"] = ", ".join(names)
    return terms


def metric_definitions(evaluation: Evaluation) -> dict[str, str]:
    """What the metrics mean."""
    alpha = f"{1 - evaluation.confidence:.3g}"
    ranges = ", ".join(
        f"{axis} {number(extent)} {unit(axis)}" for axis, extent in evaluation.training_range.items()
    )
    return {
        "PICP and its interval": "Clopper–Pearson at the effective sample size that a block bootstrap within "
        "flights gives. It holds for these flights; flights to come differ more than samples do.",
        "NMPIW": f"MPIW over the range of the measured training data: {ranges}.",
        "Winkler score": f"Mean of width + 2/α · distance outside, α = {alpha}; lower is better.",
        "n_eff": "Number of independent samples that the autocorrelated prediction errors are worth.",
    }
