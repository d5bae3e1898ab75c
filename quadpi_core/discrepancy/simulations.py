# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a flight is compared with: a simulation gives the wrench of a flight as it was flown.

Any simulation will do; :class:`Simulation` says what the search for discrepancies asks of one. What a
simulation is known to be uncertain in by itself is stated as tolerances: each is a column of wrench that one
standard deviation of a coefficient makes. A discrepancy is what these cannot explain.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES, Flight
from quadpi_core.frames import Array
from quadpi_core.inputs import relative_to_air
from quadpi_core.simulation.linear import inverse
from quadpi_core.simulation.records import STATE, VEHICLE
from quadpi_core.simulation.rotor_local import RotorLocalModel, airframe_area
from quadpi_core.vehicle import ROTORS, Vehicle

_AIRFRAME = ("airframe_fx", "airframe_fy", "airframe_fz", "airframe_mx", "airframe_my", "airframe_mz")


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


class Column(NamedTuple):
    """Wrench (N, 6) that one standard deviation of a named uncertainty adds."""

    name: str
    wrench: Array


class Simulation(ABC):
    """A simulation of one vehicle.

    Attributes:
        name: for people.
        vehicle: as the simulation has it.
        tolerances: what it is known to be uncertain in.
        memoryless: whether the wrench at an instant depends on that instant alone.
    """

    name: str
    vehicle: Vehicle
    tolerances: Tolerances
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
        """Records `simulation.records.STATE` (N,): what an effect looks at."""
        states = np.zeros(len(flight), dtype=STATE)
        states["position"], states["attitude"] = flight.position, flight.attitude
        velocity = relative_to_air(flight.velocity, flight.attitude, flight.wind)
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
        """Record `simulation.records.VEHICLE` (1,) with what effects look at; no aerodynamics."""
        vehicle = self.vehicle
        record = np.zeros(1, dtype=VEHICLE)
        for name, value in {
            "mass": vehicle.mass_kg,
            "gravity": vehicle.gravity_m_s2,
            "air_density": vehicle.air_density_kg_m3,
            "inertia": vehicle.inertia,
            "inverse_inertia": inverse(vehicle.inertia),
            "rotor_positions": vehicle.rotor_positions,
            "rotor_spins": vehicle.rotor_spins,
            "rotor_radius": vehicle.rotor_radius_m,
            "hover_induced_velocity": vehicle.hover_induced_velocity,
            "hover_rotor_speed": self.hover_rotor_speed,
            "motor_time_constant": np.inf,
            "rotor_speed_max": vehicle.rotor_speed_max_rad_s,
            "airframe_area": airframe_area(vehicle),
        }.items():
            record[name] = value
        return record


@dataclass(frozen=True)
class VehicleSimulation(Simulation):
    """quadpi's own simulation: rotor-local aerodynamics of a vehicle file."""

    model: RotorLocalModel
    tolerances: Tolerances = Tolerances()
    memoryless: ClassVar[bool] = True

    @classmethod
    def load(cls, name_or_path: str | Path) -> VehicleSimulation:
        """Read a vehicle file with the section `simulation`.

        Raises:
            VehicleError: naming the file and the key that is missing, unknown or impossible.
        """
        return cls(RotorLocalModel.load(name_or_path))

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
        states = self.model.states(_airspeed(flight), flight.rates, flight.rotor_speeds)
        return states["thrusts"].copy(), states["torques"].copy()

    def uncertain(self, flight: Flight) -> list[Column]:
        """One factor on each kind of coefficient; thrust and torque at rest have one of their own."""
        base = self.wrench(flight)
        tolerances, coefficients = self.tolerances, self.model.coefficients

        def column(name: str, share: float, **scaled: Any) -> Column:
            model = replace(self.model, coefficients=replace(coefficients, **scaled))
            return Column(name, (self._wrench(model, flight) - base) * share)

        at_rest = np.zeros(len(coefficients.thrust))
        at_rest[0] = 1.0
        columns = [
            column("thrust", tolerances.thrust, thrust=coefficients.thrust * (1.0 + at_rest)),
            column("torque", tolerances.coefficient, torque=coefficients.torque * (1.0 + at_rest)),
            column("thrust in airflow", tolerances.coefficient, thrust=coefficients.thrust * (2.0 - at_rest)),
            column("torque in airflow", tolerances.coefficient, torque=coefficients.torque * (2.0 - at_rest)),
        ]
        for key in (
            "rotor_force_along",
            "rotor_force_across",
            "rotor_moment_along",
            "rotor_moment_across",
            *_AIRFRAME,
        ):
            columns.append(column(key, tolerances.coefficient, **{key: 2.0 * getattr(coefficients, key)}))
        return columns

    @staticmethod
    def _wrench(model: RotorLocalModel, flight: Flight) -> Array:
        return model.wrench(_airspeed(flight), flight.rates, flight.rotor_speeds)


