# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The sections of the page as HTML; every name that comes from outside is escaped."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from html import escape
from itertools import zip_longest
from typing import Any

from quadpi_core.evaluation.evaluation_result import AxisMetrics, Evaluation
from quadpi_core.flight import AXES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.report.holding import Holding, joint, listed, of_axes
from quadpi_core.report.live_figure import LiveReplay
from quadpi_core.report.page import (
    cells,
    figure,
    figure_of_flight,
    flight_menu,
    footer,
    heading,
    section,
    table,
)
from quadpi_core.report.style import (
    determination,
    group_colours,
    number,
    percent,
    percent_range,
    unit,
)
from quadpi_core.report.terminal_tables import alarm_sentence, final_terms, selection_cells

# The kind of figure that shows the time history of a flight.
HISTORY = "history"


def verdict(evaluation: Evaluation, training: Collection[str]) -> str:
    """One sentence: on which groups the intervals hold, on which that is not shown, on which they do not.

    A group of `training` flights alone is marked: there the intervals hold by construction. The axis that
    covers least is named with its numbers, of those that the clause is about, unless all cover enough.
    """
    confidence = evaluation.confidence
    groups: dict[Holding, list[str]] = {}
    for group, part in evaluation.groups.items():
        holding, axes = joint(of_axes(part.axes), confidence)
        remarks = ["in sample"] if set(part.flights) <= set(training) else []
        if holding is not Holding.HOLDS:
            remarks.append(f"{len(axes)} of {len(part.axes)} axes")
        if holding is not Holding.HOLDS or axes[0].estimate < confidence:
            remarks.append(axes[0].sentence())
        groups.setdefault(holding, []).append(f"{group} ({'; '.join(remarks)})" if remarks else group)
    if not groups:
        return f"{100 * confidence:g} % prediction intervals, flight by flight."
    clauses = [f"{holding.value} on {listed(groups[holding])}" for holding in Holding if holding in groups]
    return f"{100 * confidence:g} % prediction intervals {', and '.join(clauses)}."


def header(evaluation: Evaluation, model: AerodynamicModel) -> str:
    """Verdict, and which model of which vehicle it is about."""
    facts = {
        "model": evaluation.model,
        "vehicle": evaluation.vehicle,
        "settings": model.settings,
        "low-pass": f"{model.cutoff_hz:g} Hz",
        "identified on": f"{len(model.flights)} flights",
        "evaluated on": f"{len(evaluation.flights)} flights",
    }
    training = [flight.name for flight in model.flights]
    return heading("how far can this model be trusted?", verdict(evaluation, training), facts)


def coverage(evaluation: Evaluation) -> str:
    """PICP and MPIW per axis and group, the figure, and all metrics folded away."""
    nominal = f"{100 * evaluation.confidence:g} %"
    details = "".join(
        f"<details><summary>All metrics by {kind}</summary>{metrics_table(evaluation, kind + 's')}</details>"
        for kind in ("group", "flight")
    )
    overview = _coverage_table(evaluation) + figure("coverage") if evaluation.groups else ""
    alarms = "".join(
        f"<p><b>Alarm on {escape(name)}</b>: {escape(alarm_sentence(part.alarm))}.</p>"
        for name, part in evaluation.groups.items()
        if part.alarm is not None
    )
    return section(
        "Coverage and width",
        f"PICP: share of measurements inside the {nominal} prediction interval, with its 95 % confidence "
        "interval for autocorrelated samples. MPIW: mean width of the interval. Marked ▼ where the "
        f"confidence interval lies below {nominal}.",
        f'<div class="pair">{overview}</div>{alarms}{details}',
    )


def histories(flights: Mapping[str, Sequence[str]], bins: int) -> str:
    """Time histories with a selector of the flight."""
    return section(
        "Time histories",
        "Measured wrench (grey), prediction (line) and prediction interval (band); body axes "
        "forward-right-down, gravity not included. Drag to zoom all axes together, double-click to reset. "
        f"Long flights are thinned for display: of each of {bins} equal parts of a flight the lowest and "
        "highest samples are drawn, so peaks are kept. Metrics use all samples.",
        flight_menu(flights) + figure_of_flight(HISTORY),
    )


