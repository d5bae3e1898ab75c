# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated flights in numbers: what the terminal, the JSON file and the page all show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

from quadpi_core import __version__
from quadpi_core.report.style import number
from quadpi_core.simulation.truth import Truth

if TYPE_CHECKING:
    from quadpi_core.simulation.flight_plan import FlightPlan

# A rotor within this share of its range from either end of it is at its limit.
_AT_LIMIT = 0.001


@dataclass(frozen=True)
class FlightSummary:
    """One simulated flight; the names are the keys of the JSON file.

    Attributes:
        effects: parameters by the name of the effect.
        faults: of the sensors, as the scenario gives them.
        head_wind_m_s: from the north, as an anemometer measures it; None where there is none.
        tracking_rms_m, tracking_max_m: of the distance from the reference position.
        tilt_max_deg: greatest angle between the thrust axis and the vertical.
        rotor_speed_range_rad_s: lowest and highest of all rotors.
        saturated_fraction: share of the time in which a rotor stands still or turns as fast as it can.
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


def summarise(plan: FlightPlan, truth: Truth) -> FlightSummary:
    """What was planned and what was flown, in numbers."""
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
    )


def effects_text(effects: Mapping[str, Mapping[str, float]]) -> str:
    """Effects with their parameters in one line."""
    return "; ".join(
        " ".join((name, ", ".join(f"{key} {value:g}" for key, value in parameters.items()))).strip()
        for name, parameters in effects.items()
    )


def faults_text(faults: Sequence[Mapping[str, Any]]) -> str:
    """Faults of the sensors, and when they happen, in one line."""
    return "; ".join(
        f"{fault['kind']} {fault['topic']} {fault['at_s']:g}–{fault['at_s'] + fault['for_s']:g} s"
        for fault in faults
    )


def flight_table(summaries: Sequence[FlightSummary], bags: Sequence[Path]) -> Table:
    """A row per flight, with its bag and the size of it; fits a terminal of 80 characters."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    # The one column that may be narrowed: long names are broken, numbers are not.
    table.add_column("bag", overflow="fold")
    for heading in ("s", "airspeed m/s", "error rms m", "max m", "MB"):
        table.add_column(heading, justify="right", no_wrap=True)
    sizes = [1e-6 * bag.stat().st_size for bag in bags]
    for summary, bag, size in zip(summaries, bags, sizes, strict=True):
        table.add_row(
            Text(bag.name),
            number(summary.duration_s),
            number(summary.airspeed_max_m_s),
            number(summary.tracking_rms_m),
            number(summary.tracking_max_m),
            number(size),
        )
    total = sum(summary.duration_s for summary in summaries)
    count = "1 bag" if len(bags) == 1 else f"{len(bags)} bags"
    table.caption = Text(f"{count} in {bags[0].parent}: {number(total)} s, {number(sum(sizes))} MB")
    return table


def flight_json(scenario: str, summaries: Sequence[FlightSummary], bags: Sequence[Path]) -> dict[str, Any]:
    """The same for a JSON file, and all that the summaries hold."""
    flights = [asdict(summary) | {"bag": str(bag)} for summary, bag in zip(summaries, bags, strict=True)]
    return {"quadpi_version": __version__, "scenario": scenario, "flights": flights}
