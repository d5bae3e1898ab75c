# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results as Markdown tables, in the form of the paper."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from itertools import zip_longest
from statistics import NormalDist, fmean
from typing import Any

from quadpi_core.evaluation.evaluation_result import AxisMetrics, Comparison
from quadpi_core.flight import AXES
from quadpi_core.paper.validation_result import VARIATIONS, AxisValidation, PublishedAxis, Validation
from quadpi_core.report import comparison_page as compared
from quadpi_core.report.style import hundredths, unit
from quadpi_core.report.terminal_tables import final_terms

_PUBLISHED = "*published*"
_COVERAGE = ("training", *VARIATIONS)
_WIDTH = _COVERAGE[:-1]
_HEADINGS = dict(zip(_COVERAGE, ("train", "model", "meas.", "both"), strict=True))


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], texts: Container[int] = (0,)) -> str:
    """A Markdown table.

    Args:
        headings: of the columns, as Markdown.
        rows: cells, as Markdown.
        texts: places of the columns that hold text; the others are aligned right.
    """
    rule = [":--" if place in texts else "--:" for place in range(len(headings))]
    lines = [headings, rule, *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


def comparison(result: Comparison) -> str:
    """Coverage and width of several models on groups of flights.

    Args:
        result: as :func:`quadpi_core.evaluation.compare.compare` gives it.
    """
    groups, confidence = list(result.groups), result.confidence
    headings = ["axis", "model", *(f"PICP % {group}" for group in groups), *(f"MPIW {g}" for g in groups)]
    rows, axis = [], ""
    for row in compared.rows(result):
        published = row.model is None
        numbers = [row.coverage(group, confidence) for group in groups] + [row.width(g) for g in groups]
        rows.append(
            [
                "" if row.axis == axis else f"{row.axis} [{unit(row.axis)}]",
                row.model or _PUBLISHED,
                *(f"*{text}*" if published else text for text in numbers),
            ]
        )
        axis = row.axis
    return table(headings, rows, texts=range(2))


def validation(results: Sequence[Validation], axes: Sequence[str] = AXES) -> str:
    """Coverage and width under noise, the settings of a method and the paper's numbers below each other.

    Args:
        results: as `validation_result.summarise` gives them, of the same models by name.
        axes: to show.
    """
    headings = ["axis", "method", "settings"]
    headings += [f"PICP % {_HEADINGS[key]}" for key in _COVERAGE]
    headings += [f"NMPIW % {_HEADINGS[key]}" for key in _WIDTH]
    published = results[0].published or {}
    rows = []
    for axis in axes:
        for place, name in enumerate(results[0].models):
            for again, result in enumerate(results):
                model = result.models[name]
                cells = _validation_cells(model.axes[axis], result.confidence)
                first = axis if place == again == 0 else ""
                rows.append([first, "" if again else name, model.settings, *cells])
            if known := published.get(name, {}).get(axis):
                cells = [f"*{cell}*" if cell else "" for cell in _validation_cells(known, None)]
                rows.append(["", "", _PUBLISHED, *cells])
    return table(headings, rows, texts=range(3))


def _validation_cells(found: AxisValidation | PublishedAxis, confidence: float | None) -> list[str]:
    """Percentages of one row; coverage below the confidence of the intervals is marked, if there is one."""
    parts: dict[str, Any] = {key: getattr(found, key, None) for key in _COVERAGE}
    cells = []
    for key, part in parts.items():
        # Training and combined variation are for reference only.
        short = confidence is not None and key in VARIATIONS[:2] and part.picp < confidence
        cells.append("" if part is None else ("▼ " if short else "") + hundredths(part.picp))
    widths = [getattr(parts[key], "nmpiw", None) for key in _WIDTH]
    return cells + ["" if width is None else f"{100.0 * width:.2f}" for width in widths]


def structures(selection: Mapping[str, Sequence[Mapping[str, Any]]], axes: Sequence[str]) -> str:
    """Terms, coefficients and R² of polynomials in the order of selection; fixed terms are in italics.

    Args:
        selection: selection log by axis, as a model holds it.
        axes: to show side by side.
    """
    headings = [text for axis in axes for text in (axis, "coefficient", "R²")]
    rows = []
    for steps in zip_longest(*(final_terms(selection[axis]) for axis in axes)):
        cells: list[str] = []
        for step in steps:
            if step is None:
                cells += ["", "", ""]
                continue
            term, coefficient, r2 = step.cells()
            cells += [f"*`{term}`*" if step.fixed else f"`{term}`", coefficient, r2]
        rows.append(cells)
    return table(headings, rows, texts=range(0, len(headings), 3))


def left_out(results: Mapping[str, Mapping[str, Comparison]]) -> str:
    """Coverage of each flight by models of the others, and width over that of an ideal constant interval.

    Args:
        results: by flight and kind of intervals ("fixed", "adaptive"), models of the other flights on it, as
            :func:`quadpi_core.evaluation.compare.compare` gives them with the one group `all`.
    """
    axes, models, kinds = _left_out_parts(results)
    rows = []
    for flight, of_flight in results.items():
        for model in models:
            for kind in kinds:
                found = _on_all(of_flight[kind], model)
                confidence = of_flight[kind].confidence
                cells = [
                    f"{100.0 * found[axis].picp:.1f} · {_ratio(found[axis], confidence):.2f}"
                    if axis in found
                    else ""
                    for axis in axes
                ]
                starts = (model == models[0] and kind == kinds[0], kind == kinds[0])
                rows.append([flight if starts[0] else "", model if starts[1] else "", kind, *cells])
    return table(["flight", "model", "intervals", *axes], rows, texts=range(3))


def left_out_summary(results: Mapping[str, Mapping[str, Comparison]]) -> str:
    """Least and mean coverage over flights, and the largest width over that of an ideal constant interval.

    Args:
        results: as for :func:`left_out`.
    """
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
                cells.append(f"{min(coverage):.1f} / {fmean(coverage):.1f} · {widest:.2f}" if known else "")
            rows.append([model if kind == kinds[0] else "", kind, *cells])
    return table(["model", "intervals", *axes], rows, texts=range(2))


def _left_out_parts(
    results: Mapping[str, Mapping[str, Comparison]],
) -> tuple[list[str], list[str], list[str]]:
    """Axes, models and kinds of intervals, the same for every flight."""
    of_flight = next(iter(results.values()))
    first = next(iter(of_flight.values()))
    return compared.held_axes(first), list(first.models), list(of_flight)


def _on_all(result: Comparison, model: str) -> Mapping[str, AxisMetrics]:
    return result.models[model].groups["all"].axes


def _ratio(metrics: AxisMetrics, confidence: float) -> float:
    return metrics.mpiw / ideal_width(metrics, confidence)


def ideal_width(metrics: AxisMetrics, confidence: float) -> float:
    """Width that a perfect constant interval would need on normal errors of that RMSE."""
    return 2.0 * NormalDist().inv_cdf(0.5 + 0.5 * confidence) * metrics.rmse
