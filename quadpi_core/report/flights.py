# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated flights in numbers: what the terminal, the JSON file and the page all show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from quadpi_core.simulation.truth import Truth

if TYPE_CHECKING:
    from quadpi_core.simulation.scenario import FlightPlan

# A rotor within this share of its range from either end of it is at its limit.
_AT_LIMIT = 0.001


@dataclass(frozen=True)
class FlightSummary:
    """One simulated flight; the names are the keys of the JSON file.

    Attributes:
        effects: parameters by the name of the effect.
        faults: of the sensors, as the scenario gives them.
        wind_m_s: known wind, north, east, down.
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
    wind_m_s: Sequence[float]
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
        noise=str(plan.noise),
        effects=planned["effects"],
        faults=planned["faults"],
        wind_m_s=[float(component) for component in plan.known_wind],
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
