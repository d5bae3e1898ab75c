# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Figures as records: panels of lines, bands, points and boxes, which `assets/figures.js` draws by uPlot.

A colour is the name of one in `assets/look.css`, which is another on paper, on a dark screen and in print, or
#rrggbb. A value that is NaN is not drawn.
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
    """One axis of a panel."""

    title: str = ""  # quantity and unit
    low: float | None = None  # limits; None for what the panel shows
    high: float | None = None
    logarithmic: bool = False  # decades have equal lengths
    ticks: Sequence[tuple[float, str]] | None = None  # values and labels; None for round values


@dataclass(frozen=True)
class Layer:
    """What all layers have."""

    kind: ClassVar[str]
    name: str  # in the legend, where layers of one name share an entry; empty for none
    colour: str  # see the module


@dataclass(frozen=True)
class Line(Layer):
    """A line through points (N,), which ends at NaN."""

    kind: ClassVar[str] = "line"
    x: Array  # (N,) ascending
    y: Array  # (N,), or the lowest value of each block of samples
    high: Array | None = None  # (N,) highest value of each block; None where `y` is every sample
    width: float = 1.5  # pixels
    dash: str = ""  # one of `DASHES`
    stepped: bool = False  # a value holds until the next one


@dataclass(frozen=True)
class Band(Layer):
    """The area between two lines (N,)."""

    kind: ClassVar[str] = "band"
    x: Array  # (N,) ascending
    low: Array  # (N,)
    high: Array  # (N,)
    opacity: float = 0.25  # of the fill
    pattern: int = 0  # 0 for an even fill, 1 to 3 for hatches, which differ without colours too
    stepped: bool = False  # a value holds until the next one


@dataclass(frozen=True)
class Points(Layer):
    """Marks with error bars."""

    kind: ClassVar[str] = "points"
    x: Array  # (N,)
    y: Array  # (N,)
    error: Array | None = None  # (N, 2) ends of the bars; None for none
    vertical: bool = True  # the bars are
    texts: Sequence[str] = ()  # shown at each mark that is pointed at
    symbol: int = 0  # 0 circle, 1 square, 2 diamond, 3 triangle; 4 a dash
    hollow: bool = False  # marks are outlines
    joined: bool = False  # a line joins the marks
    dash: str = ""  # one of `DASHES`, of that line


@dataclass(frozen=True)
class Boxes(Layer):
    """Rectangles (N,); a side that is NaN is that of the panel."""

    kind: ClassVar[str] = "boxes"
    left: Array
    right: Array
    bottom: Array
    top: Array
    opacity: float = 1.0  # of the fill
    outlined: bool = False  # left and right are dotted lines


@dataclass(frozen=True)
class Cells(Layer):
    """Values in cells, red above zero and blue below, with their sign."""

    kind: ClassVar[str] = "cells"
    x: Array  # (X + 1,) edges
    y: Array  # (Y + 1,) edges
    values: Array  # (Y · X,) row by row; NaN for none
    largest: float  # magnitude that has the full colour


@dataclass(frozen=True)
class Limit(Layer):
    """A straight line across the panel."""

    kind: ClassVar[str] = "limit"
    at: float
    vertical: bool = False  # `at` is on the horizontal axis
    dash: str = "dashed"  # one of `DASHES`
    label: str = ""  # at its end


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    layers: Sequence[Layer]  # from the lowest to the highest; none for a place that stays empty
    x: Scale
    y: Scale
    height: float  # in pixels, without titles
    title: str = ""  # above
    notes: Sequence[str] = ()  # at the upper right


@dataclass(frozen=True)
class Figure:
    """Panels in rows."""

    label: str  # what it shows, for those who do not see it
    panels: Sequence[Panel]  # row by row
    columns: int = 1  # panels of a row
    over_time: bool = False  # the horizontal axes are the time of one flight, and are zoomed together
    shared: bool = False  # the panels of a row share their vertical axis
    flight: str = ""  # that is drawn, of a figure that does not follow the menu; empty for none
    begins_s: float = 0.0  # time of the figure at which that of the flight is zero


@dataclass(frozen=True)
class SpaceLine:
    """A line in space; name, colour, width and dash as those of a `Line`."""

    name: str
    colour: str
    points: Array  # (N, 3) m, east, north and up; gaps are NaN
    width: float = 2.0
    dash: str = ""
    values: Array | None = None  # (N,) that colour and widen it; None for one colour
    times: Array | None = None  # (N,) s, shown with the values where the line is pointed at


@dataclass(frozen=True)
class Space:
    """Lines in space, to be turned; all three axes have one scale."""

    label: str  # see `Figure`
    lines: Sequence[SpaceLine]  # from the lowest to the highest
    low: Array  # corners (3,) of the space shown
    high: Array
    of_values: str  # what colours and widens a line
