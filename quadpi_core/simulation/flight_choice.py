# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which flights of a scenario to fly, and what to set otherwise for all of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from quadpi_core.config import nearest
from quadpi_core.errors import SimulationError
from quadpi_core.simulation.effect_definition import Effects
from quadpi_core.simulation.effect_registry import read_effects
from quadpi_core.simulation.flight_plan import FlightPlan
from quadpi_core.simulation.scenario import Scenario, flight_seed


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
