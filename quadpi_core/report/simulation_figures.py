# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of a simulated flight: its path in space, how well it followed its reference, and its rotors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import plotly.graph_objects as go
from plotly.colors import sample_colorscale
from plotly.subplots import make_subplots

from quadpi_core.frames import (
    Array,
    roll_pitch_yaw_from_quaternion,
    world_ned_to_enu,
)
from quadpi_core.report.plots import extreme_samples, series, styled
from quadpi_core.report.style import GROUPS, INK, INPUT_LABELS, MEASURED, RULE
from quadpi_core.rotations import rotate_body_to_world
from quadpi_core.simulation.truth import Truth
from quadpi_core.vehicle import Vehicle

# Lines over time in the two figures of a flight.
LINES = 25

REFERENCE = {"color": MEASURED, "width": 1.5, "dash": "dash"}
_FLOWN = {"color": GROUPS[0], "width": 1.5}
_SINGLE = {"color": INK, "width": 1.2}
# The greatest rotor speed is drawn once a rotor exceeds this share of it.
_NEAR_LIMIT = 0.8
_SAMPLES = 1500
# Largest number of vehicles, and the length of their arms over the longest side of the space shown.
_VEHICLES, _ARM = 24, 0.035
# No side of the space shown is shorter than this share of the longest, nor than this [m].
_SIDE_SHARE, _SIDE_M = 0.2, 1.0
_MARGIN = 1.08
# Diagonal of that space in plotly's scene: with the camera below, it fills the figure with its labels.
_DIAGONAL = 1.55
# Ticks along the longest side; other sides have fewer in proportion.
_TICKS = 7
# From green (slow) to dark blue (fast), without the yellow end, which cannot be seen on white.
_SPEED_COLOURS = sample_colorscale("Viridis", np.linspace(0.85, 0.0, 9))
_SPEED_BAR = {
    "title": {"text": INPUT_LABELS["speed"], "side": "top"},
    "orientation": "h",
    "y": -0.1,
    "len": 0.6,
    "thickness": 10,
    "outlinewidth": 0,
}


class _Line(NamedTuple):
    """One line of a row: name for its legend, values (N,), and its style."""

    name: str
    values: Array
    style: Mapping[str, Any]


def tracking_figure(truth: Truth, bins: int) -> go.Figure:
    """Position, yaw and the distance from the reference over time, flown against reference.

    Args:
        truth: of the flight.
        bins: number of parts that the flight is cut into, of which the extremes are drawn.
    """
    position, wanted = truth.position, truth.reference.position
    yaw = roll_pitch_yaw_from_quaternion(truth.attitude)[:, 2]
    turns = np.round((truth.reference.yaw - yaw) / (2 * np.pi))
    followed = {
        "x, north [m]": (position[:, 0], wanted[:, 0]),
        "y, east [m]": (position[:, 1], wanted[:, 1]),
        "height [m]": (-position[:, 2], -wanted[:, 2]),
        "yaw [deg]": (np.degrees(yaw + 2 * np.pi * turns), np.degrees(truth.reference.yaw)),
    }
    rows = {
        title: [_Line("flown", flown, _FLOWN), _Line("reference", reference, REFERENCE)]
        for title, (flown, reference) in followed.items()
    }
    rows["error [m]"] = [_Line("error", truth.position_error, _SINGLE)]
    figure = _history(truth, rows, bins, row_height=116)
    figure.update_yaxes(rangemode="tozero", row=len(rows), col=1)
    return figure


