# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of the paper's page that compare models on flights left out in turn."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import NormalDist, fmean

from quadpi_core.evaluation.evaluation_result import AxisMetrics, Comparison
from quadpi_core.report.comparison_page import modelled_axes
from quadpi_core.report.table import Column, Table

# Comparisons of the models of the other flights, by flight and kind of intervals ("fixed", "adaptive"), each
# with the one group `all`.
LeftOutResults = Mapping[str, Mapping[str, Comparison]]


def left_out_table(results: LeftOutResults) -> Table:
    """Coverage of each flight, and mean width over that of an ideal constant interval."""
    axes, models, kinds = _left_out_parts(results)
    rows = []
    for flight, of_flight in results.items():
        for model in models:
            for kind in kinds:
                found, confidence = _on_all(of_flight[kind], model), of_flight[kind].confidence
                cells = [
                    f"{100.0 * found[axis].picp:.1f} · {_ratio(found[axis], confidence):.2f}"
                    if axis in found
                    else None
                    for axis in axes
                ]
                rows.append([flight, model, kind, *cells])
    columns = [
        Column("flight", is_text=True, once=True),
        Column("model", is_text=True, once=True),
        Column("intervals", is_text=True),
        *map(Column, axes),
    ]
    return Table(columns, rows)


def left_out_summary(results: LeftOutResults) -> Table:
    """Least and mean coverage over flights, and the largest width over that of an ideal constant interval."""
    axes, models, kinds = _left_out_parts(results)
    rows = []
    for model in models:
        for kind in kinds:
            cells = []
            for axis in axes:
                found = [(_on_all(r[kind], model).get(axis), r[kind].confidence) for r in results.values()]
                known = [(metrics, confidence) for metrics, confidence in found if metrics is not None]
                coverage = [100.0 * metrics.picp for metrics, _ in known]
                widest = max((_ratio(*pair) for pair in known), default=0.0)
                cells.append(f"{min(coverage):.1f} / {fmean(coverage):.1f} · {widest:.2f}" if known else None)
            rows.append([model, kind, *cells])
    columns = [
        Column("model", is_text=True, once=True),
        Column("intervals", is_text=True),
        *map(Column, axes),
    ]
    return Table(columns, rows)


def _left_out_parts(results: LeftOutResults) -> tuple[list[str], list[str], list[str]]:
    """Axes, models and kinds of intervals, the same for every flight."""
    of_flight = next(iter(results.values()))
    first = next(iter(of_flight.values()))
    return modelled_axes(first), list(first.models), list(of_flight)


def _on_all(result: Comparison, model: str) -> Mapping[str, AxisMetrics]:
    return result.models[model].groups["all"].axes


def _ratio(metrics: AxisMetrics, confidence: float) -> float:
    return metrics.mpiw / ideal_width(metrics, confidence)


def ideal_width(metrics: AxisMetrics, confidence: float) -> float:
    """Width that a perfect constant interval would need on normal errors of that RMSE."""
    return 2.0 * NormalDist().inv_cdf(0.5 + 0.5 * confidence) * metrics.rmse
