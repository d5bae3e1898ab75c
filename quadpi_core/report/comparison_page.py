# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Several models compared on the same flights: for the terminal, and as a page with its figures."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from rich.console import Group
from rich.text import Text

from quadpi_core.evaluation.evaluation_result import AxisMetrics, Comparison, Evaluation, FlightResult
from quadpi_core.flight import AXES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.report.evaluation_figures import axis_coverages, count_verdicts, listing, time_history_figure
from quadpi_core.report.evaluation_page import (
    alarm_lines,
    axis_cell,
    coverage_cell,
    metric_definitions,
    metrics_table,
    short_coverage_note,
)
from quadpi_core.report.info_tables import structure_table
from quadpi_core.report.page import (
    DASHES,
    Figure,
    FlightFiles,
    Layer,
    Limit,
    Line,
    Page,
    Panel,
    Points,
    Scale,
    flight_remarks,
)
from quadpi_core.report.table import (
    INK,
    MEASURED,
    Cell,
    Column,
    Row,
    Table,
    hundredths,
    method_colours,
    nominal,
    number,
    percent,
    percent_range,
    terminal_table,
    text_columns,
    unit,
)

# Models of one method have its colour; these tell their settings apart.
_DASHES = {"default": "", "paper": "dotted"}


class ComparisonRow(NamedTuple):
    """The metrics of one axis by one model, by group."""

    axis: str
    model: str
    groups: Mapping[str, AxisMetrics]


def comparison_rows(comparison: Comparison) -> Iterator[ComparisonRow]:
    """Rows by axis, then by model."""
    for axis in modelled_axes(comparison):
        for name, model in comparison.models.items():
            if axis in _axes_of(model):
                groups = {group: part.axes[axis] for group, part in model.groups.items()}
                yield ComparisonRow(axis, name, groups)


def modelled_axes(comparison: Comparison) -> list[str]:
    """Axes that some model holds."""
    modelled = {axis for model in comparison.models.values() for axis in _axes_of(model)}
    return [axis for axis in AXES if axis in modelled]


def _axes_of(model: Evaluation) -> Collection[str]:
    """The axes that a model holds: those of any of its groups."""
    return next(iter(model.groups.values())).axes


def comparison_table(comparison: Comparison, by: Literal["metric", "group"] = "metric") -> Table:
    """Coverage and width of each axis, model and group.

    Args:
        comparison: of the models.
        by: whether the columns of a metric or those of a group stand together, below a shared heading.
    """
    groups, confidence = list(comparison.groups), comparison.confidence
    metrics = {"PICP %": hundredths, "MPIW": number}
    columns = [*text_columns("axis", is_section=True), *text_columns("model")]
    if by == "metric":
        pairs = [(metric, group) for metric in metrics for group in groups]
        columns += [Column(group, metrics[metric], group=metric) for metric, group in pairs]
    else:
        pairs = [(metric, group) for group in groups for metric in metrics]
        columns += [Column(metric, metrics[metric], group=group) for metric, group in pairs]
    rows: list[Row] = []
    for row in comparison_rows(comparison):
        cells = {group: (coverage_cell(own, confidence), Cell(own.mpiw)) for group, own in row.groups.items()}
        shown = (cells[group][metric != "PICP %"] for metric, group in pairs)
        rows.append([axis_cell(row.axis), row.model, *shown])
    return Table(columns, rows)


def comparison_summary(comparison: Comparison) -> Group:
    """Coverage and width of each axis, model and group, for the terminal."""
    confidence = comparison.confidence
    kind = "adaptive prediction intervals" if comparison.adaptive else "prediction intervals"
    marked = any(
        metrics.covers_too_little(confidence)
        for row in comparison_rows(comparison)
        for metrics in row.groups.values()
    )
    notes = [
        *([short_coverage_note(confidence)] if marked else []),
        *(f"{name}: {own.support.sentence()}" for name, own in comparison.models.items() if own.support),
        *(
            f"alarm of {name} on {group}: {'; '.join(alarm_lines(part.alarm))}"
            for name, model in comparison.models.items()
            for group, part in model.groups.items()
        ),
    ]
    return Group(
        Text(f"{comparison.vehicle}: {percent(confidence)} {kind}", style="bold"),
        terminal_table(comparison_table(comparison, by="group")),
        *(Text(note, style="dim") for note in notes),
    )


