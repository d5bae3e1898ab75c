# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A load on a cable below the vehicle, which swings."""

from __future__ import annotations

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.simulation.effect_definition import (
    NO_WRENCH,
    Parameter,
    Wrench,
    body_to_world,
    effect,
    world_to_body,
)
from quadpi_core.simulation.state_records import State, VehicleNumbers

# Shortest cable [m]: on a shorter one the load swings faster than flights are integrated.
_SHORTEST_M = 0.05


@effect(
    "wrench",
    "Fx Fy Fz Mx My",
    Parameter("mass_kg", "kg", 0.03, 0.0, 5.0),
    Parameter("length_m", "m", 0.5, _SHORTEST_M, 20.0),
    Parameter("damping_1_s", "1/s", 0.1, 0.0, 5.0),
    Parameter("hook_m", "m", 0.01, -0.5, 0.5),
    shown_by="lateral stops from two speeds",
    composable=False,
    at_rest=(0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
    # Half a radian, and the rate of that swing on half a metre.
    start_spread=(0.5, 0.5, 0.5, 2.0, 2.0, 2.0),
    moments_alone=("hook_m",),
    formula=(
        r"F = T\,R_{BE}\,n,\quad T = m_L\,\max(l\,|\dot n|^2 - n \cdot f,\ 0),\quad "
        r"\ddot n = -\frac{f - (n \cdot f)\,n}{l} - |\dot n|^2\,n - c\,\dot n,\quad M = (0, 0, h) \times F"
    ),
    symbols="m_L l c h",
)
@njit(cache=True)
def slung_load(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """A load on a cable below the centre of gravity: a spherical pendulum that the vehicle's motion drives.

    n is the direction from the vehicle to the load, in the world, and f the specific force of the vehicle
    there, with the pull of the cable, whose tension T is 0 where it would push. The cable has no mass, stays
    taut, and pulls at a hook so near the centre of gravity that it moves alike. Its own state is n and its
    derivative. Size: 30 g on half a metre, 0.3 N.
    """
    mass, length, damping = p[0], max(p[1], _SHORTEST_M), p[2]
    memory, slope = state.memory, state.memory_slope
    size = np.sqrt(memory[0] ** 2 + memory[1] ** 2 + memory[2] ** 2)
    force = state.wrench
    fx, fy, fz = body_to_world(state.attitude, force[0], force[1], force[2])
    fx, fy, fz = fx / vehicle.mass, fy / vehicle.mass, fz / vehicle.mass
    if size == 0.0:
        # Without a state of its own, as in records of single instants, the load hangs along the force.
        along = np.sqrt(fx * fx + fy * fy + fz * fz)
        if along == 0.0:
            return NO_WRENCH
        nx, ny, nz = -fx / along, -fy / along, -fz / along
    else:
        nx, ny, nz = memory[0] / size, memory[1] / size, memory[2] / size
    vx, vy, vz = memory[3], memory[4], memory[5]
    along = nx * vx + ny * vy + nz * vz
    vx, vy, vz = vx - along * nx, vy - along * ny, vz - along * nz
    turning = vx * vx + vy * vy + vz * vz
    pulled = nx * fx + ny * fy + nz * fz
    tension = mass * max(length * turning - pulled, 0.0)
    if state.force_is_measured == 0.0:
        # The force is that without the cable, which pulls the vehicle towards the load.
        tension *= vehicle.mass / (vehicle.mass + mass)
    slope[0], slope[1], slope[2] = size * vx, size * vy, size * vz
    slope[3] = -(fx - pulled * nx) / length - turning * nx - damping * vx
    slope[4] = -(fy - pulled * ny) / length - turning * ny - damping * vy
    slope[5] = -(fz - pulled * nz) / length - turning * nz - damping * vz
    x, y, z = world_to_body(state.attitude, tension * nx, tension * ny, tension * nz)
    return x, y, z, -p[3] * y, p[3] * x, 0.0
