# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations that give the wrench of a flight: the interface of any simulation, and quadpi's own.

The search for discrepancies needs of a simulation what :class:`Simulation` declares. The known uncertainty of
its coefficients is stated as tolerances: each is a column of wrench, the change by one standard deviation of
    a
coefficient. A discrepancy is a difference that no coefficient within its tolerance explains.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import Section, Share, parse_config
from quadpi_core.errors import DiscrepancyError, VehicleError
from quadpi_core.flight import AXES, Flight
from quadpi_core.frames import Array
from quadpi_core.inputs import relative_to_air
from quadpi_core.simulation.rotor_local import (
    RotorLocalCoefficients,
    RotorLocalModel,
    read_simulation,
    vehicle_record,
)
from quadpi_core.simulation.state_records import STATE
from quadpi_core.vehicle import Vehicle


@dataclass(frozen=True)
class Tolerances(Section):
    """Standard deviations of the coefficients of a simulation.

    Attributes:
        thrust: share of the static thrust of rotors, of all together and of each.
        coefficient: share of every other coefficient.
        inertia: share of each moment of inertia.
        cg_m: position of the centre of gravity along each axis.
    """

    thrust: Share = 0.01
    coefficient: Share = 0.1
    inertia: Share = 0.02
    cg_m: Share = 0.0003

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 <= value < np.inf:
                raise DiscrepancyError(f"tolerance `{name}` must not be negative, found {value}")


def read_tolerances(vehicle: str | Path) -> Tolerances:
    """Tolerances of a vehicle file, its mapping `simulation.tolerances`; the usual ones where it has none.

    Raises:
        VehicleError: naming the file and the key that is unknown or impossible.
    """
    path, section = read_simulation(vehicle)
    given = {} if section.tolerances is None else section.tolerances
    return parse_config(Tolerances, given, str(path), VehicleError, ("simulation", "tolerances"))


class Column(NamedTuple):
    """Change of the wrench (N, 6) by one standard deviation of a named uncertainty."""

    name: str
    wrench: Array


def axis_columns(parts: Mapping[str, Array], tolerances: Tolerances) -> list[Column]:
    """One column per part (N, 6) of a wrench and axis; the part `rotors` has the thrust as its Fz."""
    columns = []
    for part, wrench in parts.items():
        for axis, name in enumerate(AXES):
            share = tolerances.thrust if (part, name) == ("rotors", "Fz") else tolerances.coefficient
            single = np.zeros_like(wrench)
            single[:, axis] = share * wrench[:, axis]
            columns.append(Column(f"{name} of {part}", single))
    return columns


class Simulation(ABC):
    """A simulation of one vehicle.

    Attributes:
        name: name for people.
        vehicle: vehicle of the simulation.
        vehicle_file: name or path that the vehicle was read from; empty where it was not.
        tolerances: known uncertainty of its coefficients.
        code: the user's code that it runs: the function, its file, and the file that named it; empty without.
        memoryless: whether the wrench at an instant depends on that instant alone.
    """

    name: str
    vehicle: Vehicle
    vehicle_file: str = ""
    tolerances: Tolerances
    code: str = ""
    memoryless: ClassVar[bool] = False

    @abstractmethod
    def wrench(self, flight: Flight) -> Array:
        """Wrench (N, 6) [N, Nm] of a flight, body axes, gravity not included.

        Raises:
            DiscrepancyError: where the simulation gives no such wrench.
        """

    @abstractmethod
    def uncertain(self, flight: Flight) -> list[Column]:
        """Columns of the tolerances of aerodynamic coefficients."""

    @abstractmethod
    def thrusts(self, flight: Flight) -> tuple[Array, Array]:
        """Thrusts (N, 4) N along -z and torques (N, 4) Nm about z of the rotors, without effects."""

    @property
    @abstractmethod
    def hover_rotor_speed(self) -> float:
        """Rotor speed [rad/s] that carries the weight in still air."""

    def states(self, flight: Flight) -> npt.NDArray[np.void]:
        """Records `simulation.state_records.STATE` (N,), the input of effects."""
        states = np.zeros(len(flight), dtype=STATE)
        states["position"], states["attitude"] = flight.position, flight.attitude
        velocity = airspeed(flight)
        states["velocity_air"], states["rates"] = velocity, flight.rates
        states["rotor_speeds"] = flight.rotor_speeds
        states["rotor_accelerations"] = np.gradient(flight.rotor_speeds, flight.time, axis=0)
        states["hub_velocity"] = velocity[:, None] + np.cross(
            flight.rates[:, None], self.vehicle.rotor_positions[None]
        )
        states["thrusts"], states["torques"] = self.thrusts(flight)
        states["wrench"] = self.wrench(flight)
        return states

    def record(self) -> npt.NDArray[np.void]:
        """Record `state_records.VEHICLE` (1,), the input of effects; aerodynamics where known."""
        return vehicle_record(self.vehicle, self.hover_rotor_speed)


def airspeed(flight: Flight) -> Array:
    """Velocity (N, 3) m/s relative to the air, body axes."""
    velocity: Array = relative_to_air(flight.velocity, flight.attitude, flight.wind)
    return velocity


# Coefficients that one factor scales, by the name of their column: the first (static), all others, or all.
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
        """See :class:`Simulation`; with the aerodynamics, for effects on forces in the rotor plane."""
        return self.model.record()

    def uncertain(self, flight: Flight) -> list[Column]:
        """One factor on each kind of coefficient, and separate ones on static thrust and torque."""
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
