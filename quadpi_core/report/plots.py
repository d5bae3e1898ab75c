# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What all plotly figures share: their look, single precision, and no more samples than can be seen."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import plotly.graph_objects as go

from quadpi_core.frames import Array
from quadpi_core.report.style import GROUPS, INK, MEASURED, RULE

# Fewer parts of a flight cannot be read, more cannot be seen.
_FEWEST_BINS, _MOST_BINS = 150, 1000


def bins_within(samples: int, lines: int) -> int:
    """Parts to cut each flight into, so that `lines` lines together draw about `samples` samples."""
    return max(_FEWEST_BINS, min(_MOST_BINS, samples // (2 * max(1, lines))))


def extreme_samples(low: Array, high: Array, bins: int) -> npt.NDArray[np.intp]:
    """Indices to draw of a band (N,): in each of `bins` equal parts where it is lowest and highest.

    A line is a band with `low` equal to `high`. Ends are kept, so at most 2 · bins + 2 indices, sorted.
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
