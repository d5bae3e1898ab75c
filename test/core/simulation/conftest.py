# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A truth whose derivatives are exact, without a simulation: a body that swings and spins along sines."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from quadpi_core.frames import Array, quaternion_from_roll_pitch_yaw
from quadpi_core.rotations import rotate_world_to_body
from quadpi_core.simulation.truth import Reference, Truth
from quadpi_core.vehicle import Vehicle

START_NS = 1_700_000_000_000_000_000


def swing(seconds: float = 4.0, *, wind: bool = True, roll: float = 0.7, pitch: float = 0.4) -> Truth:
    """Truth at 500 Hz with largest roll and pitch [rad]; yaw, path and rotor speeds vary as well."""
    vehicle = Vehicle.load("bebop2")
    time = np.arange(round(seconds * 500) + 1) / 500.0

    def sines(amplitude: list[float], frequency: list[float], order: int) -> Array:
        rate = np.array(frequency)
        return np.array(amplitude) * rate**order * np.sin(np.outer(time, rate) + order * np.pi / 2)

    angles, turning, turning_rate = (sines([roll, pitch, 1.5], [3.0, 2.2, 0.9], order) for order in range(3))
    path = [sines([2.0, 1.0, 0.5], [1.1, 1.7, 0.8], order) for order in range(3)]
    attitude = quaternion_from_roll_pitch_yaw(angles)
    rates, angular_acceleration = _body_rates(angles, turning, turning_rate)
    gravity = np.array([0.0, 0.0, vehicle.gravity_m_s2])
    momentum = rates @ vehicle.inertia
    force = vehicle.mass_kg * rotate_world_to_body(attitude, path[2] - gravity)
    moment = angular_acceleration @ vehicle.inertia + np.cross(rates, momentum)
    air = np.tile([-8.0, 0.0, 0.0], (len(time), 1))
    return Truth(
        name="swing",
        vehicle=vehicle,
        time_ns=START_NS + np.arange(len(time)) * 2_000_000,
        position=path[0],
        attitude=attitude,
        velocity=rotate_world_to_body(attitude, path[1]),
        rates=rates,
        acceleration=path[2],
        angular_acceleration=angular_acceleration,
        rotor_speeds=600.0 + sines([90.0, 70.0, 50.0, 80.0], [5.0, 4.0, 6.0, 3.0], 0),
        rotor_accelerations=sines([90.0, 70.0, 50.0, 80.0], [5.0, 4.0, 6.0, 3.0], 1),
        wrench=np.concatenate((force, moment), axis=1),
        wind=air + sines([0.3, 0.2, 0.1], [7.0, 9.0, 8.0], 0) if wind else np.zeros_like(air),
        known_wind=air if wind else None,
        reference=Reference(
            *path, angles[:, 2], turning[:, 2], np.zeros((len(time), 2)), np.zeros(len(time))
        ),
    )


def _body_rates(angles: Array, turning: Array, turning_rate: Array) -> tuple[Array, Array]:
    """Body rates and their derivative of roll, pitch and yaw, their first and second derivatives (N, 3)."""
    (sr, sp, _), (cr, cp, _) = np.sin(angles).T, np.cos(angles).T
    (dr, dp, dy), (ddr, ddp, ddy) = turning.T, turning_rate.T
    rates = np.stack((dr - dy * sp, dp * cr + dy * cp * sr, dy * cp * cr - dp * sr), axis=1)
    derivative = np.stack(
        (
            ddr - ddy * sp - dy * dp * cp,
            ddp * cr - dp * dr * sr + ddy * cp * sr + dy * (dr * cp * cr - dp * sp * sr),
            ddy * cp * cr - dy * (dp * sp * cr + dr * cp * sr) - ddp * sr - dp * dr * cr,
        ),
        axis=1,
    )
    return rates, derivative


@pytest.fixture(scope="session", name="swing")
def swing_fixture() -> Callable[..., Truth]:
    """swing(seconds, …) → Truth, see :func:`swing`."""
    return swing
