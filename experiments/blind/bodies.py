# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects on the body and of the air around it, each (state, vehicle, b) -> wrench, as in `rotors`."""

# Every function of a table takes what all take.
# ruff: noqa: ARG001

from __future__ import annotations

import math

import numpy as np

from blind.geometry import NOTHING, force_at, to_body, to_world
from quadpi_core.simulation.state_records import STATE, VEHICLE, apply_to_all

# Speed [m/s] at which the drag of any exponent is that of the square law.
DRAG_SPEED = 7.0
# Of a law of the aerodynamics that takes all from the vehicle.
_NO_NUMBERS = np.zeros((0, 0))


def body_drag(state, vehicle, b):
    """Drag of bluff parts below the critical Reynolds number: it grows less than with the square.

    b: N s²/m² along x, y and z at DRAG_SPEED, exponent.
    """
    u, v, w = state.velocity_air
    speed = math.sqrt(u * u + v * v + w * w)
    if speed < 1e-9:
        return NOTHING
    k = -DRAG_SPEED * (speed / DRAG_SPEED) ** (b[3] - 1.0)
    return k * b[0] * u, k * b[1] * v, k * b[2] * w, 0.0, 0.0, 0.0


def rate_damping(state, vehicle, b):
    """Moments against the rates, a third of it at 3 rad/s with their square, as of plates that turn.

    b: Nm s about x, y and z.
    """
    p, q, r = state.rates
    return (
        *(0.0, 0.0, 0.0),
        -b[0] * p * (2.0 + abs(p) / 3.0) / 3.0 * 1.2,
        -b[1] * q * (2.0 + abs(q) / 3.0) / 3.0 * 1.2,
        -b[2] * r * (2.0 + abs(r) / 3.0) / 3.0 * 1.2,
    )


def tether(state, vehicle, b):
    """A damped elastic line from a place on the ground to the belly; it pulls, never pushes.

    b: N/m, slack length [m], N s/m along the line, north and east [m] of the anchor, below the centre [m].
    """
    ax, ay, az = to_world(state.attitude, 0.0, 0.0, b[5])
    x, y, z = state.position[0] + ax - b[3], state.position[1] + ay - b[4], state.position[2] + az
    length = math.sqrt(x * x + y * y + z * z)
    if length <= b[1]:
        return NOTHING
    vx, vy, vz = to_world(state.attitude, state.velocity_air[0], state.velocity_air[1], state.velocity_air[2])
    pull = max(b[0] * (length - b[1]) + b[2] * (x * vx + y * vy + z * vz) / length, 0.0)
    fx, fy, fz = to_body(state.attitude, -pull * x / length, -pull * y / length, -pull * z / length)
    return force_at(0.0, 0.0, b[5], fx, fy, fz)


def constant(state, vehicle, b):
    """A force [N] and a moment [Nm] that stay the same in body axes.

    b: the wrench.
    """
    return b[0], b[1], b[2], b[3], b[4], b[5]


def blow(state, vehicle, b):
    """Wind that grows with height by a power law: the aerodynamics again, in that air.

    Before all formulas: the state's own arrays are replaced. What the simulation knew of the wind was none.

    b: m/s towards north, east and down at 3 m, exponent.
    """
    profile = (max(-state.position[0, 2], 0.05) / 3.0) ** b[3]
    state.velocity_air[0] -= to_body(state.attitude[0], b[0] * profile, b[1] * profile, b[2] * profile)
    states = np.zeros(1, STATE)
    for name in ("velocity_air", "rates", "rotor_speeds", "rotor_accelerations"):
        states[name] = getattr(state, name)
    apply_to_all(states, np.array([tuple(vehicle)], VEHICLE), "rotor_local", _NO_NUMBERS)
    for name in ("hub_velocity", "thrusts", "torques", "wrench"):
        getattr(state, name)[:] = states[name]


def airframe_offset(state, vehicle, b):
    """The airframe's force acts where the file has the centre of gravity, not at the true one.

    Before any other effect but wind: what is not of the rotors is the airframe's.

    b: true centre [m] from that of the file.
    """
    fx, fy, fz = state.wrench[:3]
    along, sideways = vehicle.rotor_force_along, vehicle.rotor_force_across
    rotors = zip(state.hub_velocity, state.rotor_speeds, state.thrusts, vehicle.rotor_spins, strict=True)
    for (u, v, _), speed, thrust, spin in rotors:
        across = spin * sideways
        fx -= speed * (along * u + across * v)
        fy -= speed * (along * v - across * u)
        fz += thrust
    _, _, _, mx, my, mz = force_at(-b[0], -b[1], -b[2], fx, fy, fz)
    return 0.0, 0.0, 0.0, mx, my, mz
