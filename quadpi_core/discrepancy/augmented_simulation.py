# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A simulation with effects added to it: again a simulation, made and written by a search."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
import yaml

from quadpi_core.config_schema import is_config_path
from quadpi_core.discrepancy.discrepancy_result import Discovery
from quadpi_core.discrepancy.effect_regression import Regression
from quadpi_core.discrepancy.effect_response import body_tolerances, predicted_flight, without_sensor_effect
from quadpi_core.discrepancy.evidence import Fit
from quadpi_core.discrepancy.simulations import Column, Simulation, VehicleSimulation, attribute_of
from quadpi_core.discrepancy.unmeasured_states import BiasResponse, OwnStates, started
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES, Flight
from quadpi_core.frames import Array
from quadpi_core.records import brief_repr
from quadpi_core.signals.chain import interpolate_columns
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.applied_effects import (
    EFFECTS,
    added_wind,
    altered_vehicle,
    effect_wrench,
    with_memory,
)
from quadpi_core.simulation.effect_definition import Effect, Effects
from quadpi_core.simulation.simulated_file import vehicle_content
from quadpi_core.vehicle import Vehicle
from quadpi_core.version import __version__


@dataclass(frozen=True)
class AugmentedSimulation(Simulation):
    """A simulation with effects that it lacked.

    Effects act on the wrench, on the vehicle or on the air. The errors of sensors are removed from a flight
    before the simulation gets it.

    Attributes:
        base: simulation that the effects are added to.
        effects: every parameter of each effect.
        adjusted: multiples of the columns of the base's tolerances, by their names.
        track: state that an effect has of its own, where bodies depart from a recorded flight; unless given,
            it is followed along each flight.
    """

    __repr__ = brief_repr

    base: Simulation
    effects: Effects
    adjusted: Mapping[str, float] = field(default_factory=dict)
    track: OwnStates | None = None

    tolerances = attribute_of("base.tolerances")
    vehicle_file = attribute_of("base.vehicle_file")
    code = attribute_of("base.code")
    sound = attribute_of("base.sound")
    own_inputs = attribute_of("base.own_inputs")
    # The coefficients of effects refer to the hover of the base.
    hover_rotor_speed = attribute_of("base.hover_rotor_speed")
    loads = attribute_of("base.loads")
    recorded = attribute_of("base.recorded")
    margins = attribute_of("base.margins")
    unjudged = attribute_of("base.unjudged")
    identified_on = attribute_of("base.identified_on")

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the base and of the effects."""
        return " + ".join((self.base.name, *self.effects))

    @property
    def memoryless(self) -> bool:  # type: ignore[override]
        """As the base, but not with effects on sensors, whose change depends on the whole flight."""
        return self.base.memoryless and not self._of("sensor")

    @property
    def reads_accelerations(self) -> bool:  # type: ignore[override]
        """As the base, but a state that an effect has of its own follows the measured force."""
        return self.base.reads_accelerations or any(e.at_rest or e.kind == "sensor" for e in self._of())

    @cached_property
    def vehicle(self) -> Vehicle:  # type: ignore[override]
        """The vehicle with the effects on it."""
        return altered_vehicle(self.effects, self.base.vehicle)

    @cached_property
    def physical(self) -> AugmentedSimulation:
        """The simulation without effects on sensors, for flights as :meth:`corrected`."""
        return self._without(*self._of("sensor"))

    def corrected(self, flight: Flight) -> Flight:
        """The flight as sensors without errors would have reported it."""
        biases = BiasResponse(flight, self.vehicle, flight.rate_hz)
        for effect in reversed(self._of("sensor")):
            flight = without_sensor_effect(flight, effect, self.vehicle, self._values(effect), biases)
        return flight

    def wrench(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        wrench = self._physics(flight)["wrench"]
        if not self._of("sensor"):
            return wrench
        known = self.learned([(flight, flight)])
        seen = predicted_flight(flight, self.vehicle, self.recorded(flight, wrench))
        same = None if self.physical.reads_accelerations else wrench
        return wrench + known._left(seen, same) - known._left(self.corrected(seen))

    def states(self, flight: Flight) -> npt.NDArray[np.void]:
        """See :class:`Simulation`; with the effects in the wrench."""
        corrected = self.corrected(flight)
        return self.answering(flight, corrected)._physics(corrected)

    def record(self) -> npt.NDArray[np.void]:
        """See :class:`Simulation`; quantities that effects refer to stay those of the base."""
        record, altered = self.base.record(), super().record()
        for name in ("mass", "inertia", "inverse_inertia"):
            record[name] = altered[name]
        return record

    def explained(self, flight: Flight) -> Array:
        """See :class:`Simulation`; the base's part without noise."""
        if not self.own_inputs:
            return self.wrench(flight)
        return self.wrench(flight) - self.base.wrench(flight) + self.base.explained(flight)

    def learned(self, flights: Sequence[tuple[Flight, Flight]]) -> AugmentedSimulation:
        """See :class:`Simulation`; the base."""
        return self._on(self.base.learned(flights))

    def answering(self, flight: Flight, corrected: Flight) -> AugmentedSimulation:
        """See :class:`Simulation`; the base."""
        return self._on(self.base.answering(flight, corrected))

    def with_coefficients(self, multiples: Mapping[str, float]) -> AugmentedSimulation:
        """See :class:`Simulation`; the base."""
        return self._on(self.base.with_coefficients(multiples))

    def _on(self, base: Simulation) -> AugmentedSimulation:
        return self if base is self.base else replace(self, base=base)

    def uncertain(self, flight: Flight) -> list[Column]:
        """Columns of the base, and one per effect and axis for the error of its law."""
        columns, whole = self.base.uncertain(self._in_wind(flight)), self.wrench(flight)
        for effect in self._of():
            if effect.kind != "vehicle":
                share = max(effect.form, self.tolerances.coefficient)
                added = share * (whole - self._without(effect).wrench(flight))
                # Every flight must have the same columns, even one without the effect.
                only = {axis: added * (np.array(AXES) == axis) for axis in effect.axes}
                columns += [Column(f"{axis} of {effect.name}", wrench) for axis, wrench in only.items()]
        return columns

    def departing_from(self, flight: Flight) -> AugmentedSimulation:
        """The simulation for bodies that start in states of a flight and go their own ways.

        A load swings as it did in the flight: what a body's own way changes of that is small over a second.
        """
        for effect in self._of("wrench"):
            if effect.at_rest:
                states = self._remembering(effect, flight, self._without(effect)._physics(flight))
                return replace(self, track=OwnStates(flight.time, states["memory"]))
        return self

    def _physics(self, flight: Flight) -> npt.NDArray[np.void]:
        """Records STATE (N,) with the wrench of the base and all effects except those on sensors."""
        base, moved = self.base.learned([(flight, flight)]), self._in_wind(flight)
        states = base.states(moved)
        if self.own_inputs and self._of("wind"):
            # What was recorded is of the wind as it was known.
            states["wrench"] += base.explained(moved) - base.explained(flight)
        columns = {own.name: own.wrench for own in base.uncertain(moved)} if self.adjusted else {}
        for name, multiple in self.adjusted.items():
            if name not in columns:
                raise DiscrepancyError(
                    f"{self.name}: no coefficient is named `{name}`: make the addition anew"
                )
            states["wrench"] += multiple * columns[name]
        record = self.record()
        for effect in self._of("wrench"):
            own = self._remembering(effect, moved, states) if effect.at_rest else states
            states["wrench"] += effect_wrench(effect.name, self.effects[effect.name], own, record)
        return states

    def _remembering(
        self, effect: Effect, flight: Flight, states: npt.NDArray[np.void]
    ) -> npt.NDArray[np.void]:
        """States (N,) with the state that an effect has of its own along the flight."""
        own = states.copy()
        if self.track is not None:
            own["memory"] = interpolate_columns(*self.track, flight.time)
            return own
        measured = measured_wrench(flight, self.vehicle)
        own["wrench"][:, :3], own["force_is_measured"] = measured[:, :3], 1.0
        step_s, record, left = 1.0 / flight.rate_hz, self.record(), measured - states["wrench"]
        start = started(effect, self._values(effect), own, record, left, step_s).memory
        return with_memory(effect.name, self.effects[effect.name], own, record, start, step_s)

    def _left(self, flight: Flight, wrench: Array | None = None) -> Array:
        """Measured less simulated wrench (N, 6), without the effects on sensors."""
        wrench = self._physics(flight)["wrench"] if wrench is None else wrench
        left: Array = measured_wrench(flight, self.vehicle) - wrench
        return left + self.base.wrench(flight) - self.base.explained(flight) if self.own_inputs else left

    def _in_wind(self, flight: Flight) -> Flight:
        if not self._of("wind"):
            return flight
        # Only gusts need random numbers, and no search looks for gusts.
        added = added_wind(self.effects, flight.time, np.random.default_rng(0))
        return replace(flight, wind=flight.wind + added)

    def _of(self, kind: str = "") -> list[Effect]:
        """The effects, or those of one kind, in the order in which they act."""
        return [e for e in EFFECTS.values() if e.name in self.effects and kind in ("", e.kind)]

    def _without(self, *effects: Effect) -> AugmentedSimulation:
        left_out = {effect.name for effect in effects}
        kept = {name: values for name, values in self.effects.items() if name not in left_out}
        return replace(self, effects=kept)

    def _values(self, effect: Effect) -> Array:
        return np.array([self.effects[effect.name][parameter.name] for parameter in effect.parameters])