def envelope() -> str:
    """Distributions of the inputs."""
    return section(
        "Training envelope",
        "Where each group flew: share of samples by input. The shaded range is what the training flights "
        "covered; outside it the model extrapolates.",
        figure("envelope"),
    )


def residuals(confidence: float) -> str:
    """Residuals against airspeed."""
    return section(
        "Residuals against airspeed",
        f"Band: the central {100 * confidence:g} % of measured − predicted at that speed. Dashed: the mean "
        "prediction interval there. Where the band leaves the dashed lines, the interval is too narrow.",
        figure("residuals"),
    )


def live(replay: LiveReplay) -> str:
    """Statistics of the live replay and its timeline."""
    s = replay.statistics
    first = {
        level: "none" if (time := s[f"{level}_first_s"]) is None else f"{time:.2f} s"
        for level in ("warning", "alarm")
    }
    tiles = {
        "first warning": first["warning"],
        "first alarm": first["alarm"],
        "time in alarm": _optional(s["alarm_fraction"], percent),
        "samples in": _optional(s["samples_in"], _count),
        "predictions out": _optional(s["predictions_out"], _count),
        "dropped": _optional(s["dropped"], _count),
        "latency, median": _optional(s["latency_ms_p50"], _milliseconds),
        "latency, 99 %": _optional(s["latency_ms_p99"], _milliseconds),
    }
    boxes = "".join(f'<div class="tile"><b>{escape(v)}</b><span>{k}</span></div>' for k, v in tiles.items())
    return section(
        "Live replay",
        f"Flight {escape(replay.flight)} through the live nodes: the alarm level, the evidence over its "
        "threshold (1 is the limit that training sets), and the inputs outside the training envelope.",
        f'<div class="tiles">{boxes}</div>{figure("alarm")}',
    )


def model(held: AerodynamicModel) -> str:
    """Terms of each axis, of a polynomial as stepwise selection took them, folded away."""
    tables = "".join(_terms(axis, held) for axis in held.axes)
    flights = ", ".join(f"{flight.name} ({flight.samples} samples)" for flight in held.flights)
    return section(
        "Identified model",
        f"Training flights: {escape(flights)}. {escape(held.calibration().capitalize())}; "
        f"{escape(held.alarm_limits.sentence())}.",
        _held_out_table(held) + tables,
    )


def _terms(axis: str, held: AerodynamicModel) -> str:
    log, terms = held.selection[axis], held.fitted[axis].terms
    content = _selection_table(log) if log else f"<p>{escape(', '.join(terms))}</p>"
    count = f"{len(terms)} terms" if log else f"{held.method} ensemble"
    return f"<details><summary>{axis}: {count}</summary>{content}</details>"


def structure_table(held: AerodynamicModel) -> str:
    """Terms, coefficients and R² of the polynomials of all axes side by side, in the form of the paper."""
    axes = [axis for axis in held.axes if held.selection[axis]]
    top = "".join(f'<th colspan="3" class="group">{axis}</th>' for axis in axes)
    second = '<th class="text start">term</th><th>coefficient</th><th>R²</th>' * len(axes)
    rows = []
    for steps in zip_longest(*(final_terms(held.selection[axis]) for axis in axes)):
        columns = []
        for step in steps:
            kind = " unit" if step is None or step.fixed else ""
            term, coefficient, r2 = ("–", "–", "–") if step is None else step.cells()
            columns.append(
                f'<td class="text start{kind}">{escape(term)}</td>'
                f'<td class="{kind.strip()}">{coefficient}</td><td class="{kind.strip()}">{r2}</td>'
            )
        rows.append("".join(columns))
    return table(f"<tr>{top}</tr><tr>{second}</tr>", rows)


def _held_out_table(held: AerodynamicModel) -> str:
    """Coverage of each training flight by model and intervals of the others."""
    if not all(held.held_out_coverage[axis] for axis in held.axes):
        return ""
    head = "<tr>" + cells("th", ("left out: coverage", *held.axes)) + "</tr>"
    rows = "".join(
        "<tr>"
        + cells("td", (escape(flight.name), *(percent(held.held_out_coverage[a][k]) for a in held.axes)))
        + "</tr>"
        for k, flight in enumerate(held.flights)
    )
    return f"<table><thead>{head}</thead><tbody>{rows}</tbody></table>"


