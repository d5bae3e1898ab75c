# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The simulation with the effects that were found, as a value and as files that can be simulated again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from quadpi_core.config import is_config_path, read_config
from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.discrepancy_result import Discovery
from quadpi_core.discrepancy.effect_formulas import write_formulas
from quadpi_core.discrepancy.effect_response import body_tolerances
from quadpi_core.discrepancy.search import Found
from quadpi_core.discrepancy.simulations import Simulation, Tolerances, VehicleSimulation
from quadpi_core.errors import DiscrepancyError, VehicleError
from quadpi_core.simulation.effect_definition import Effects
from quadpi_core.simulation.effect_registry import EFFECTS
from quadpi_core.simulation.rotor_local import RotorLocalCoefficients
from quadpi_core.vehicle import Vehicle
from quadpi_core.version import __version__


def augmented(discovery: Discovery, without: int | None = None) -> AugmentedSimulation:
    """The simulation with the effects that were found, and its coefficients as the flights have them.

    Coefficients move by their posterior means within their tolerances, if that brings flights left out
    closer; otherwise none of them moves.

    Args:
        discovery: its search.
        without: index of a flight to leave out of the fit, so that the result can be judged on it.

    Raises:
        DiscrepancyError: where an effect cannot be added to one that the simulation already has.
    """
    found = discovery.found
    regression, columns = found.regression, found.regression.columns
    simulation = regression.flights[0].simulation
    law, fitted = found.closing.fits(without)
    effects: Effects = {}
    for index in found.chosen:
        candidate = regression.candidates[index]
        values = candidate.values(regression.parameters(index, law))
        shape = found.closing.shape(index, law, fitted)
        effects = {**effects, candidate.name: _named(candidate.name, values) | shape}
    adjusted: dict[str, float] = {}
    if _adjusting_helps(found):
        multiples = dict(zip(columns.tolerance_names, fitted.of(columns.tolerances).tolist(), strict=True))
        adjusted, small = _divided(multiples, simulation.tolerances)
        effects = merged(small, effects)
    return _added(simulation, effects, adjusted)


def _possible(effects: Effects, vehicle: Vehicle) -> Effects:
    """The effects, with parameters that are possible on the vehicle: noise can take a fit beyond."""
    possible = dict(effects)
    for name, parameters in effects.items():
        feasible = EFFECTS[name].feasible
        if feasible is not None:
            possible[name] = _named(name, feasible(vehicle, np.array(list(parameters.values()))))
    return possible


def _adjusting_helps(found: Found) -> bool:
    """Whether coefficients moved within their tolerances bring flights that are left out closer."""
    gained = 0.0
    for own, fit in zip(found.closing.grams, found.closing.left_out, strict=True):
        weights = fit.left
        unmoved = weights.copy()
        unmoved[found.regression.columns.tolerances] = 0.0
        gained += float(unmoved @ own @ unmoved - weights @ own @ weights)
    return gained > 0.0


def _divided(multiples: Mapping[str, float], tolerances: Tolerances) -> tuple[dict[str, float], Effects]:
    """Multiples of tolerances split into those of the simulation's own coefficients and small effects."""
    own, small = dict(multiples), {}
    for effect, deviation in body_tolerances(tolerances):
        values = [deviation * own.pop(f"{effect.name}.{p.name}") for p in effect.parameters]
        small[effect.name] = _named(effect.name, values)
    return own, {name: values for name, values in small.items() if any(values.values())}


def _named(name: str, values: Any) -> dict[str, float]:
    parameters = EFFECTS[name].parameters
    return {
        p.name: float(min(max(value, p.lowest), p.highest))
        for p, value in zip(parameters, values, strict=True)
    }


def merged(one: Effects, other: Effects) -> Effects:
    """Effects of two sets, in the order in which they act; those in both add up.

    Raises:
        DiscrepancyError: for two of a kind that do not add up: of different rotors, or tethers.
    """
    for name in set(one) & set(other):
        whole = [parameter.name for parameter in EFFECTS[name].parameters if parameter.whole]
        if not EFFECTS[name].composable or any(one[name][key] != other[name][key] for key in whole):
            raise DiscrepancyError(
                f"effect `{name}`: the simulation has one already, and a second one cannot be added to it"
            )

    def parameters(name: str) -> Mapping[str, float]:
        if name not in one or name not in other:
            return one.get(name) or other[name]
        whole = {p.name: one[name][p.name] for p in EFFECTS[name].parameters if p.whole}
        both = [(p, one[name][p.name], other[name][p.name]) for p in EFFECTS[name].parameters]
        # The second change of a moment of inertia is one of what the first has left.
        shares = EFFECTS[name].kind == "vehicle"
        sums = [a + b + (a * b if shares and not p.unit else 0.0) for p, a, b in both]
        return _named(name, sums) | whole | _both_shapes(name, one[name], other[name])

    return {name: parameters(name) for name in EFFECTS if name in one or name in other}


