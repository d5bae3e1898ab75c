# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations that give the wrench of a flight: the interface of any simulation, and quadpi's own.

The search for discrepancies needs of a simulation what :class:`Simulation` declares. The known uncertainty of
its coefficients is stated as tolerances: each is a column of wrench, the change by one standard deviation of
a coefficient. A discrepancy is a difference that no coefficient within its tolerance explains.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from quadpi_core.brief_repr import brief_repr
from quadpi_core.config_schema import Section, Share, parse_config
from quadpi_core.errors import DiscrepancyError, VehicleError
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.inputs import relative_to_air
from quadpi_core.models.sound_flights import SoundFlights
from quadpi_core.signals.force_bandwidth import band_limited
from quadpi_core.simulation.simulated_aerodynamics import SimulatedAerodynamics, vehicle_record
from quadpi_core.simulation.simulated_file import read_simulation
from quadpi_core.simulation.state_records import STATE
from quadpi_core.simulation.vehicle_aerodynamics import load_aerodynamics
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
    path, _, section = read_simulation(vehicle)
    given = {} if section.tolerances is None else section.tolerances
    return parse_config(Tolerances, given, str(path), VehicleError, ("simulation", "tolerances"))


class Column(NamedTuple):
    """Change of the wrench (N, 6) by one standard deviation of a named uncertainty.

    Attributes:
        name: of the uncertainty.
        wrench: (N, 6) N, Nm.
        law: name of the column of what it shares with others, see :mod:`.uncertain_parts`; empty without.
    """

    name: str
    wrench: Array
    law: str = ""


class Margins(NamedTuple):
    """Bounds (N, 6), (N, 6) of intervals less the wrench that they are about, and their nominal coverage."""

    lower: Array
    upper: Array
    confidence: float


Own = TypeVar("Own", bound="Simulation")


class Simulation(ABC):
    """A simulation of one vehicle.

    Attributes:
        name: name for people.
        vehicle: vehicle of the simulation.
        vehicle_file: name or path that the vehicle was read from; empty where it was not.
        tolerances: known uncertainty of its coefficients.
        code: the user's code that it runs: the function, its file, and the file that named it; empty without.
        memoryless: whether the wrench at an instant depends on that instant alone.
        own_inputs: whether it was computed from other inputs than the flight's, with noise of their own.
    """

    name: str
    vehicle: Vehicle
    vehicle_file: str = ""
    tolerances: Tolerances
    sound: SoundFlights | None = None
    code: str = ""
    memoryless: ClassVar[bool] = False
    own_inputs: ClassVar[bool] = False

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

    def loads(self, flight: Flight) -> tuple[Array, Array, Array]:
        """:meth:`wrench` and :meth:`thrusts` of a flight together."""
        return self.wrench(flight), *self.thrusts(flight)

    @property
    @abstractmethod
    def hover_rotor_speed(self) -> float:
        """Rotor speed [rad/s] that carries the weight in still air."""

    def with_coefficients(self: Own, multiples: Mapping[str, float]) -> Own:  # noqa: ARG002 - where known
        """The simulation with other coefficients: each column of tolerances times a multiple, by its name.

        One that is known by its answers alone stays as it is, and names of what is no coefficient are left.
        """
        return self

    def recorded(self, flight: Flight, wrench: Array) -> Array:  # noqa: ARG002 - for those that know more
        """A wrench (N, 6) of a flight as the measured one of its recording would have it.

        It is what the flight is compared by, as in `evaluate`; a body that rolls out or flies has the wrench
        itself.
        """
        return wrench

    def learned(self: Own, flights: Sequence[tuple[Flight, Flight]]) -> Own:  # noqa: ARG002 - for own inputs
        """The simulation, for one with own inputs with what these flights tell of it.

        Args:
            flights: flights as recorded, each with the quiet one, see :mod:`.quiet_flight`.
        """
        return self

    def knowing(self: Own, flight: Flight) -> Own:  # noqa: ARG002 - for own inputs
        """The simulation, for one with own inputs that learned nothing of this flight with what it tells."""
        return self

    def answering(self: Own, flight: Flight, corrected: Flight) -> Own:  # noqa: ARG002 - for own inputs
        """The simulation, for one with own inputs as it would have answered to a corrected flight."""
        return self

    def explained(self, flight: Flight) -> Array:
        """The wrench (N, 6), without the noise of own inputs; see :mod:`.instruments`."""
        return self.wrench(flight)

    def margins(self, flight: Flight) -> Margins | None:  # noqa: ARG002 - for those that have any
        """Its intervals for a flight; None for a simulation without intervals."""
        return None

    def unjudged(self, flight: Flight) -> int:  # noqa: ARG002 - for those that leave samples out
        """Number of samples of a flight that the simulation cannot judge and leaves out."""
        return 0

    def identified_on(self, flight: Flight) -> bool:  # noqa: ARG002 - for those that were
        """Whether it was identified on this flight, by its hash, so that it is compared in sample."""
        return False

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
        wrench, states["thrusts"], states["torques"] = self.loads(flight)
        states["aerodynamics"] = states["wrench"] = wrench
        if self.own_inputs:
            states["aerodynamics"] = self.explained(flight)
        return states

    def record(self) -> npt.NDArray[np.void]:
        """Record `state_records.VEHICLE` (1,), the input of effects; aerodynamics where known."""
        return vehicle_record(self.vehicle, self.hover_rotor_speed)


