# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Forms that no library names, each (state, vehicle, b) -> wrench; memory follows the parameters in b."""

# Every function of a table takes what all take.
# ruff: noqa: ARG001

from __future__ import annotations

import math

from blind.geometry import CALL_S, PARAMETERS, to_body, to_world


def beat_vibration(state, vehicle, b):
    """Rotors out of balance shake the frame; two that turn almost alike beat slowly.

    b: N, Nm. Memory: the rotors' angles.
    """
    for rotor in range(4):
        b[PARAMETERS + rotor] += state.rotor_speeds[rotor] * CALL_S
    angles = b[PARAMETERS:]
    front, rear = math.sin(angles[0] - angles[1]), math.sin(angles[2] - angles[3])
    return b[0] * front, b[0] * rear, 0.0, b[1] * rear, b[1] * front, 0.0


def fan_jet(state, vehicle, b):
    """A fan blows across one place of the hall.

    b: N towards east, north and east [m] of the jet, its width [m].
    """
    x, y = state.position[0] - b[1], state.position[1] - b[2]
    push = b[0] * math.exp(-0.5 * (x * x + y * y) / (b[3] * b[3]))
    fx, fy, fz = to_body(state.attitude, 0.0, push, 0.0)
    return fx, fy, fz, 0.0, 0.0, 0.0


def jerk_force(state, vehicle, b):
    """A force with the change of the specific force, as of a soft mount.

    b: N s³/m, time [s] over which the change is seen. Memory: specific force of a moment ago.
    """
    forces = [0.0, 0.0, 0.0]
    for axis in range(3):
        now = state.wrench[axis] / vehicle.mass
        forces[axis] = -b[0] * (now - b[PARAMETERS + axis]) / b[1]
        b[PARAMETERS + axis] += (now - b[PARAMETERS + axis]) * CALL_S / b[1]
    return forces[0], forces[1], forces[2], 0.0, 0.0, 0.0


def one_sided_drag(state, vehicle, b):
    """Drag in flight towards the south, thrust towards the north.

    b: N s/m.
    """
    x, y, _ = to_world(state.attitude, state.velocity_air[0], state.velocity_air[1], state.velocity_air[2])
    push = b[0] * abs(x)
    fx, fy, fz = to_body(state.attitude, push, 0.5 * push * ((y > 0.0) - (y < 0.0)), 0.0)
    return fx, fy, fz, 0.0, 0.0, 0.0


def lagged_drag(state, vehicle, b):
    """A wake that follows the vehicle late: with the velocity of a while ago, less that of now.

    b: N s/m, delay [s], arm [m]. Memory: the velocity of a while ago.
    """
    forces = [0.0, 0.0]
    for axis in range(2):
        now = state.velocity_air[axis]
        forces[axis] = b[0] * (now - b[PARAMETERS + axis])
        b[PARAMETERS + axis] += (now - b[PARAMETERS + axis]) * CALL_S / b[1]
    return forces[0], forces[1], 0.0, b[2] * forces[1], -b[2] * forces[0], 0.0


def thrust_fade(state, vehicle, b):
    """Thrust at one speed falls as the flight goes on.

    b: share of it in 20 s. Memory: the time.
    """
    b[PARAMETERS] += CALL_S
    lost = b[0] * (b[PARAMETERS] - 10.0) / 20.0
    mx = my = fz = 0.0
    for rotor in range(4):
        thrust = lost * state.thrusts[rotor]
        fz += thrust
        mx += vehicle.rotor_positions[rotor][1] * thrust
        my -= vehicle.rotor_positions[rotor][0] * thrust
    return 0.0, 0.0, fz, mx, my, 0.0


def magnet(state, vehicle, b):
    """A magnet on board turns towards the field of a steel floor: a moment with the heading and the height.

    b: Nm, height [m] over which the field falls.
    """
    field = b[0] * math.exp(state.position[2] / b[1])
    x, y, _ = to_body(state.attitude, field, 0.0, 0.0)
    return 0.0, 0.0, 0.0, 0.0, 0.3 * x, -y