def definitions(evaluation: Evaluation) -> str:
    """What the metrics mean."""
    alpha = f"{1 - evaluation.confidence:.3g}"
    ranges = ", ".join(
        f"{axis} {number(extent)} {unit(axis)}" for axis, extent in evaluation.training_range.items()
    )
    entries = {
        "PICP and its interval": "Clopper–Pearson at the effective sample size that a block bootstrap within "
        "flights gives. It holds for these flights; flights to come differ more than samples do.",
        "NMPIW": f"MPIW over the range of the measured training data: {ranges}.",
        "Winkler score": f"Mean of width + 2/α · distance outside, α = {alpha}; lower is better.",
        "n_eff": "Number of independent samples that the autocorrelated prediction errors are worth.",
    }
    return footer(entries)


def _coverage_table(evaluation: Evaluation) -> str:
    groups = evaluation.groups
    axes = [axis for axis in AXES if any(axis in part.axes for part in groups.values())]
    top = "".join(
        f'<th colspan="3" class="group" style="--group: {colour}">{escape(group)}</th>'
        for group, colour in group_colours(groups).items()
    )
    second = '<th class="start">PICP</th><th>95 % CI</th><th>MPIW</th>' * len(groups)
    head = f"<tr><th></th><th></th>{top}</tr><tr><th>axis</th><th></th>{second}</tr>"
    rows = []
    for axis in axes:
        cells = [f'<td>{axis}</td><td class="unit">{unit(axis)}</td>']
        for part in groups.values():
            metrics = part.axes.get(axis)
            if metrics is None:
                cells.append('<td class="start">–</td><td></td><td></td>')
                continue
            cells.append(
                f"{_coverage_cell(metrics, evaluation.confidence)}"
                f'<td class="ci">{percent_range(metrics.picp_ci)}</td><td>{number(metrics.mpiw)}</td>'
            )
        rows.append("".join(cells))
    return table(head, rows)


def metrics_table(evaluation: Evaluation, kind: str) -> str:
    """All metrics by axis of each of its `kind`, "groups" or "flights"."""
    parts = evaluation.groups if kind == "groups" else evaluation.flights
    headings = ("PICP", "95 % CI", "MPIW", "NMPIW", "RMSE", "R²", "Winkler", "n", "n_eff")
    head = f'<tr><th>{kind[:-1]}</th><th class="text">axis</th>{cells("th", headings)}</tr>'
    rows = [
        f'<td>{escape(name)}</td><td class="text">{axis} <span class="unit">[{unit(axis)}]</span></td>'
        + _coverage_cell(metrics, evaluation.confidence)
        + f'<td class="ci">{percent_range(metrics.picp_ci)}</td>'
        + cells("td", (number(metrics.mpiw), percent(metrics.nmpiw)))
        + cells("td", (number(metrics.rmse), determination(metrics.r2), number(metrics.winkler)))
        + cells("td", (_count(metrics.n), _count(metrics.n_eff)))
        for name, part in parts.items()
        for axis, metrics in part.axes.items()
    ]
    return table(head, rows)


def _selection_table(log: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for row in log:
        term, *numbers = (escape(cell) for cell in selection_cells(row))
        rows.append(f'<td class="term">{term}</td>{cells("td", numbers)}')
    head = f"<tr><th>term</th>{cells('th', ('coefficient', 'R² reached', 'criterion'))}</tr>"
    return table(head, rows)


def _coverage_cell(metrics: AxisMetrics, confidence: float) -> str:
    if metrics.covers_too_little(confidence):
        return f'<td class="start short">▼ {percent(metrics.picp)}</td>'
    return f'<td class="start">{percent(metrics.picp)}</td>'


def _optional(value: float | None, text: Any) -> str:
    return "–" if value is None else str(text(value))


def _count(value: float) -> str:
    return f"{value:,.0f}".replace(",", "\u202f")


def _milliseconds(value: float) -> str:
    return f"{value:.2f} ms"
