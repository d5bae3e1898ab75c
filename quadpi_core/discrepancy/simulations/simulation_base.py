# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a flight is compared with: a simulation gives the wrench of a flight as it was flown.

Any simulation will do; :class:`Simulation` says what the search for discrepancies asks of one. What a
simulation is known to be uncertain in by itself is stated as tolerances: each is a column of wrench that one
standard deviation of a coefficient makes. A discrepancy is what these cannot explain.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.config import read_config
from quadpi_core.errors import DiscrepancyError, VehicleError
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.inputs import relative_to_air
from quadpi_core.simulation.config_section import Section
from quadpi_core.simulation.rotor_local import vehicle_record
from quadpi_core.simulation.state_records import STATE
from quadpi_core.vehicle import Vehicle


@dataclass(frozen=True)
class Tolerances:
    """One standard deviation of what a simulation is known to be uncertain in.

    Attributes:
        thrust: share of the thrust of rotors at rest in the air, of all alike and of each by itself.
        coefficient: share of every other coefficient.
        inertia: share of each moment of inertia.
        cg_m: of the centre of gravity along each axis.
    """

    thrust: float = 0.01
    coefficient: float = 0.1
    inertia: float = 0.02
    cg_m: float = 0.0003

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 <= value < np.inf:
                raise DiscrepancyError(f"tolerance `{name}` must not be negative, found {value}")


def read_tolerances(vehicle: str | Path) -> Tolerances:
    """Tolerances of a vehicle file, its mapping `simulation.tolerances`; the usual ones where it has none.

    Raises:
        VehicleError: if there is no such file.
        SimulationError: naming the file and the key that is unknown or impossible.
    """
    path, data = read_config("vehicle", vehicle, VehicleError)
    given = (data.get("simulation") or {}).get("tolerances") or {} if isinstance(data, dict) else {}
    known = [column.name for column in fields(Tolerances)]
    section = Section(given, f"{path}: simulation.tolerances", known)
    return Tolerances(**{key: section.number(key, highest=1.0) for key in known if key in section})


class Column(NamedTuple):
    """Wrench (N, 6) that one standard deviation of a named uncertainty adds."""

    name: str
    wrench: Array


class Simulation(ABC):
    """A simulation of one vehicle.

    Attributes:
        name: for people.
        vehicle: as the simulation has it.
        vehicle_file: name or path that the vehicle was read from; empty where it was not.
        tolerances: what it is known to be uncertain in.
        code: that gives its answers and is no part of quadpi: which function, of which file, and what named
            it; empty without such code.
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
        """Wrench (N, 6) [N, Nm], body axes, gravity not included, of a flight as it was flown.

        Raises:
            DiscrepancyError: where the simulation gives no such wrench.
        """

    @abstractmethod
    def uncertain(self, flight: Flight) -> list[Column]:
        """A column for each aerodynamic coefficient of the vehicle that is known within a tolerance."""

    @abstractmethod
    def thrusts(self, flight: Flight) -> tuple[Array, Array]:
        """Thrusts (N, 4) N along -z and torques (N, 4) Nm about z of the rotors, without any effect."""

    @property
    @abstractmethod
    def hover_rotor_speed(self) -> float:
        """Rotor speed [rad/s] that carries the weight in still air."""

    def states(self, flight: Flight) -> npt.NDArray[np.void]:
        """Records `simulation.state_records.STATE` (N,): what an effect looks at."""
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
        """`state_records.VEHICLE` (1,) of what effects look at; aerodynamics where known."""
        return vehicle_record(self.vehicle, self.hover_rotor_speed)


def airspeed(flight: Flight) -> Array:
    """Velocity (N, 3) m/s relative to the air, body axes."""
    velocity: Array = relative_to_air(flight.velocity, flight.attitude, flight.wind)
    return velocity
