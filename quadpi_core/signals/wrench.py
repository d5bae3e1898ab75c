# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The measured wrench on a vehicle, by the Newton-Euler equations of a rigid body."""

from __future__ import annotations

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.flight import AXES, Flight
from quadpi_core.frames import Array
from quadpi_core.vehicle import Vehicle


def newton_euler(
    specific_force: Array, rates: Array, angular_acceleration: Array, mass_kg: float, inertia: Array
) -> Array:
    """Wrench (N, 6) on a rigid body, gravity not included: F = m f, M = I Ω̇ + Ω × IΩ.

    Args:
        specific_force: (N, 3) m/s², body axes.
        rates: (N, 3) rad/s.
        angular_acceleration: (N, 3) rad/s².
        mass_kg: mass.
        inertia: (3, 3) kg m², about the centre of gravity.

    Returns:
        (N, 6) force [N] and moment [Nm] in body axes, columns as :data:`quadpi_core.flight.AXES`.
    """
    wrench = np.empty((len(rates), len(AXES)))
    motion = (specific_force, rates, angular_acceleration, inertia)
    force, rates, acceleration, inertia = map(np.ascontiguousarray, motion)
    compiled.newton_euler(force, rates, acceleration, mass_kg, inertia, wrench)
    return wrench


def measured_wrench(flight: Flight, vehicle: Vehicle) -> Array:
    """Measured wrench (N, 6) of a flight: N and Nm, body axes, gravity not included.

    All factors have passed the low-pass of the flight; its angular acceleration is the consistent derivative
    of its rates.
    """
    return newton_euler(
        flight.specific_force, flight.rates, flight.angular_acceleration, vehicle.mass_kg, vehicle.inertia
    )
