# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations that give the wrench of a flight: the interface of any simulation, and quadpi's own.

The search for discrepancies needs of a simulation what :class:`Simulation` declares. The known uncertainty of
its coefficients is stated as tolerances: each is a column of wrench, by one standard deviation of one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import Section, Share, parse_config
from quadpi_core.errors import VehicleError
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.inputs import relative_to_air
from quadpi_core.models.sound_flights import SoundFlights
from quadpi_core.records import brief_repr, record_dtype
from quadpi_core.signals.wrench import band_limited
from quadpi_core.simulation.flying import load_aerodynamics
from quadpi_core.simulation.simulated_aerodynamics import SimulatedAerodynamics, vehicle_record
from quadpi_core.simulation.simulated_file import read_simulation
from quadpi_core.simulation.state_records import State
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


def read_tolerances(vehicle: str | Path) -> Tolerances:
    """Tolerances of a vehicle file, its mapping `simulation.tolerances`; the usual ones where it has none."""
    path, _, section = read_simulation(vehicle)
    given = {} if section.tolerances is None else section.tolerances
    return parse_config(Tolerances, given, str(path), VehicleError, ("simulation", "tolerances"))


class Column(NamedTuple):
    """Change of the wrench (N, 6) by one standard deviation of a named uncertainty.

    Attributes:
        name: of the uncertainty.
        wrench: (N, 6) N, Nm.
        law: name of the column of what it shares with others, see :mod:`.candidates`; empty without.
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
        tolerances: known uncertainty of its coefficients.
        hover_rotor_speed: rotor speed [rad/s] that carries the weight in still air.
        vehicle_file: name or path that the vehicle was read from; empty where it was not.
        sound: what sound flights leave of it, where it was identified on some.
        code: the user's code that it runs: the function, its file, and the file that named it; empty without.
        memoryless: whether the wrench at an instant depends on that instant alone.
        reads_accelerations: whether it depends on the accelerations that the flight measured.
        own_inputs: whether it was computed from other inputs than the flight's, with noise of their own. Then
            `learned`, `answering` and `explained` say what flights tell of it.
        intervals_of: the identified model whose intervals are its own; None without intervals.
        goes_with_air: whether it is known which air its coefficients are of: the wrench goes with that of a
            flight.
    """

    name: str
    vehicle: Vehicle
    tolerances: Tolerances
    hover_rotor_speed: float
    vehicle_file: str = ""
    sound: SoundFlights | None = None
    code: str = ""
    memoryless: bool = False
    reads_accelerations: bool = True
    own_inputs: bool = False
    intervals_of: Simulation | None = None

    @property
    def goes_with_air(self) -> bool:
        """See :class:`Simulation`."""
        return self.intervals_of is None or self.intervals_of.goes_with_air

    @abstractmethod
    def wrench(self, flight: Flight) -> Array:
        """Wrench (N, 6) [N, Nm] of a flight in its air, body axes, gravity not included.

        Raises:
            DiscrepancyError: where the simulation gives no such wrench.
        """

    @abstractmethod
    def loads(self, flight: Flight) -> tuple[Array, Array, Array]:
        """The wrench, thrusts (N, 4) N along -z and torques (N, 4) Nm about z of the rotors; no effects."""

    @abstractmethod
    def uncertain(self, flight: Flight) -> list[Column]:
        """Columns of the tolerances of aerodynamic coefficients."""

    def with_coefficients(self: Own, multiples: Mapping[str, float]) -> Own:  # noqa: ARG002
        """The simulation with other coefficients: each column of tolerances times a multiple, by its name.

        One that is known by its answers alone stays as it is, and names of what is no coefficient are left.
        """
        return self

    def recorded(self, flight: Flight, wrench: Array) -> Array:  # noqa: ARG002
        """A wrench (N, 6) of a flight as the measured one of its recording would have it.

        It is what the flight is compared by, as in `evaluate`; a body that rolls out or flies has the wrench
        itself.
        """
        return wrench

    def learned(self: Own, flights: Sequence[tuple[Flight, Flight]]) -> Own:  # noqa: ARG002
        """The simulation with what these flights tell of it, unless it learned of all of them before.

        Args:
            flights: flights as recorded, each with the quiet one, see :func:`.effect_response.quiet`.
        """
        return self

    def answering(self: Own, flight: Flight, corrected: Flight) -> Own:  # noqa: ARG002
        """The simulation as it would have answered to a corrected flight."""
        return self

    def explained(self, flight: Flight) -> Array:
        """The wrench (N, 6), without the noise of own inputs; see :mod:`.other_simulations`."""
        return self.wrench(flight)

    def margins(self, flight: Flight) -> Margins | None:
        """Its intervals for a flight; None for a simulation without intervals."""
        return None if self.intervals_of is None else self.intervals_of.margins(flight)

    def unjudged(self, flight: Flight) -> int:  # noqa: ARG002
        """Number of samples of a flight that the simulation cannot judge and leaves out."""
        return 0

    def identified_on(self, flight: Flight) -> bool:
        """Whether it was identified on this flight, by its hash, so that it is compared in sample."""
        return self.intervals_of is not None and self.intervals_of.identified_on(flight)

    def states(self, flight: Flight) -> npt.NDArray[np.void]:
        """Records `simulation.state_records.STATE` (N,), the input of effects."""
        states = np.zeros(len(flight), dtype=record_dtype(State, self.vehicle.rotor_count))
        states["position"], states["attitude"] = flight.position, flight.attitude
        velocity = airspeed(flight)
        states["velocity_air"], states["rates"] = velocity, flight.rates
        states["rotor_speeds"] = flight.rotor_speeds
        states["rotor_accelerations"] = np.gradient(flight.rotor_speeds, flight.time, axis=0)
        states["hub_velocity"] = velocity[:, None] + np.cross(
            flight.rates[:, None], self.vehicle.rotor_positions[None]
        )
        wrench, states["thrusts"], states["torques"] = self.loads(flight)
        states["wrench"] = wrench
        states["aerodynamics"] = self.explained(flight) if self.own_inputs else wrench
        return states

    def record(self) -> npt.NDArray[np.void]:
        """Record `state_records.VEHICLE` (1,), the input of effects; aerodynamics where known."""
        return vehicle_record(self.vehicle, self.hover_rotor_speed)


