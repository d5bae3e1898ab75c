# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of an evaluation: coverage, time histories, the training envelope, residuals against airspeed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from quadpi_core.evaluation.evaluation_result import AxisMetrics, Evaluation
from quadpi_core.evaluation.flight_results import FlightResult
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX
from quadpi_core.models.envelope import Envelope
from quadpi_core.report.plots import Subplot, extreme_samples, grid, label_axes_over_time, series, styled
from quadpi_core.report.style import (
    INK,
    INPUT_LABELS,
    MEASURED,
    TRAINING,
    error_bar,
    group_colours,
    percent,
    percent_range,
    translucent,
    unit,
)

ENVELOPE_INPUTS = ("speed", "omega_avg", "mu_x", "mu_y", "mu_z", "p", "q", "r")
_HISTOGRAM_BINS = 60
# Share of the samples on either side that lies beyond the bins of a histogram.
_TAIL = 0.001
# Lowest share on the logarithmic axis [%].
_SHARE_FLOOR = 0.03
# Share of the samples outside the training range from which on it is written in the figure.
_WORTH_NOTING = 0.01
_LIMIT_LINE = {"color": MEASURED, "width": 1, "dash": "dot"}
# Bins of airspeed, and samples that one needs for its quantiles to be drawn.
_SPEED_BINS, _FEWEST_SAMPLES = 14, 50

Groups = Mapping[str, Sequence[FlightResult]]


def time_history_figure(
    result: FlightResult, metrics: Mapping[str, AxisMetrics], colour: str, bins: int
) -> go.Figure:
    """Measured and predicted wrench of one flight with the prediction interval as a band, axis by axis.

    Args:
        result: the flight.
        metrics: its metrics per axis, as in the evaluation.
        colour: of prediction and band.
        bins: number of parts that the flight is cut into, of which the extremes are drawn.
    """
    axes = list(metrics)
    figure = make_subplots(rows=len(axes), cols=1, shared_xaxes=True, vertical_spacing=0.035)
    for row, axis in enumerate(axes, start=1):
        measured, predicted, lower, upper = (
            result.column(quantity, axis) for quantity in ("measured", "predicted", "lower", "upper")
        )
        drawn = extreme_samples(lower, upper, bins)
        time = result.time[drawn]
        subplot = Subplot(figure, row, in_legend=row == 1)
        subplot.band(time, lower[drawn], upper[drawn], name="prediction interval", colour=colour)
        subplot.thinned_line(result.time, measured, bins, name="measured", colour=MEASURED, width=1)
        subplot.line(time, predicted[drawn], name="predicted", colour=colour, width=1.5)
        subplot.note(f"PICP {percent(metrics[axis].picp)}")
    label_axes_over_time(figure, axes)
    return styled(figure, height=90 + 150 * len(axes), hovermode="x unified")


