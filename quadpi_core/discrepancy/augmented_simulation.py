# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A simulation with effects added to it: again a simulation, to compare with and to search on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from quadpi_core.discrepancy.bias_response import BiasResponse
from quadpi_core.discrepancy.effect_response import predicted_flight, without_sensor_effect
from quadpi_core.discrepancy.simulations import Column, Simulation, Tolerances
from quadpi_core.flight import AXES, Flight
from quadpi_core.frames import Array
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.applied_effects import added_wind, altered_vehicle, effect_wrench
from quadpi_core.simulation.effect_definition import Effect, Effects
from quadpi_core.simulation.effect_registry import EFFECTS
from quadpi_core.vehicle import Vehicle


@dataclass(frozen=True)
class AugmentedSimulation(Simulation):
    """A simulation and what it lacked.

    Effects of every kind act where they belong: on the wrench, on the vehicle, on the air, and, for sensors,
    on what a flight reports, which is corrected before the simulation sees it.

    Attributes:
        base: that the effects are added to.
        effects: every parameter of each.
        adjusted: multiples of the columns of the base's tolerances, by their names.
    """

    base: Simulation
    effects: Effects
    adjusted: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the base and of the effects."""
        return " + ".join((self.base.name, *self.effects))

    @property
    def code(self) -> str:  # type: ignore[override]
        """Of the base."""
        return self.base.code

    @property
    def vehicle_file(self) -> str:  # type: ignore[override]
        """Of the base."""
        return self.base.vehicle_file

    @property
    def tolerances(self) -> Tolerances:  # type: ignore[override]
        """Of the base."""
        return self.base.tolerances

    @property
    def memoryless(self) -> bool:  # type: ignore[override]
        """As the base, but not with effects on sensors: what they change depends on the whole flight."""
        return self.base.memoryless and not self._of("sensor")

    @cached_property
    def vehicle(self) -> Vehicle:  # type: ignore[override]
        """The vehicle with the effects on it."""
        return altered_vehicle(self.effects, self.base.vehicle)

    @property
    def hover_rotor_speed(self) -> float:
        """Rotor speed of the base, which the coefficients of effects refer to."""
        return self.base.hover_rotor_speed

    @cached_property
    def physical(self) -> AugmentedSimulation:
        """Without the effects on sensors: the simulation of flights as :meth:`corrected`."""
        return replace(self, effects={e.name: self.effects[e.name] for e in self._of() if e.kind != "sensor"})

    def corrected(self, flight: Flight) -> Flight:
        """The flight as sensors without the effects on them would have reported it."""
        biases = BiasResponse(flight, self.vehicle, flight.rate_hz)
        for effect in reversed(self._of("sensor")):
            flight = without_sensor_effect(flight, effect, self.vehicle, self._values(effect), biases)
        return flight

    def wrench(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        wrench = self._physics(flight)["wrench"]
        if not self._of("sensor"):
            return wrench
        seen = predicted_flight(flight, self.physical)
        corrected = self.corrected(seen)
        return wrench + self._left(seen) - self._left(corrected)

    def states(self, flight: Flight) -> npt.NDArray[np.void]:
        """See :class:`Simulation`; with the effects in the wrench."""
        return self._physics(self.corrected(flight))

    def thrusts(self, flight: Flight) -> tuple[Array, Array]:
        """See :class:`Simulation`: those of the base."""
        return self.base.thrusts(self._in_wind(flight))

    def record(self) -> npt.NDArray[np.void]:
        """See :class:`Simulation`; what coefficients of effects refer to stays that of the base."""
        record = self.base.record()
        for name in ("mass", "inertia", "inverse_inertia"):
            record[name] = super().record()[name]
        return record

    def uncertain(self, flight: Flight) -> list[Column]:
        """Columns of the base, and one per effect and axis for a law that may be off."""
        columns = self.base.uncertain(self._in_wind(flight))
        whole = self.wrench(flight)
        for effect in self._of():
            if effect.kind == "vehicle":
                continue
            others = {name: values for name, values in self.effects.items() if name != effect.name}
            share = max(effect.form, self.tolerances.coefficient)
            added = share * (whole - replace(self, effects=others).wrench(flight))
            for axis, name in enumerate(AXES):
                # Every flight must have the same columns, also one that the effect does not act on.
                if name in effect.axes:
                    single = np.zeros_like(added)
                    single[:, axis] = added[:, axis]
                    columns.append(Column(f"{name} of {effect.name}", single))
        return columns

    def _physics(self, flight: Flight) -> npt.NDArray[np.void]:
        """Records STATE (N,) with the wrench of the base and all effects except those on sensors."""
        flight = self._in_wind(flight)
        states = self.base.states(flight)
        if self.adjusted:
            for name, wrench in self.base.uncertain(flight):
                states["wrench"] += self.adjusted.get(name, 0.0) * wrench
        record = self.record()
        for effect in self._of("wrench"):
            states["wrench"] += effect_wrench(effect.name, self.effects[effect.name], states, record)
        return states

    def _left(self, flight: Flight) -> Array:
        """Measured less simulated wrench (N, 6), without the effects on sensors."""
        left: Array = measured_wrench(flight, self.vehicle) - self._physics(flight)["wrench"]
        return left

    def _in_wind(self, flight: Flight) -> Flight:
        if not self._of("wind"):
            return flight
        # Only gusts need random numbers, and no search looks for gusts.
        added = added_wind(self.effects, flight.time, np.random.default_rng(0))
        return replace(flight, wind=flight.wind + added)

    def _of(self, kind: str = "") -> list[Effect]:
        """The effects, or those of one kind, in the order in which they act."""
        return [e for e in EFFECTS.values() if e.name in self.effects and kind in ("", e.kind)]

    def _values(self, effect: Effect) -> Array:
        return np.array([self.effects[effect.name][parameter.name] for parameter in effect.parameters])
