# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The measured wrench on a vehicle, by the Newton-Euler equations of a rigid body."""

from __future__ import annotations

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.flight import AXES, Flight, mean_rate_hz
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.inputs import INPUT_INDEX
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


_ORDER = 2
_RATES = slice(INPUT_INDEX["p"], INPUT_INDEX["r"] + 1)


def band_limited(time: Array, rates: Array, forces: Array, bandwidth_hz: float | None) -> Array:
    """Forces (N, 3, K) in body axes as a measurement of this bandwidth has them: smoothed without delay.

    Smoothing is done in axes that do not turn, as that of a velocity in the world.

    Args:
        time: (N,) s.
        rates: (N, 3) rad/s.
        forces: (N, 3, K), K at a time.
        bandwidth_hz: of a second-order low-pass, forward and backward; None or beyond half the sample rate
            leaves the forces as they are.
    """
    if bandwidth_hz is None or bandwidth_hz >= 0.5 * (rate_hz := mean_rate_hz(time)):
        return forces
    # Slow to import, and most importers of this module smooth nothing.
    from scipy.signal import butter, sosfiltfilt

    # Attitudes since the first sample, by the rates alone: they hardly drift in a smoothing time.
    attitude = np.empty((len(time), 4))
    compiled.turn_by_rates(np.ascontiguousarray(time), np.ascontiguousarray(rates), attitude)
    rotation = rotation_matrix(attitude)
    still = (rotation @ forces).reshape(len(forces), -1)
    smooth = sosfiltfilt(butter(_ORDER, bandwidth_hz, fs=rate_hz, output="sos"), still, axis=0)
    return rotation.transpose(0, 2, 1) @ smooth.reshape(forces.shape)


def as_recorded(time: Array, inputs: Array, wrench: Array, bandwidth_hz: float | None) -> Array:
    """Wrench (N, 6) in N and Nm, body, at time (N,) s, forces as a measurement of a bandwidth has them."""
    forces = band_limited(time, inputs[:, _RATES], wrench[:, :3, np.newaxis], bandwidth_hz)
    return np.concatenate((forces[:, :, 0], wrench[:, 3:]), axis=1)
