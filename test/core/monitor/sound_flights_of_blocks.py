# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Blocks of flights that leave of a model what is stated, and changes of them."""

from __future__ import annotations

import numpy as np

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.alarm_limits import CHANGE_AXES, ChangeLimits, LeftOnAxis
from quadpi_core.monitor.change import BLOCK_S, CHANGE_BLOCK, mean_arm
from quadpi_core.records import Records
from quadpi_core.vehicle import Vehicle

SHARES = {"between": 0.004, "walk": 0.0007, "process": 0.02, "white": 0.003}


def weight(vehicle: Vehicle) -> float:
    return vehicle.mass_kg * vehicle.gravity_m_s2


def limits_of(vehicle: Vehicle, scale: float = 0.65) -> ChangeLimits:
    """Deviations are shares of a rotor's thrust, and of that times the arm."""
    axes = {}
    for axis in CHANGE_AXES:
        unit = weight(vehicle) / vehicle.rotor_count * (mean_arm(vehicle) if axis[0] == "M" else 1.0)
        square = {name: (share * unit) ** 2 for name, share in SHARES.items()}
        axes[axis] = LeftOnAxis(mean=0.0, keep=0.6, scale=scale, loudest=3.0, **square)
    x, y = vehicle.rotor_positions[:, 0], vehicle.rotor_positions[:, 1]
    levers = tuple((1.0, float(b), -float(a)) for a, b in zip(x, y, strict=True))
    return ChangeLimits(axes, levers, flights=12, hours=0.1, largest=0.0)


def sound_blocks(vehicle: Vehicle, seconds: float, rng: np.random.Generator) -> Records:
    """A flight whose residuals have the noise of :func:`limits_of`, with heavy tails."""
    count = round(seconds / BLOCK_S)
    blocks = np.zeros(count, CHANGE_BLOCK)
    blocks["number"] = 1000 + np.arange(count)
    blocks["lift"] = weight(vehicle) * (1.0 + 0.1 * np.sin(np.arange(count)))
    blocks["squares"][:, : vehicle.rotor_count] = 1e6 * rng.uniform(0.8, 1.2, (count, vehicle.rotor_count))
    for axis, left in limits_of(vehicle).axes.items():
        # Scaled to a variance of 1, by that of Student's distribution with 5 degrees of freedom.
        steps, white, driven = rng.standard_t(5, (3, count)) / np.sqrt(5.0 / 3.0)
        constant = np.sqrt(left.between) * rng.standard_normal() + np.cumsum(np.sqrt(left.walk) * steps)
        process = np.sqrt(left.process) * _remembering(driven, left.keep)
        blocks["residual"][:, AXES.index(axis)] = constant + process + np.sqrt(left.white) * white
    return blocks


def _remembering(driven: Array, keep: float) -> Array:
    process = driven.copy()
    for row in range(1, len(process)):
        process[row] = keep * process[row - 1] + np.sqrt(1.0 - keep * keep) * driven[row]
    return process


def weaken(blocks: Records, vehicle: Vehicle, rotor: int, share: float, start: int) -> None:
    """Take a share of a rotor's thrust away, from a block on."""
    thrust = blocks["lift"] * blocks["squares"][:, rotor] / blocks["squares"].sum(axis=1)
    x, y = vehicle.rotor_positions[rotor, :2]
    blocks["residual"][start:, 2:5] += share * thrust[start:, np.newaxis] * np.array([1.0, y, -x])
