# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated flight over time as plotly figures: what was to be followed, what was flown, what it took."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from quadpi_core.frames import Array, roll_pitch_yaw_from_quaternion
from quadpi_core.report.decimation import extreme_samples
from quadpi_core.report.figures import series, styled
from quadpi_core.report.style import GROUPS, INK, INPUT_LABELS, MEASURED
from quadpi_core.simulation.truth import Truth
from quadpi_core.vehicle import Vehicle

# The figures of a flight draw so many lines together.
LINES = 25

REFERENCE = {"color": MEASURED, "width": 1.5, "dash": "dash"}
_FLOWN = {"color": GROUPS[0], "width": 1.5}
_SINGLE = {"color": INK, "width": 1.2}
# The greatest rotor speed is drawn once a rotor exceeds this share of it.
_NEAR_LIMIT = 0.8


class _Line(NamedTuple):
    """One line of a row: name for its legend, values (N,), and its style."""

    name: str
    values: Array
    style: Mapping[str, Any]


def tracking_figure(truth: Truth, bins: int) -> go.Figure:
    """Position, yaw and the distance from the reference over time, flown against reference.

    Args:
        truth: of the flight.
        bins: parts that the flight is cut into; of each the extremes are drawn.
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
    """Airspeed, attitude, rates, rotor speeds and wrench over time; arguments as of `tracking_figure`."""
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
    """Where each rotor sits, such as "front left"."""
    return [
        f"{'front' if x > 0 else 'rear'} {'right' if y > 0 else 'left'}"
        for x, y, _ in vehicle.rotor_positions
    ]


def _lines(names: Sequence[str], columns: Array) -> list[_Line]:
    return [_Line(name, columns[:, i], {"color": GROUPS[i], "width": 1.2}) for i, name in enumerate(names)]


def _history(truth: Truth, rows: Mapping[str, Sequence[_Line]], bins: int, row_height: int) -> go.Figure:
    """Rows of lines over one axis of time, each row with a legend of its own beside it."""
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
