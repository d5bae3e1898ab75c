# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What results show of themselves in a notebook: a sentence above a table, or a figure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np

from quadpi_core.array_checks import found
from quadpi_core.errors import ArgumentError, require_library

_ROWS_SHOWN = 12


def html_table(sentence: str, headings: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A sentence above a table of HTML, of the first rows only where there are many."""
    more = f"<p>… {len(rows) - _ROWS_SHOWN} more</p>" if len(rows) > _ROWS_SHOWN else ""
    body = "".join(_row("td", row) for row in rows[:_ROWS_SHOWN])
    return f"<p>{escape(sentence)}</p><table>{_row('th', headings)}{body}</table>{more}"


def counted(flights: int) -> str:
    """Their number in words."""
    return "1 flight" if flights == 1 else f"{flights} flights"


def _row(cell: str, values: Iterable[Any]) -> str:
    return f"<tr>{''.join(f'<{cell}>{escape(str(value))}</{cell}>' for value in values)}</tr>"


def new_axes(axes: Any, count: int = 1) -> Any:
    """Axes (count,) of matplotlib to draw on: those given, else of a new figure, one below another.

    Raises:
        ArgumentError: for what are no axes, or another number of them.
        LogError: without matplotlib.
    """
    if axes is not None:
        given = np.ravel(np.array(axes, dtype=object))
        if len(given) != count or not all(hasattr(one, "fill_between") for one in given):
            raise ArgumentError(f"axes: expected {count} of matplotlib, found {found(axes)}")
        return given
    pyplot = require_library("matplotlib.pyplot", "notebook")
    height_in = max(3.0, 1.8 * count)
    figure = {"figsize": (8.0, height_in), "layout": "constrained"}
    return np.ravel(pyplot.subplots(count, 1, sharex=True, **figure)[1])


def pandas() -> Any:
    """The module pandas.

    Raises:
        LogError: without it.
    """
    return require_library("pandas", "notebook")
