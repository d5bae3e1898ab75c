# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Intervals around the spread of noisy measurements and predictions, as a plotly figure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.paper.realisations import HIGHEST, LOWEST, Spread
from quadpi_core.paper.validation_case import ValidationCase
from quadpi_core.paper.validation_result import Validation
from quadpi_core.report.decimation import extreme_samples
from quadpi_core.report.figures import series, styled
from quadpi_core.report.style import INK, MEASURED, PREDICTED, method_colours, translucent, unit

# The axes of the paper's figures; each model draws so many lines of each.
BAND_AXES = ("Fz", "Fx", "My")
LINES = 7
# The extremes of so many realisations lie about two standard deviations from their mean, as the bounds do.
SHOWN = 20


def band_figure(case: ValidationCase, place: int, spread: Spread, result: Validation, bins: int) -> go.Figure:
    """Rows Fz, Fx, My, a column per model: its bounds, and what they have to cover.

    Args:
        case: that was validated.
        place: of the flight in it.
        spread: of that flight.
        result: gives the coverage of the flight.
        bins: parts that the flight is cut into; of each the extremes are drawn.
    """
    flight = case.flights[place]
    held = {axis for model in case.models.values() for axis in model.axes}
    axes = [axis for axis in BAND_AXES if axis in held] or [axis for axis in AXES if axis in held][:1]
    figure = make_subplots(
        rows=len(axes),
        cols=len(case.models),
        shared_xaxes="all",
        shared_yaxes="rows",
        column_titles=list(case.models),
        horizontal_spacing=0.03,
        vertical_spacing=0.06,
    )
    for column, (name, colour) in enumerate(method_colours(case.models).items(), start=1):
        reference = case.references[name][place]
        for row, axis in enumerate(axes, start=1):
            if axis not in case.models[name].axes:
                continue
            k = AXES.index(axis)
            cell = {"row": row, "col": column, "first": row == 1 and column == 1}
            _band(figure, flight.time, spread.measured[..., k], MEASURED, "noisy measurements", bins, cell)
            _band(
                figure,
                flight.time,
                spread.predicted[name][..., k],
                PREDICTED,
                "noisy predictions",
                bins,
                cell,
            )
            _line(figure, flight.time, reference.wrench[:, k], INK, "without noise", bins, cell)
            for bound in (reference.lower, reference.upper):
                _line(figure, flight.time, bound[:, k], colour, f"{name} interval", bins, cell)
            covered = result.models[name].flights[flight.name][axis].measurement_variation
            figure.add_annotation(
                text=f"{100.0 * covered:.1f} % covered",
                x=1,
                y=1,
                xref="x domain",
                yref="y domain",
                xanchor="right",
                yanchor="bottom",
                showarrow=False,
                row=row,
                col=column,
            )
    for row, axis in enumerate(axes, start=1):
        figure.update_yaxes(title_text=f"{axis} [{unit(axis)}]", row=row, col=1)
    figure.update_xaxes(title_text="time [s]", row=len(axes))
    return styled(figure, height=110 + 250 * len(axes)).update_layout(showlegend=True)


def _band(
    figure: go.Figure,
    time: Array,
    extremes: Array,
    colour: str,
    name: str,
    bins: int,
    cell: Mapping[str, Any],
) -> None:
    low, high = extremes[LOWEST], extremes[HIGHEST]
    drawn = extreme_samples(low, high, bins)
    place = {"row": cell["row"], "col": cell["col"], "hoverinfo": "skip", "line_width": 0}
    # Both bounds must be Scatter: with Scattergl, "tonexty" fills to zero.
    figure.add_scatter(**series(time[drawn], low[drawn]), name=f"{name}, lowest", showlegend=False, **place)
    figure.add_scatter(
        **series(time[drawn], high[drawn]),
        fill="tonexty",
        fillcolor=translucent(colour, 0.45),
        name=name,
        legendgroup=name,
        showlegend=cell["first"],
        **place,
    )


def _line(
    figure: go.Figure, time: Array, values: Array, colour: str, name: str, bins: int, cell: Mapping[str, Any]
) -> None:
    drawn = extreme_samples(values, values, bins)
    figure.add_scatter(
        **series(time[drawn], values[drawn]),
        line={"color": colour, "width": 1.4},
        name=name,
        legendgroup=name,
        showlegend=cell["first"] and colour == INK,
        row=cell["row"],
        col=cell["col"],
    )