def comparison_verdict(comparison: Comparison) -> str:
    """The page's headline: in how many axes of all models the intervals hold on each group, and where not."""
    coverages = {
        group: [
            replace(coverage, subject=f"{name} {coverage.subject}")
            for name, model in comparison.models.items()
            for coverage in axis_coverages(model.groups[group].axes)
        ]
        for group in comparison.groups
    }
    verdicts = count_verdicts(coverages, comparison.confidence)
    return f"Over the axes of all models, {nominal(comparison.confidence)} prediction intervals {verdicts}."


def write_comparison_page(
    path: Path,
    comparison: Comparison,
    results: Mapping[str, Sequence[FlightResult]],
    models: Mapping[str, AerodynamicModel],
    files: FlightFiles | None = None,
) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        comparison: of the models, on at least one group.
        results: predictions of each model on each flight.
        models: that were compared.
        files: of flights and models, to look at moments in `quadpi view`.

    Raises:
        OutputError: if `path` cannot be written.
    """
    flights = [result.name for result in next(iter(results.values()))]
    colours = _colours(comparison)
    of_flight = {}
    for place, flight in enumerate(flights):
        own = {name: model_results[place] for name, model_results in results.items()}
        of_flight[flight] = {"intervals": _interval_figure(comparison, own)} | {
            f"model {name}": time_history_figure(
                result, comparison.models[name].flights[flight].axes, colours[name]
            )
            for name, result in own.items()
        }
    cutoffs = sorted({model.cutoff_hz for model in comparison.models.values()})
    facts = {
        "vehicle": comparison.vehicle,
        "models": ", ".join(model.model for model in comparison.models.values()),
        "flights": str(len({name for names in comparison.groups.values() for name in names})),
        "low-pass": " and ".join(f"{cutoff:g} Hz" for cutoff in cutoffs),
    }
    Page(
        title=f"quadpi: {len(models)} models compared",
        about="how far can these models be trusted?",
        verdict=comparison_verdict(comparison),
        facts=facts | ({"intervals": "adaptive"} if comparison.adaptive else {}),
        definitions=metric_definitions(next(iter(comparison.models.values()))),
        figures={"groups": _group_figure(comparison)},
        flight_figures=of_flight,
        files=files or FlightFiles(),
        remarks=_remarks(comparison),
    ).write(
        path,
        "comparison.html",
        nominal=nominal(comparison.confidence),
        coverage=comparison_table(comparison),
        by_model={
            name: metrics_table(model.groups, comparison.confidence, "group")
            for name, model in comparison.models.items()
        },
        flights=comparison.groups,
        models=list(models),
        structures={
            name: structure_table(model.selection, [axis for axis in model.axes if model.selection[axis]])
            for name, model in models.items()
            if any(model.selection.values())
        },
    )


def _remarks(comparison: Comparison) -> list[tuple[str, str]]:
    """On the data, and which groups of which models are in sample."""
    in_sample = [
        (name, f"was identified on {listing(known)} of group {group}: in sample")
        for name, model in comparison.models.items()
        for group in comparison.groups
        if (known := model.in_sample(group))
    ]
    quality = next(iter(comparison.models.values())).data_quality
    asked = [
        (name, model.support.sentence())
        for name, model in comparison.models.items()
        if model.support is not None and not model.support.is_supported
    ]
    return in_sample + asked + flight_remarks(quality, comparison.left_out)


def _group_figure(comparison: Comparison) -> Figure:
    """A column per axis: coverage by group and model; below, width relative to that of the first group."""
    models, groups = comparison.models, list(comparison.groups)
    colours = _colours(comparison)
    ticks = [(float(place), group) for place, group in enumerate(groups)]
    slots = Scale("", -0.5, len(groups) - 0.5, ticks=ticks)
    above, below = list[Panel](), list[Panel]()
    axes = modelled_axes(comparison)
    for axis in axes:
        coverages: list[Layer] = [Limit("", INK, 100.0 * comparison.confidence)]
        widths: list[Layer] = []
        for place, (name, model) in enumerate(models.items()):
            if axis not in _axes_of(model):
                continue
            cells = [model.groups[group].axes[axis] for group in groups]
            x = np.arange(float(len(groups))) + 0.5 * ((place + 0.5) / len(models) - 0.5)
            width = np.array([metrics.mpiw for metrics in cells])
            coverage = Points(
                name,
                colours[name],
                x,
                100.0 * np.array([metrics.picp for metrics in cells]),
                100.0 * np.array([metrics.picp_ci for metrics in cells]),
                texts=[f"{name}: {percent(m.picp)} ({percent_range(m.picp_ci)})" for m in cells],
                symbol=place % 4,
                hollow=model.settings == "paper",
                joined=True,
                dash=_DASHES[model.settings],
            )
            coverages.append(coverage)
            texts = [f"{name}: {w:.3g} {unit(axis)}" for w in width]
            widths.append(replace(coverage, y=width / width[0], error=None, texts=texts))
        above.append(Panel(coverages, slots, Scale("PICP [%]"), 190.0, axis))
        below.append(Panel(widths, slots, Scale(f"MPIW over {groups[0]}", low=0.0), 190.0))
    return Figure("Coverage and width from group to group", above + below, len(axes), shared=True)


def _interval_figure(comparison: Comparison, results: Mapping[str, FlightResult]) -> Figure:
    """A row per axis and a column per low-pass: bounds of the models around what was measured.

    Args:
        comparison: of the models.
        results: predictions of each model on one flight.
    """
    models, axes, colours = comparison.models, modelled_axes(comparison), _colours(comparison)
    # Models that share a colour share an entry of the legend.
    labels = {
        name: model.method if list(colours.values()).count(colours[name]) > 1 else name
        for name, model in models.items()
    }
    patterns = dict(zip(dict.fromkeys(labels.values()), cycle(DASHES), strict=False))
    cutoffs = list(dict.fromkeys(model.cutoff_hz for model in models.values()))
    panels = list[Panel]()
    for axis in axes:
        for cutoff in cutoffs:
            names = [name for name, model in models.items() if model.cutoff_hz == cutoff]
            flight = results[names[0]]
            layers: list[Layer] = [
                Line("measured", MEASURED, flight.time, flight.column("measured", axis), width=1.0)
            ]
            layers += [
                Line(
                    labels[name],
                    colours[name],
                    flight.time,
                    results[name].column(bound, axis),
                    dash=patterns[labels[name]],
                )
                for name in names
                if axis in results[name].axes
                for bound in ("lower", "upper")
            ]
            settings = " and ".join(dict.fromkeys(models[name].settings for name in names))
            title = f"{settings} settings, low-pass {cutoff:g} Hz" if len(panels) < len(cutoffs) else ""
            panels.append(Panel(layers, Scale("time [s]"), Scale(f"{axis} [{unit(axis)}]"), 170.0, title))
    return Figure("Bounds of each model over time", panels, len(cutoffs), over_time=True, shared=True)


def _colours(comparison: Comparison) -> dict[str, str]:
    """A colour for each method where settings distinguish its models, else one for each model."""
    methods = {name: model.method for name, model in comparison.models.items()}
    kinds = {(model.method, model.settings) for model in comparison.models.values()}
    if len(kinds) < len(methods):
        return method_colours(methods)
    of_method = method_colours(methods.values())
    return {name: of_method[method] for name, method in methods.items()}
