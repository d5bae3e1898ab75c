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
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import NotNegative, Positive, Section, parse_config
from quadpi_core.core import inverse
from quadpi_core.errors import SimulationError, VehicleError
from quadpi_core.frames import Array
from quadpi_core.models.physical_terms import TERM_INDEX, TERMS, MotionSample, numbers_of, regressors
from quadpi_core.records import record_dtype
from quadpi_core.simulation.simulated_file import read_simulation
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


# Relative step of the squared rotor speed for central differences.
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


# The terms of the accelerometer's position move no body: in a vehicle file they are the effect
# `imu_lever_arm`. What remains of the forces and moments at rest, and of the inclination of the rotors, acts
# on the body as in the identified model.

_HOVER_ROUNDS = 20
# Rows of the numbers of the law in the core.
_VALUES, _REFERENCE = 0, 1


@dataclass(frozen=True, kw_only=True)
class PhysicalCoefficients(Section):
    """The key `simulation.physical` of a vehicle file.

    Attributes:
        reference_thrust_n_s2: thrust of a rotor over ω² that the induced velocity refers to.
        parameters: by name, SI; those without a value are zero.
        deviations: what is not known of them: by name, rows of the lower triangular L of their covariance
            L Lᵀ without the zeros beyond its diagonal; empty where no flights tell.
        rotor_delay_s: that recorded rotor speeds act after their stamps, in the flights identified on.
        force_bandwidth_hz: of the forces measured in those flights, where it ends below that of the other
            signals. Neither changes how the vehicle flies.
    """

    reference_thrust_n_s2: Positive
    parameters: dict[str, float]
    deviations: dict[str, list[float]] = field(default_factory=dict)
    rotor_delay_s: NotNegative = 0.0
    force_bandwidth_hz: Positive | None = None

    def __post_init__(self) -> None:
        for name, value in self.parameters.items():
            if name not in _FLYING:
                raise ValueError(f"`parameters`: unknown parameter `{name}`")
            if not np.isfinite(value):
                raise ValueError(f"`parameters.{name}` must be a number")
        if self.deviations and set(self.deviations) != set(self.parameters):
            raise ValueError("`deviations` must have a row for each of `parameters`")
        for place, name in enumerate(self.triangular):
            row = self.deviations[name]
            if len(row) != place + 1 or not np.all(np.isfinite(row)):
                raise ValueError(f"`deviations.{name}` must be {place + 1} numbers")

    @property
    def triangular(self) -> tuple[str, ...]:
        """Names of the parameters in the order of the rows of L, however a file orders them."""
        return tuple(sorted(self.deviations, key=lambda name: len(self.deviations[name])))


_FLYING = {term.name: term for term in TERMS if term.group != "imu position"}
# Groups that one factor scales, with how the names of their parameters begin; the first that fits counts.
_FAMILY_STARTS: dict[str, tuple[str, ...]] = {
    "differences of rotors": ("thrust_rotor_", "torque_rotor_"),
    "thrust in airflow": ("thrust_",),
    "thrust": ("thrust",),
    "arms": ("arm_",),
    "wakes": ("wake_",),
    "torque in airflow": ("torque_",),
    "torque": ("torque",),
    "rotor inertia": ("rotor_inertia_",),
    "rotor drag": ("rotor_drag",),
    "rotor side force": ("rotor_side",),
    "hub moment": ("hub_",),
    "airframe in the wake": ("body_",),
    "airframe": ("drag_", "lift_", "pitch_", "roll_", "yaw_", "damping_", "inertia_"),
    "at rest": ("bias_", "incline_", "gravity_centre_"),
}


_FAMILIES = {
    name: next(family for family, starts in _FAMILY_STARTS.items() if name.startswith(starts))
    for name in _FLYING
}


