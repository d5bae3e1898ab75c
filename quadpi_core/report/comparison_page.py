# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Several models on the same flights, as the paper's wind-tunnel table: for the terminal, and as a page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from quadpi_core.evaluation.evaluation_result import (
    AxisMetrics,
    Comparison,
    Evaluation,
    GroupEvaluation,
    PublishedMetrics,
)
from quadpi_core.evaluation.flight_results import FlightResult
from quadpi_core.flight import AXES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.report import evaluation_sections
from quadpi_core.report.decimation import bins_within
from quadpi_core.report.group_figures import group_figure, interval_figure, lines_drawn
from quadpi_core.report.holding import in_cells, of_axes
from quadpi_core.report.page import (
    figure,
    figure_of_flight,
    flight_menu,
    heading,
    section,
    table,
    write_page,
)
from quadpi_core.report.style import hundredths, number, percent, unit
from quadpi_core.report.terminal_tables import alarm_sentence

PUBLISHED = "published"
# All intervals together draw so many samples, at about 11 bytes each in the page.
_DRAWN_SAMPLES = 300_000


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        axis: of the wrench.
        model: its name; None for what was published on the method of the rows before.
        groups: by group the metrics, of a published row `picp` and `mpiw` alone.
    """

    axis: str
    model: str | None
    groups: Mapping[str, AxisMetrics | PublishedMetrics]

    def short(self, group: str, confidence: float) -> bool:
        """Whether the coverage is too low beyond chance; of published numbers nobody knows."""
        metrics = self.groups[group]
        return isinstance(metrics, AxisMetrics) and metrics.covers_too_little(confidence)

    def coverage(self, group: str, confidence: float) -> str:
        """PICP in percent with the two decimals of the paper, marked where it is too low."""
        mark = "▼ " if self.short(group, confidence) else ""
        return mark + hundredths(self.groups[group].picp)

    def width(self, group: str) -> str:
        """MPIW in the unit of the axis; published ones have two decimals."""
        width = self.groups[group].mpiw
        return number(width) if self.model else f"{width:.2f}"


def rows(comparison: Comparison) -> Iterator[Row]:
    """Rows by axis, then model in its order; after the models of one method what was published on it.

    Args:
        comparison: what was found.
    """
    models, published = comparison.models, comparison.published or {}
    for axis in held_axes(comparison):
        names = [name for name in models if axis in _group(models[name], comparison).axes]
        for place, name in enumerate(names):
            parts = models[name].groups
            yield Row(axis, name, {group: part.axes[axis] for group, part in parts.items()})
            method = models[name].method
            is_last = place + 1 == len(names) or models[names[place + 1]].method != method
            known = published.get(method, {}).get(axis)
            if is_last and known is not None:
                yield Row(axis, None, known)


def held_axes(comparison: Comparison) -> list[str]:
    """Axes that some model holds."""
    parts = [_group(model, comparison) for model in comparison.models.values()]
    return [axis for axis in AXES if any(axis in part.axes for part in parts)]


def _group(model: Evaluation, comparison: Comparison) -> GroupEvaluation:
    """Any of its groups: all hold the same axes."""
    return model.groups[next(iter(comparison.groups))]


def comparison_table(comparison: Comparison) -> Group:
    """Coverage and width of each axis, model and group, with the paper's numbers where there are some."""
    confidence, groups = comparison.confidence, list(comparison.groups)
    shown = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    shown.add_column("model", vertical="bottom")
    for group in groups:
        shown.add_column(Text(f"{group}\n{'PICP %':>7} {'MPIW':>8}"), justify="right", overflow="fold")
    axis = ""
    for row in rows(comparison):
        if row.axis != axis:
            axis = row.axis
            shown.add_section()
            shown.add_row(Text(f"{axis} [{unit(axis)}]", style="bold"))
        cells = []
        for group in groups:
            style = "bold red" if row.short(group, confidence) else ""
            cells.append(
                Text.assemble((f"{row.coverage(group, confidence):>7}", style), f" {row.width(group):>8}")
            )
        shown.add_row(Text(row.model or PUBLISHED), *cells, style="" if row.model else "dim")
    nominal = percent(confidence)
    kind = "adaptive prediction intervals" if comparison.adaptive else "prediction intervals"
    notes = [f"▼ the confidence interval of the coverage lies below {nominal}"] * _any_short(comparison)
    notes += list(_alarm_notes(comparison))
    notes += [f"{PUBLISHED}: van Beers and de Visser, on the real vehicle"] * bool(comparison.published)
    return Group(
        Text(f"{comparison.vehicle}: {nominal} {kind}", style="bold"),
        shown,
        *(Text(note, style="dim") for note in notes),
    )


def _alarm_notes(comparison: Comparison) -> Iterator[str]:
    """What each model's alarm did on each group."""
    for name, model in comparison.models.items():
        for group, part in model.groups.items():
            if part.alarm is not None:
                yield f"alarm of {name} on {group}: {alarm_sentence(part.alarm)}"


def _any_short(comparison: Comparison) -> bool:
    confidence = comparison.confidence
    return any(row.short(group, confidence) for row in rows(comparison) for group in row.groups)


