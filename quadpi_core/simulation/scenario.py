# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Scenarios: files under config/scenarios, or of the user's own, that plan flights and include each other."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

from quadpi_core.config import is_config_path, nearest
from quadpi_core.config_schema import Expected, Section, Text, Within, load_config, unknown_key
from quadpi_core.errors import SimulationError, named_in
from quadpi_core.simulation.effect_definition import Effects
from quadpi_core.simulation.effect_registry import read_effects
from quadpi_core.simulation.flight_plan import FlightPlan

# Keys that a scenario may set for all flights in its file; the key of a flight takes precedence.
_SHARED = ("vehicle", "noise", "duration_s", "height_m", "head_wind_m_s", "truth_rate_hz")
_FLIGHT_KEYS = [column.name for column in fields(FlightPlan) if column.name not in {"name", "scenario"}]


@dataclass(frozen=True, kw_only=True)
class _ScenarioFile(Section):
    """The content of a scenario file; flights are checked when what they share is known."""

    description: Text
    include: Annotated[tuple[Text, ...], Expected("must be a list of names or paths")] = ()
    seed: Annotated[int, Within(0, 2**32)] | None = None
    vehicle: Any = None
    noise: Any = None
    duration_s: Any = None
    height_m: Any = None
    head_wind_m_s: Any = None
    truth_rate_hz: Any = None
    effects: Any = None
    flights: Annotated[dict[Any, Any], Expected("must be flights by name")] = field(default_factory=dict)


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
    that of its file and its name, which other flights of the scenario do not change.

    Raises:
        SimulationError: naming file, flight and key that is missing, unknown or impossible; for flights of
            the same name, and for files that include each other.
    """
    return _load(name_or_path, ())


def _load(name_or_path: str | Path, including: tuple[Path, ...]) -> Scenario:
    path, content = load_config("scenario", name_or_path, _ScenarioFile, SimulationError)
    if path.resolve() in including:
        circle = " includes ".join(str(file) for file in (*including, path))
        raise SimulationError(f"{circle}: a scenario cannot include itself")
    effects = read_effects(content.effects, str(path))
    included = []
    for other in content.include:
        with named_in(f"{path}: `include`"):
            plans = _load(_beside(path, other), (*including, path.resolve())).flights
        included += [_with_effects(plan, effects) for plan in plans]
    flights = (*included, *_own_flights(path, content, effects))
    if not flights:
        raise SimulationError(f"{path}: holds no flights: `flights` and `include` are empty")
    _require_different_names(path, flights)
    return Scenario(path.stem, content.description, flights)


def _own_flights(path: Path, content: _ScenarioFile, effects: Effects) -> Iterator[FlightPlan]:
    shared = {key: getattr(content, key) for key in _SHARED}
    for name, data in content.flights.items():
        where = f"{path}: flight `{name}`"
        own = {} if data is None else data
        if not isinstance(own, dict):
            raise SimulationError(f"{where}: expected keys and values, found {own!r}")
        for key in own:
            if key not in _FLIGHT_KEYS:
                raise SimulationError(f"{where}: {unknown_key(key, _FLIGHT_KEYS)}")
        merged: dict[str, Any] = shared | {key: value for key, value in own.items() if value is not None}
        merged["effects"] = dict(effects) | dict(read_effects(own.get("effects"), where))
        if merged.get("seed") is None:
            if content.seed is None:
                raise SimulationError(f"{path}: missing key `seed`")
            merged["seed"] = flight_seed(content.seed, str(name))
        for key in ("vehicle", "noise"):
            if isinstance(merged[key], str):
                merged[key] = str(_beside(path, merged[key]))
        yield FlightPlan.from_dict(merged | {"name": str(name), "scenario": path.stem}, where)


def flight_seed(scenario_seed: int, name: str) -> int:
    """The seed of a flight that has none of its own."""
    return zlib.crc32(f"{scenario_seed} {name}".encode())


def _with_effects(plan: FlightPlan, effects: Effects) -> FlightPlan:
    return plan.overridden(effects=dict(effects) | dict(plan.effects)) if effects else plan


def _beside(path: Path, other: str) -> str | Path:
    """A path relative to the folder of the file that names it; the name of a file in config unchanged."""
    return path.parent / other if is_config_path(other) else other


def _require_different_names(path: Path, flights: Iterable[FlightPlan]) -> None:
    seen: dict[str, str] = {}
    for plan in flights:
        if plan.name in seen:
            raise SimulationError(
                f"{path}: two flights are named `{plan.name}`: of {seen[plan.name]} and of {plan.scenario}"
            )
        seen[plan.name] = plan.scenario


def choose_flights(
    scenario: Scenario,
    names: Sequence[str] = (),
    *,
    vehicle: str | None = None,
    noise: str | None = None,
    seed: int | None = None,
    effects: Effects | None = None,
) -> list[FlightPlan]:
    """Flights of a scenario in its order; what is None stays as the scenario has it.

    Args:
        scenario: that is flown.
        names: of the flights; none for all.
        vehicle: of every flight.
        noise: of the sensors of every flight.
        seed: from which, with its name, each flight gets its own.
        effects: switched on in every flight; they replace those of the same name.

    Raises:
        SimulationError: for a flight that the scenario does not hold, and what no flight can have.
    """
    known = [plan.name for plan in scenario.flights]
    for name in names:
        if name not in known:
            raise SimulationError(
                f"scenario {scenario.name}: no flight `{name}`; its flights: {', '.join(known)}"
                f"{nearest(name, known)}"
            )
    chosen = [plan for plan in scenario.flights if not names or plan.name in names]
    return [_overridden(plan, vehicle, noise, seed, effects or {}) for plan in chosen]


def _overridden(
    plan: FlightPlan, vehicle: str | None, noise: str | None, seed: int | None, effects: Effects
) -> FlightPlan:
    changes: dict[str, Any] = {"vehicle": vehicle, "noise": noise}
    if seed is not None:
        changes["seed"] = flight_seed(seed, plan.name)
    if effects:
        changes["effects"] = {**plan.effects, **effects}
    given = {key: value for key, value in changes.items() if value is not None}
    return plan.overridden(**given) if given else plan


def parse_effects(texts: Iterable[str]) -> Effects:
    """Effects from texts NAME or NAME:PARAMETER=VALUE[,PARAMETER=VALUE…].

    Raises:
        SimulationError: naming the text that is no such thing, and the unknown effect or parameter.
    """
    data: dict[str, dict[str, float]] = {}
    for text in texts:
        name, colon, listed = text.partition(":")
        for part in listed.split(",") if colon else ():
            parameter, _, value = part.partition("=")
            try:
                number = float(value)
            except ValueError:
                raise SimulationError(
                    f"--effect {text}: expected NAME or NAME:PARAMETER=VALUE[,PARAMETER=VALUE…]"
                ) from None
            if parameter in data.setdefault(name, {}):
                raise SimulationError(f"--effect {text}: `{parameter}` is given twice")
            data[name][parameter] = number
        data.setdefault(name, {})
    return read_effects(data, "--effect")
