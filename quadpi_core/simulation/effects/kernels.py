# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What several wrench effects share, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.signals.rotations import inverse, product
from quadpi_core.simulation.effects.definition import Wrench

NO_WRENCH: Wrench = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@njit(cache=True)
def with_hub_force(wrench: Wrench, vehicle: Any, rotor: int, fx: float, fy: float, fz: float) -> Wrench:
    """The wrench with a force at the hub of a rotor added, and its moment r × F."""
    x = vehicle.rotor_positions[rotor, 0]
    y = vehicle.rotor_positions[rotor, 1]
    z = vehicle.rotor_positions[rotor, 2]
    return (
        wrench[0] + fx,
        wrench[1] + fy,
        wrench[2] + fz,
        wrench[3] + (y * fz - z * fy),
        wrench[4] + (z * fx - x * fz),
        wrench[5] + (x * fy - y * fx),
    )


@njit(cache=True)
def in_plane_speed(state: Any, rotor: int) -> float:
    """Airspeed [m/s] of a hub within the plane of its disc."""
    u, v = state.hub_velocity[rotor, 0], state.hub_velocity[rotor, 1]
    speed: float = np.sqrt(u * u + v * v)
    return speed


@njit(cache=True)
def hub_height(state: Any, vehicle: Any, rotor: int) -> float:
    """Height [m] of a hub above the ground, negative below it."""
    x, y, z = world_to_body(state.attitude, 0.0, 0.0, 1.0)
    hub = vehicle.rotor_positions[rotor]
    below_centre = x * hub[0] + y * hub[1] + z * hub[2]
    height: float = -(state.position[2] + below_centre)
    return height


@njit(cache=True)
def world_to_body(attitude: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector of the world in body axes."""
    quaternion = (attitude[0], attitude[1], attitude[2], attitude[3])
    turned = product(inverse(quaternion), product((0.0, x, y, z), quaternion))
    return turned[1], turned[2], turned[3]
