# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The part of a simulated wrench that the flight explains, for a simulation with noisy inputs of its own.

The residual is the measured wrench less the simulated one, and holds the noise of the simulation's inputs
with a minus. A column in proportion to the simulated wrench, as every tolerance is, holds the same noise:
least squares shrink the simulation to remove it, by half where the noise of the measured wrench is small, and
the lost part is then found as an effect. The remedy is instruments (two-stage least squares; Wooldridge,
Econometric Analysis of Cross Section and Panel Data, chapter 5): columns are replaced by what functions of
the flight's own states, which do not share that noise, explain of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.inputs import relative_to_air
from quadpi_core.vehicle import Vehicle

# Ridge in shares of each function's square: enough for functions that a flight does not excite, 1e-6 of a
# column.
_RIDGE = 1e-6


def instruments(flight: Flight, vehicle: Vehicle, hover_rotor_speed: float) -> Array:
    """Functions (N, J) of the motion and the rotors of a flight, of the order of 1.

    They span the terms of aerodynamic models: thrust and torque of each rotor; drag, inflow and lift with
    the airspeed; damping with the rates; and their products with the rotor speeds. None uses the
    specific force.
    """
    speeds = flight.rotor_speeds / hover_rotor_speed
    velocity = relative_to_air(flight.velocity, flight.attitude, flight.wind) / vehicle.hover_induced_velocity
    motion = np.concatenate((velocity, flight.rates / 3.0), axis=1)
    airspeed = np.linalg.norm(velocity, axis=1)[:, None]
    mean = speeds.mean(axis=1)[:, None]
    first, second = np.triu_indices(motion.shape[1])
    products = motion[:, first] * motion[:, second]
    skewed = np.concatenate([speeds[:, rotor, None] * motion for rotor in range(speeds.shape[1])], axis=1)
    return np.concatenate(
        (np.ones_like(mean), speeds, speeds**2, motion, skewed, products, airspeed * motion, mean * products,
         airspeed**2 * velocity),
        axis=1,
    )  # fmt: skip


def explained(columns: Sequence[Array], functions: Sequence[Array]) -> list[Array]:
    """The part of columns that functions explain, by one least squares over all flights.

    Args:
        columns: per flight (N, 6, K).
        functions: per flight (N, J).
    """
    gram = np.sum([own.T @ own for own in functions], axis=0)
    gram += _RIDGE * np.diag(np.maximum(np.diag(gram), np.finfo(float).tiny))
    flat = [own.reshape(len(own), -1) for own in columns]
    aim = np.sum([own.T @ column for own, column in zip(functions, flat, strict=True)], axis=0)
    weights = cho_solve(cho_factor(gram), aim)
    return [(own @ weights).reshape(column.shape) for own, column in zip(functions, columns, strict=True)]