def augmented(discovery: Discovery, without: int | None = None) -> AugmentedSimulation:
    """The simulation with the effects that were found, and with adjusted coefficients.

    Coefficients are adjusted, by their posterior means, where that helps on flights left out, and the
    discovery does not say otherwise. The flight at the index `without` has no part in the fit.

    Raises:
        DiscrepancyError: where an effect cannot be added to one that the simulation already has.
    """
    found = discovery.found
    regression = found.regression
    simulation = regression.flights[0].simulation
    law, fitted = found.closing.fits(without)
    effects: Effects = {}
    for index in found.chosen:
        candidate = regression.candidates[index]
        own = _named(candidate.name, candidate.values(regression.parameters(index, law)))
        effects = {**effects, candidate.name: own | found.closing.shape(index, law, fitted)}
    if without is not None:
        effects = _with_own(effects, regression, without, law)
    adjusted: dict[str, float] = {}
    if discovery.adjusted:
        adjusted = dict(zip(regression.tolerances.names, regression.moved_by(fitted).tolist(), strict=True))
        # What is uncertain in the body are small effects rather than coefficients of the simulation.
        for effect, deviation in body_tolerances(simulation):
            moved = [deviation * adjusted.pop(f"{effect.name}.{p.name}") for p in effect.parameters]
            small = _named(effect.name, moved)
            effects = merged({effect.name: small}, effects) if any(small.values()) else effects
    return _added(simulation, effects, adjusted)


