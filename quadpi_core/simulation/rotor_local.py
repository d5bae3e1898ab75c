# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotor-local aerodynamics: each rotor sees its own airspeed (Sun and de Visser, Bebop 2 in a wind tunnel).

The equations are those of the public simulation SihaoSun/INDI_Quadrotor_FTC. Two features of the published
fit are kept: at standstill the slope of the thrust jumps, and slow climb and slow descent both lose thrust.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import Numbers, ReadBy, Real, Section, Text, check_config, parse_config
from quadpi_core.core import compiled
from quadpi_core.errors import SimulationError, VehicleError, named_in
from quadpi_core.frames import Array
from quadpi_core.records import Threshold
from quadpi_core.simulation.simulated_aerodynamics import SimulatedAerodynamics, airframe_area
from quadpi_core.simulation.simulated_file import SimulatedFile, read_simulation
from quadpi_core.simulation.state_records import Law
from quadpi_core.vehicle import Vehicle

FITTED_ADVANCE_RATIO = Threshold(
    "largest advance ratio",
    compiled.ADVANCE_RATIO_MAX,
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
        force = target.air_density_kg_m3 / source.air_density_kg_m3 * (radius * radius * radius)
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


def _read_aerodynamics(data: Any) -> RotorLocalCoefficients | ScaledAerodynamics | None:
    if data is None:
        return None
    if not isinstance(data, Mapping):
        raise ValueError("must be coefficients, or `scaled_from` and a vehicle")
    if "scaled_from" in data:
        return check_config(ScaledAerodynamics, data)
    return check_config(RotorLocalCoefficients, data)


@dataclass(frozen=True, kw_only=True)
class _Section(Section):
    """The keys of `simulation` in a vehicle file that belong to this law."""

    rotor_local: Annotated[RotorLocalCoefficients | ScaledAerodynamics | None, ReadBy(_read_aerodynamics)] = (
        None
    )


# Coefficients that one factor scales, by the name of their group: the first (static), all others, or all.
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
class RotorLocalModel(SimulatedAerodynamics):
    """The rotor-local law with the coefficients of a vehicle."""

    key: ClassVar[str] = "rotor_local"
    coefficients_by_name = tuple(_SCALED)
    vehicle: Vehicle
    coefficients: RotorLocalCoefficients

    @classmethod
    def load(cls, name_or_path: str | Path) -> RotorLocalModel:
        """Read the model from the section `simulation` of a vehicle file.

        Raises:
            VehicleError: naming the file and the key that is missing, unknown or impossible.
        """
        file = read_simulation(name_or_path)
        coefficients = cls._read(file)
        if coefficients is None:
            raise VehicleError(
                f"{file.path}: cannot be simulated: `simulation.rotor_local` is missing; give its "
                "coefficients, or `scaled_from: bebop2`"
            )
        if isinstance(coefficients, RotorLocalCoefficients):
            return cls(file.vehicle, coefficients)
        with named_in(f"{file.path}: `simulation.rotor_local.scaled_from`"):
            other = read_simulation(coefficients.scaled_from)
            source = cls._read(other)
            # One step only: the vehicle that others are scaled from has coefficients of its own.
            if not isinstance(source, RotorLocalCoefficients):
                raise VehicleError(f"{other.path}: `simulation.rotor_local` has no coefficients of its own")
            return cls(file.vehicle, source.scaled(other.vehicle, file.vehicle))

    @staticmethod
    def _read(file: SimulatedFile) -> RotorLocalCoefficients | ScaledAerodynamics | None:
        given = {"rotor_local": file.section.rotor_local}
        return parse_config(_Section, given, str(file.path), VehicleError, ("simulation",)).rotor_local

    @cached_property
    def hover_rotor_speed(self) -> float:
        """Rotor speed [rad/s] at which the rotors in still air carry the weight.

        Raises:
            SimulationError: if the thrust coefficient at rest is not positive.
        """
        if self.coefficients.thrust[0] <= 0.0:
            raise SimulationError(f"vehicle {self.vehicle.name}: its rotors give no thrust at rest")
        vehicle = self.vehicle
        weight = vehicle.mass_kg * vehicle.gravity_m_s2
        per_square_speed = vehicle.air_density_kg_m3 * np.pi * np.square(np.square(vehicle.rotor_radius_m))
        return float(np.sqrt(weight / (vehicle.rotor_count * self.coefficients.thrust[0] * per_square_speed)))

    @property
    def function(self) -> Law:
        """See :class:`.SimulatedAerodynamics`."""
        return self.key

    @property
    def numbers(self) -> Array:
        """None: the record of the vehicle holds the coefficients."""
        return np.zeros((0, 0))

    def scaled(self, shares: Mapping[str, float]) -> RotorLocalModel:
        """See :class:`.SimulatedAerodynamics`; the names are those of `_SCALED`."""
        changed: dict[str, Any] = dict(vars(self.coefficients))
        for name, share in shares.items():
            key, part = _SCALED[name]
            value = np.array(changed[key], dtype=float, ndmin=1)
            value[part] *= 1.0 + share
            changed[key] = value if np.ndim(changed[key]) else float(value[0])
        return replace(self, coefficients=RotorLocalCoefficients(**changed))

    def carrying(self, vehicle: Vehicle) -> RotorLocalModel:
        """See :class:`.SimulatedAerodynamics`."""
        return replace(self, vehicle=vehicle)

    def to_section(self) -> dict[str, Any]:
        """See :class:`.SimulatedAerodynamics`."""
        return {
            name: value if isinstance(value, float) else value.tolist()
            for name, value in vars(self.coefficients).items()
        }

    @cached_property
    def effectiveness(self) -> Array:
        """See :class:`.SimulatedAerodynamics`; of the coefficients at rest."""
        vehicle, c = self.vehicle, self.coefficients
        disc = vehicle.air_density_kg_m3 * np.pi * np.square(np.square(vehicle.rotor_radius_m))
        slope, yaw_slope = c.thrust[0] * disc, c.torque[0] * disc * vehicle.rotor_radius_m
        x, y, _ = vehicle.rotor_positions.T
        return np.stack(
            (np.full(vehicle.rotor_count, slope), -y * slope, x * slope, vehicle.rotor_spins * yaw_slope)
        )

    def record(self, motor_time_constant: float = np.inf) -> npt.NDArray[np.void]:
        """Record VEHICLE (1,) for the compiled physics."""
        record = super().record(motor_time_constant)
        for column in fields(self.coefficients):
            record[column.name] = getattr(self.coefficients, column.name)
        return record
