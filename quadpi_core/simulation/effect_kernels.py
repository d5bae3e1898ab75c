# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled functions that several wrench effects use."""

from __future__ import annotations

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.rotations import inverse, product
from quadpi_core.simulation.effect_definition import SHAPE, Wrench
from quadpi_core.simulation.state_records import State, VehicleNumbers
from quadpi_core.thresholds import CONVENTION, Threshold

NO_WRENCH: Wrench = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
SHAPE_MAX = Threshold(
    "largest factor on a law that flights shape",
    3.0,
    "factor, the smallest being 0",
    "beyond what was flown a law neither changes sign nor grows without bound",
    CONVENTION,
)
_MOST = SHAPE_MAX.value
# `SHAPE` begins with a share for each axis.
_AXES = 6
MODULATORS = len(SHAPE) - _AXES


@njit(cache=True)
def modulators(
    state: State, vehicle: VehicleNumbers
) -> tuple[float, float, float, float, float, float, float, float]:
    """What a shaped law may depend on beyond its formula, as in `effect_definition.SHAPE` after the axes.

    Airspeed and its components over the induced velocity of hover, mean square of the rotor speeds over that
    of hover, speed of a rotor's radius at the body rates over the induced velocity, radius over height, and
    the square of the velocity along z over the induced one: climb and descent alike.
    """
    induced, radius = vehicle.hover_induced_velocity, vehicle.rotor_radius
    u, v, w = (
        state.velocity_air[0] / induced,
        state.velocity_air[1] / induced,
        state.velocity_air[2] / induced,
    )
    p, q, r = state.rates[0], state.rates[1], state.rates[2]
    load = 0.0
    for rotor in range(4):
        load += 0.25 * (state.rotor_speeds[rotor] / vehicle.hover_rotor_speed) ** 2
    speed = np.sqrt(u * u + v * v + w * w)
    turning = radius * np.sqrt(p * p + q * q + r * r)
    ground = radius / max(-state.position[2], radius)
    return speed, u, v, w, load, turning / induced, ground, w * w


@njit(cache=True)
def shaped(wrench: Wrench, state: State, vehicle: VehicleNumbers, shape: Array) -> Wrench:
    """The wrench of a law as shaped by the values of `effect_definition.SHAPE`."""
    if not shape.any():
        return wrench
    more = 1.0
    of = modulators(state, vehicle)
    for index in range(MODULATORS):
        more += shape[_AXES + index] * of[index]
    return (
        wrench[0] * min(max(more + shape[0], 0.0), _MOST),
        wrench[1] * min(max(more + shape[1], 0.0), _MOST),
        wrench[2] * min(max(more + shape[2], 0.0), _MOST),
        wrench[3] * min(max(more + shape[3], 0.0), _MOST),
        wrench[4] * min(max(more + shape[4], 0.0), _MOST),
        wrench[5] * min(max(more + shape[5], 0.0), _MOST),
    )


@njit(cache=True)
def with_hub_force(
    wrench: Wrench, vehicle: VehicleNumbers, rotor: int, fx: float, fy: float, fz: float
) -> Wrench:
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
def in_plane_speed(state: State, rotor: int) -> float:
    """Airspeed [m/s] of a hub within the plane of its disc."""
    u, v = state.hub_velocity[rotor, 0], state.hub_velocity[rotor, 1]
    speed: float = np.sqrt(u * u + v * v)
    return speed


@njit(cache=True)
def hub_height(state: State, vehicle: VehicleNumbers, rotor: int) -> float:
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
