# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the paper's methods reach here, with the paper's numbers below each of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby

from paper.numbers import PublishedAxis, tunnel_numbers, validation_numbers
from paper.published import PublishedValidation
from quadpi_core.evaluation.evaluation_result import Comparison
from quadpi_core.models.model_kind import Settings
from quadpi_core.report import validation_page
from quadpi_core.report.comparison_page import comparison_rows, comparison_table
from quadpi_core.report.evaluation_page import axis_cell
from quadpi_core.report.table import Column, Row, Table, Value, soft

PUBLISHED = "published"


def validation_table(found: Mapping[Settings, PublishedValidation], axes: Sequence[str]) -> Table:
    """Coverage and width under noise of some axes, by method and settings.

    Args:
        found: by settings, of the same methods.
        axes: to show.
    """
    ours = {settings: validation_page.validation_table(own.result, axes) for settings, own in found.items()}
    cells = {
        (axis, method, settings): of for settings, table in ours.items() for axis, method, *of in table.rows
    }
    axis_column, method_column, *others = next(iter(ours.values())).columns
    columns = [
        axis_column,
        replace(method_column, once=True),
        Column("settings", is_text=True),
        *others,
    ]
    rows: list[Row] = []
    for axis in axes:
        for method, known in validation_numbers().items():
            held = [settings for settings in found if (axis, method, settings) in cells]
            for settings in held:
                _, *covered, _, wide, wide_measured = cells[axis, method, settings]
                seen = found[settings].training[method][axis]
                rows.append([axis, method, settings, seen.picp, *covered, seen.nmpiw, wide, wide_measured])
            if held:
                rows.append([axis, method, *soft(PUBLISHED, *_cells(known[axis]))])
    return Table(columns, rows)


def _cells(known: PublishedAxis) -> list[Value]:
    """Coverage and width of a row; the paper has no combined variation."""
    parts = (known.training, known.model_variation, known.measurement_variation)
    return [*(part.picp for part in parts), None, *(part.nmpiw for part in parts)]


def tunnel_table(comparison: Comparison) -> Table:
    """Coverage and width in the wind tunnel, by model and group."""
    ours = comparison_table(comparison)
    known, models = tunnel_numbers(), comparison.models
    rows: list[Row] = []
    for (axis, method), own in groupby(
        zip(comparison_rows(comparison), ours.rows, strict=True),
        key=lambda pair: (pair[0].axis, models[pair[0].model].method),
    ):
        rows += [row for _, row in own]
        cells = known[method][axis].values()
        # Widths have two decimals, as in the paper.
        numbers: list[Value] = [*(cell.picp for cell in cells), *(f"{cell.mpiw:.2f}" for cell in cells)]
        rows.append([axis_cell(axis), *soft(PUBLISHED, *numbers)])
    return Table(ours.columns, rows)
