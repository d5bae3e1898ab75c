# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What all plotly figures share: their look, single precision, and no more samples than a screen shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import plotly.graph_objects as go

from quadpi_core.frames import Array
from quadpi_core.report.style import GROUPS, INK, MEASURED, RULE, translucent, unit

# Samples that the time histories of a page draw together: 3.3 MB at about 11 bytes each.
_DRAWN_SAMPLES = 300_000
# Fewer parts hide the peaks of a flight from each other; 1000 are as many as a figure has pixels.
_FEWEST_BINS, _MOST_BINS = 150, 1000


def bins_within(lines: int) -> int:
    """Number of parts to cut a flight into, of which each line draws two samples, for the size of the page.

    Args:
        lines: in all time histories of the page together.
    """
    return max(_FEWEST_BINS, min(_MOST_BINS, _DRAWN_SAMPLES // (2 * max(1, lines))))


def extreme_samples(low: Array, high: Array, bins: int) -> npt.NDArray[np.intp]:
    """Indices of the samples of a band (N,) to draw: the lowest and highest in each of `bins` equal parts.

    For a line, `low` and `high` are the same. Both ends are kept: at most 2 · bins + 2 indices, sorted.
    """
    size = len(low)
    if size <= 2 * bins:
        return np.arange(size)
    starts = np.arange(bins + 1) * size // bins
    parts = [slice(start, stop) for start, stop in pairwise(starts)]
    lowest = [part.start + np.argmin(low[part]) for part in parts]
    highest = [part.start + np.argmax(high[part]) for part in parts]
    return np.unique(np.concatenate(([0, size - 1], lowest, highest)))


def series(x: Array, y: Array) -> dict[str, Any]:
    """Arguments of a line in single precision, which is finer than a screen and halves the page."""
    return {"x": x.astype(np.float32), "y": y.astype(np.float32), "mode": "lines"}


@dataclass(frozen=True)
class Subplot:
    """One cell of a figure over time, to draw lines and bands in.

    Attributes:
        figure: to draw in.
        row, column: of the subplot in the figure, from 1.
        in_legend: whether lines and bands appear in the legend, where those of one name share an entry.
    """

    figure: go.Figure
    row: int
    column: int = 1
    in_legend: bool = True

    @property
    def cell(self) -> dict[str, int]:
        """Row and column, as plotly names them."""
        return {"row": self.row, "col": self.column}

    def line(self, x: Array, y: Array, *, name: str, colour: str, width: float = 1.2) -> None:
        """Draw a line (N,)."""
        self.figure.add_scatter(
            **series(x, y),
            line={"color": colour, "width": width},
            name=name,
            legendgroup=name,
            showlegend=self.in_legend,
            **self.cell,
        )

    def thinned_line(
        self, x: Array, y: Array, bins: int, *, name: str, colour: str, width: float = 1.2
    ) -> None:
        """Draw the extremes of a line (N,) in each of `bins` parts."""
        drawn = extreme_samples(y, y, bins)
        self.line(x[drawn], y[drawn], name=name, colour=colour, width=width)

    def band(
        self, x: Array, low: Array, high: Array, *, name: str, colour: str, opacity: float = 0.25
    ) -> None:
        """Fill the area between two lines (N,)."""
        place = {"legendgroup": name, "hoverinfo": "skip", "line_width": 0, **self.cell}
        # Both bounds must be Scatter: with Scattergl, "tonexty" fills to zero.
        self.figure.add_scatter(**series(x, low), name=f"{name}, lower", showlegend=False, **place)
        self.figure.add_scatter(
            **series(x, high),
            fill="tonexty",
            fillcolor=translucent(colour, opacity),
            name=name,
            showlegend=self.in_legend,
            **place,
        )

    def note(self, text: str, *, inside: bool = False) -> None:
        """Write above the upper right corner, or below it inside the subplot."""
        self.figure.add_annotation(
            text=text,
            x=1,
            y=1,
            xref="x domain",
            yref="y domain",
            xanchor="right",
            yanchor="top" if inside else "bottom",
            align="right",
            showarrow=False,
            font={"color": MEASURED},
            **self.cell,
        )


def grid(figure: go.Figure, count: int, columns: int) -> list[Subplot]:
    """Subplots of a figure with some columns, row by row; only the first adds to the legend."""
    return [
        Subplot(figure, place // columns + 1, place % columns + 1, in_legend=place == 0)
        for place in range(count)
    ]


def label_axes_over_time(figure: go.Figure, axes: Sequence[str]) -> None:
    """Name the axes of the wrench at the left of their rows, and the time below the last."""
    for row, axis in enumerate(axes, start=1):
        figure.update_yaxes(title_text=f"{axis} [{unit(axis)}]", row=row, col=1)
    figure.update_xaxes(title_text="time [s]", row=len(axes))


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
    # Without it plotly puts titles upon wide labels.
    figure.update_yaxes(title_standoff=8)
    figure.update_yaxes(selector=lambda axis: axis.zeroline is None, zeroline=False)
    return figure
