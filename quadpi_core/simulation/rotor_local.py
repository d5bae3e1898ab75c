# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotor-local aerodynamics: each rotor sees its own airspeed (Sun and de Visser, Bebop 2 in a wind tunnel).

The equations are those of the public simulation SihaoSun/INDI_Quadrotor_FTC. Two features of the published
fit are kept: at standstill the slope of the thrust jumps, and slow climb and slow descent both lose thrust.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import PlainValidator

from quadpi_core.compiled import njit
from quadpi_core.config_schema import Numbers, Real, Section, Text, Within, check_config, parse_config
from quadpi_core.errors import SimulationError, VehicleError, named_in
from quadpi_core.frames import Array
from quadpi_core.records import Records
from quadpi_core.simulation.linear_algebra import inverse
from quadpi_core.simulation.state_records import STATE, VEHICLE, State, VehicleNumbers
from quadpi_core.thresholds import Threshold
from quadpi_core.vehicle import ROTORS, Vehicle, simulation_section

FITTED_ADVANCE_RATIO = Threshold(
    "largest advance ratio",
    0.6,
    "airspeed of the hub over speed of the blade tip",
    "the largest of the fit: its polynomials grow without bound beyond",
    "Bebop 2 in a wind tunnel, as published in SihaoSun/INDI_Quadrotor_FTC",
)
ADVANCE_RATIO_MAX = FITTED_ADVANCE_RATIO.value


@dataclass(frozen=True)
class RotorLocalCoefficients(Section):
    """Coefficients for one rotor size: the key `simulation.rotor_local` of a vehicle file.

    Attributes:
        thrust, torque: (16,) of C_T and C_Q in advance ratio and disc angle.
        rotor_force_along, rotor_force_across: k4, k5 [N s²/m] of the force in the rotor plane.
        rotor_moment_along, rotor_moment_across: k6, k7 [N s²] of the moment at the hub.
        airframe_fx, airframe_fy, airframe_fz: (2,) of the airframe's force, per dynamic pressure and area.
        airframe_mx, airframe_my, airframe_mz: (6,) [m] of its moment.
    """

    thrust: Annotated[Array, Numbers(16)]
    torque: Annotated[Array, Numbers(16)]
    rotor_force_along: Real
    rotor_force_across: Real
    rotor_moment_along: Real
    rotor_moment_across: Real
    airframe_fx: Annotated[Array, Numbers(2)]
    airframe_fy: Annotated[Array, Numbers(2)]
    airframe_fz: Annotated[Array, Numbers(2)]
    airframe_mx: Annotated[Array, Numbers(6)]
    airframe_my: Annotated[Array, Numbers(6)]
    airframe_mz: Annotated[Array, Numbers(6)]

    def scaled(self, source: Vehicle, target: Vehicle) -> RotorLocalCoefficients:
        """The same non-dimensional aerodynamics on another vehicle.

        C_T, C_Q and the airframe's force coefficients have no dimension. With rotor radius R, air density ρ
        and half-distance L between rotors, k4 and k5 scale with ρ R³, k6 and k7 with ρ R⁴, the airframe's
        moment coefficients with L.
        """
        radius = target.rotor_radius_m / source.rotor_radius_m
        force = target.air_density_kg_m3 / source.air_density_kg_m3 * radius**3
        length = float(np.sqrt(airframe_area(target) / airframe_area(source)))
        return RotorLocalCoefficients(
            thrust=self.thrust,
            torque=self.torque,
            rotor_force_along=self.rotor_force_along * force,
            rotor_force_across=self.rotor_force_across * force,
            rotor_moment_along=self.rotor_moment_along * force * radius,
            rotor_moment_across=self.rotor_moment_across * force * radius,
            airframe_fx=self.airframe_fx,
            airframe_fy=self.airframe_fy,
            airframe_fz=self.airframe_fz,
            airframe_mx=self.airframe_mx * length,
            airframe_my=self.airframe_my * length,
            airframe_mz=self.airframe_mz * length,
        )


@dataclass(frozen=True)
class ScaledAerodynamics(Section):
    """Aerodynamics without dimension of another vehicle, by the name of its file."""

    scaled_from: Text


def _read_aerodynamics(data: Any) -> RotorLocalCoefficients | ScaledAerodynamics:
    if not isinstance(data, Mapping):
        raise ValueError("must be coefficients, or `scaled_from` and a vehicle")
    if "scaled_from" in data:
        return check_config(ScaledAerodynamics, data)
    return check_config(RotorLocalCoefficients, data)


