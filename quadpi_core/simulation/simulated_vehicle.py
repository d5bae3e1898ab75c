# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A vehicle that can be simulated: the section `simulation` of its vehicle file."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import VehicleError
from quadpi_core.simulation.effect_definition import Effects
from quadpi_core.simulation.effect_registry import read_effects
from quadpi_core.simulation.rotor_local import RotorLocalModel, read_simulation
from quadpi_core.vehicle import Vehicle


@dataclass(frozen=True)
class SimulatedVehicle:
    """Aerodynamics and motors of a vehicle.

    Attributes:
        aerodynamics: its rotor-local model; holds the vehicle.
        motor_time_constant: s, of the first-order answer of a rotor's speed to its command.
        effects: that the vehicle always has.
    """

    aerodynamics: RotorLocalModel
    motor_time_constant: float
    effects: Effects = field(default_factory=dict)

    @classmethod
    def load(cls, name_or_path: str | Path) -> SimulatedVehicle:
        """Read a vehicle by the name of a file in config/vehicles, or by path.

        Raises:
            VehicleError: naming the file and the key that is missing, unknown or impossible.
            SimulationError: likewise, of effects.
        """
        path, section = read_simulation(name_or_path)
        aerodynamics = RotorLocalModel.load(path)
        if section.motor_time_constant_s is None:
            raise VehicleError(f"{path}: simulation: missing key `motor_time_constant_s`")
        return cls(aerodynamics, section.motor_time_constant_s, own_effects(path))

    @property
    def vehicle(self) -> Vehicle:
        """Mass, inertia, rotors and sensors."""
        return self.aerodynamics.vehicle

    @property
    def greatest_thrust(self) -> float:
        """Thrust [N] of four rotors at their greatest speed, in still air."""
        vehicle = self.vehicle
        ratio = vehicle.rotor_speed_max_rad_s / self.aerodynamics.hover_rotor_speed
        return float(vehicle.mass_kg * vehicle.gravity_m_s2 * ratio**2)

    def with_own(self, effects: Effects) -> Effects:
        """Effects of a flight and the vehicle's own; of the same name those of the flight count."""
        return {**self.effects, **effects}

    def altered(self, vehicle: Vehicle) -> SimulatedVehicle:
        """The same aerodynamics and motors under another mass and inertia."""
        return replace(self, aerodynamics=replace(self.aerodynamics, vehicle=vehicle))

    def record(self) -> npt.NDArray[np.void]:
        """Record VEHICLE (1,) for the compiled physics."""
        return self.aerodynamics.record(self.motor_time_constant)


def own_effects(name_or_path: str | Path) -> Effects:
    """The effects that a vehicle file says the vehicle always has: its mapping `simulation.effects`.

    Raises:
        VehicleError: naming the file and the key that is unknown or impossible.
        SimulationError: naming the effect or parameter that is unknown or out of bounds.
    """
    path, section = read_simulation(name_or_path)
    return read_effects(section.effects, f"{path}: simulation.effects")
