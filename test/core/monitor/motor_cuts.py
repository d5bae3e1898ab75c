# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rigid bodies for tests, flown step by step, and a simulated flight whose rotor stops at an instant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quadpi_core import frames
from quadpi_core.frames import Array
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.truth import LOG_HZ, Truth
from quadpi_core.vehicle import Vehicle

# Steps of integration per logged instant, and what is flown after the cut.
_STEPS = 4
FLOWN_S = 0.4


@dataclass
class FlownBody:
    """A vehicle in motion: position and velocity in the world, rates in body axes, rotor speeds."""

    vehicle: Vehicle
    position: Array
    attitude: Array
    velocity: Array
    rates: Array
    speeds: Array

    @property
    def turn(self) -> Array:
        """Rotation matrix, body to world."""
        return np.array(frames.matrix(self.attitude))

    def aerodynamic_wrench(self, simulated: SimulatedVehicle) -> Array:
        """Wrench (6,) that it would feel in still air, as simulated."""
        velocity = self.turn.T @ self.velocity
        return simulated.aerodynamics.wrench(velocity[None], self.rates[None], self.speeds[None])[0]

    def step(self, wrench: Array, slopes: Array, step_s: float) -> dict[str, Array]:
        """Move on by Euler's method under a wrench (6,) and slopes of speeds; gives the state before."""
        turn, vehicle = self.turn, self.vehicle
        moment = wrench[3:] - np.cross(self.rates, vehicle.inertia @ self.rates)
        before = {
            "position": self.position,
            "attitude": self.attitude,
            "velocity": turn.T @ self.velocity,
            "rates": self.rates,
            "acceleration": turn @ wrench[:3] / vehicle.mass_kg + [0.0, 0.0, vehicle.gravity_m_s2],
            "angular_acceleration": np.linalg.solve(vehicle.inertia, moment),
            "rotor_speeds": self.speeds,
            "rotor_accelerations": slopes,
            "wrench": wrench,
        }
        self.velocity = self.velocity + step_s * before["acceleration"]
        self.position = self.position + step_s * self.velocity
        self.rates = self.rates + step_s * before["angular_acceleration"]
        turned = np.array(frames.from_rotation_vector(step_s * self.rates))
        self.attitude = np.array(frames.product(self.attitude, turned))
        self.speeds = np.maximum(self.speeds + step_s * slopes, 0.0)
        return before


def with_motor_cut(truth: Truth, simulated: SimulatedVehicle, rotor: int, at_s: float) -> Truth:
    """The flight until 0.4 s after its rotor is cut; the controller, unaware of it, damps the rates."""
    vehicle = simulated.vehicle
    start, count = round(at_s * LOG_HZ), round(FLOWN_S * LOG_HZ)
    columns = {
        name: values[: start + count].copy()
        for name, values in vars(truth).items()
        if isinstance(values, np.ndarray) and len(values) == len(truth.time_ns)
    }
    body = FlownBody(
        vehicle,
        truth.position[start],
        truth.attitude[start],
        np.array(frames.matrix(truth.attitude[start])) @ truth.velocity[start],
        truth.rates[start],
        truth.rotor_speeds[start],
    )
    x, y = vehicle.rotor_positions[:, 0], vehicle.rotor_positions[:, 1]
    rotors = vehicle.rotor_count
    allocation = np.linalg.pinv(np.stack((np.ones(rotors), -y, x)))
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    per_square = weight / (rotors * simulated.aerodynamics.hover_rotor_speed**2)
    lag = np.full(rotors, simulated.motor_time_constant)
    step_s = 1.0 / (LOG_HZ * _STEPS)
    # What a servo that tilts a rotor gives about z stays as it is.
    given = (truth.velocity[start], body.rates, body.speeds)
    now = simulated.aerodynamics.wrench(*(own[None] for own in given))[0]
    servo = truth.wrench[start, 5] - now[5] if rotors == 3 else 0.0
    for row in range(start, start + count):
        for step in range(_STEPS):
            moment = -25.0 * vehicle.inertia[[0, 1], [0, 1]] * body.rates[:2]
            wanted = allocation @ np.array([weight, *moment])
            command = np.sqrt(np.clip(wanted / per_square, 100.0**2, vehicle.rotor_speed_max_rad_s**2))
            command[rotor] = 0.0
            wrench = body.aerodynamic_wrench(simulated)
            wrench[5] += servo
            before = body.step(wrench, (command - body.speeds) / lag, step_s)
            if step == 0:
                for name, value in before.items():
                    columns[name][row] = value
    return replace(truth, **columns)
