# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Self-contained HTML pages from the templates beside this file: no network, no other file.

A figure is either fixed, or drawn for the flight that a menu selects: the page then holds one for each
flight, which is read when it is first chosen.
"""

from __future__ import annotations

import base64
import json
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from quadpi_core.findings import DataQuality
from quadpi_core.flight_files import FlightLeftOut, named_files
from quadpi_core.frames import Array
from quadpi_core.paths import whole_output
from quadpi_core.report import ASSETS
from quadpi_core.report.table import css_colour
from quadpi_core.version import __version__

# A colour is the name of one in `assets/look.css`, which is another on paper, on a dark screen and in print,
# or #rrggbb. A value that is NaN is not drawn.

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


# Values that the time histories of a page hold together: 1.9 MB at 2.7 bytes each, for a page of 3 MB at most
# with its text.
PAGE_VALUES = 700_000
# Fewer parts hide the peaks of a flight from each other; more than 4000 nobody zooms into.
_FEWEST_BINS, _MOST_BINS = 150, 4000
# Values up to which an array is written as text, which a reader of the page understands.
_AS_TEXT = 8
_LEVELS = 65534
_MISSING = 65535
# Steps of a uniform array differ by less than this share of it.
_UNIFORM = 1e-6


def bins_of(figures: Iterable[Figure | Space]) -> int:
    """Number of parts to cut flights into, of which each line draws two values, for the size of a page."""
    lines = sum(
        isinstance(layer, (Line, Band))
        for figure in figures
        if isinstance(figure, Figure) and figure.over_time
        for panel in figure.panels
        for layer in panel.layers
    )
    return max(_FEWEST_BINS, min(_MOST_BINS, PAGE_VALUES // (2 * max(1, lines))))


def thinned(figure: Figure, bins: int) -> Figure:
    """A figure over time with the extremes of at most `bins` equal parts of each line and band.

    All samples stay where they are few, and in lines with gaps or whose values hold until the next one.
    """
    panels = [
        replace(panel, layers=[_thinned(layer, bins) for layer in panel.layers]) for panel in figure.panels
    ]
    return replace(figure, panels=panels)


def _thinned(layer: Layer, bins: int) -> Layer:
    if not isinstance(layer, (Line, Band)) or layer.stepped:
        return layer
    low, high = (layer.y, layer.y) if isinstance(layer, Line) else (layer.low, layer.high)
    size = -(-len(layer.x) // bins)
    if size <= 2 or np.isnan(low).any():
        return layer
    starts = np.arange(0, len(layer.x), size)
    middle = layer.x[starts] + 0.5 * (layer.x[size - 1] - layer.x[0])
    low, high = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
    if isinstance(layer, Line):
        return replace(layer, x=middle, y=low, high=high)
    return replace(layer, x=middle, low=low, high=high)


class _Arrays:
    """Arrays of a page, each stored once."""

    def __init__(self) -> None:
        self.stored: list[object] = []
        self._places: dict[bytes, int] = {}

    def place(self, values: Array) -> dict[str, int]:
        key = np.ascontiguousarray(values, dtype=np.float64).tobytes()
        if key not in self._places:
            self._places[key] = len(self.stored)
            self.stored.append(_packed(np.frombuffer(key)))
        return {"array": self._places[key]}


def figures_as_json(figures: Mapping[str, Figure | Space], bins: int) -> str:
    """JSON of figures by name and of their arrays, which cannot end a script element that holds it.

    Args:
        figures: by name.
        bins: see :func:`thinned`.
    """
    arrays = _Arrays()
    drawn = {
        name: _plain(
            thinned(figure, bins) if isinstance(figure, Figure) and figure.over_time else figure, arrays
        )
        for name, figure in figures.items()
    }
    text = json.dumps({"figures": drawn, "arrays": arrays.stored}, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def _plain(value: object, arrays: _Arrays) -> object:
    """Records as dictionaries without what is unset, arrays by their places."""
    if isinstance(value, np.ndarray):
        return arrays.place(value) if value.ndim == 1 else [arrays.place(column) for column in value.T]
    if isinstance(value, (Figure, Space, SpaceLine, Panel, Scale, Layer)):
        record = {field.name: _plain(getattr(value, field.name), arrays) for field in fields(value)}
        named = {"kind": value.kind} if isinstance(value, Layer) else {}
        return named | {name: part for name, part in record.items() if not _is_unset(part)}
    if isinstance(value, (np.floating, np.integer)):
        return value.item()
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(part, arrays) for part in value]
    return value


def _packed(values: Array) -> object:
    """An array (N,) as its ends if it is uniform, as numbers if it is short, else in sixteen bits a value."""
    if len(values) <= _AS_TEXT:
        return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values]
    known = np.isfinite(values)
    if not known.any():
        return [None] * len(values)
    low, high = float(values[known].min()), float(values[known].max())
    if known.all():
        straight = np.linspace(values[0], values[-1], len(values))
        if np.abs(values - straight).max() <= _UNIFORM * max(high - low, 1e-300):
            return {"from": float(values[0]), "to": float(values[-1]), "count": len(values)}
    step = (high - low) / _LEVELS or 1.0
    codes = np.full(len(values), _MISSING, dtype="<u2")
    codes[known] = np.rint((values[known] - low) / step)
    return {"low": low, "step": step, "data": base64.b64encode(codes.tobytes()).decode()}


def _is_unset(part: object) -> bool:
    return part is None or part is False or part in ("", [])


_STYLES = ("uPlot.css", "look.css", "report.css")
# Each after those that it imports from.
_SCRIPTS = ("uPlot.js", "drawing.js", "figures.js", "space.js", "report.js")


@dataclass(frozen=True)
class FlightFiles:
    """Where the flights and models of a page are, for the commands that it gives.

    Attributes:
        bags: by the name of the flight.
        models: folders.
        vehicle: name or path of the vehicle file, where the models' own is not meant.
    """

    bags: Mapping[str, Path] = field(default_factory=dict)
    models: Sequence[Path] = ()
    vehicle: str | None = None

    @classmethod
    def from_paths(
        cls, flights: Sequence[Path], models: Sequence[Path] = (), vehicle: str | None = None
    ) -> FlightFiles:
        """The files of flights, by the names that results give them."""
        return cls({file.name: file.path for file in named_files(flights)}, models, vehicle)

    def commands(self) -> dict[str, str]:
        """The command that shows each flight live, to which `--at` is added; quoted for a shell."""
        judged = [word for folder in self.models for word in ("--model", str(folder))]
        if self.vehicle is not None:
            judged += ["--vehicle", self.vehicle]
        return {name: shlex.join(["quadpi", "view", str(bag), *judged]) for name, bag in self.bags.items()}


@dataclass(frozen=True)
class Page:
    """What all pages have in common; a template adds the sections.

    Attributes:
        title: of the window.
        about: the question that the page answers.
        verdict: the answer in one sentence, as its heading.
        facts: such as vehicle and number of flights, by name.
        definitions: meaning of each term.
        figures: by name.
        flight_figures: those that follow the menu, by flight, then by kind.
        files: of the flights; empty where there are none to look at.
        remarks: on the data, above all sections: subject, such as a flight, and sentence.
    """

    title: str
    about: str
    verdict: str
    facts: Mapping[str, str]
    definitions: Mapping[str, str]
    figures: Mapping[str, Figure | Space]
    flight_figures: Mapping[str, Mapping[str, Figure | Space]] = field(default_factory=dict)
    files: FlightFiles = FlightFiles()
    remarks: Sequence[tuple[str, str]] = ()

    def write(self, path: Path, template: str, **content: Any) -> None:
        """Write the page; it appears whole or not at all.

        Args:
            path: of the HTML file.
            template: name of the file in `templates` that draws the sections.
            **content: of the sections, by the names in the template; all text is escaped.

        Raises:
            OutputError: if `path` cannot be written.
        """
        of_flights = [figure for own in self.flight_figures.values() for figure in own.values()]
        bins = bins_of([*self.figures.values(), *of_flights])
        environment = Environment(
            loader=PackageLoader("quadpi_core.report"),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        environment.filters["css_colour"] = css_colour
        page = environment.get_template(template).render(
            title=self.title,
            about=self.about,
            verdict=self.verdict,
            facts=self.facts,
            definitions=self.definitions,
            remarks=self.remarks,
            bins=bins,
            figures=figures_as_json(self.figures, bins),
            flight_figures={name: figures_as_json(own, bins) for name, own in self.flight_figures.items()},
            commands=_for_script(self.files.commands()),
            style="\n".join(_asset(name) for name in _STYLES),
            script=_one_module(_SCRIPTS),
            version=__version__,
            **content,
        )
        with whole_output(path) as temporary:
            temporary.write_text(page, encoding="utf-8")


def flight_remarks(
    quality: Mapping[str, DataQuality], left_out: Sequence[FlightLeftOut] = (), in_sample: Iterable[str] = ()
) -> list[tuple[str, str]]:
    """What the head of a page says of the data, each with the flight that it is about.

    Args:
        quality: remarks on the data of each flight.
        left_out: flights that were given and cannot be used.
        in_sample: flights that the model was identified on, where nothing else of the page says it.
    """
    return [
        *((flight.flight, f"left out: {flight.reason}") for flight in left_out),
        *((name, "the model was identified on this flight: in sample") for name in in_sample),
        *((name, sentence) for name, own in quality.items() for sentence in own.sentences()),
    ]


def _asset(name: str) -> str:
    return (ASSETS / name).read_text(encoding="utf-8")


def _one_module(names: Sequence[str]) -> str:
    """The text of several modules as one, which needs no imports: a page from a file cannot load any."""
    lines = (line for name in names for line in _asset(name).splitlines())
    return "\n".join(line.removeprefix("export ") for line in lines if not line.startswith("import "))


def _for_script(content: object) -> str:
    """JSON that cannot end the script element that holds it."""
    return json.dumps(content).replace("<", "\\u003c")