@dataclass(frozen=True)
class PhysicalAerodynamics(SimulatedAerodynamics):
    """The physical model with the parameters of a vehicle."""

    key: ClassVar[str] = "physical"
    memoryless: ClassVar[bool] = False
    vehicle: Vehicle
    coefficients: PhysicalCoefficients

    @classmethod
    def load(cls, name_or_path: str | Path) -> PhysicalAerodynamics:
        """See :class:`.SimulatedAerodynamics`."""
        file = read_simulation(name_or_path)
        if file.section.physical is None:
            raise VehicleError(f"{file.path}: cannot be simulated: `simulation.physical` is missing")
        return cls.from_section(file.vehicle, file.section.physical, str(file.path))

    @classmethod
    def from_section(cls, vehicle: Vehicle, section: Any, where: str) -> PhysicalAerodynamics:
        """The aerodynamics of a vehicle, as the key `simulation.physical` says them.

        Raises:
            VehicleError: naming where it is from, and the key that is missing, unknown or impossible.
        """
        above = ("simulation", "physical")
        return cls(vehicle, parse_config(PhysicalCoefficients, section, where, VehicleError, above))

    @property
    def coefficients_by_name(self) -> tuple[str, ...]:  # type: ignore[override]
        """See :class:`.SimulatedAerodynamics`; single parameters where their covariance is known."""
        return self.coefficients.triangular or tuple(dict.fromkeys(_FAMILIES.values()))

    @property
    def covariance_known(self) -> bool:  # type: ignore[override]
        """See :class:`.SimulatedAerodynamics`."""
        return bool(self.coefficients.deviations)

    @property
    def rotor_delay_s(self) -> float:  # type: ignore[override]
        """See :class:`.SimulatedAerodynamics`."""
        return self.coefficients.rotor_delay_s

    @property
    def force_bandwidth_hz(self) -> float | None:  # type: ignore[override]
        """See :class:`.SimulatedAerodynamics`."""
        return self.coefficients.force_bandwidth_hz

    @property
    def function(self) -> Law:
        """See :class:`.SimulatedAerodynamics`."""
        return self.key

    @cached_property
    def numbers(self) -> Array:
        """Values of all terms, and the reference thrust."""
        numbers = np.zeros((2, len(TERMS)))
        for name, value in self.coefficients.parameters.items():
            numbers[_VALUES, TERM_INDEX[name]] = value
        numbers[_REFERENCE, 0] = self.coefficients.reference_thrust_n_s2
        return numbers

    @cached_property
    def hover_rotor_speed(self) -> float:
        """See :class:`.SimulatedAerodynamics`; by iteration, as thrust is about quadratic in the speed."""
        weight = self.vehicle.mass_kg * self.vehicle.gravity_m_s2
        speed = float(np.sqrt(weight / (self.vehicle.rotor_count * self.coefficients.reference_thrust_n_s2)))
        record = vehicle_record(self.vehicle, speed)
        hover = np.zeros(1, record_dtype(State, self.vehicle.rotor_count))
        for _ in range(_HOVER_ROUNDS):
            hover["rotor_speeds"] = speed
            apply_to_all(hover, record, self.function, self.numbers)
            thrust = -float(hover["wrench"][0, 2])
            if not thrust > 0.0:
                raise SimulationError(f"vehicle {self.vehicle.name}: its rotors give no thrust at rest")
            speed *= float(np.sqrt(weight / thrust))
        return speed

    def record(self, motor_time_constant: float = np.inf) -> npt.NDArray[np.void]:
        """Record VEHICLE (1,) with the coefficients of the rotors that effects refer to."""
        record = super().record(motor_time_constant)
        values = self.coefficients.parameters
        record["rotor_inertia"] = values.get("rotor_inertia_spin", 0.0)
        # Rotor-local forces and moments point along the motion, these against it.
        for name, term, sign in (
            ("rotor_force_along", "rotor_drag", -1.0),
            ("rotor_force_across", "rotor_side", -1.0),
            ("rotor_moment_along", "hub_height", -1.0),
            ("rotor_moment_across", "hub_roll", 1.0),
        ):
            record[name] = sign * values.get(term, 0.0)
        return record

    def scaled(self, shares: Mapping[str, float]) -> PhysicalAerodynamics:
        """See :class:`.SimulatedAerodynamics`."""
        grown = np.array([shares.get(name, 0.0) for name in self.coefficients_by_name]) @ self._steps
        values = self.coefficients.parameters
        parameters = {name: value + float(grown[TERM_INDEX[name]]) for name, value in values.items()}
        return replace(self, coefficients=replace(self.coefficients, parameters=parameters))

    @cached_property
    def _steps(self) -> Array:
        """What each of :attr:`coefficients_by_name`, grown by one, adds to the values (K, P) of the terms."""
        names = self.coefficients_by_name
        steps = np.zeros((len(names), len(TERMS)))
        for name, value in self.coefficients.parameters.items():
            if self.covariance_known:
                row = self.coefficients.deviations[name]
                steps[: len(row), TERM_INDEX[name]] = row
            else:
                steps[names.index(_FAMILIES[name]), TERM_INDEX[name]] = value
        return steps

    def added_by_coefficients(self, states: npt.NDArray[np.void]) -> Array:
        """See :class:`.SimulatedAerodynamics`; by the terms, which the wrench is linear in."""
        motion = np.zeros(len(states), record_dtype(MotionSample, self.vehicle.rotor_count))
        motion["velocity"] = states["velocity_air"]
        for name in ("rates", "rotor_speeds", "rotor_accelerations"):
            motion[name] = states[name]
        terms = regressors(motion, numbers_of(self.vehicle, self.coefficients.reference_thrust_n_s2))
        return np.tensordot(self._steps, terms, axes=(1, 1))

    def carrying(self, vehicle: Vehicle) -> PhysicalAerodynamics:
        """See :class:`.SimulatedAerodynamics`."""
        return replace(self, vehicle=vehicle)

    def to_section(self) -> dict[str, Any]:
        """See :class:`.SimulatedAerodynamics`."""
        return {name: value for name, value in vars(self.coefficients).items() if value not in (None, {})}
