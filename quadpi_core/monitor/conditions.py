# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What may be known of samples beside their signals: density of the air, and how sure their state is."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from quadpi_core import array_checks
from quadpi_core.errors import ArgumentError
from quadpi_core.frames import Array
from quadpi_core.records import Records, record_dtype

STATE_ERRORS = 9
# Of air that multirotors fly in [kg/m³]: from 9 km above the sea (ISO 2533) to sea level at -60 °C.
DENSITY_MIN, DENSITY_MAX = 0.4, 1.8
# By what share of its scale a covariance may be off a symmetric one without negative variances: rounding.
_ROUNDING = 1e-9


class Conditions:
    """Of one sample.

    Attributes:
        air_density: kg/m³; 0 where only the vehicle file tells. At the same velocities and rotor speeds the
            wrench of the air goes with it.
        covariance: of the errors of the state: velocity in body axes m/s, rotation about the world's axes
            rad, rates rad/s; as `nav_msgs/Odometry` has them. Zero where nothing is known. What the model's
            flights were unsure of is in its intervals already: give what goes beyond.
    """

    air_density: float
    covariance: Annotated[Array, STATE_ERRORS, STATE_ERRORS]


CONDITIONS = record_dtype(Conditions)


def conditions(
    samples: int, air_density: Array | float | None = None, covariance: Array | None = None
) -> Records | None:
    """The :class:`Conditions` (K,) of samples; None where nothing is given.

    Args:
        samples: K.
        air_density: kg/m³, one or (K,).
        covariance: (9, 9) or (K, 9, 9), see :class:`Conditions`.

    Raises:
        ArgumentError: naming what is no density of air, or no covariance.
    """
    if air_density is None and covariance is None:
        return None
    found = np.zeros(samples, CONDITIONS)
    if air_density is not None:
        density = np.broadcast_to(np.atleast_1d(np.asarray(air_density, np.float64)), samples)
        found["air_density"] = array_checks.floats("air_density", density, rows=samples, of="time_ns")
        if wrong := np.flatnonzero((density < DENSITY_MIN) | (density > DENSITY_MAX)).tolist():
            raise ArgumentError(
                f"air_density: sample {wrong[0]} has {density[wrong[0]]:g}, no density of air in kg/m³ "
                f"({DENSITY_MIN:g} to {DENSITY_MAX:g})"
            )
    if covariance is not None:
        found["covariance"] = _checked(covariance, samples)
    return found


def _checked(covariance: Array, samples: int) -> Array:
    rows = np.asarray(covariance)
    if rows.shape == (STATE_ERRORS, STATE_ERRORS):
        rows = np.broadcast_to(rows, (samples, *rows.shape))
    if rows.shape != (samples, STATE_ERRORS, STATE_ERRORS):
        raise ArgumentError(
            f"covariance: expected (9, 9) or ({samples}, 9, 9) numbers, found {array_checks.found(rows)}"
        )
    flat = array_checks.floats("covariance", rows.reshape(samples, -1), STATE_ERRORS**2)
    rows = flat.reshape(rows.shape)
    scale = np.sqrt(np.maximum(np.einsum("kii->ki", rows), 0.0))
    limits = _ROUNDING * scale[:, :, np.newaxis] * scale[:, np.newaxis]
    uneven = (np.abs(rows - np.swapaxes(rows, 1, 2)) > limits).any(axis=(1, 2))
    # In units of its own deviations, so that metres and radians are alike.
    units = np.where(scale > 0.0, scale, 1.0)
    least = np.linalg.eigvalsh(rows / (units[:, :, np.newaxis] * units[:, np.newaxis]))[:, 0]
    if wrong := np.flatnonzero(uneven | (least < -STATE_ERRORS * _ROUNDING)).tolist():
        raise ArgumentError(
            f"covariance: that of sample {wrong[0]} is none: not symmetric, or a variance below 0"
        )
    return rows