def write_comparison_page(
    path: Path,
    comparison: Comparison,
    results: Mapping[str, Sequence[FlightResult]],
    models: Mapping[str, AerodynamicModel],
) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        comparison: what was found, of at least one group.
        results: what each model says of each flight, from there.
        models: that were compared.

    Raises:
        OutputError: if `path` cannot be written.
    """
    flights = [result.name for result in next(iter(results.values()))]
    bins = bins_within(_DRAWN_SAMPLES, lines_drawn(comparison) * len(flights))
    figures = {"groups": group_figure(comparison)}
    for place, flight in enumerate(flights):
        of_flight = {name: model_results[place] for name, model_results in results.items()}
        figures[f"intervals {flight}"] = interval_figure(comparison, of_flight, bins)
    parts = [
        _header(comparison),
        _table(comparison),
        _groups(comparison),
        _intervals(comparison, bins),
        _structures(models),
        evaluation_sections.definitions(next(iter(comparison.models.values()))),
    ]
    write_page(path, f"quadpi: {len(models)} models compared", parts, figures)


def verdict(comparison: Comparison) -> str:
    """One sentence: in how many axes of all models the intervals hold on each group, and where not."""
    cells = {
        group: [
            replace(coverage, what=f"{name} {coverage.what}")
            for name, model in comparison.models.items()
            for coverage in of_axes(model.groups[group].axes)
        ]
        for group in comparison.groups
    }
    confidence = comparison.confidence
    found = in_cells(cells, confidence)
    return f"{100 * confidence:g}\u00a0% prediction intervals {found} (axes of all models)."


def _header(comparison: Comparison) -> str:
    cutoffs = sorted({model.cutoff_hz for model in comparison.models.values()})
    facts = {
        "vehicle": comparison.vehicle,
        "models": str(len(comparison.models)),
        "flights": str(len({name for names in comparison.groups.values() for name in names})),
        "low-pass": " and ".join(f"{cutoff:g} Hz" for cutoff in cutoffs),
    }
    if comparison.adaptive:
        facts["intervals"] = "adaptive"
    return heading("how far can these models be trusted?", verdict(comparison), facts)


def _table(comparison: Comparison) -> str:
    nominal = f"{100 * comparison.confidence:g} %"
    paper = (
        " Grey: what van Beers and de Visser found with each method on the real vehicle."
        if comparison.published
        else ""
    )
    details = "".join(
        f"<h3>{escape(name)}</h3>{evaluation_sections.metrics_table(model, 'groups')}"
        for name, model in comparison.models.items()
    )
    return section(
        "Coverage and width",
        f"PICP: share of measurements inside the {nominal} prediction interval. MPIW: mean width of the "
        f"interval. Marked ▼ where the confidence interval of the coverage lies below {nominal}.{paper}",
        _html_table(comparison) + f"<details><summary>All metrics by group</summary>{details}</details>",
    )


def _html_table(comparison: Comparison) -> str:
    confidence, groups = comparison.confidence, list(comparison.groups)
    names = "".join(
        f"<th{_start(place)}>{escape(group)}</th>" for _ in "pw" for place, group in enumerate(groups)
    )
    head = (
        f'<tr><th></th><th></th><th colspan="{len(groups)}" class="group">PICP [%]</th>'
        f'<th colspan="{len(groups)}" class="group">MPIW</th></tr>'
        f'<tr><th>axis</th><th class="text">model</th>{names}</tr>'
    )
    body, axis = [], ""
    for row in rows(comparison):
        soft = "" if row.model else " unit"
        coverage = "".join(
            f'<td class="{"start" * (not place)}{soft}{" short" * row.short(group, confidence)}">'
            f"{row.coverage(group, confidence)}</td>"
            for place, group in enumerate(groups)
        )
        width = "".join(
            f'<td class="{"start" * (not place)}{soft}">{row.width(group)}</td>'
            for place, group in enumerate(groups)
        )
        first = "" if row.axis == axis else f'{row.axis} <span class="unit">[{unit(row.axis)}]</span>'
        axis = row.axis
        body.append(
            f'<td>{first}</td><td class="text{soft}">{escape(row.model or PUBLISHED)}</td>{coverage}{width}'
        )
    return table(head, body)


def _start(place: int) -> str:
    return "" if place else ' class="start"'


def _groups(comparison: Comparison) -> str:
    first = next(iter(comparison.groups))
    return section(
        "From group to group",
        "Above, coverage with its 95 % confidence interval, against the nominal one (dashed). Below, mean "
        f"width over that on {escape(first)}: an interval that knows when its model extrapolates widens "
        "where coverage would fall.",
        figure("groups"),
    )


def _intervals(comparison: Comparison, bins: int) -> str:
    return section(
        "Intervals over time",
        "Bounds of each model (lines) around the measured wrench (grey), a column for each low-pass. Of each "
        f"of {bins} equal parts of a flight the extremes are drawn. Drag to zoom, double-click to reset.",
        flight_menu(comparison.groups) + figure_of_flight("intervals"),
    )


def _structures(models: Mapping[str, AerodynamicModel]) -> str:
    tables = "".join(
        f'<h3>{escape(name)}</h3><div class="dense">{evaluation_sections.structure_table(model)}</div>'
        for name, model in models.items()
        if any(model.selection.values())
    )
    if not tables:
        return ""
    return section(
        "Identified polynomials",
        "Terms in the order of their selection, coefficients in SI units, R² of the fit up to the term; "
        "fixed terms are grey.",
        tables,
    )
