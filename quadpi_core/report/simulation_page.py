# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The flights of a simulation in numbers: for the terminal, as JSON, and as a self-contained page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array, roll_pitch_yaw_from_quaternion, rotate_body_to_world, world_ned_to_enu
from quadpi_core.paths import config_directory
from quadpi_core.report.page import DASHES, Figure, Layer, Limit, Line, Page, Panel, Scale, Space, SpaceLine
from quadpi_core.report.table import (
    GROUPS,
    INK,
    INPUT_LABELS,
    MEASURED,
    RULE,
    Cell,
    Column,
    Row,
    Table,
    number,
    number_columns,
    percent,
    text_columns,
)
from quadpi_core.simulation.applied_effects import EFFECTS
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.truth import Truth
from quadpi_core.vehicle import Vehicle
from quadpi_core.version import __version__

if TYPE_CHECKING:
    from quadpi_core.simulation.scenario import FlightPlan

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
    return np.searchsorted(travelled, np.linspace(0.0, travelled[-1], count))


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


# A rotor is at its limit within this share of its largest speed from zero or from the largest.
_AT_LIMIT = 0.001


@dataclass(frozen=True)
class FlightSummary:
    """One simulated flight in numbers, by the keys of the JSON file.

    Attributes:
        effects: parameters by the name of the effect.
        faults: of the sensors, as in the scenario.
        head_wind_m_s: from the north, as an anemometer measures it; None without an anemometer.
        tracking_rms_m, tracking_max_m: distance from the reference position.
        tilt_max_deg: greatest angle between the thrust axis and the vertical.
        rotor_speed_range_rad_s: lowest and highest of all rotors.
        saturated_fraction: share of the time in which a rotor stands still or turns as fast as it can.
        beyond_identified: how the flight left those that its vehicle was identified on; None where it did
            not, and for a vehicle that was not identified.
    """

    name: str
    duration_s: float
    seed: int
    vehicle: str
    noise: str
    effects: Mapping[str, Mapping[str, float]]
    faults: Sequence[Mapping[str, Any]]
    head_wind_m_s: float | None
    airspeed_max_m_s: float
    tracking_rms_m: float
    tracking_max_m: float
    tilt_max_deg: float
    rotor_speed_range_rad_s: Sequence[float]
    saturated_fraction: float
    beyond_identified: Mapping[str, float | str] | None = None


def summarise(plan: FlightPlan, truth: Truth) -> FlightSummary:
    """Numbers of a flight, from its plan and its truth."""
    error, speeds = truth.position_error, truth.rotor_speeds
    highest = truth.vehicle.rotor_speed_max_rad_s
    margin = _AT_LIMIT * highest
    saturated = ((speeds < margin) | (speeds > highest - margin)).any(axis=1)
    _, x, y, _ = truth.attitude.T
    planned = plan.as_dict()
    return FlightSummary(
        name=plan.name,
        duration_s=float(truth.time[-1]),
        seed=plan.seed,
        vehicle=truth.vehicle.name,
        noise=plan.noise,
        effects=planned["effects"],
        faults=planned["faults"],
        head_wind_m_s=plan.head_wind_m_s,
        airspeed_max_m_s=float(truth.speed.max()),
        tracking_rms_m=float(np.sqrt(np.mean(error**2))),
        tracking_max_m=float(error.max()),
        tilt_max_deg=float(np.degrees(np.arccos(1 - 2 * (x * x + y * y))).max()),
        rotor_speed_range_rad_s=[float(speeds.min()), float(speeds.max())],
        saturated_fraction=float(saturated.mean()),
        beyond_identified=None if truth.excursion is None else truth.excursion._asdict(),
    )


def excursion_sentences(truths: Iterable[Truth]) -> list[str]:
    """A sentence for each flight that left those that its vehicle was identified on."""
    return [f"{truth.name}: {truth.excursion.sentence()}" for truth in truths if truth.excursion is not None]


def effects_text(effects: Mapping[str, Mapping[str, float]]) -> str:
    """Effects with their parameters in one line."""
    return "; ".join(
        " ".join((name, ", ".join(f"{key} {value:g}" for key, value in parameters.items()))).strip()
        for name, parameters in effects.items()
    )


def faults_text(faults: Sequence[Mapping[str, Any]]) -> str:
    """Faults of the sensors with their times in one line."""
    return "; ".join(
        f"{fault['kind']} {fault['topic']} {fault['at_s']:g}–{fault['at_s'] + fault['for_s']:g} s"
        for fault in faults
    )


def flight_table(summaries: Sequence[FlightSummary], bags: Sequence[Path]) -> Table:
    """A row for each flight with the size of its bag, within 80 characters."""
    sizes = [1e-6 * bag.stat().st_size for bag in bags]
    headings = ("s", "airspeed m/s", "error rms m", "max m", "MB")
    columns = [*text_columns("bag", wraps=True), *number_columns(*headings)]
    rows: list[Row] = [
        [
            *(bag.name, summary.duration_s, summary.airspeed_max_m_s),
            *(summary.tracking_rms_m, summary.tracking_max_m, size),
        ]
        for summary, bag, size in zip(summaries, bags, sizes, strict=True)
    ]
    total = sum(summary.duration_s for summary in summaries)
    count = "1 bag" if len(bags) == 1 else f"{len(bags)} bags"
    note = f"{count} in {bags[0].parent}: {number(total)} s, {number(sum(sizes))} MB"
    return Table(columns, rows, note=note)


