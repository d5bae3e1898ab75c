# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Two free bodies joined by a stiff spring and damper, integrated by scipy: a vehicle and a load on a cable.

An implementation of its own, in other coordinates than those of the library.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from quadpi_core.frames import Array, matrix, quaternion_from_roll_pitch_yaw
from quadpi_core.records import Records
from quadpi_core.simulation.state_records import STATE

GRAVITY = np.array([0.0, 0.0, 9.80665])
STIFFNESS_N_M, DAMPING_N_S_M = 4000.0, 0.3
ATTITUDE = quaternion_from_roll_pitch_yaw(np.array([[0.3, -0.2, 0.8]]))[0]


class TwoBodies(NamedTuple):
    """A flight: times (N,), direction to the load, force of rotors and air, pull on the vehicle (N, 3)."""

    time: Array
    direction: Array
    force: Array
    pull: Array

    def states(self, *, measured: bool) -> Records:
        """Records of the vehicle at a fixed attitude, with the measured force or that without the cable."""
        states = np.zeros(len(self.time), dtype=STATE)
        states["attitude"] = ATTITUDE
        states["wrench"][:, :3] = (self.force + measured * self.pull) @ matrix(ATTITUDE)
        states["force_is_measured"] = measured
        return states

    def pull_in_body(self) -> Array:
        """Wrench (N, 6) of the cable, body axes."""
        return np.hstack((self.pull @ matrix(ATTITUDE), np.zeros_like(self.pull)))


def flown(
    mass: float, load: float, length: float, aside: float = 0.0, seconds: float = 4.0, step_s: float = 0.004
) -> TwoBodies:
    """Fly about hover with sideways stops; the load begins at an angle `aside` [rad] towards north."""

    def driving(t):
        return mass * np.array([2.0 * np.sin(3.0 * t), -1.5 * np.cos(2.0 * t), -9.5 - 0.7 * np.sin(5.0 * t)])

    def pull(x, v, y, u):
        """Of one instant (3,), or of many (3, N)."""
        apart = y - x
        distance = np.sqrt(np.sum(apart * apart, axis=0))
        n = apart / distance
        return n * (STIFFNESS_N_M * (distance - length) + DAMPING_N_S_M * np.sum(n * (u - v), axis=0))

    def slope(t, state):
        x, v, y, u = state.reshape(4, 3)
        tension = pull(x, v, y, u)
        return np.concatenate((v, GRAVITY + (driving(t) + tension) / mass, u, GRAVITY - tension / load))

    stretched = length + load * 9.5 / STIFFNESS_N_M
    start = np.zeros(12)
    start[6:9] = stretched * np.array([np.sin(aside), 0.0, np.cos(aside)])
    time = np.arange(0.0, seconds, step_s)
    # An implicit method takes fewer steps than the spring's 60 Hz ask for, and four times as long.
    found = solve_ivp(slope, (0.0, seconds), start, "DOP853", time, rtol=1e-7, atol=1e-9).y
    x, v, y, u = found.reshape(4, 3, -1)
    direction = (y - x) / np.linalg.norm(y - x, axis=0)
    return TwoBodies(time, direction.T, driving(time).T, pull(x, v, y, u).T)