def _both_shapes(name: str, one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    """Shape of the law of two effects that add up: each weighted by its part in their sum."""
    free = [p for p in EFFECTS[name].parameters if not p.whole]
    parts = np.array([[own[p.name] / (abs(p.default) or 1.0) for p in free] for own in (one, other)])
    total = parts.sum(axis=0)
    if not total.any():
        return {}
    weights = parts @ total / (total @ total)
    shape = {
        p.name: float(np.clip(weights @ [own.get(p.name, 0.0) for own in (one, other)], p.lowest, p.highest))
        for p in EFFECTS[name].shape
    }
    return {key: value for key, value in shape.items() if value != 0.0}


def _added(simulation: Simulation, effects: Effects, adjusted: dict[str, float]) -> AugmentedSimulation:
    before: Mapping[str, float] = {}
    if isinstance(simulation, AugmentedSimulation):
        # A simulation has no setting for how far the laws of its earlier effects are off.
        own = {name for name in adjusted if not any(name.endswith(f" of {e}") for e in simulation.effects)}
        adjusted = {name: adjusted[name] for name in own}
        effects, before = merged(simulation.effects, effects), simulation.adjusted
        simulation = simulation.base
    effects = _possible(effects, simulation.vehicle)
    if isinstance(simulation, VehicleSimulation):
        return AugmentedSimulation(simulation.adjusted(adjusted), effects)
    both = {name: before.get(name, 0.0) + adjusted.get(name, 0.0) for name in {*before, *adjusted}}
    return AugmentedSimulation(simulation, effects, dict(sorted(both.items())))


def write_addition(discovery: Discovery, folder: Path) -> list[Path]:
    """Write the simulation with what was found added, and the formulas of the effects.

    A vehicle file becomes a vehicle file of the same name, with `simulation.effects`; any other simulation
    gets an `addition.json` that refers to it and loads in its place. Without effects nothing is written.

    Args:
        discovery: of the search.
        folder: that exists.

    Returns:
        Paths of the files, the simulation first.

    Raises:
        DiscrepancyError: where an effect cannot be added to one that the simulation already has.
    """
    if not discovery.effects:
        return []
    simulation = augmented(discovery)
    if isinstance(simulation.base, VehicleSimulation):
        path = folder / f"{simulation.vehicle.name}.yaml"
        path.write_text(_vehicle_file(simulation, simulation.base))
    else:
        path = folder / "addition.json"
        data = {
            "simulation": _absolute(simulation.base.name),
            "vehicle": _absolute(simulation.base.vehicle_file or simulation.vehicle.name),
            "effects": simulation.effects,
            "adjusted": simulation.adjusted,
            "version": __version__,
        }
        path.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n")
    return [path, *write_formulas(discovery.effects, folder)]


def _absolute(text: str) -> str:
    """A name, or the absolute path of a file or folder, so that it is found from any working directory."""
    return str(Path(text).resolve()) if is_config_path(text) or Path(text).exists() else text


def _vehicle_file(simulation: AugmentedSimulation, base: VehicleSimulation) -> str:
    path, data = read_config("vehicle", base.vehicle_file, VehicleError)
    section = dict(data["simulation"])
    coefficients = base.model.coefficients
    section["rotor_local"] = {
        name: getattr(coefficients, name)
        if isinstance(getattr(coefficients, name), float)
        else getattr(coefficients, name).tolist()
        for name in RotorLocalCoefficients.__dataclass_fields__
    }
    section["effects"] = {name: dict(values) for name, values in simulation.effects.items()}
    text: str = yaml.safe_dump(
        {**data, "simulation": section}, sort_keys=False, default_flow_style=None, width=110
    )
    head = (
        f"# {path.name} with what flights showed to be missing; coefficients moved within their tolerances."
    )
    return f"{head}\n{text}"