def as_it_was(discovery: Discovery, place: int) -> Simulation:
    """The simulation as it is, with what one flight has of its own."""
    regression = discovery.found.regression
    simulation = regression.flights[0].simulation
    own = _with_own({}, regression, place, discovery.found.closing.fits(place)[0])
    return _added(simulation, own, {}) if own else simulation


def _with_own(shared: Effects, regression: Regression, place: int, law: Fit) -> Effects:
    """Effects that all flights share with what one has of its own, given a fit to the others."""
    effects: Effects = {}
    for condition in regression.conditions:
        candidate = regression.candidates[condition.index]
        own = candidate.values(regression.of_condition(condition, place, law)[0])
        # Less than the others have is possible, less than nothing is not.
        pairs = zip(candidate.effect.parameters, own.tolist(), strict=True)
        raw = {p.name: value for p, value in pairs if candidate.name in shared}
        effects = {**effects, candidate.name: raw or _named(candidate.name, own)}
    return merged(shared, effects)


def _named(name: str, values: Iterable[float]) -> dict[str, float]:
    pairs = zip(EFFECTS[name].parameters, values, strict=True)
    return {p.name: float(min(max(value, p.lowest), p.highest)) for p, value in pairs}


def merged(one: Effects, other: Effects) -> Effects:
    """Union of two sets of effects, in the order in which they act; effects in both are added.

    Raises:
        DiscrepancyError: for two of a kind that do not add up: of different rotors, or tethers.
    """
    both = {**one, **other}
    both |= {name: _sum(EFFECTS[name], one[name], other[name]) for name in one.keys() & other.keys()}
    return {name: both[name] for name in EFFECTS if name in both}


