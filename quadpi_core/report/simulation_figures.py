# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of a simulated flight: its path in space, how well it followed its reference, and its rotors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array, roll_pitch_yaw_from_quaternion, world_ned_to_enu
from quadpi_core.report.figure import DASHES, Figure, Layer, Limit, Line, Panel, Scale, Space, SpaceLine
from quadpi_core.report.style import GROUPS, INK, INPUT_LABELS, MEASURED, RULE
from quadpi_core.rotations import rotate_body_to_world
from quadpi_core.simulation.truth import Truth
from quadpi_core.vehicle import Vehicle

# The greatest rotor speed is drawn once a rotor exceeds this share of it.
_NEAR_LIMIT = 0.8
_SAMPLES = 1500
# Largest number of vehicles, and the length of their arms over the longest side of the space shown.
_VEHICLES, _ARM = 24, 0.035
# No side of the space shown is shorter than this share of the longest, nor than this [m].
_SIDE_SHARE, _SIDE_M = 0.2, 1.0
_MARGIN = 1.08


def tracking_figure(truth: Truth) -> Figure:
    """Position, yaw and the distance from the reference over time, flown against reference."""
    position, wanted = truth.position, truth.reference.position
    yaw = roll_pitch_yaw_from_quaternion(truth.attitude)[:, 2]
    turns = np.round((truth.reference.yaw - yaw) / (2 * np.pi))
    followed = {
        "x, north [m]": (position[:, 0], wanted[:, 0]),
        "y, east [m]": (position[:, 1], wanted[:, 1]),
        "height [m]": (-position[:, 2], -wanted[:, 2]),
        "yaw [deg]": (np.degrees(yaw + 2 * np.pi * turns), np.degrees(truth.reference.yaw)),
    }
    rows: dict[str, list[Layer]] = {
        title: [
            Line("flown", GROUPS[0], truth.time, flown),
            Line("reference", MEASURED, truth.time, reference, dash="dashed"),
        ]
        for title, (flown, reference) in followed.items()
    }
    rows["error [m]"] = [Line("error", INK, truth.time, truth.position_error)]
    panels = [
        Panel(lines, Scale("time [s]"), Scale(title, low=0.0 if title == "error [m]" else None), 80.0)
        for title, lines in rows.items()
    ]
    return Figure("Path and reference over time", panels, over_time=True)


def effort_figure(truth: Truth) -> Figure:
    """Airspeed, attitude, rates, rotor speeds and wrench over time."""
    attitude = np.degrees(roll_pitch_yaw_from_quaternion(truth.attitude))
    rotors = "rotor speeds [rad/s]"

    def lines(names: Sequence[str], columns: Array) -> list[Layer]:
        return [
            Line(name, GROUPS[i], truth.time, columns[:, i], width=1.2, dash=DASHES[i % len(DASHES)])
            for i, name in enumerate(names)
        ]

    rows: dict[str, list[Layer]] = {
        INPUT_LABELS["speed"]: [Line("airspeed", INK, truth.time, truth.speed)],
        "tilt [deg]": lines(("roll", "pitch"), attitude),
        "rates [rad/s]": lines(("p", "q", "r"), truth.rates),
        rotors: lines(rotor_names(truth.vehicle), truth.rotor_speeds),
        "force [N]": lines(("Fx", "Fy", "Fz"), truth.wrench[:, :3]),
        "moment [Nm]": lines(("Mx", "My", "Mz"), truth.wrench[:, 3:]),
    }
    limit = truth.vehicle.rotor_speed_max_rad_s
    if truth.rotor_speeds.max() > _NEAR_LIMIT * limit:
        rows[rotors].append(Limit("", MEASURED, limit, dash="dotted", label="largest"))
    panels = [Panel(layers, Scale("time [s]"), Scale(title), 115.0) for title, layers in rows.items()]
    return Figure("Rotors and wrench over time", panels, over_time=True)


def rotor_names(vehicle: Vehicle) -> list[str]:
    """Position of each rotor, such as "front left"."""
    return [
        f"{'front' if x > 0 else 'rear'} {'right' if y > 0 else 'left'}"
        for x, y, _ in vehicle.rotor_positions
    ]


def trajectory_figure(truth: Truth) -> Space:
    """The path in space, coloured by airspeed, over its shadow, with the reference and the vehicle along it.

    The axes east, north and height are right-handed and have the same scale. Vehicles are drawn at equal
    distances along the path, enlarged, with the nose in another colour.
    """
    shown = np.unique(np.linspace(0, len(truth) - 1, _SAMPLES).astype(np.intp))
    path = world_ned_to_enu(truth.position[shown])
    reference = world_ned_to_enu(truth.reference.position[shown])
    low, high = _sides(np.concatenate((path, reference)))
    longest = float((high - low).max())
    shadow = np.column_stack((path[:, :2], np.full(len(path), low[2])))
    lines = [
        SpaceLine("", RULE, shadow, 3.0),
        SpaceLine("reference", MEASURED, reference, 1.5, "dotted"),
        SpaceLine("", GROUPS[0], path, values=truth.speed[shown], times=truth.time[shown]),
        *_vehicles(truth, shown[_along(path, longest)], _ARM * longest),
    ]
    return Space("Path in space", lines, low, high, INPUT_LABELS["speed"])


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


def _vehicles(truth: Truth, samples: npt.NDArray[np.intp], arm: float) -> list[SpaceLine]:
    """Arms and noses of the vehicle at some samples."""
    hubs = truth.vehicle.rotor_positions / np.linalg.norm(truth.vehicle.rotor_positions, axis=1).max()
    centre, gap = np.zeros(3), np.full(3, np.nan)
    shapes = (
        ("vehicle, enlarged", [row for hub in hubs for row in (centre, arm * hub, gap)], INK),
        ("nose", [centre, np.array([1.8 * arm, 0.0, 0.0]), gap], GROUPS[1]),
    )
    position, attitude = truth.position[samples, None], truth.attitude[samples, None]
    return [
        SpaceLine(
            name,
            colour,
            world_ned_to_enu(position + rotate_body_to_world(attitude, np.array(lines))).reshape(-1, 3),
        )
        for name, lines, colour in shapes
    ]
