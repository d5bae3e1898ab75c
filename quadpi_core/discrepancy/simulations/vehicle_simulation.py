# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""quadpi's own simulation: the rotor-local aerodynamics of a vehicle file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from quadpi_core.discrepancy.simulations.simulation_base import (
    Column,
    Simulation,
    Tolerances,
    airspeed,
    read_tolerances,
)
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.simulation.rotor_local import RotorLocalCoefficients, RotorLocalModel
from quadpi_core.vehicle import Vehicle

# The columns of tolerances, by name: coefficients that one factor scales, and of these the first (at rest in
# the air), all but the first, or all.
_SCALED = {
    "thrust": ("thrust", slice(0, 1)),
    "torque": ("torque", slice(0, 1)),
    "thrust in airflow": ("thrust", slice(1, None)),
    "torque in airflow": ("torque", slice(1, None)),
    **{
        name: (name, slice(None))
        for name in (
            *("rotor_force_along", "rotor_force_across", "rotor_moment_along", "rotor_moment_across"),
            *("airframe_fx", "airframe_fy", "airframe_fz", "airframe_mx", "airframe_my", "airframe_mz"),
        )
    },
}


@dataclass(frozen=True)
class VehicleSimulation(Simulation):
    """quadpi's own simulation: rotor-local aerodynamics of a vehicle file, without effects."""

    model: RotorLocalModel
    tolerances: Tolerances = field(default_factory=Tolerances)
    vehicle_file: str = ""
    memoryless: ClassVar[bool] = True

    @classmethod
    def load(cls, name_or_path: str | Path) -> VehicleSimulation:
        """Read a vehicle file with the section `simulation`; its effects are left to `load_simulation`.

        Raises:
            VehicleError: naming the file and the key that is missing, unknown or impossible.
            SimulationError: likewise, of tolerances.
        """
        model, tolerances = RotorLocalModel.load(name_or_path), read_tolerances(name_or_path)
        return cls(model, tolerances, str(name_or_path))

    @property
    def name(self) -> str:  # type: ignore[override]
        """Of the vehicle file."""
        return self.model.vehicle.name

    @property
    def vehicle(self) -> Vehicle:  # type: ignore[override]
        """As in the vehicle file."""
        return self.model.vehicle

    @property
    def hover_rotor_speed(self) -> float:
        """See :class:`Simulation`."""
        return self.model.hover_rotor_speed

    def wrench(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        return self._wrench(self.model, flight)

    def thrusts(self, flight: Flight) -> tuple[Array, Array]:
        """See :class:`Simulation`."""
        states = self.model.states(airspeed(flight), flight.rates, flight.rotor_speeds)
        return states["thrusts"].copy(), states["torques"].copy()

    def record(self) -> npt.NDArray[np.void]:
        """See :class:`Simulation`; with the aerodynamics, as rotors have forces in their plane, too."""
        return self.model.record()

    def uncertain(self, flight: Flight) -> list[Column]:
        """One factor on each kind of coefficient; thrust and torque at rest have one of their own."""
        base = self.wrench(flight)
        return [
            Column(name, (self._wrench(self._scaled({name: 1.0}), flight) - base) * self._tolerance(name))
            for name in _SCALED
        ]

    def adjusted(self, multiples: Mapping[str, float]) -> VehicleSimulation:
        """The simulation with other coefficients: each column of tolerances times a multiple, by its name."""
        shares = {name: self._tolerance(name) * multiple for name, multiple in multiples.items()}
        return replace(self, model=self._scaled(shares))

    def _tolerance(self, name: str) -> float:
        return self.tolerances.thrust if name == "thrust" else self.tolerances.coefficient

    def _scaled(self, shares: Mapping[str, float]) -> RotorLocalModel:
        """The model with each named group of coefficients grown by a share."""
        changed: dict[str, Any] = dict(vars(self.model.coefficients))
        for name, share in shares.items():
            key, part = _SCALED[name]
            value = np.array(changed[key], dtype=float, ndmin=1)
            value[part] *= 1.0 + share
            changed[key] = value if np.ndim(changed[key]) else float(value[0])
        return replace(self.model, coefficients=RotorLocalCoefficients(**changed))

    @staticmethod
    def _wrench(model: RotorLocalModel, flight: Flight) -> Array:
        return model.wrench(airspeed(flight), flight.rates, flight.rotor_speeds)
