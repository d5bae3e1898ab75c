# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Coverage and time histories, as plotly figures that carry no more data than can be seen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from quadpi_core.evaluation.evaluation_result import AxisMetrics, Evaluation
from quadpi_core.evaluation.flight_results import FlightResult
from quadpi_core.frames import Array
from quadpi_core.report.decimation import extreme_samples
from quadpi_core.report.style import (
    GROUPS,
    INK,
    MEASURED,
    RULE,
    error_bar,
    group_colours,
    percent,
    percent_range,
    translucent,
    unit,
)


def time_history_figure(
    result: FlightResult, metrics: Mapping[str, AxisMetrics], colour: str, bins: int
) -> go.Figure:
    """Measured and predicted wrench of one flight with the prediction interval as a band, axis by axis.

    Args:
        result: the flight.
        metrics: its metrics per axis, as in the evaluation.
        colour: of prediction and band.
        bins: parts that the flight is cut into; of each the extremes are drawn.
    """
    axes = list(metrics)
    figure = make_subplots(rows=len(axes), cols=1, shared_xaxes=True, vertical_spacing=0.035)
    for row, axis in enumerate(axes, start=1):
        measured, predicted, lower, upper = (
            result.column(quantity, axis) for quantity in ("measured", "predicted", "lower", "upper")
        )
        band = extreme_samples(lower, upper, bins)
        line = extreme_samples(measured, measured, bins)
        first = row == 1
        # Both bounds must be Scatter: with Scattergl, "tonexty" fills to zero.
        figure.add_scatter(
            **series(result.time[band], lower[band]),
            line_width=0,
            hoverinfo="skip",
            showlegend=False,
            name=f"{axis} lower",
            row=row,
            col=1,
        )
        figure.add_scatter(
            **series(result.time[band], upper[band]),
            line_width=0,
            fill="tonexty",
            hoverinfo="skip",
            fillcolor=translucent(colour, 0.25),
            name="prediction interval",
            legendgroup="band",
            showlegend=first,
            row=row,
            col=1,
        )
        figure.add_scatter(
            **series(result.time[line], measured[line]),
            line={"color": MEASURED, "width": 1},
            name="measured",
            legendgroup="measured",
            showlegend=first,
            row=row,
            col=1,
        )
        figure.add_scatter(
            **series(result.time[band], predicted[band]),
            line={"color": colour, "width": 1.5},
            name="predicted",
            legendgroup="predicted",
            showlegend=first,
            row=row,
            col=1,
        )
        figure.update_yaxes(title_text=f"{axis} [{unit(axis)}]", row=row, col=1)
        figure.add_annotation(
            text=f"PICP {percent(metrics[axis].picp)}",
            x=1,
            y=1,
            xref="x domain",
            yref="y domain",
            xanchor="right",
            yanchor="bottom",
            showarrow=False,
            font={"size": 11, "color": MEASURED},
            row=row,
            col=1,
        )
    figure.update_xaxes(title_text="time [s]", row=len(axes), col=1)
    return styled(figure, height=90 + 150 * len(axes), hovermode="x unified")


def coverage_figure(evaluation: Evaluation) -> go.Figure:
    """Coverage of each axis and group with its confidence interval, against the nominal coverage.

    The colours are those of the table beside it, so there is no legend.
    """
    groups = evaluation.groups
    axes = list(dict.fromkeys(axis for part in groups.values() for axis in part.axes))
    figure = go.Figure()
    for i, (group, colour) in enumerate(group_colours(groups).items()):
        held = groups[group].axes
        coverage = 100.0 * np.array([metrics.picp for metrics in held.values()])
        interval = 100.0 * np.array([metrics.picp_ci for metrics in held.values()]).reshape(-1, 2)
        figure.add_scatter(
            x=coverage,
            y=[axes.index(axis) + 0.5 * (i + 0.5) / len(groups) - 0.25 for axis in held],
            error_x=error_bar(coverage, interval, 2),
            mode="markers",
            marker={"color": colour, "size": 9},
            name=group,
            text=[f"{axis}: {percent(m.picp)} ({percent_range(m.picp_ci)})" for axis, m in held.items()],
            hovertemplate="%{text}",
        )
    nominal = 100.0 * evaluation.confidence
    figure.add_vline(
        x=nominal,
        line={"color": INK, "width": 1, "dash": "dash"},
        annotation={"text": f"nominal {nominal:g} %", "yanchor": "bottom", "y": 1, "xanchor": "right"},
    )
    bounds = [m.picp_ci[0] for part in groups.values() for m in part.axes.values()]
    lowest = min(nominal, 100.0 * min(bounds, default=1.0))
    figure.update_xaxes(title_text="PICP [%]", range=[lowest - 2.0, 101.0])
    figure.update_yaxes(
        tickvals=list(range(len(axes))), ticktext=axes, range=[len(axes) - 0.5, -0.5], showgrid=False
    )
    return styled(figure, height=130 + 44 * len(axes)).update_layout(showlegend=False)


def series(x: Array, y: Array) -> dict[str, Any]:
    """A line in single precision: finer than a screen, half the page."""
    return {"x": x.astype(np.float32), "y": y.astype(np.float32), "mode": "lines"}


def styled(figure: go.Figure, height: int, hovermode: str = "closest") -> go.Figure:
    """The look that all figures share; the width follows the page."""
    figure.update_layout(
        template="none",
        height=height,
        hovermode=hovermode,
        colorway=GROUPS,
        font={
            "family": "system-ui, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif",
            "size": 12.5,
            "color": INK,
        },
        margin={"l": 80, "r": 16, "t": 56, "b": 48},
        legend={"orientation": "h", "x": 0, "y": 1, "yref": "container", "yanchor": "top"},
        modebar={"bgcolor": "rgba(0,0,0,0)", "color": "#b4bcc5", "activecolor": MEASURED},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
    )
    figure.update_annotations(font_size=12)
    figure.update_xaxes(gridcolor=RULE, linecolor=RULE, title_font_size=13, zeroline=False, ticks="outside")
    figure.update_xaxes(tickcolor=RULE)
    figure.update_yaxes(gridcolor=RULE, linecolor=RULE, title_font_size=13, exponentformat="power")
    figure.update_yaxes(selector=lambda axis: axis.zeroline is None, zeroline=False)
    return figure
