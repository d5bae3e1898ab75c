# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of the residuals of a simulation, before and after effects are added."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from quadpi_core.discrepancy.by_condition import WORDS, Profile
from quadpi_core.discrepancy.closure import Gap
from quadpi_core.discrepancy.residual_bins import Residual
from quadpi_core.evaluation.metrics import round_edges
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.report.plots import Subplot, grid, label_axes_over_time, series, styled
from quadpi_core.report.style import GROUPS, MEASURED, translucent, unit

BEFORE, AFTER = GROUPS[1], GROUPS[0]
# Lines over time of each flight: before and after for each axis.
LINES = 2 * len(AXES)
MAPS = (("u", "v"), ("speed", "height"), ("w", "rotor_speed"))
# Samples that a cell of a map needs to be drawn, and bins of a variable at most.
_FEWEST_IN_CELL, _MOST_BINS = 20, 12
_COLUMNS = 3


def profile_figure(profiles: Sequence[Profile]) -> go.Figure:
    """Root mean square of the residual of each axis over the variable that explains most of it."""
    rows = -(-len(profiles) // _COLUMNS)
    figure = make_subplots(rows=rows, cols=_COLUMNS, vertical_spacing=0.34 / rows, horizontal_spacing=0.08)
    for profile, subplot in zip(profiles, grid(figure, len(profiles), _COLUMNS), strict=True):
        lines = (
            ("allowed by noise and tolerances", profile.allowed, {"color": MEASURED, "dash": "dot"}),
            ("with what was found", profile.after, {"color": AFTER}),
            ("as it is", profile.beyond, {"color": BEFORE}),
        )
        for name, values, line in lines:
            figure.add_scatter(
                **series(profile.edges, np.append(values, values[-1])),
                line={"width": 2, "shape": "hv", **line},
                name=name,
                legendgroup=name,
                showlegend=subplot.in_legend,
                hovertemplate="%{y:.3g}",
                **subplot.cell,
            )
        figure.update_xaxes(title_text=_label(profile.variable), **subplot.cell)
        title = f"{profile.axis} [{unit(profile.axis)}]"
        figure.update_yaxes(title_text=title, rangemode="tozero", **subplot.cell)
    return styled(figure, height=90 + 240 * rows)


def map_figure(flights: Sequence[Residual], axes: Sequence[str]) -> go.Figure:
    """Mean residual over pairs of variables (rows) for each axis (columns)."""
    figure = make_subplots(
        rows=len(MAPS),
        cols=len(axes),
        shared_xaxes="rows",
        shared_yaxes="rows",
        horizontal_spacing=0.02,
        vertical_spacing=0.1,
        column_titles=[f"{axis} [{unit(axis)}]" for axis in axes],
    )
    width = 1.0 / len(axes)
    for column, axis in enumerate(axes, start=1):
        k = AXES.index(axis)
        tables = [mean_map(flights, k, *pair) for pair in MAPS]
        largest = max(float(np.nanmax(np.abs(table))) for *_, table in tables)
        for row, (pair, (x, y, table)) in enumerate(zip(MAPS, tables, strict=True), start=1):
            figure.add_heatmap(
                x=x,
                y=y,
                z=table.astype(np.float32),
                coloraxis=f"coloraxis{column}",
                hovertemplate="%{x}, %{y}: %{z:.3g}<extra></extra>",
                row=row,
                col=column,
            )
            figure.update_xaxes(title_text=_label(pair[0]), row=row, col=column)
        figure.update_layout(
            {
                f"coloraxis{column}": {
                    "colorscale": "RdBu_r",
                    "cmin": -largest,
                    "cmax": largest,
                    "colorbar": {
                        "orientation": "h",
                        "x": (column - 0.5) * width,
                        "y": -0.09,
                        "yanchor": "top",
                        "len": 0.8 * width,
                        "thickness": 9,
                        "nticks": 3,
                        "exponentformat": "power",
                    },
                }
            }
        )
    for row, pair in enumerate(MAPS, start=1):
        figure.update_yaxes(title_text=_label(pair[1]), row=row, col=1)
    styled(figure, height=200 + 230 * len(MAPS))
    figure.update_xaxes(showgrid=False, showticklabels=True)
    return figure.update_yaxes(showgrid=False).update_layout(margin_b=90)


def mean_map(flights: Sequence[Residual], axis: int, x: str, y: str) -> tuple[Array, Array, Array]:
    """Edges of the bins of two variables, and the mean residual in each cell (Y, X); NaN for few samples."""
    first, second = (np.concatenate([own.variables[name] for own in flights]) for name in (x, y))
    values = np.concatenate([own.beyond[:, axis] for own in flights])
    edges = round_edges(first, _MOST_BINS), round_edges(second, _MOST_BINS)
    count, *_ = np.histogram2d(second, first, bins=(edges[1], edges[0]))
    total, *_ = np.histogram2d(second, first, bins=(edges[1], edges[0]), weights=values)
    enough = count >= _FEWEST_IN_CELL
    return *edges, np.where(enough, total / np.maximum(count, 1.0), np.nan)


def gap_figure(gap: Gap) -> go.Figure:
    """Root mean square error of each axis before and after, and the floor from noise."""
    figure = make_subplots(rows=1, cols=2, horizontal_spacing=0.17)
    for column in (1, 2):
        own = slice(3 * column - 3, 3 * column)
        axes = list(AXES[own])
        for name, values, colour in (("before", gap.before, BEFORE), ("after", gap.after, AFTER)):
            figure.add_bar(
                x=axes,
                y=values[own],
                name=name,
                marker_color=colour,
                legendgroup=name,
                showlegend=column == 1,
                hovertemplate="%{y:.3g}",
                row=1,
                col=column,
            )
        figure.add_scatter(
            x=axes,
            y=gap.floor[own],
            mode="markers",
            marker={
                "symbol": "line-ew",
                "size": 60,
                "line": {"width": 2, "color": MEASURED},
            },
            name="floor: noise",
            legendgroup="floor",
            showlegend=column == 1,
            hovertemplate="%{y:.3g}",
            row=1,
            col=column,
        )
        title = f"RMSE [{unit(axes[0])}]"
        figure.update_yaxes(title_text=title, rangemode="nonnegative", row=1, col=column)
    return styled(figure, height=330).update_layout(bargap=0.35, bargroupgap=0.05)


def residual_figure(flight: Residual, floor: Array, bins: int) -> go.Figure:
    """Measured − simulated wrench of one flight over time, before and after.

    Args:
        flight: its residuals.
        floor: (6,) root mean square of the noise; twice the floor is drawn as a band.
        bins: number of parts that the flight is cut into, of which the extremes are drawn.
    """
    figure = make_subplots(rows=len(AXES), cols=1, shared_xaxes=True, vertical_spacing=0.035)
    for k in range(len(AXES)):
        row = k + 1
        subplot = Subplot(figure, row, in_legend=row == 1)
        for name, values, colour in (("before", flight.before, BEFORE), ("after", flight.after, AFTER)):
            subplot.thinned_line(flight.time, values[:, k], bins, name=name, colour=colour)
        # After the lines: plotly leaves shapes out of a subplot that is still empty.
        band = 2.0 * float(floor[k])
        figure.add_hrect(
            -band, band, fillcolor=translucent(MEASURED, 0.18), line_width=0, layer="below", row=row, col=1
        )
    label_axes_over_time(figure, AXES)
    return styled(figure, height=90 + 130 * len(AXES), hovermode="x unified")


def _label(variable: str) -> str:
    words, of = WORDS[variable]
    return f"{words} [{of}]"