def airspeed(flight: Flight) -> Array:
    """Velocity (N, 3) m/s relative to the air, body axes."""
    velocity: Array = relative_to_air(flight.velocity, flight.attitude, flight.wind)
    return velocity


@dataclass(frozen=True)
class VehicleSimulation(Simulation):
    """quadpi's own simulation: the aerodynamics of a vehicle file or of a model folder, without effects.

    Attributes:
        intervals_of: the model whose intervals are those of the simulation; None without intervals.
    """

    __repr__ = brief_repr

    model: SimulatedAerodynamics
    tolerances: Tolerances = field(default_factory=Tolerances)
    vehicle_file: str = ""
    intervals_of: Simulation | None = None
    sound: SoundFlights | None = None

    @classmethod
    def load(cls, name_or_path: str | Path) -> VehicleSimulation:
        """Read a vehicle file with the section `simulation`, or the folder of a model that is one.

        Effects in it are left to `load_simulation`.

        Raises:
            VehicleError: naming the file and the key that is missing, unknown or impossible.
        """
        model, tolerances = load_aerodynamics(name_or_path), read_tolerances(name_or_path)
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

    @property
    def memoryless(self) -> bool:  # type: ignore[override]
        """See :class:`Simulation`."""
        return self.model.memoryless

    def wrench(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        return self._wrench(self.model, flight)

    def recorded(self, flight: Flight, wrench: Array) -> Array:
        """See :class:`Simulation`; forces of the bandwidth that its flights had."""
        bandwidth = self.model.force_bandwidth_hz
        forces = band_limited(flight.time, flight.rates, wrench[:, :3, np.newaxis], bandwidth)
        return np.column_stack((forces[:, :, 0], wrench[:, 3:]))

    def margins(self, flight: Flight) -> Margins | None:
        """See :class:`Simulation`."""
        return None if self.intervals_of is None else self.intervals_of.margins(flight)

    def identified_on(self, flight: Flight) -> bool:
        """See :class:`Simulation`."""
        return self.intervals_of is not None and self.intervals_of.identified_on(flight)

    def thrusts(self, flight: Flight) -> tuple[Array, Array]:
        """See :class:`Simulation`."""
        return self.loads(flight)[1:]

    def loads(self, flight: Flight) -> tuple[Array, Array, Array]:
        """See :class:`Simulation`; all from one evaluation."""
        states = self._states(self.model, flight)
        return states["wrench"].copy(), states["thrusts"].copy(), states["torques"].copy()

    def record(self) -> npt.NDArray[np.void]:
        """See :class:`Simulation`; with the aerodynamics, for effects on forces in the rotor plane."""
        return self.model.record()

    def uncertain(self, flight: Flight) -> list[Column]:
        """One factor on each kind of coefficient, and separate ones on static thrust and torque."""
        base = self.wrench(flight)
        return [
            Column(
                name, (self._wrench(self.model.scaled({name: 1.0}), flight) - base) * self._tolerance(name)
            )
            for name in self.model.coefficients_by_name
        ]

    def with_coefficients(self, multiples: Mapping[str, float]) -> VehicleSimulation:
        """See :class:`Simulation`."""
        shares = {
            name: self._tolerance(name) * multiples[name]
            for name in self.model.coefficients_by_name
            if name in multiples
        }
        return replace(self, model=self.model.scaled(shares))

    def _tolerance(self, name: str) -> float:
        if self.model.covariance_known:
            return 1.0
        return self.tolerances.thrust if name == "thrust" else self.tolerances.coefficient

    @staticmethod
    def _wrench(model: SimulatedAerodynamics, flight: Flight) -> Array:
        return VehicleSimulation._states(model, flight)["wrench"].copy()

    @staticmethod
    def _states(model: SimulatedAerodynamics, flight: Flight) -> npt.NDArray[np.void]:
        speeds, accelerations = flight.rotor_speeds, None
        if not model.memoryless:
            accelerations = np.gradient(speeds, flight.time, axis=0)
            delay = model.rotor_delay_s
            if delay > 0.0:
                # By neighbours alone, as roll-outs give them; delays are of milliseconds.
                jerks = _second_derivative(flight.time, speeds)
                speeds = np.maximum(speeds - delay * accelerations + 0.5 * delay**2 * jerks, 0.0)
                accelerations = accelerations - delay * jerks
        return model.states(airspeed(flight), flight.rates, speeds, rotor_accelerations=accelerations)


def _second_derivative(time: Array, values: Array) -> Array:
    """Second derivative (N, K) of values (N, K) at times (N,) from the two neighbours; zero at the ends."""
    before, after = np.diff(time)[:-1, np.newaxis], np.diff(time)[1:, np.newaxis]
    slopes = np.diff(values, axis=0) / np.diff(time)[:, np.newaxis]
    second = np.zeros_like(values)
    second[1:-1] = 2.0 * (slopes[1:] - slopes[:-1]) / (before + after)
    return second
