# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The path of a simulated flight in space, as a plotly figure."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import plotly.graph_objects as go
from plotly.colors import sample_colorscale

from quadpi_core.frames import Array, world_ned_to_enu
from quadpi_core.report.figures import styled
from quadpi_core.report.flown_figures import REFERENCE
from quadpi_core.report.style import GROUPS, INK, INPUT_LABELS, RULE
from quadpi_core.rotations import rotate_body_to_world
from quadpi_core.simulation.truth import Truth

_SAMPLES = 1500
# Vehicles drawn at most, and the length of their arms over the longest side of the space shown.
_VEHICLES, _ARM = 24, 0.035
# No side of the space shown is shorter than this share of the longest, nor than this [m].
_SIDE_SHARE, _SIDE_M = 0.2, 1.0
_MARGIN = 1.08
# Diagonal of that space on the screen: with the camera below it fills the figure, its labels within.
_DIAGONAL = 1.55
# Along the longest side, fewer along the others.
_TICKS = 7
# Slow in green, fast in the dark: the yellow end of the scale would be lost on white.
_SPEED_COLOURS = sample_colorscale("Viridis", np.linspace(0.85, 0.0, 9))
_SPEED_BAR = {
    "title": {"text": INPUT_LABELS["speed"], "side": "top"},
    "orientation": "h",
    "y": -0.1,
    "len": 0.6,
    "thickness": 10,
    "outlinewidth": 0,
}


def trajectory_figure(truth: Truth) -> go.Figure:
    """The path coloured by airspeed over its shadow on the floor, the reference dashed, the vehicle along it.

    Axes are east, north and height, which are right-handed, at equal scale. Vehicles are drawn at equal
    distances along the path, larger than life, with the nose in another colour.
    """
    shown = np.unique(np.linspace(0, len(truth) - 1, _SAMPLES).astype(np.intp))
    path = world_ned_to_enu(truth.position[shown])
    reference = world_ned_to_enu(truth.reference.position[shown])
    low, high = _sides(np.concatenate((path, reference)))
    sides = high - low
    longest = float(sides.max())

    figure = go.Figure()
    shadow = np.column_stack((path[:, :2], np.full(len(path), low[2])))
    figure.add_scatter3d(
        **_points(shadow), line={"color": RULE, "width": 3}, hoverinfo="skip", showlegend=False
    )
    figure.add_scatter3d(
        **_points(reference), line=REFERENCE | {"width": 2, "dash": "dot"}, hoverinfo="skip", name="reference"
    )
    speed = truth.speed[shown]
    figure.add_scatter3d(
        **_points(path),
        line={
            "color": speed.astype(np.float32),
            "colorscale": _SPEED_COLOURS,
            "width": 5,
            "colorbar": _SPEED_BAR,
            "showscale": True,
        },
        customdata=np.column_stack((truth.time[shown], speed)).astype(np.float32),
        hovertemplate="%{customdata[0]:.1f} s, %{customdata[1]:.1f} m/s<extra></extra>",
        name="flown",
        showlegend=False,
    )
    for name, lines, colour in _vehicles(truth, shown[_along(path, longest)], _ARM * longest):
        figure.add_scatter3d(
            **_points(lines), line={"color": colour, "width": 4}, hoverinfo="skip", name=name
        )
    axes = {
        f"{axis}axis": {
            "title": {"text": title},
            "range": [low[i], high[i]],
            "gridcolor": RULE,
            "zeroline": False,
            "nticks": max(2, round(_TICKS * float(sides[i]) / longest)),
            "showbackground": False,
        }
        for i, (axis, title) in enumerate((("x", "east [m]"), ("y", "north [m]"), ("z", "height [m]")))
    }
    ratio = dict(zip("xyz", (_DIAGONAL * sides / np.linalg.norm(sides)).tolist(), strict=True))
    camera = {"eye": {"x": -1.0, "y": -1.4, "z": 0.8}, "center": {"x": 0, "y": 0, "z": -0.2}}
    figure.update_layout(scene={**axes, "aspectmode": "manual", "aspectratio": ratio, "camera": camera})
    return styled(figure, height=600).update_layout(margin={"l": 0, "r": 0, "t": 32, "b": 60})


def _points(points: Array) -> dict[str, Any]:
    x, y, z = points.T.astype(np.float32)
    return {"x": x, "y": y, "z": z, "mode": "lines"}


def _sides(points: Array) -> tuple[Array, Array]:
    """Lowest and highest corner (3,) of the space to show, no side too short to see; not below the ground."""
    low, high = points.min(axis=0), points.max(axis=0)
    sides = _MARGIN * (high - low)
    sides = np.maximum(sides, max(_SIDE_M, _SIDE_SHARE * float(sides.max())))
    middle = 0.5 * (low + high)
    bottom = np.array([-np.inf, -np.inf, min(0.0, low[2])])
    return np.maximum(middle - 0.5 * sides, bottom), middle + 0.5 * sides


def _along(path: Array, longest: float) -> npt.NDArray[np.intp]:
    """Samples of the path (N, 3) at equal distances along it, at least three arms of a vehicle apart."""
    travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
    count = int(min(_VEHICLES, travelled[-1] // (3.0 * _ARM * longest) + 1))
    chosen: npt.NDArray[np.intp] = np.searchsorted(travelled, np.linspace(0.0, travelled[-1], count))
    return chosen


def _vehicles(truth: Truth, samples: npt.NDArray[np.intp], arm: float) -> list[tuple[str, Array, str]]:
    """Arms and noses of the vehicle at some samples: name, lines (M, 3) with gaps, colour."""
    hubs = truth.vehicle.rotor_positions / np.linalg.norm(truth.vehicle.rotor_positions, axis=1).max()
    centre, gap = np.zeros(3), np.full(3, np.nan)
    shapes = (
        ("vehicle, enlarged", [row for hub in hubs for row in (centre, arm * hub, gap)], INK),
        ("nose", [centre, np.array([1.8 * arm, 0.0, 0.0]), gap], GROUPS[1]),
    )
    position, attitude = truth.position[samples, None], truth.attitude[samples, None]
    return [
        (
            name,
            world_ned_to_enu(position + rotate_body_to_world(attitude, np.array(lines))).reshape(-1, 3),
            colour,
        )
        for name, lines, colour in shapes
    ]
