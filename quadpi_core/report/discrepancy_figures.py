# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of the residuals of a simulation, before and after effects are added."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from quadpi_core.discrepancy.by_condition import MOST_BINS, VARIABLES, Profile, Residual
from quadpi_core.discrepancy.closure import Gap
from quadpi_core.evaluation.metrics import round_edges
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.report.figure import Boxes, Cells, Figure, Layer, Line, Panel, Points, Scale
from quadpi_core.report.style import GROUPS, INK, MEASURED, unit

BEFORE, AFTER = GROUPS[1], GROUPS[0]
MAPS = (("u", "v"), ("speed", "height"), ("w", "rotor_speed"))
# Samples that a cell of a map needs to be drawn.
_FEWEST_IN_CELL = 20
_COLUMNS = 3


def profile_figure(profiles: Sequence[Profile]) -> Figure:
    """Root mean square of the residual of each axis over the variable that explains most of it."""
    panels = []
    for profile in profiles:
        lines = (
            ("allowed by noise and tolerances", profile.allowed, MEASURED, "dotted"),
            ("with what was found", profile.after, AFTER, "dashed"),
            ("as it is", profile.beyond, BEFORE, ""),
        )
        layers = [
            Line(name, colour, profile.edges, np.append(values, values[-1]), None, 2.0, dash, True)
            for name, values, colour, dash in lines
        ]
        y = Scale(f"{profile.axis} [{unit(profile.axis)}]", low=0.0)
        panels.append(Panel(layers, Scale(_label(profile.variable)), y, 190.0))
    return Figure("Residual by condition", panels, _COLUMNS)


def map_figure(flights: Sequence[Residual], axes: Sequence[str]) -> Figure:
    """Mean residual over pairs of variables (rows) for each axis (columns)."""
    tables = {axis: [mean_map(flights, AXES.index(axis), *pair) for pair in MAPS] for axis in axes}
    largest = {
        axis: max(float(np.nanmax(np.abs(values))) for *_, values in own) for axis, own in tables.items()
    }
    panels = []
    for row, pair in enumerate(MAPS):
        for axis in axes:
            x, y, values = tables[axis][row]
            cells = Cells("", INK, x, y, values.ravel(), largest[axis])
            title = "" if row else f"{axis} [{unit(axis)}]"
            notes = [] if row else [f"full colour: ± {largest[axis]:.2g}"]
            x_scale = Scale(_label(pair[0]), float(x[0]), float(x[-1]))
            y_scale = Scale(_label(pair[1]), float(y[0]), float(y[-1]))
            panels.append(Panel([cells], x_scale, y_scale, 190.0, title, notes))
    return Figure("Maps of the mean residual", panels, len(axes), shared=True)


def mean_map(flights: Sequence[Residual], axis: int, x: str, y: str) -> tuple[Array, Array, Array]:
    """Edges of the bins of two variables, and the mean residual in each cell (Y, X); NaN for few samples."""
    first, second = (np.concatenate([own.variables[name] for own in flights]) for name in (x, y))
    values = np.concatenate([own.beyond[:, axis] for own in flights])
    edges = round_edges(first, MOST_BINS), round_edges(second, MOST_BINS)
    count, *_ = np.histogram2d(second, first, bins=(edges[1], edges[0]))
    total, *_ = np.histogram2d(second, first, bins=(edges[1], edges[0]), weights=values)
    enough = count >= _FEWEST_IN_CELL
    return *edges, np.where(enough, total / np.maximum(count, 1.0), np.nan)


def gap_figure(gap: Gap) -> Figure:
    """Root mean square error of each axis before and after, and the floor."""
    panels = []
    for own in (slice(0, 3), slice(3, 6)):
        axes, places = AXES[own], np.arange(3.0)
        layers: list[Layer] = []
        for name, values, colour, left in (
            ("before", gap.before, BEFORE, -0.32),
            ("after", gap.after, AFTER, 0.02),
        ):
            bottom = np.zeros(3)
            layers.append(Boxes(name, colour, places + left, places + left + 0.3, bottom, values[own]))
        layers.append(Points("floor", MEASURED, places, gap.floor[own], symbol=4))
        x = Scale("", -0.5, 2.5, ticks=[(float(k), axis) for k, axis in enumerate(axes)])
        panels.append(Panel(layers, x, Scale(f"RMSE [{unit(axes[0])}]", low=0.0), 230.0))
    return Figure("Error of each axis before and after", panels, 2)


def residual_figure(flight: Residual, floor: Array) -> Figure:
    """Measured − simulated wrench of one flight over time, before and after.

    Args:
        flight: its residuals.
        floor: (6,) root mean square, see `Gap`; twice the floor is drawn as a band.
    """
    panels = []
    whole = np.array([np.nan])
    for k, axis in enumerate(AXES):
        band = np.array([2.0 * float(floor[k])])
        layers = [
            Boxes("twice the floor", MEASURED, whole, whole, -band, band, 0.18),
            Line("before", BEFORE, flight.time, flight.before[:, k], width=1.2),
            Line("after", AFTER, flight.time, flight.after[:, k], width=1.2, dash="dashed"),
        ]
        panels.append(Panel(layers, Scale("time [s]"), Scale(f"{axis} [{unit(axis)}]"), 100.0))
    return Figure("Residuals over time", panels, over_time=True)


def _label(variable: str) -> str:
    words, of, _ = VARIABLES[variable]
    return f"{words} [{of}]"