def flight_json(scenario: str, summaries: Sequence[FlightSummary], bags: Sequence[Path]) -> dict[str, Any]:
    """The content of the JSON file."""
    flights = [asdict(summary) | {"bag": str(bag)} for summary, bag in zip(summaries, bags, strict=True)]
    return {"quadpi_version": __version__, "scenario": scenario, "flights": flights}


def catalogue_tables() -> list[Table]:
    """The scenarios in config/scenarios, and the effects that can be switched on with their parameters."""
    paths = sorted((config_directory() / "scenarios").glob("*.yaml"))
    scenarios = [load_scenario(path.stem) for path in paths]
    columns = [*text_columns("name"), Column("flights"), *number_columns("s"), *text_columns("", wraps=True)]
    rows: list[Row] = [
        [own.name, len(own.flights), sum(plan.duration_s for plan in own.flights), own.description]
        for own in scenarios
    ]
    about = "axes, what it does, and its parameters with their defaults"
    effect_columns = [*text_columns("name"), *text_columns(about, wraps=True)]
    effect_rows: list[Row] = []
    for name, effect in EFFECTS.items():
        axes = f"{' '.join(effect.axes)}: " if effect.axes else ""
        defaults = ", ".join(f"{parameter.name}={parameter.default:g}" for parameter in effect.parameters)
        effect_rows.append([name, Cell(f"{axes}{effect.summary}", detail=defaults)])
    return [Table(columns, rows, title="scenarios"), Table(effect_columns, effect_rows, title="effects")]


def write_simulation_page(path: Path, flights: Sequence[tuple[FlightPlan, Truth]]) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        flights: plan and truth of each; at least one, of different names.

    Raises:
        OutputError: if `path` cannot be written.
    """
    summaries = [summarise(plan, truth) for plan, truth in flights]
    scenarios = _distinct(plan.scenario for plan, _ in flights)
    facts = {
        "scenario": scenarios,
        "vehicle": _distinct(summary.vehicle for summary in summaries),
        "noise": _distinct(summary.noise for summary in summaries),
    }
    common = {name: own[0] for name, own in _alterations(summaries).items() if len(set(own)) == 1}
    Page(
        title=f"quadpi: simulation of {scenarios}",
        about="simulated flights",
        verdict=_verdict(summaries),
        facts=facts | common,
        definitions={
            "Tracking error": "Distance from the reference position at the same instant. Wind, effects and "
            "demands on roll, pitch and thrust add to the error of the controller.",
            "Airspeed": "Speed of the vehicle relative to the air, gusts included.",
            "Seed": "The same scenario, seed and version of quadpi make the same bag, byte for byte.",
        },
        figures={},
        flight_figures={
            plan.name: {
                "trajectory": trajectory_figure(truth),
                "tracking": tracking_figure(truth),
                "effort": effort_figure(truth),
            }
            for plan, truth in flights
        },
    ).write(
        path,
        "simulation.html",
        table_of_flights=_page_table(summaries),
        flights=[summary.name for summary in summaries],
    )


def _verdict(summaries: Sequence[FlightSummary]) -> str:
    total = sum(summary.duration_s for summary in summaries)
    fastest = max(summaries, key=lambda summary: summary.airspeed_max_m_s)
    worst = max(summaries, key=lambda summary: summary.tracking_rms_m)
    flights = "One simulated flight" if len(summaries) == 1 else f"{len(summaries)} simulated flights"
    return (
        f"{flights}, {number(total)}\u00a0s, at up to {number(fastest.airspeed_max_m_s)}\u00a0m/s "
        f"({fastest.name}); worst tracking error {number(worst.tracking_rms_m)}\u00a0m rms ({worst.name})."
    )


def _alterations(summaries: Sequence[FlightSummary]) -> dict[str, list[str]]:
    """Effects and faults of each flight as text; what no flight has is left out."""
    texts = {
        "effects": [effects_text(summary.effects) for summary in summaries],
        "faults": [faults_text(summary.faults) for summary in summaries],
    }
    return {name: column for name, column in texts.items() if any(column)}


def _distinct(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(names))


def _page_table(summaries: Sequence[FlightSummary]) -> Table:
    """A row for each flight; effects and faults that all flights share are left out."""
    columns = {
        Column("flight", is_text=True, chooses_flight=True): [s.name for s in summaries],
        Column("time [s]", number): [s.duration_s for s in summaries],
        Column("airspeed [m/s]", number): [s.airspeed_max_m_s for s in summaries],
        Column("error rms [m]", number): [s.tracking_rms_m for s in summaries],
        Column("max [m]", number): [s.tracking_max_m for s in summaries],
        Column("tilt [deg]", "{:.0f}".format): [s.tilt_max_deg for s in summaries],
        Column("rotors [rad/s]"): [
            "–".join(f"{speed:.0f}" for speed in s.rotor_speed_range_rad_s) for s in summaries
        ],
        Column("at limit", percent): [s.saturated_fraction for s in summaries],
        Column("seed"): [s.seed for s in summaries],
    }
    if any(s.head_wind_m_s for s in summaries):
        columns[Column("wind [m/s]", number)] = [s.head_wind_m_s for s in summaries]
    for name, texts in _alterations(summaries).items():
        if len(set(texts)) > 1:
            columns[Column(name, is_text=True, wraps=True)] = [text or None for text in texts]
    return Table(list(columns), list(zip(*columns.values(), strict=True)))
