# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Attitude and rotor speeds at which a vehicle stands still in a steady wind."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadpi_core import rotations
from quadpi_core.errors import SimulationError
from quadpi_core.frames import Array
from quadpi_core.simulation.linear_algebra import inverse, matrix_times
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.vehicle import ROTORS

_NEWTON_STEPS_MAX = 30
_CONVERGED = 1e-10
# The wind is raised in steps of this [m/s]: each trim starts from the one before.
_WIND_STEP = 0.5
_DIFFERENCE = 1e-6


class Trim(NamedTuple):
    """Attitude (4,) body to world, rotor speeds (4,) rad/s."""

    attitude: Array
    rotor_speeds: Array


def trim(model: RotorLocalModel, wind: Array, yaw: float = 0.0) -> Trim:
    """Stand still in a wind (3,) m/s of the world, nose at a yaw [rad].

    Newton's method on six unknowns, a tilt about two axes and four rotor speeds, for six equations.

    Raises:
        SimulationError: if there is no such state within the limits of the rotors.
    """
    vehicle = model.vehicle
    heading = np.array(rotations.from_rotation_vector(np.array([0.0, 0.0, yaw])))
    unknowns = np.append(np.zeros(2), np.ones(ROTORS))
    speed = math.sqrt(sum(component * component for component in wind.tolist()))
    steps = max(1, math.ceil(speed / _WIND_STEP))
    for step in range(steps + 1):
        found = _solve(model, wind * (step / steps), heading, unknowns)
        if found is None or not np.all(found[2:] > 0.0):
            raise SimulationError(f"vehicle {vehicle.name}: cannot stand still in a wind of {speed:.1f} m/s")
        unknowns = found
    rotor_speeds = unknowns[2:] * model.hover_rotor_speed
    if rotor_speeds.max() > vehicle.rotor_speed_max_rad_s:
        raise SimulationError(
            f"vehicle {vehicle.name}: to stand still in a wind of {speed:.1f} m/s takes "
            f"{rotor_speeds.max():.0f} rad/s, beyond its {vehicle.rotor_speed_max_rad_s:.0f} rad/s"
        )
    return Trim(_tilted(heading, unknowns), rotor_speeds)


def _solve(model: RotorLocalModel, wind: Array, heading: Array, start: Array) -> Array | None:
    """Unknowns (6,) at which the accelerations vanish, from a start near them; None where there are none."""
    unknowns = start.copy()
    for _ in range(_NEWTON_STEPS_MAX):
        probes = np.vstack((unknowns, unknowns + _DIFFERENCE * np.eye(6), unknowns - _DIFFERENCE * np.eye(6)))
        residuals = _unbalance(model, wind, heading, probes)
        if np.abs(residuals[0]).max() < _CONVERGED:
            return unknowns
        jacobian = (residuals[1:7] - residuals[7:]).T / (2.0 * _DIFFERENCE)
        step = matrix_times(inverse(np.ascontiguousarray(jacobian)), residuals[0])
        if not np.all(np.isfinite(step)):
            return None
        unknowns = unknowns - step
    return None


def _unbalance(model: RotorLocalModel, wind: Array, heading: Array, unknowns: Array) -> Array:
    """What is left (K, 6) of force over weight, and of moment over weight and arm, for unknowns (K, 6)."""
    vehicle = model.vehicle
    turns = np.array([rotations.matrix(_tilted(heading, row)) for row in unknowns])
    velocity = np.array([matrix_times(np.ascontiguousarray(turn.T), -wind) for turn in turns])
    rotor_speeds = unknowns[:, 2:] * model.hover_rotor_speed
    wrench = model.wrench(velocity, np.zeros((len(unknowns), 3)), rotor_speeds)
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    wrench[:, :3] += weight * turns[:, 2, :]
    wrench[:, :3] /= weight
    wrench[:, 3:] /= weight * float(np.abs(vehicle.rotor_positions).max())
    return wrench


def _tilted(heading: Array, unknowns: Array) -> Array:
    tilt = rotations.from_rotation_vector(np.array([unknowns[0], unknowns[1], 0.0]))
    return np.array(rotations.product(heading, tilt))
