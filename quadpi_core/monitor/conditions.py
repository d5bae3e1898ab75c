# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What may be known of samples beside their signals.

The density of the air, how sure the state is, and which rotor speeds are commands.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.errors import ArgumentError
from quadpi_core.frames import Array
from quadpi_core.inputs import DENSITY_MAX, DENSITY_MIN
from quadpi_core.records import ROTORS_MAX, Records, record_dtype

STATE_ERRORS = 9
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
        commanded: bit per rotor, the first 1, whose speed follows from its command, as nothing measured it.
            Verdicts carry it on; nothing is decided by it yet.
        unsettled: 1 while the wind is still to be told; the sample then counts as one whose state settles.
    """

    air_density: float
    covariance: Annotated[Array, STATE_ERRORS, STATE_ERRORS]
    commanded: int
    unsettled: int


CONDITIONS = record_dtype(Conditions)


def conditions(
    samples: int,
    air_density: npt.ArrayLike | None = None,
    state_covariance: npt.ArrayLike | None = None,
    commanded: npt.ArrayLike | None = None,
) -> Records | None:
    """The :class:`Conditions` (K,) of samples; None where nothing is given.

    Args:
        samples: K.
        air_density: kg/m³, one or (K,).
        state_covariance: (9, 9) or (K, 9, 9), see :class:`Conditions`.
        commanded: (n,) or (K, n) which rotors' speeds are commands.

    Raises:
        ArgumentError: naming what is no density of air, no covariance, or of other shapes.
    """
    if air_density is None and state_covariance is None and commanded is None:
        return None
    found = np.zeros(samples, CONDITIONS)
    if air_density is not None:
        if np.ndim(air_density) == 0:
            air_density = np.full(samples, air_density)
        density = array_checks.floats("air_density", air_density, rows=samples, of="time_ns")
        if wrong := np.flatnonzero((density < DENSITY_MIN) | (density > DENSITY_MAX)).tolist():
            raise ArgumentError(
                f"air_density: sample {wrong[0]} has {density[wrong[0]]:g}, no density of air in kg/m³ "
                f"({DENSITY_MIN:g} to {DENSITY_MAX:g})"
            )
        found["air_density"] = density
    if commanded is not None:
        flags = np.atleast_2d(np.asarray(commanded))
        fits = flags.ndim == 2 and len(flags) in (1, samples) and flags.shape[1] <= ROTORS_MAX
        if flags.dtype != np.bool_ or not fits:
            raise ArgumentError(
                f"commanded: expected true or false for each rotor, found {array_checks.found(flags)}"
            )
        found["commanded"] = flags @ (1 << np.arange(flags.shape[1]))
    if state_covariance is not None:
        found["covariance"] = _checked(state_covariance, samples)
    return found


def _checked(covariance: npt.ArrayLike, samples: int) -> Array:
    if np.ndim(covariance) == 2:
        one = array_checks.floats("state_covariance", covariance, STATE_ERRORS, rows=STATE_ERRORS)
        covariance = np.broadcast_to(one, (samples, *one.shape))
    rows = array_checks.floats(
        "state_covariance", covariance, STATE_ERRORS, STATE_ERRORS, rows=samples, of="time_ns"
    )
    scale = np.sqrt(np.maximum(np.einsum("kii->ki", rows), 0.0))
    limits = _ROUNDING * scale[:, :, np.newaxis] * scale[:, np.newaxis]
    uneven = (np.abs(rows - np.swapaxes(rows, 1, 2)) > limits).any(axis=(1, 2))
    # In units of its own deviations, so that metres and radians are alike.
    units = np.where(scale > 0.0, scale, 1.0)
    least = np.linalg.eigvalsh(rows / (units[:, :, np.newaxis] * units[:, np.newaxis]))[:, 0]
    if wrong := np.flatnonzero(uneven | (least < -STATE_ERRORS * _ROUNDING)).tolist():
        raise ArgumentError(
            f"state_covariance: that of sample {wrong[0]} is none: not symmetric, or a variance below 0"
        )
    return rows