def coverage_figure(evaluation: Evaluation) -> go.Figure:
    """Coverage of each axis and group with its confidence interval, beside the nominal coverage.

    The table beside the figure has the same colours, in place of a legend.
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


def envelope_figure(groups: Groups, envelope: Envelope, training_flights: Sequence[str]) -> go.Figure:
    """Distributions of the main inputs by group over the range of the training flights.

    Shares have a logarithmic scale, as only the tails of a distribution leave the envelope. The range of the
    airspeed, which is not an input, is drawn if training flights are among those of the groups.
    """
    columns = 4
    figure = make_subplots(
        rows=len(ENVELOPE_INPUTS) // columns,
        cols=columns,
        vertical_spacing=0.2,
        horizontal_spacing=0.03,
        shared_yaxes="all",
        subplot_titles=[INPUT_LABELS[name] for name in ENVELOPE_INPUTS],
    )
    training = [f for flights in groups.values() for f in flights if f.name in training_flights]
    subplots = grid(figure, len(ENVELOPE_INPUTS), columns)
    for name, subplot in zip(ENVELOPE_INPUTS, subplots, strict=True):
        values = {
            group: np.concatenate([_input(f, name) for f in flights]) for group, flights in groups.items()
        }
        _add_histograms(subplot, values)
        limits = _training_limits(name, envelope, training)
        if limits is not None:
            # After the histograms: plotly leaves shapes out of a subplot that is still empty.
            figure.add_vrect(*limits, fillcolor=TRAINING, line=_LIMIT_LINE, layer="below", **subplot.cell)
            _note_outside(subplot, values, limits)
    shares = {"tickvals": [0.1, 1, 10, 100], "ticktext": ["0.1 %", "1 %", "10 %", "100 %"]}
    figure.update_yaxes(type="log", range=[np.log10(_SHARE_FLOOR), 2], **shares)
    return styled(figure, height=540)


def _add_histograms(subplot: Subplot, values: Mapping[str, Array]) -> None:
    edges = _edges(list(values.values()))
    for group, colour in group_colours(values).items():
        counts, _ = np.histogram(values[group], edges)
        share = 100.0 * np.append(counts, counts[-1]) / len(values[group])
        subplot.figure.add_scatter(
            **series(edges, np.maximum(share, _SHARE_FLOOR)),
            line={"color": colour, "width": 1.5, "shape": "hv"},
            fill="tozeroy",
            fillcolor=translucent(colour, 0.2),
            name=group,
            legendgroup=group,
            showlegend=subplot.in_legend,
            hovertemplate="%{y:.2f} %",
            **subplot.cell,
        )


def _note_outside(subplot: Subplot, values: Mapping[str, Array], limits: tuple[float, float]) -> None:
    notes = []
    for group, colour in group_colours(values).items():
        outside = float(np.mean((values[group] < limits[0]) | (values[group] > limits[1])))
        if outside >= _WORTH_NOTING:
            notes.append(f"<span style='color:{colour}'>{100 * outside:.0f} % outside</span>")
    if notes:
        subplot.note("<br>".join(notes), inside=True)


def residual_figure(groups: Groups, axes: Sequence[str], confidence: float) -> go.Figure:
    """Residuals over airspeed: band of the central share `confidence`, and the mean interval, dashed."""
    columns = min(3, len(axes))
    rows = -(-len(axes) // columns)
    figure = make_subplots(
        rows=rows,
        cols=columns,
        vertical_spacing=0.18 / rows,
        horizontal_spacing=0.07,
        shared_xaxes=True,
        subplot_titles=[f"{axis} [{unit(axis)}]" for axis in axes],
    )
    fastest = max(float(f.speed.max()) for flights in groups.values() for f in flights)
    edges = np.linspace(0.0, fastest, _SPEED_BINS + 1)
    tail = 0.5 - 0.5 * confidence
    for i, (axis, subplot) in enumerate(zip(axes, grid(figure, len(axes), columns), strict=True)):
        for (group, colour), flights in zip(group_colours(groups).items(), groups.values(), strict=True):
            speed, low, high, below, above = _residual_bands(flights, axis, edges, tail)
            subplot.band(speed, low, high, name=group, colour=colour)
            for bound in (below, above):
                figure.add_scatter(
                    **series(speed, bound),
                    line={"color": colour, "width": 1.5, "dash": "dash"},
                    showlegend=False,
                    legendgroup=group,
                    hoverinfo="skip",
                    **subplot.cell,
                )
        figure.update_yaxes(zeroline=True, zerolinecolor=MEASURED, zerolinewidth=1, **subplot.cell)
        if i + columns >= len(axes):
            figure.update_xaxes(title_text=INPUT_LABELS["speed"], showticklabels=True, **subplot.cell)
    return styled(figure, height=90 + 230 * rows)


def _residual_bands(flights: Sequence[FlightResult], axis: str, edges: Array, tail: float) -> Array:
    """By bin of airspeed (5, K): mean speed, two quantiles of the residual, mean bounds − prediction."""
    measured, predicted, lower, upper = (
        np.concatenate([f.column(quantity, axis) for f in flights])
        for quantity in ("measured", "predicted", "lower", "upper")
    )
    speed = np.concatenate([f.speed for f in flights])
    bins = np.clip(np.searchsorted(edges, speed, side="right") - 1, 0, len(edges) - 2)
    columns = []
    for k in np.flatnonzero(np.bincount(bins, minlength=len(edges) - 1) >= _FEWEST_SAMPLES):
        chosen = bins == k
        residual = np.quantile(measured[chosen] - predicted[chosen], [tail, 1.0 - tail])
        below = np.mean(lower[chosen] - predicted[chosen])
        above = np.mean(upper[chosen] - predicted[chosen])
        columns.append((np.mean(speed[chosen]), *residual, below, above))
    return np.array(columns).reshape(-1, 5).T


def _input(result: FlightResult, name: str) -> Array:
    return result.speed if name == "speed" else result.inputs[:, INPUT_INDEX[name]]


def _training_limits(
    name: str, envelope: Envelope, training: Sequence[FlightResult]
) -> tuple[float, float] | None:
    if name != "speed":
        index = INPUT_INDEX[name]
        return float(envelope.lower[index]), float(envelope.upper[index])
    if not training:
        return None
    return min(float(f.speed.min()) for f in training), max(float(f.speed.max()) for f in training)


def _edges(values: Sequence[Array]) -> Array:
    """Bin edges between extreme quantiles of all groups, so that a single spike does not set the scale."""
    low = min(float(np.quantile(v, _TAIL)) for v in values)
    high = max(float(np.quantile(v, 1.0 - _TAIL)) for v in values)
    return np.linspace(low, high if high > low else low + 1.0, _HISTOGRAM_BINS + 1)