@dataclass(frozen=True)
class CallableSimulation(Simulation):
    """Any function from a flight to its wrench.

    It is known by its answers alone: what it says of the same rotor speeds in still air without rotation is
    taken for thrust and torque of the rotors, what rates add and what the airspeed adds for coefficients of
    their own, axis by axis.
    """

    name: str
    vehicle: Vehicle
    function: Callable[[Flight], Array]
    tolerances: Tolerances = Tolerances()

    def wrench(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        try:
            wrench = np.asarray(self.function(flight), dtype=float)
        except Exception as error:  # the user's code may raise anything
            raise DiscrepancyError(
                f"{self.name}: raised {type(error).__name__} for flight {flight.name}: {error}"
            ) from error
        if wrench.shape != (len(flight), len(AXES)):
            raise DiscrepancyError(
                f"{self.name}: flight {flight.name}: expected a wrench of shape "
                f"{(len(flight), len(AXES))}, found {wrench.shape}"
            )
        finite = np.isfinite(wrench).all(axis=1)
        if not finite.all():
            sample = int(np.argmin(finite))
            raise DiscrepancyError(f"{self.name}: flight {flight.name}: sample {sample}: not finite")
        return wrench

    @property
    def hover_rotor_speed(self) -> float:
        """See :class:`Simulation`: from the answer to a hover at the vehicle's largest rotor speed."""
        vehicle = self.vehicle
        speed = 0.5 * vehicle.rotor_speed_max_rad_s
        thrust = -self.wrench(_hover(vehicle, speed))[0, 2]
        if thrust <= 0.0:
            raise DiscrepancyError(f"{self.name}: gives no thrust at rotor speeds of {speed:.0f} rad/s")
        return float(speed * np.sqrt(vehicle.mass_kg * vehicle.gravity_m_s2 / thrust))

    def thrusts(self, flight: Flight) -> tuple[Array, Array]:
        """See :class:`Simulation`: what it says of hover, shared among the rotors by their speeds squared."""
        still = self.wrench(_still(flight))
        squares = np.square(flight.rotor_speeds)
        total = squares.sum(axis=1)
        thrust = -(still[:, 2] @ total) / max(float(total @ total), np.finfo(float).tiny)
        signed = squares @ self.vehicle.rotor_spins
        torque = (still[:, 5] @ signed) / max(float(signed @ signed), float(np.finfo(float).tiny))
        return thrust * squares, torque * squares * self.vehicle.rotor_spins

    def uncertain(self, flight: Flight) -> list[Column]:
        """Per axis: of the rotors at rest, of what rates add, of what the airspeed adds."""
        tolerances = self.tolerances
        moved, still = self.wrench(_without_airspeed(flight)), self.wrench(_still(flight))
        columns = []
        for part, wrench in (
            ("rotors", still),
            ("rates", moved - still),
            ("airspeed", self.wrench(flight) - moved),
        ):
            for axis, name in enumerate(AXES):
                share = tolerances.thrust if (part, name) == ("rotors", "Fz") else tolerances.coefficient
                single = np.zeros_like(wrench)
                single[:, axis] = share * wrench[:, axis]
                if np.any(single):
                    columns.append(Column(f"{name} of {part}", single))
        return columns


def _airspeed(flight: Flight) -> Array:
    velocity: Array = relative_to_air(flight.velocity, flight.attitude, flight.wind)
    return velocity


def _without_airspeed(flight: Flight) -> Flight:
    none = np.zeros((len(flight), 3))
    return replace(flight, velocity=none, wind=none)


def _still(flight: Flight) -> Flight:
    none = np.zeros((len(flight), 3))
    return replace(_without_airspeed(flight), rates=none, angular_acceleration=none)


def _hover(vehicle: Vehicle, rotor_speed: float) -> Flight:
    """A hover of two samples."""
    none = np.zeros((2, 3))
    force = np.tile([0.0, 0.0, -vehicle.gravity_m_s2], (2, 1))
    return Flight(
        name="hover",
        vehicle=vehicle.name,
        source="hover",
        start_ns=0,
        time=np.array([0.0, 0.002]),
        position=np.tile([0.0, 0.0, -10.0], (2, 1)),
        attitude=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
        velocity=none,
        rates=none,
        angular_acceleration=none,
        specific_force=force,
        rotor_speeds=np.full((2, ROTORS), rotor_speed),
        wind=none,
    )