def effort_figure(truth: Truth, bins: int) -> go.Figure:
    """Airspeed, attitude, rates, rotor speeds and wrench over time; arguments as `tracking_figure`."""
    attitude = np.degrees(roll_pitch_yaw_from_quaternion(truth.attitude))
    rotors = "rotor speeds [rad/s]"
    rows = {
        INPUT_LABELS["speed"]: [_Line("airspeed", truth.speed, _SINGLE)],
        "tilt [deg]": _lines(("roll", "pitch"), attitude),
        "rates [rad/s]": _lines(("p", "q", "r"), truth.rates),
        rotors: _lines(rotor_names(truth.vehicle), truth.rotor_speeds),
        "force [N]": _lines(("Fx", "Fy", "Fz"), truth.wrench[:, :3]),
        "moment [Nm]": _lines(("Mx", "My", "Mz"), truth.wrench[:, 3:]),
    }
    figure = _history(truth, rows, bins, row_height=125)
    limit = truth.vehicle.rotor_speed_max_rad_s
    if truth.rotor_speeds.max() > _NEAR_LIMIT * limit:
        line = {"color": MEASURED, "width": 1, "dash": "dot"}
        figure.add_hline(y=limit, line=line, row=list(rows).index(rotors) + 1, col=1)
    return figure


def rotor_names(vehicle: Vehicle) -> list[str]:
    """Position of each rotor, such as "front left"."""
    return [
        f"{'front' if x > 0 else 'rear'} {'right' if y > 0 else 'left'}"
        for x, y, _ in vehicle.rotor_positions
    ]


def _lines(names: Sequence[str], columns: Array) -> list[_Line]:
    return [_Line(name, columns[:, i], {"color": GROUPS[i], "width": 1.2}) for i, name in enumerate(names)]


def _history(truth: Truth, rows: Mapping[str, Sequence[_Line]], bins: int, row_height: int) -> go.Figure:
    """Rows of lines over a shared time axis, each with its own legend to the right."""
    figure = make_subplots(rows=len(rows), cols=1, shared_xaxes=True, vertical_spacing=0.03)
    explained: set[str] = set()
    for i, (title, lines) in enumerate(rows.items(), start=1):
        for line in lines:
            shown = extreme_samples(line.values, line.values, bins)
            figure.add_scatter(
                **series(truth.time[shown], line.values[shown]),
                line=line.style,
                name=line.name,
                legend=f"legend{i}",
                showlegend=len(lines) > 1 and line.name not in explained,
                row=i,
                col=1,
            )
        explained |= {line.name for line in lines}
        figure.update_yaxes(title_text=title, row=i, col=1)
    figure.update_xaxes(title_text="time [s]", row=len(rows), col=1)
    styled(figure, height=70 + row_height * len(rows), hovermode="x unified")
    beside = {"x": 1.01, "yref": "paper", "yanchor": "top", "orientation": "v"}
    for i, axis in enumerate(figure.select_yaxes(), start=1):
        figure.update_layout({f"legend{i}": beside | {"y": axis.domain[1]}})
    figure.update_layout(margin={"t": 30, "r": 110})
    return figure


def trajectory_figure(truth: Truth) -> go.Figure:
    """The path in space, coloured by airspeed, over its shadow, with the reference and the vehicle along it.

    The axes east, north and height are right-handed and have the same scale. Vehicles are drawn at equal
    distances along the path, enlarged, with the nose in another colour.
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
    """Lowest and highest corner (3,) of the space to show: each side long enough to see, above ground."""
    low, high = points.min(axis=0), points.max(axis=0)
    sides = _MARGIN * (high - low)
    sides = np.maximum(sides, max(_SIDE_M, _SIDE_SHARE * float(sides.max())))
    middle = 0.5 * (low + high)
    bottom = np.array([-np.inf, -np.inf, min(0.0, low[2])])
    return np.maximum(middle - 0.5 * sides, bottom), middle + 0.5 * sides


def _along(path: Array, longest: float) -> npt.NDArray[np.intp]:
    """Indices of samples at equal distances along the path (N, 3), at least three arms of a vehicle apart."""
    travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
    count = int(min(_VEHICLES, travelled[-1] // (3.0 * _ARM * longest) + 1))
    chosen: npt.NDArray[np.intp] = np.searchsorted(travelled, np.linspace(0.0, travelled[-1], count))
    return chosen


def _vehicles(truth: Truth, samples: npt.NDArray[np.intp], arm: float) -> list[tuple[str, Array, str]]:
    """Arms and noses of the vehicle at some samples: name, lines (M, 3) with gaps of NaN, colour."""
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
