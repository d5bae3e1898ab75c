# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A load on a cable below the vehicle, which swings."""

from __future__ import annotations

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.frames import Array
from quadpi_core.simulation.effect_definition import Parameter, Wrench, body_to_world, effect, world_to_body
from quadpi_core.simulation.state_records import State, VehicleNumbers

# Shortest cable [m]: on a shorter one the load swings faster than flights are integrated.
SHORTEST_CABLE_M = compiled.SHORTEST_CABLE_M


@effect(
    "wrench",
    "Fx Fy Fz Mx My",
    Parameter("mass_kg", "kg", 0.03, 0.0, 5.0),
    Parameter("length_m", "m", 0.5, SHORTEST_CABLE_M, 20.0),
    Parameter("damping_1_s", "1/s", 0.1, 0.0, 5.0),
    Parameter("hook_m", "m", 0.01, -0.5, 0.5),
    shown_by="lateral stops from two speeds",
    composable=False,
    at_rest=(0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
    # Half a radian, and the rate of that swing on half a metre.
    start_spread=(0.5, 0.5, 0.5, 2.0, 2.0, 2.0),
    moments_alone=("hook_m",),
    brings=("payload",),
    formula=(
        r"F = T\,R_{BE}\,n,\quad T = m_L\,\max(l\,|\dot n|^2 - n \cdot f,\ 0),\quad "
        r"\ddot n = -\frac{f - (n \cdot f)\,n}{l} - |\dot n|^2\,n - c\,\dot n,\quad M = (0, 0, h) \times F"
    ),
    symbols="m_L l c h",
)
def slung_load(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """A load on a cable below the centre of gravity: a spherical pendulum that the vehicle's motion drives.

    n is the direction from the vehicle to the load, in the world, and f the specific force of the vehicle
    there, with the pull of the cable, whose tension T is 0 where it would push. The cable has no mass, stays
    taut, and pulls at a hook so near the centre of gravity that it moves alike. Its own state is n and its
    derivative. Size: 30 g on half a metre, 0.3 N.
    """
    mass, length, damping = p[0], max(p[1], SHORTEST_CABLE_M), p[2]
    own, force = state.memory.T, np.array(body_to_world(state.attitude, *state.wrench.T[:3])) / vehicle.mass
    size, along = np.sqrt(np.sum(own[:3] ** 2, axis=0)), np.sqrt(np.sum(force**2, axis=0))
    # Without a state of its own, as in records of single instants, the load hangs along the force.
    hanging = -force / np.where(along > 0.0, along, 1.0)
    n = np.where(size == 0.0, hanging, own[:3] / np.where(size > 0.0, size, 1.0))
    v = own[3:] - np.sum(n * own[3:], axis=0) * n
    turning, pulled = np.sum(v * v, axis=0), np.sum(n * force, axis=0)
    tension = mass * np.maximum(length * turning - pulled, 0.0)
    # A force that is not measured is that without the cable, which pulls the vehicle towards the load.
    tension *= np.where(state.force_is_measured == 0.0, vehicle.mass / (vehicle.mass + mass), 1.0)
    state.memory_slope.T[:3] = size * v
    state.memory_slope.T[3:] = -(force - pulled * n) / length - turning * n - damping * v
    x, y, z = world_to_body(state.attitude, *(tension * n))
    return x, y, z, -p[3] * y, p[3] * x, 0.0
