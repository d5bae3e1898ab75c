# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Models beside each other, as plotly figures: from group to group, and over time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from quadpi_core.evaluation.evaluation_result import Comparison
from quadpi_core.evaluation.flight_results import FlightResult
from quadpi_core.flight import AXES
from quadpi_core.report.decimation import extreme_samples
from quadpi_core.report.figures import series, styled
from quadpi_core.report.style import INK, MEASURED, error_bar, method_colours, percent, percent_range, unit

# Settings of one method share its colour.
_MARKERS = {"default": "circle", "paper": "circle-open"}
_DASHES = {"default": "solid", "paper": "dot"}


def group_figure(comparison: Comparison) -> go.Figure:
    """A column per axis: coverage of each group by each model, and below its width over that on the first.

    Args:
        comparison: as :func:`quadpi_core.evaluation.compare.compare` gives it.
    """
    models, groups = comparison.models, list(comparison.groups)
    axes = _axes(comparison)
    colours = _colours(comparison)
    figure = make_subplots(
        rows=2,
        cols=len(axes),
        shared_xaxes="columns",
        shared_yaxes="rows",
        column_titles=axes,
        horizontal_spacing=0.03,
        vertical_spacing=0.06,
    )
    for column, axis in enumerate(axes, start=1):
        for place, (name, model) in enumerate(models.items()):
            if axis not in model.training_range:
                continue
            found = [model.groups[group].axes[axis] for group in groups]
            coverage = 100.0 * np.array([metrics.picp for metrics in found])
            interval = 100.0 * np.array([metrics.picp_ci for metrics in found])
            width = np.array([metrics.mpiw for metrics in found])
            style = {
                "x": np.arange(len(groups)) + 0.5 * ((place + 0.5) / len(models) - 0.5),
                "mode": "lines+markers",
                "marker": {"color": colours[name], "size": 9, "symbol": _MARKERS[model.settings]},
                "line": {"color": colours[name], "width": 1, "dash": _DASHES[model.settings]},
                "name": name,
                "legendgroup": name,
            }
            figure.add_scatter(
                y=coverage,
                error_y=error_bar(coverage, interval, 1.5),
                text=[f"{name}: {percent(m.picp)} ({percent_range(m.picp_ci)})" for m in found],
                hovertemplate="%{text}<extra></extra>",
                showlegend=column == 1,
                row=1,
                col=column,
                **style,
            )
            figure.add_scatter(
                y=width / width[0],
                text=[f"{name}: {w:.3g} {unit(axis)}" for w in width],
                hovertemplate="%{text}<extra></extra>",
                showlegend=False,
                row=2,
                col=column,
                **style,
            )
    nominal = 100.0 * comparison.confidence
    figure.add_hline(y=nominal, line={"color": INK, "width": 1, "dash": "dash"}, row=1, col="all")
    figure.update_xaxes(tickvals=list(range(len(groups))), ticktext=groups, showgrid=False)
    figure.update_yaxes(title_text="PICP [%]", row=1, col=1)
    figure.update_yaxes(title_text=f"MPIW over {groups[0]}", row=2, col=1, rangemode="tozero")
    return _with_legend_below(figure, height=620)


def interval_figure(comparison: Comparison, results: Mapping[str, FlightResult], bins: int) -> go.Figure:
    """A row per axis and a column per low-pass: bounds of the models around what was measured.

    Args:
        comparison: as :func:`quadpi_core.evaluation.compare.compare` gives it.
        results: what each model says of one flight.
        bins: parts that the flight is cut into; of each the extremes are drawn.
    """
    models, axes, colours = comparison.models, _axes(comparison), _colours(comparison)
    # Models that share a colour share an entry of the legend.
    labels = {
        name: model.method if list(colours.values()).count(colours[name]) > 1 else name
        for name, model in models.items()
    }
    shown: set[str] = set()
    cutoffs = list(dict.fromkeys(model.cutoff_hz for model in models.values()))
    figure = make_subplots(
        rows=len(axes),
        cols=len(cutoffs),
        shared_xaxes="all",
        shared_yaxes="rows",
        column_titles=[_column_title(comparison, cutoff) for cutoff in cutoffs],
        horizontal_spacing=0.03,
        vertical_spacing=0.06 / max(1, len(axes) - 2),
    )
    for column, cutoff in enumerate(cutoffs, start=1):
        names = [name for name, model in models.items() if model.cutoff_hz == cutoff]
        for row, axis in enumerate(axes, start=1):
            cell = {"row": row, "col": column}
            first = results[names[0]]
            measured = first.column("measured", axis)
            drawn = extreme_samples(measured, measured, bins)
            figure.add_scatter(
                **series(first.time[drawn], measured[drawn]),
                line={"color": MEASURED, "width": 1},
                name="measured",
                legendgroup="measured",
                showlegend=row == column == 1,
                **cell,
            )
            for name in names:
                if axis not in results[name].axes:
                    continue
                result = results[name]
                for bound in ("lower", "upper"):
                    values = result.column(bound, axis)
                    drawn = extreme_samples(values, values, bins)
                    figure.add_scatter(
                        **series(result.time[drawn], values[drawn]),
                        line={"color": colours[name], "width": 1.4},
                        name=labels[name],
                        legendgroup=labels[name],
                        showlegend=row == 1 and bound == "lower" and labels[name] not in shown,
                        **cell,
                    )
                shown.add(labels[name])
    for row, axis in enumerate(axes, start=1):
        figure.update_yaxes(title_text=f"{axis} [{unit(axis)}]", row=row, col=1)
    figure.update_xaxes(title_text="time [s]", row=len(axes))
    return _with_legend_below(figure, height=130 + 230 * len(axes))


def _with_legend_below(figure: go.Figure, height: int) -> go.Figure:
    """Many entries above would lie under the buttons."""
    styled(figure, height).update_layout(showlegend=True, margin_b=96)
    return figure.update_layout(legend={"y": 0, "yanchor": "bottom"})


def lines_drawn(comparison: Comparison) -> int:
    """Lines in the figure of one flight."""
    models = comparison.models.values()
    bounds = 2 * sum(len(model.training_range) for model in models)
    return bounds + len(_axes(comparison)) * len({model.cutoff_hz for model in models})


def _axes(comparison: Comparison) -> list[str]:
    held = {axis for model in comparison.models.values() for axis in model.training_range}
    return [axis for axis in AXES if axis in held]


def _colours(comparison: Comparison) -> dict[str, str]:
    """A colour per method where settings tell its models apart, else one per model."""
    methods = {name: model.method for name, model in comparison.models.items()}
    kinds = {(model.method, model.settings) for model in comparison.models.values()}
    if len(kinds) < len(methods):
        return method_colours(methods)
    of_method = method_colours(methods.values())
    return {name: of_method[method] for name, method in methods.items()}


def _column_title(comparison: Comparison, cutoff: float) -> str:
    settings = dict.fromkeys(
        model.settings for model in comparison.models.values() if model.cutoff_hz == cutoff
    )
    return f"{' and '.join(settings)} settings, low-pass {cutoff:g} Hz"
