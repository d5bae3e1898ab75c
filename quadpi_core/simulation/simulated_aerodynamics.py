# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a simulation needs of the aerodynamics of a vehicle: the interface of all laws that can fly.

A law fills the wrench of states, with a table of numbers: one of the compiled core, or a function of Python.
Each is one file, read from a key of its own in the mapping `simulation` of a vehicle file (see
:func:`.load_aerodynamics`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import SimulationError
from quadpi_core.frames import Array
from quadpi_core.linear_algebra import inverse
from quadpi_core.records import record_dtype
from quadpi_core.simulation.state_records import Law, State, VehicleNumbers, apply_to_all
from quadpi_core.vehicle import Vehicle

Own = TypeVar("Own", bound="SimulatedAerodynamics")


class SimulatedAerodynamics(ABC):
    """Aerodynamic wrench of a vehicle from its motion through the air and its rotor speeds.

    Attributes:
        key: of its numbers in the mapping `simulation` of a vehicle file.
        vehicle: mass, inertia, rotors.
        memoryless: whether the wrench depends on the motion of the instant alone, not on how fast rotor
            speeds change.
        rotor_delay_s: that recorded rotor speeds act after their stamps; it belongs to the recordings, and a
            simulated flight has none.
        force_bandwidth_hz: of the forces measured in those recordings, where it ends below that of the other
            signals; likewise.
        coefficients_by_name: names of the groups of coefficients that :meth:`scaled` takes, the static
            thrust first.
        covariance_known: whether flights tell the covariance of the coefficients; then :meth:`scaled` takes
            numbers of standard deviations that are independent of each other.
    """

    key: ClassVar[str]
    memoryless: ClassVar[bool] = True
    coefficients_by_name: tuple[str, ...]
    covariance_known: bool = False
    vehicle: Vehicle
    rotor_delay_s: float = 0.0
    force_bandwidth_hz: float | None = None

    @classmethod
    @abstractmethod
    def load(cls: type[Own], name_or_path: str | Path) -> Own:
        """Read from a vehicle file, or the folder of a model.

        Raises:
            VehicleError: naming the file and the key that is missing, unknown or impossible.
        """

    @abstractmethod
    def to_section(self) -> dict[str, Any]:
        """The content of :attr:`key` in a vehicle file; :meth:`load` reads it."""

    @property
    @abstractmethod
    def function(self) -> Law:
        """Name of a law of the compiled core, or (state, vehicle, numbers) over N states.

        It fills hub velocities, thrusts, torques and wrench of the states.
        """

    @property
    @abstractmethod
    def numbers(self) -> Array:
        """Parameters (K, P) of :attr:`function`."""

    @property
    @abstractmethod
    def hover_rotor_speed(self) -> float:
        """Rotor speed [rad/s] at which the rotors in still air carry the weight.

        Raises:
            SimulationError: if there is none.
        """

    @abstractmethod
    def scaled(self: Own, shares: Mapping[str, float]) -> Own:
        """The law with named groups of coefficients grown by a share each, or by a standard deviation."""

    def added_by_coefficients(self, states: npt.NDArray[np.void]) -> Array:
        """Wrench (K, N, 6) that each of :attr:`coefficients_by_name`, grown by one, adds to states (N,)."""
        added = np.empty((len(self.coefficients_by_name), len(states), 6))
        for name, own in zip(self.coefficients_by_name, added, strict=True):
            law, grown = self.scaled({name: 1.0}), states.copy()
            apply_to_all(grown, law.record(), law.function, law.numbers)
            own[:] = grown["wrench"] - states["wrench"]
        return added

    @abstractmethod
    def carrying(self: Own, vehicle: Vehicle) -> Own:
        """The same law under another mass and inertia."""

    def record(self, motor_time_constant: float = np.inf) -> npt.NDArray[np.void]:
        """Record VEHICLE (1,) for the compiled physics."""
        return vehicle_record(self.vehicle, self.hover_rotor_speed, motor_time_constant)

    @cached_property
    def effectiveness(self) -> Array:
        """Change (4, rotors) of thrust [N] and moments [Nm] by the squared speed of each rotor, in hover."""
        hover, rotors = np.square(self.hover_rotor_speed), self.vehicle.rotor_count
        squares = hover * (1.0 + _DIFFERENCE * np.vstack((np.eye(rotors), -np.eye(rotors))))
        still = np.zeros((len(squares), 3))
        wrench = self.wrench(still, still, np.sqrt(squares))
        slopes = (wrench[:rotors] - wrench[rotors:]).T / (2.0 * _DIFFERENCE * hover)
        return np.ascontiguousarray(np.vstack((-slopes[2], slopes[3:])))

    def wrench(
        self, velocity: Array, rates: Array, rotor_speeds: Array, rotor_accelerations: Array | None = None
    ) -> Array:
        """Wrench (N, 6) [N, Nm], body axes, columns as `flight.AXES`; see :meth:`states`."""
        filled = self.states(velocity, rates, rotor_speeds, rotor_accelerations=rotor_accelerations)
        return filled["wrench"].copy()

    def states(
        self,
        velocity: Array,
        rates: Array,
        rotor_speeds: Array,
        *,
        rotor_accelerations: Array | None = None,
        position: Array | None = None,
        attitude: Array | None = None,
    ) -> npt.NDArray[np.void]:
        """Records STATE (N,) with the aerodynamics of each instant, the input of effects.

        Args:
            velocity: (N, 3) m/s relative to the air, body axes.
            rates: (N, 3) rad/s.
            rotor_speeds: (N, rotors) rad/s.
            rotor_accelerations: (N, rotors) rad/s²; zero where not given.
            position: (N, 3) m, world; the origin where not given.
            attitude: (N, 4) body to world; level where not given.

        Raises:
            SimulationError: for another shape, and for values that are not finite.
        """
        states = np.zeros(len(velocity), dtype=record_dtype(State, self.vehicle.rotor_count))
        states["attitude"][:, 0] = 1.0
        given = {
            "velocity_air": velocity,
            "rates": rates,
            "rotor_speeds": rotor_speeds,
            "rotor_accelerations": rotor_accelerations,
            "position": position,
            "attitude": attitude,
        }
        for name, values in given.items():
            if values is None:
                continue
            if np.shape(values) != states[name].shape:
                raise SimulationError(
                    f"{name}: expected shape {states[name].shape}, found {np.shape(values)}"
                )
            if not np.all(np.isfinite(values)):
                raise SimulationError(f"{name}: holds values that are not finite")
            states[name] = values
        apply_to_all(states, self.record(), self.function, self.numbers)
        states["aerodynamics"] = states["wrench"]
        return states


# Of the squared rotor speed, for central differences.
_DIFFERENCE = 1e-3


def vehicle_record(
    vehicle: Vehicle, hover_rotor_speed: float, motor_time_constant: float = np.inf
) -> npt.NDArray[np.void]:
    """Record VEHICLE (1,) of a vehicle without aerodynamics.

    Args:
        vehicle: vehicle.
        hover_rotor_speed: rotor speed [rad/s] that carries the weight in still air.
        motor_time_constant: time constant [s] of the rotors.
    """
    record = np.zeros(1, dtype=record_dtype(VehicleNumbers, vehicle.rotor_count))
    for name, value in {
        "mass": vehicle.mass_kg,
        "gravity": vehicle.gravity_m_s2,
        "air_density": vehicle.air_density_kg_m3,
        "inertia": vehicle.inertia,
        "inverse_inertia": inverse(vehicle.inertia),
        "rotors": vehicle.rotor_count,
        "rotor_positions": vehicle.rotor_positions,
        "rotor_spins": vehicle.rotor_spins,
        "rotor_radius": vehicle.rotor_radius_m,
        "hover_induced_velocity": vehicle.hover_induced_velocity,
        "hover_rotor_speed": hover_rotor_speed,
        "motor_time_constant": motor_time_constant,
        "rotor_speed_max": vehicle.rotor_speed_max_rad_s,
        "airframe_area": airframe_area(vehicle),
    }.items():
        record[name] = value
    return record


def airframe_area(vehicle: Vehicle) -> float:
    """Area S = 4 b l [m²] of the rectangle whose corners are the rotors."""
    half_length, half_width, _ = np.abs(vehicle.rotor_positions).mean(axis=0)
    return float(4.0 * half_length * half_width)
