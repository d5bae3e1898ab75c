# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Figures as records: panels of lines, bands, points and boxes, which `assets/layers.js` draws as SVG.

A colour is the name of one in `assets/look.css`, which is another on paper, on a dark screen and in print, or
#rrggbb. An array that two layers share is stored once in the page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from quadpi_core.frames import Array

# They distinguish bands and points in a print without colours.
DASHES = ("", "dashed", "dotted", "dashdot")


@dataclass(frozen=True)
class Scale:
    """One axis of a panel.

    Attributes:
        title: quantity and unit.
        low, high: limits; None for what the panel shows.
        logarithmic: whether decades have equal lengths.
        ticks: values and their labels; None for round values.
    """

    title: str = ""
    low: float | None = None
    high: float | None = None
    logarithmic: bool = False
    ticks: Sequence[tuple[float, str]] | None = None


@dataclass(frozen=True)
class Layer:
    """What all layers have.

    Attributes:
        name: in the legend, where layers of one name share an entry; empty for none.
        colour: see the module.
    """

    kind: ClassVar[str]
    name: str
    colour: str


@dataclass(frozen=True)
class Line(Layer):
    """A line through points (N,), which ends at NaN.

    Attributes:
        x: (N,) ascending.
        y: (N,), or the lowest value of each block of samples.
        high: (N,) highest value of each block; None where `y` is every sample.
        width: pixels.
        dash: one of `DASHES`.
        stepped: whether a value holds until the next one.
    """

    kind: ClassVar[str] = "line"
    x: Array
    y: Array
    high: Array | None = None
    width: float = 1.5
    dash: str = ""
    stepped: bool = False


@dataclass(frozen=True)
class Band(Layer):
    """The area between two lines (N,).

    Attributes:
        x, low, high: (N,).
        opacity: of the fill.
        pattern: 0 for an even fill, 1 to 3 for hatches, which differ without colours too.
        stepped: whether a value holds until the next one.
    """

    kind: ClassVar[str] = "band"
    x: Array
    low: Array
    high: Array
    opacity: float = 0.25
    pattern: int = 0
    stepped: bool = False


@dataclass(frozen=True)
class Points(Layer):
    """Marks with error bars.

    Attributes:
        x, y: (N,).
        error: (N, 2) ends of the bars; None for none.
        vertical: whether the bars are.
        texts: shown at each mark that is pointed at.
        symbol: 0 circle, 1 square, 2 diamond, 3 triangle; 4 a dash.
        hollow: whether marks are outlines.
        joined: whether a line joins the marks.
        dash: one of `DASHES`, of that line.
    """

    kind: ClassVar[str] = "points"
    x: Array
    y: Array
    error: Array | None = None
    vertical: bool = True
    texts: Sequence[str] = ()
    symbol: int = 0
    hollow: bool = False
    joined: bool = False
    dash: str = ""


@dataclass(frozen=True)
class Boxes(Layer):
    """Rectangles; a side that is NaN is that of the panel.

    Attributes:
        left, right, bottom, top: (N,).
        opacity: of the fill.
        outlined: whether left and right are dotted lines.
    """

    kind: ClassVar[str] = "boxes"
    left: Array
    right: Array
    bottom: Array
    top: Array
    opacity: float = 1.0
    outlined: bool = False


@dataclass(frozen=True)
class Shapes(Layer):
    """Outlines (N,) separated by NaN, whose points need no order.

    Attributes:
        x, y: (N,).
        closed: whether they are filled, else lines.
        opacity: of the fill.
    """

    kind: ClassVar[str] = "shapes"
    x: Array
    y: Array
    closed: bool = True
    opacity: float = 0.25


@dataclass(frozen=True)
class Cells(Layer):
    """Values in cells, red above zero and blue below, with their sign.

    Attributes:
        x: (X + 1,) edges.
        y: (Y + 1,) edges.
        values: (Y · X,) row by row; NaN for none.
        largest: magnitude that has the full colour.
    """

    kind: ClassVar[str] = "cells"
    x: Array
    y: Array
    values: Array
    largest: float


@dataclass(frozen=True)
class Limit(Layer):
    """A straight line across the panel.

    Attributes:
        at: its value.
        vertical: whether it stands on the horizontal axis.
        dash: one of `DASHES`.
        label: at its end.
    """

    kind: ClassVar[str] = "limit"
    at: float
    vertical: bool = False
    dash: str = "dashed"
    label: str = ""


@dataclass(frozen=True)
class Panel:
    """One pair of axes.

    Attributes:
        layers: from the lowest to the highest.
        x, y: axes.
        title: above.
        notes: at the upper right.
        row, column: in the figure, from 0.
    """

    layers: Sequence[Layer]
    x: Scale
    y: Scale
    title: str = ""
    notes: Sequence[str] = ()
    row: int = 0
    column: int = 0


@dataclass(frozen=True)
class Figure:
    """Panels in rows and columns.

    Attributes:
        label: what it shows, for those who do not see it.
        panels: in any order.
        heights: of the rows, in pixels, without titles.
        over_time: whether the horizontal axes are the time of one flight, and are zoomed together.
        shared: whether the panels of a row share their vertical axis.
        flight: that is drawn, of a figure that does not follow the menu; empty for none.
        begins_s: time of the figure at which that of the flight is zero.
    """

    label: str
    panels: Sequence[Panel]
    heights: Sequence[float]
    over_time: bool = False
    shared: bool = False
    flight: str = ""
    begins_s: float = 0.0


@dataclass(frozen=True)
class SpaceLine:
    """A line in space.

    Attributes:
        name, colour, width, dash: see `Line`.
        points: (N, 3) m, east, north and up; gaps are NaN.
        values: (N,) that colour and widen it; None for one colour.
        times: (N,) s, shown with the values where the line is pointed at.
    """

    name: str
    colour: str
    points: Array
    width: float = 2.0
    dash: str = ""
    values: Array | None = None
    times: Array | None = None


@dataclass(frozen=True)
class Space:
    """Lines in space, to be turned; all three axes have one scale.

    Attributes:
        label: see `Figure`.
        lines: from the lowest to the highest.
        low, high: corners (3,) of the space shown.
        of_values: what colours and widens a line.
    """

    label: str
    lines: Sequence[SpaceLine]
    low: Array
    high: Array
    of_values: str


def over_grid(panels: Sequence[Panel], columns: int) -> list[Panel]:
    """The panels in rows of some columns."""
    return [
        Panel(panel.layers, panel.x, panel.y, panel.title, panel.notes, place // columns, place % columns)
        for place, panel in enumerate(panels)
    ]
