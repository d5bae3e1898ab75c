# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Motor cuts for tests: a simulated flight whose rotor stops at an instant, with what follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core import frames
from quadpi_core.frames import Array
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.truth import LOG_HZ, Truth

# Steps of integration per logged instant, and what is flown after the cut.
_STEPS = 4
FLOWN_S = 0.4


def with_motor_cut(truth: Truth, simulated: SimulatedVehicle, rotor: int, at_s: float) -> Truth:
    """The flight until 0.4 s after its rotor is cut; the controller, unaware of it, damps the rates."""
    vehicle = simulated.vehicle
    start, count = round(at_s * LOG_HZ), round(FLOWN_S * LOG_HZ)
    columns = {
        name: values[: start + count].copy()
        for name, values in vars(truth).items()
        if isinstance(values, np.ndarray) and len(values) == len(truth.time_ns)
    }
    turn = np.array(frames.matrix(truth.attitude[start]))
    attitude, position = truth.attitude[start].copy(), truth.position[start].copy()
    velocity, rates = turn @ truth.velocity[start], truth.rates[start].copy()
    speeds = truth.rotor_speeds[start].copy()
    x, y = vehicle.rotor_positions[:, 0], vehicle.rotor_positions[:, 1]
    rotors = vehicle.rotor_count
    allocation = np.linalg.pinv(np.stack((np.ones(rotors), -y, x)))
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    per_square = weight / (rotors * simulated.aerodynamics.hover_rotor_speed**2)
    lag = np.full(rotors, simulated.motor_time_constant)
    step_s = 1.0 / (LOG_HZ * _STEPS)
    # What a servo that tilts a rotor gives about z stays as it is.
    now = simulated.aerodynamics.wrench(truth.velocity[start : start + 1], rates[None], speeds[None])[0]
    servo = truth.wrench[start, 5] - now[5] if vehicle.rotor_count == 3 else 0.0
    for row in range(start, start + count):
        for step in range(_STEPS):
            moment = -25.0 * vehicle.inertia[[0, 1], [0, 1]] * rates[:2]
            wanted = allocation @ np.array([weight, *moment])
            command = np.sqrt(np.clip(wanted / per_square, 100.0**2, vehicle.rotor_speed_max_rad_s**2))
            command[rotor] = 0.0
            slopes = (command - speeds) / lag
            turn = np.array(frames.matrix(attitude))
            wrench = simulated.aerodynamics.wrench((turn.T @ velocity)[None], rates[None], speeds[None])[0]
            wrench[5] += servo
            acceleration = turn @ wrench[:3] / vehicle.mass_kg + [0.0, 0.0, vehicle.gravity_m_s2]
            moment = wrench[3:] - np.cross(rates, vehicle.inertia @ rates)
            turning: Array = np.linalg.solve(vehicle.inertia, moment)
            if step == 0:
                for name, value in {
                    "position": position,
                    "attitude": attitude,
                    "velocity": turn.T @ velocity,
                    "rates": rates,
                    "acceleration": acceleration,
                    "angular_acceleration": turning,
                    "rotor_speeds": speeds,
                    "rotor_accelerations": slopes,
                    "wrench": wrench,
                }.items():
                    columns[name][row] = value
            velocity = velocity + step_s * acceleration
            position = position + step_s * velocity
            rates = rates + step_s * turning
            turned = np.array(frames.from_rotation_vector(step_s * rates))
            attitude = np.array(frames.product(attitude, turned))
            speeds = np.maximum(speeds + step_s * slopes, 0.0)
    return replace(truth, **columns)
