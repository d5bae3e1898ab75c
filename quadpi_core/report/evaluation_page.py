# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""An evaluation as one self-contained page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import plotly.graph_objects as go

from quadpi_core.evaluation.evaluation_result import Evaluation
from quadpi_core.evaluation.flight_results import FlightResult
from quadpi_core.flight import AXES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.report import evaluation_sections
from quadpi_core.report.decimation import bins_within
from quadpi_core.report.distribution_figures import envelope_figure, residual_figure
from quadpi_core.report.figures import coverage_figure, time_history_figure
from quadpi_core.report.live_figure import LiveReplay, alarm_figure
from quadpi_core.report.page import write_page
from quadpi_core.report.style import group_colours

# All time histories together draw so many samples, at about 11 bytes each in the page.
_DRAWN_SAMPLES = 240_000
_LINES_PER_AXIS = 4
_UNGROUPED = "flights in no group"


def write_report(
    path: Path,
    evaluation: Evaluation,
    results: Sequence[FlightResult],
    model: AerodynamicModel,
    live: LiveReplay | None = None,
) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        evaluation: as :func:`quadpi_core.evaluation.flight_results.evaluate_flights` gives it.
        results: the flights that were evaluated, at least one.
        model: that was evaluated; gives training flights, envelope and selection log.
        live: what the live nodes said of one of the flights.
    """
    by_name = {result.name: result for result in results}
    groups = {name: [by_name[flight] for flight in part.flights] for name, part in evaluation.groups.items()}
    grouped = {flight.name for flights in groups.values() for flight in flights}
    rest = [result for result in results if result.name not in grouped]
    if rest:
        groups[_UNGROUPED] = rest
    bins = bins_within(_DRAWN_SAMPLES, _LINES_PER_AXIS * sum(len(result.axes) for result in results))

    parts = [evaluation_sections.header(evaluation, model), evaluation_sections.coverage(evaluation)]
    figures = {"coverage": coverage_figure(evaluation)} if evaluation.groups else {}
    if live is not None:
        figures["alarm"] = alarm_figure(live, by_name.get(live.flight))
        parts.append(evaluation_sections.live(live))
    figures |= _histories(groups, evaluation, bins)
    figures["envelope"] = envelope_figure(groups, model.envelope, [flight.name for flight in model.flights])
    figures["residuals"] = residual_figure(groups, _common_axes(results), evaluation.confidence)
    parts += [
        evaluation_sections.histories(
            {group: [f.name for f in flights] for group, flights in groups.items()}, bins
        ),
        evaluation_sections.envelope(),
        evaluation_sections.residuals(evaluation.confidence),
        evaluation_sections.model(model),
        evaluation_sections.definitions(evaluation),
    ]
    write_page(path, f"quadpi: {evaluation.model}", parts, figures)


def _histories(
    groups: Mapping[str, Sequence[FlightResult]], evaluation: Evaluation, bins: int
) -> dict[str, go.Figure]:
    """One figure per flight; a flight of several groups has the colour of the first."""
    figures: dict[str, go.Figure] = {}
    for (_, colour), flights in zip(group_colours(groups).items(), groups.values(), strict=True):
        for flight in flights:
            name = f"{evaluation_sections.HISTORY} {flight.name}"
            if name not in figures:
                metrics = evaluation.flights[flight.name].axes
                figures[name] = time_history_figure(flight, metrics, colour, bins)
    return figures


def _common_axes(results: Sequence[FlightResult]) -> list[str]:
    return [axis for axis in AXES if all(axis in result.axes for result in results)]