def _sum(effect: Effect, one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    """One effect that acts as two of a kind do."""
    fixed = {p.name: one[p.name] for p in effect.parameters if p.whole}
    if not effect.composable or any(other[name] != value for name, value in fixed.items()):
        raise DiscrepancyError(
            f"effect `{effect.name}`: the simulation has one already, and a second one cannot be added to it"
        )
    # Changes of a moment of inertia are multiplied: the second refers to the result of the first.
    shares = effect.kind == "vehicle"
    pairs = [(p, one[p.name], other[p.name]) for p in effect.parameters]
    added = _named(effect.name, [a + b + (a * b if shares and not p.unit else 0.0) for p, a, b in pairs])
    # The shape of its law is the mean of theirs, weighted by their parts in the sum.
    parts = np.array([[a, b] for p, a, b in pairs if not p.whole])
    parts /= np.array([[abs(p.default) or 1.0] for p in effect.parameters if not p.whole])
    total = parts.sum(axis=1)
    weights = total @ parts / max(float(total @ total), np.finfo(float).tiny)
    for p in effect.shape:
        shape = float(weights @ [one.get(p.name, 0.0), other.get(p.name, 0.0)])
        if shape:
            added[p.name] = min(max(shape, p.lowest), p.highest)
    return added | fixed


def _added(simulation: Simulation, effects: Effects, adjusted: Mapping[str, float]) -> AugmentedSimulation:
    """A simulation, which may have effects already, with more of them and adjusted coefficients."""
    before: Mapping[str, float] = {}
    if isinstance(simulation, AugmentedSimulation):
        # A simulation has no parameter for the error of the laws of its earlier effects.
        of_laws = tuple(f" of {effect}" for effect in simulation.effects)
        adjusted = {name: value for name, value in adjusted.items() if not name.endswith(of_laws)}
        effects, before = merged(simulation.effects, effects), simulation.adjusted
        simulation = simulation.base
    # A fit to noise may exceed what is possible on the vehicle.
    for name, parameters in effects.items():
        feasible = EFFECTS[name].feasible
        if feasible is not None:
            values = feasible(simulation.vehicle, np.array(list(parameters.values())))
            effects = {**effects, name: _named(name, values)}
    if isinstance(simulation, VehicleSimulation):
        return AugmentedSimulation(simulation.with_coefficients(adjusted), effects)
    both = {name: before.get(name, 0.0) + adjusted.get(name, 0.0) for name in sorted({*before, *adjusted})}
    return AugmentedSimulation(simulation, effects, both)


def write_addition(discovery: Discovery, folder: Path) -> Path | None:
    """Write the simulation with the effects that were found into a folder that exists.

    For a vehicle file it is a vehicle file of the same name with `simulation.effects`; for any other
    simulation an `addition.json` that refers to it and loads in its place. Nothing is written with any other
    verdict than "effects".

    Raises:
        DiscrepancyError: where an effect cannot be added to one that the simulation already has.
    """
    if not discovery.added:
        return None
    simulation = augmented(discovery)
    base, effects = simulation.base, {name: dict(values) for name, values in simulation.effects.items()}
    if isinstance(base, VehicleSimulation):
        path = folder / f"{simulation.vehicle.name}.yaml"
        name, data = vehicle_content(base.vehicle_file)
        section = {**data["simulation"], base.model.key: base.model.to_section(), "effects": effects}
        text = yaml.safe_dump(
            {**data, "simulation": section}, sort_keys=False, default_flow_style=None, width=110
        )
        head = f"# {name} with what flights showed to be missing; coefficients moved within their tolerances."
        path.write_text(f"{head}\n{text}")
    else:
        path = folder / "addition.json"
        data = {
            "simulation": _absolute(base.name),
            "vehicle": _absolute(base.vehicle_file or simulation.vehicle.name),
            "effects": effects,
            "adjusted": simulation.adjusted,
            "version": __version__,
        }
        path.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n")
    return path


def _absolute(text: str) -> str:
    """A name, or the absolute path of a file or folder, so that it is found from any working directory."""
    return str(Path(text).resolve()) if is_config_path(text) or Path(text).exists() else text
