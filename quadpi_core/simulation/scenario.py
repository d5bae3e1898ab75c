# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Scenarios: files under config/scenarios, or of the user's own, that plan flights and compose."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from quadpi_core.config import read_config
from quadpi_core.errors import SimulationError, named_in
from quadpi_core.simulation.config_section import Section
from quadpi_core.simulation.effect_definition import Effects
from quadpi_core.simulation.effect_registry import read_effects
from quadpi_core.simulation.flight_plan import FlightPlan

# What a scenario may set for all flights in its file, each of which may set it otherwise.
_SHARED = ("vehicle", "noise", "duration_s", "height_m", "head_wind_m_s", "truth_rate_hz")
_SCENARIO_KEYS = ("description", "include", "seed", *_SHARED, "effects", "flights")
_FLIGHT_KEYS = tuple(field.name for field in fields(FlightPlan) if field.name not in {"name", "scenario"})


@dataclass(frozen=True)
class Scenario:
    """Flights that belong together."""

    name: str
    description: str
    flights: tuple[FlightPlan, ...]


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario by the name of a file in config/scenarios, or by path.

    Flights of included files come first. What a file sets for all holds for the flights in it; the effects
    that it switches on hold for the included flights too. A flight without a seed of its own gets one from
    that of its file and its name, so that it stays the same whatever flies beside it.

    Raises:
        SimulationError: naming file, flight and key that is missing, unknown or impossible; for flights of
            the same name, and for files that include each other.
    """
    return _load(name_or_path, ())


def _load(name_or_path: str | Path, including: tuple[Path, ...]) -> Scenario:
    path, data = read_config("scenario", name_or_path, SimulationError)
    if path.resolve() in including:
        circle = " includes ".join(str(file) for file in (*including, path))
        raise SimulationError(f"{circle}: a scenario cannot include itself")
    section = Section(data, str(path), _SCENARIO_KEYS)
    description = section.text("description")
    effects = read_effects(section.get("effects", None), str(path))
    included = []
    for other in _listed(section, "include"):
        with named_in(f"{path}: `include`"):
            plans = _load(_beside(path, other), (*including, path.resolve())).flights
        included += [_with_effects(plan, effects) for plan in plans]
    flights = (*included, *_own_flights(path, section, effects))
    if not flights:
        raise SimulationError(f"{path}: holds no flights: `flights` and `include` are empty")
    _require_different_names(path, flights)
    return Scenario(path.stem, description, flights)


def _own_flights(path: Path, section: Section, effects: Effects) -> Iterable[FlightPlan]:
    flights = section.get("flights", None) or {}
    if not isinstance(flights, Mapping):
        raise SimulationError(f"{path}: `flights` must be flights by name, found {flights!r}")
    shared = {key: section.get(key, None) for key in _SHARED if key in section}
    for name, data in flights.items():
        where = f"{path}: flight `{name}`"
        own = Section({} if data is None else data, where, _FLIGHT_KEYS)
        merged: dict[str, Any] = shared | {key: own.get(key, None) for key in _FLIGHT_KEYS if key in own}
        merged["effects"] = dict(effects) | dict(read_effects(own.get("effects", None), where))
        merged["seed"] = own.whole("seed") if "seed" in own else flight_seed(section.whole("seed"), str(name))
        for key in ("vehicle", "noise"):
            if isinstance(merged.get(key), str):
                merged[key] = str(_beside(path, merged[key]))
        yield FlightPlan.from_dict(merged | {"name": str(name), "scenario": path.stem}, where)


def flight_seed(scenario_seed: int, name: str) -> int:
    """The seed of a flight that has none of its own."""
    return zlib.crc32(f"{scenario_seed} {name}".encode())


def _with_effects(plan: FlightPlan, effects: Effects) -> FlightPlan:
    return plan.overridden(effects=dict(effects) | dict(plan.effects)) if effects else plan


def _listed(section: Section, key: str) -> list[str]:
    names = section.get(key, None) or []
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise SimulationError(f"{section.where}: `{key}` must be a list of names or paths, found {names!r}")
    return names


def _beside(path: Path, other: str) -> str | Path:
    """A path as seen from the folder of the file that it stands in; a name as it is."""
    return path.parent / other if Path(other).suffix in {".yaml", ".yml"} else other


def _require_different_names(path: Path, flights: Iterable[FlightPlan]) -> None:
    seen: dict[str, str] = {}
    for plan in flights:
        if plan.name in seen:
            raise SimulationError(
                f"{path}: two flights are named `{plan.name}`: of {seen[plan.name]} and of {plan.scenario}"
            )
        seen[plan.name] = plan.scenario