@dataclass(frozen=True, kw_only=True)
class SimulationSection(Section):
    """The key `simulation` of a vehicle file.

    Attributes:
        motor_time_constant_s: time constant of the first-order response of a rotor's speed.
        rotor_local: aerodynamics; None for a vehicle that cannot be simulated.
        effects: effects, read by :func:`quadpi_core.simulation.flying.own_effects`.
        tolerances: tolerances, read where simulations are compared with flights.
    """

    motor_time_constant_s: Annotated[float, Within(0.001, 1.0)] | None = None
    rotor_local: Annotated[
        RotorLocalCoefficients | ScaledAerodynamics | None, PlainValidator(_read_aerodynamics)
    ] = None
    effects: Any = None
    tolerances: Any = None


def read_simulation(name_or_path: str | Path) -> tuple[Path, SimulationSection]:
    """Path and key `simulation` of a vehicle file.

    Raises:
        VehicleError: naming the file and the key that is unknown or impossible.
    """
    path, data = simulation_section(name_or_path)
    return path, parse_config(SimulationSection, data, str(path), VehicleError, ("simulation",))


@dataclass(frozen=True)
class RotorLocalModel:
    """Aerodynamic wrench of a vehicle from its motion through the air and its rotor speeds."""

    vehicle: Vehicle
    coefficients: RotorLocalCoefficients

    @classmethod
    def load(cls, name_or_path: str | Path) -> RotorLocalModel:
        """Read the model from the section `simulation` of a vehicle file.

        Raises:
            VehicleError: naming the file and the key that is missing, unknown or impossible.
        """
        path, aerodynamics = read_simulation(name_or_path)
        vehicle = Vehicle.load(path)
        if aerodynamics.rotor_local is None:
            raise VehicleError(
                f"{path}: cannot be simulated: `simulation.rotor_local` is missing; give its coefficients, "
                "or `scaled_from: bebop2`"
            )
        if isinstance(aerodynamics.rotor_local, RotorLocalCoefficients):
            return cls(vehicle, aerodynamics.rotor_local)
        with named_in(f"{path}: `simulation.rotor_local.scaled_from`"):
            source_path, source = read_simulation(aerodynamics.rotor_local.scaled_from)
            # One step only: the vehicle that others are scaled from has coefficients of its own.
            if not isinstance(source.rotor_local, RotorLocalCoefficients):
                raise VehicleError(f"{source_path}: `simulation.rotor_local` has no coefficients of its own")
            return cls(vehicle, source.rotor_local.scaled(Vehicle.load(source_path), vehicle))

    @cached_property
    def hover_rotor_speed(self) -> float:
        """Rotor speed [rad/s] at which four rotors in still air carry the weight.

        Raises:
            SimulationError: if the thrust coefficient at rest is not positive.
        """
        if self.coefficients.thrust[0] <= 0.0:
            raise SimulationError(f"vehicle {self.vehicle.name}: its rotors give no thrust at rest")
        vehicle = self.vehicle
        weight = vehicle.mass_kg * vehicle.gravity_m_s2
        per_square_speed = vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**4
        return float(np.sqrt(weight / (ROTORS * self.coefficients.thrust[0] * per_square_speed)))

    def wrench(self, velocity: Array, rates: Array, rotor_speeds: Array) -> Array:
        """Wrench (N, 6) [N, Nm], body axes, columns as `flight.AXES`.

        Args:
            velocity: (N, 3) m/s relative to the air, body axes.
            rates: (N, 3) rad/s.
            rotor_speeds: (N, 4) rad/s.

        Raises:
            SimulationError: for another shape, and for values that are not finite.
        """
        return self.states(velocity, rates, rotor_speeds)["wrench"].copy()

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
            rotor_speeds: (N, 4) rad/s.
            rotor_accelerations: (N, 4) rad/s²; zero where not given.
            position: (N, 3) m, world; the origin where not given.
            attitude: (N, 4) body to world; level where not given.

        Raises:
            SimulationError: for another shape, and for values that are not finite.
        """
        states = np.zeros(len(velocity), dtype=STATE)
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
        _aerodynamics_of_all(states, self.record())
        return states

    def record(self, motor_time_constant: float = np.inf) -> npt.NDArray[np.void]:
        """Record VEHICLE (1,) for the compiled physics."""
        record = vehicle_record(self.vehicle, self.hover_rotor_speed, motor_time_constant)
        for column in fields(self.coefficients):
            record[column.name] = getattr(self.coefficients, column.name)
        return record


def vehicle_record(
    vehicle: Vehicle, hover_rotor_speed: float, motor_time_constant: float = np.inf
) -> npt.NDArray[np.void]:
    """Record VEHICLE (1,) of a vehicle without aerodynamics.

    Args:
        vehicle: vehicle.
        hover_rotor_speed: rotor speed [rad/s] that carries the weight in still air.
        motor_time_constant: time constant [s] of the rotors.
    """
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


@njit(cache=True, nogil=True)
def aerodynamics(state: State, vehicle: VehicleNumbers) -> None:
    """Fill hub velocities, thrusts, torques and wrench of a STATE from the rest of it.

    Source: equations of the Bebop 2 rotor-local model as in the module's docstring. A rotor at rest has the
    largest advance ratio of the fit; air at rest has disc angle 0.
    """
    p, q, r = state.rates[0], state.rates[1], state.rates[2]
    radius = vehicle.rotor_radius
    disc = vehicle.air_density * np.pi * radius**4
    wrench = state.wrench
    wrench[:] = 0.0
    for rotor in range(ROTORS):
        x, y, z = (
            vehicle.rotor_positions[rotor, 0],
            vehicle.rotor_positions[rotor, 1],
            vehicle.rotor_positions[rotor, 2],
        )
        spin, speed = vehicle.rotor_spins[rotor], state.rotor_speeds[rotor]
        u = state.velocity_air[0] + q * z - r * y
        v = state.velocity_air[1] + r * x - p * z
        w = state.velocity_air[2] + p * y - q * x
        in_plane = np.sqrt(u * u + v * v)
        airspeed = np.sqrt(in_plane * in_plane + w * w)
        tip_speed = speed * radius
        advance_ratio = ADVANCE_RATIO_MAX
        if airspeed < ADVANCE_RATIO_MAX * tip_speed:
            advance_ratio = airspeed / tip_speed
        disc_angle = np.arctan2(w, in_plane)

        thrust = _coefficient(vehicle.thrust, advance_ratio, disc_angle) * disc * speed * speed
        torque = (
            spin * _coefficient(vehicle.torque, advance_ratio, disc_angle) * disc * radius * speed * speed
        )
        force_x = speed * (vehicle.rotor_force_along * u + spin * vehicle.rotor_force_across * v)
        force_y = speed * (vehicle.rotor_force_along * v - spin * vehicle.rotor_force_across * u)
        hub_x = speed * (spin * vehicle.rotor_moment_across * u - vehicle.rotor_moment_along * v)
        hub_y = speed * (vehicle.rotor_moment_along * u + spin * vehicle.rotor_moment_across * v)

        state.hub_velocity[rotor, 0], state.hub_velocity[rotor, 1], state.hub_velocity[rotor, 2] = u, v, w
        state.thrusts[rotor], state.torques[rotor] = thrust, torque
        wrench[0] += force_x
        wrench[1] += force_y
        wrench[2] -= thrust
        wrench[3] += hub_x - y * thrust
        wrench[4] += hub_y + x * thrust
        wrench[5] += torque - y * force_x + x * force_y
    _add_airframe(state, vehicle)


@njit(cache=True, nogil=True)
def _coefficient(c: Array, m: float, a: float) -> float:
    """C_T or C_Q of advance ratio m and disc angle a, as nested products of the 16 terms."""
    free: float = c[0] + m * (c[1] + m * (c[2] + m * (c[3] + m * (c[4] + m * c[5]))))
    first = m * (c[6] + m * (c[7] + m * (c[8] + m * c[9])))
    second = m * (c[10] + m * (c[11] + m * c[12]))
    third = m * (c[13] + m * c[14])
    coefficient: float = free + a * (first + a * (second + a * (third + a * m * c[15])))
    return coefficient


@njit(cache=True, nogil=True)
def _add_airframe(state: State, vehicle: VehicleNumbers) -> None:
    u, v, w = state.velocity_air[0], state.velocity_air[1], state.velocity_air[2]
    square = u * u + v * v + w * w
    if square == 0.0:
        return
    airspeed = np.sqrt(square)
    u, v, w = u / airspeed, v / airspeed, w / airspeed
    pressure_area = 0.5 * vehicle.air_density * vehicle.airframe_area * square
    wrench = state.wrench
    wrench[0] += pressure_area * _odd(vehicle.airframe_fx, u)
    wrench[1] += pressure_area * _odd(vehicle.airframe_fy, v)
    wrench[2] += pressure_area * _odd(vehicle.airframe_fz, w)
    wrench[3] += pressure_area * np.sign(v) * _airframe_moment(vehicle.airframe_mx, abs(v), w)
    wrench[4] += pressure_area * np.sign(u) * _airframe_moment(vehicle.airframe_my, abs(u), w)
    wrench[5] += (
        pressure_area * np.sign(u) * np.sign(v) * _airframe_moment(vehicle.airframe_mz, abs(v), abs(u))
    )


@njit(cache=True, nogil=True)
def _odd(c: Array, x: float) -> float:
    return float(np.sign(x) * (c[0] * abs(x) + c[1] * x * x))


@njit(cache=True, nogil=True)
def _airframe_moment(c: Array, x: float, y: float) -> float:
    return float(x * (c[0] + x * (c[1] + x * c[3] + y * c[5]) + y * (c[2] + y * c[4])))


@njit(cache=True, nogil=True)
def _aerodynamics_of_all(states: Records, vehicles: Records) -> None:
    for i in range(len(states)):
        aerodynamics(states[i], vehicles[0])
