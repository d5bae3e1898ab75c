# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the formulas share: forces at points, turns between world and body, induced velocity."""

from __future__ import annotations

import math

NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
# Of parameters in the block of a formula; what follows them is its memory.
PARAMETERS = 8
# A flight evaluates the equations of motion four times in each of 1000 steps per second.
CALL_S = 1.0 / 4000.0


def force_at(x, y, z, fx, fy, fz):
    """A force [N] at a point [m] from the centre of gravity, as a wrench."""
    return fx, fy, fz, y * fz - z * fy, z * fx - x * fz, x * fy - y * fx


def lift_at(vehicle, rotor, lift):
    """A force upwards [N] at a rotor, as a wrench."""
    position = vehicle.rotor_positions[rotor]
    return force_at(position[0], position[1], position[2], 0.0, 0.0, -lift)


def plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5]


def to_body(attitude, x, y, z):
    """A vector of the world in body axes."""
    w, i, j, k = attitude
    return to_world((w, -i, -j, -k), x, y, z)


def to_world(attitude, x, y, z):
    """A vector of the body in world axes."""
    w, i, j, k = attitude
    return (
        (1.0 - 2.0 * (j * j + k * k)) * x + 2.0 * (i * j - w * k) * y + 2.0 * (i * k + w * j) * z,
        2.0 * (i * j + w * k) * x + (1.0 - 2.0 * (i * i + k * k)) * y + 2.0 * (j * k - w * i) * z,
        2.0 * (i * k - w * j) * x + 2.0 * (j * k + w * i) * y + (1.0 - 2.0 * (i * i + j * j)) * z,
    )


def induced_ratio(advance):
    """v_i/v_h of a rotor at constant thrust that moves edgewise at `advance` v_h (Glauert).

    From v_i √(V² + v_i²) = v_h².
    """
    square = advance * advance
    return math.sqrt(0.5 * (math.sqrt(square * square + 4.0) - square))
