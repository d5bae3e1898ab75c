# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Figures as JSON of a page: blocks of samples with their extremes, sixteen bits a value, each array once."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import NamedTuple

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.report.figure import Band, Figure, Layer, Line, Panel, Scale, Space, SpaceLine

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


def bins_within(lines: int) -> int:
    """Number of parts to cut a flight into, of which each line draws two values, for the size of the page.

    Args:
        lines: in all time histories of the page together; a band is one.
    """
    return max(_FEWEST_BINS, min(_MOST_BINS, PAGE_VALUES // (2 * max(1, lines))))


class Blocks(NamedTuple):
    """A signal in equal blocks of samples.

    Attributes:
        x: (B,) the middle of each block, or the samples (N,) themselves.
        low, high: (B,) extremes of each block; the same array where they are the samples.
    """

    x: Array
    low: Array
    high: Array


def blocks(x: Array, low: Array, high: Array, bins: int) -> Blocks:
    """The lowest and the highest values in at most `bins` equal parts of a band (N,).

    For a line, `low` and `high` are the same. All samples are kept where they are few.
    """
    size = -(-len(x) // bins)
    if size <= 2:
        return Blocks(x, low, high)
    starts = np.arange(0, len(x), size)
    middle = x[starts] + 0.5 * (x[size - 1] - x[0])
    return Blocks(middle, np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts))


def thinned_line(
    x: Array, y: Array, bins: int, *, name: str, colour: str, width: float = 1.5, dash: str = ""
) -> Line:
    """A line (N,) as the extremes of its blocks."""
    found = blocks(x, y, y, bins)
    high = None if found.high is found.low else found.high
    return Line(name, colour, found.x, found.low, high, width, dash)


def thinned_band(
    x: Array, low: Array, high: Array, bins: int, *, name: str, colour: str, opacity: float = 0.25
) -> Band:
    """A band (N,) as the extremes of its blocks."""
    return Band(name, colour, *blocks(x, low, high, bins), opacity=opacity)


class _Arrays:
    """Arrays of a page, each stored once."""

    def __init__(self) -> None:
        self.stored: list[object] = []
        self._places: dict[bytes, int] = {}

    def place(self, values: Array) -> int:
        key = np.ascontiguousarray(values, dtype=np.float64).tobytes()
        if key not in self._places:
            self._places[key] = len(self.stored)
            self.stored.append(_packed(np.frombuffer(key)))
        return self._places[key]


def _packed(values: Array) -> object:
    """An array (N,) as its ends if it is uniform, as numbers if it is short, else in sixteen bits a value."""
    if len(values) <= _AS_TEXT:
        return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values]
    finite = values[np.isfinite(values)]
    if not len(finite):
        return [None] * len(values)
    low, high = float(finite.min()), float(finite.max())
    if len(finite) == len(values):
        straight = np.linspace(values[0], values[-1], len(values))
        if np.abs(values - straight).max() <= _UNIFORM * max(high - low, 1e-300):
            return {"from": float(values[0]), "to": float(values[-1]), "count": len(values)}
    step = (high - low) / _LEVELS or 1.0
    codes = np.full(len(values), _MISSING, dtype="<u2")
    known = np.isfinite(values)
    codes[known] = np.rint((values[known] - low) / step)
    return {"low": low, "step": step, "data": base64.b64encode(codes.tobytes()).decode()}


def figures_as_json(figures: Mapping[str, Figure | Space]) -> str:
    """JSON of figures by name and of their arrays, which cannot end a script element that holds it."""
    arrays = _Arrays()
    drawn = {name: _plain(figure, arrays) for name, figure in figures.items()}
    text = json.dumps({"figures": drawn, "arrays": arrays.stored}, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def _plain(value: object, arrays: _Arrays) -> object:
    """Records as dictionaries without what is unset, arrays by their places."""
    if isinstance(value, np.ndarray):
        return {"array": arrays.place(value)} if value.ndim == 1 else _columns(value, arrays)
    if isinstance(value, (Figure, Space, SpaceLine, Panel, Scale, Layer)):
        record = {field.name: _plain(getattr(value, field.name), arrays) for field in fields(value)}
        named = {"kind": value.kind} if isinstance(value, Layer) else {}
        return named | {name: part for name, part in record.items() if not _is_unset(part)}
    if isinstance(value, (np.floating, np.integer)):
        return value.item()
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(part, arrays) for part in value]
    return value


def _is_unset(part: object) -> bool:
    return part is None or part is False or part in ("", [])


def _columns(values: Array, arrays: _Arrays) -> list[dict[str, int]]:
    """The columns of a table (N, K) by their places."""
    return [{"array": arrays.place(column)} for column in values.T]