def airspeed(flight: Flight) -> Array:
    """Velocity (N, 3) m/s relative to the air, body axes."""
    return relative_to_air(flight.velocity, flight.attitude, flight.wind)


def attribute_of(path: str) -> Any:
    """A property that is an attribute or method of a part, by its path, such as `model.vehicle`."""
    return property(attrgetter(path))


@dataclass(frozen=True)
class VehicleSimulation(Simulation):
    """quadpi's own simulation: the aerodynamics of a vehicle file or of a model folder, without effects."""

    __repr__ = brief_repr

    model: SimulatedAerodynamics
    tolerances: Tolerances = field(default_factory=Tolerances)
    vehicle_file: str = ""
    intervals_of: Simulation | None = None
    sound: SoundFlights | None = None

    name = attribute_of("model.vehicle.name")
    vehicle = attribute_of("model.vehicle")
    hover_rotor_speed = attribute_of("model.hover_rotor_speed")
    memoryless = attribute_of("model.memoryless")
    reads_accelerations = False
    record = attribute_of("model.record")

    def __post_init__(self) -> None:
        """Take from the tolerances what a fit of the coefficients, with its covariance, knows better."""
        if self.model.covariance_known:
            object.__setattr__(self, "tolerances", replace(self.tolerances, thrust=0.0))

    @classmethod
    def load(cls, name_or_path: str | Path) -> VehicleSimulation:
        """Read a vehicle file with the section `simulation`, or a model folder; without effects in it."""
        return cls(load_aerodynamics(name_or_path), read_tolerances(name_or_path), str(name_or_path))

    def wrench(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        return self.loads(flight)[0]

    def loads(self, flight: Flight) -> tuple[Array, Array, Array]:
        """See :class:`Simulation`."""
        states = self._acting(flight)
        return states["wrench"].copy(), states["thrusts"].copy(), states["torques"].copy()

    def states(self, flight: Flight) -> npt.NDArray[np.void]:
        """See :class:`Simulation`."""
        states = self._acting(flight)
        states["rotor_speeds"] = flight.rotor_speeds
        states["rotor_accelerations"] = np.gradient(flight.rotor_speeds, flight.time, axis=0)
        return states

    def _acting(self, flight: Flight) -> npt.NDArray[np.void]:
        """Records STATE (N,) in the flight's air, with the rotor speeds that act, recorded later."""
        states, ratio = self._in_file_air(flight), self._air_of(flight)
        for name in ("wrench", "thrusts", "torques") if ratio != 1.0 else ():
            states[name] *= ratio
        return states

    def _air_of(self, flight: Flight) -> float:
        return flight.air_ratio if self.goes_with_air else 1.0

    def _in_file_air(self, flight: Flight) -> npt.NDArray[np.void]:
        time, speeds, accelerations = flight.time, flight.rotor_speeds, None
        if not self.memoryless:
            accelerations = np.gradient(speeds, time, axis=0)
            delay = self.model.rotor_delay_s
            if delay > 0.0:
                # By neighbours alone, as roll-outs give them; delays are of milliseconds.
                jerks, slopes = np.zeros_like(speeds), np.diff(speeds, axis=0) / np.diff(time)[:, np.newaxis]
                jerks[1:-1] = 2.0 * np.diff(slopes, axis=0) / (time[2:] - time[:-2])[:, np.newaxis]
                speeds = np.maximum(speeds - delay * accelerations + 0.5 * delay**2 * jerks, 0.0)
                accelerations = accelerations - delay * jerks
        return self.model.states(
            airspeed(flight),
            flight.rates,
            speeds,
            rotor_accelerations=accelerations,
            position=flight.position,
            attitude=flight.attitude,
        )

    def recorded(self, flight: Flight, wrench: Array) -> Array:
        """See :class:`Simulation`; forces of the bandwidth that its flights had."""
        bandwidth = self.model.force_bandwidth_hz
        forces = band_limited(flight.time, flight.rates, wrench[:, :3, np.newaxis], bandwidth)
        return np.column_stack((forces[:, :, 0], wrench[:, 3:]))

    def uncertain(self, flight: Flight) -> list[Column]:
        """One factor on each kind of coefficient, and separate ones on static thrust and torque."""
        added, ratio = self.model.added_by_coefficients(self._in_file_air(flight)), self._air_of(flight)
        return [
            Column(name, own * (self._tolerance(name) * ratio))
            for name, own in zip(self.model.coefficients_by_name, added, strict=True)
        ]

    def with_coefficients(self, multiples: Mapping[str, float]) -> VehicleSimulation:
        """See :class:`Simulation`."""
        known = set(self.model.coefficients_by_name)
        shares = {name: self._tolerance(name) * m for name, m in multiples.items() if name in known}
        return replace(self, model=self.model.scaled(shares))

    def _tolerance(self, name: str) -> float:
        if self.model.covariance_known:
            return 1.0
        return self.tolerances.thrust if name == "thrust" else self.tolerances.coefficient
