# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Open-loop roll-outs of the physical model with their derivatives by each parameter.

A rigid body starts at a smoothed state and moves by the model's wrench of the measured rotor speeds, by the
explicit midpoint rule. With it go the derivatives of its state by the parameters: the scheme itself is
differentiated, so they are those of the numbers computed (Jategaonkar, Flight Vehicle System Identification,
2015, 4.7). The derivatives of the wrench by velocity and rates are central differences. Attitude errors are
rotation vectors φ in body axes: R exp(φ). A disturbance, the residual wrench known at the start, adds to the
wrench and decays.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.frames import Array
from quadpi_core.records import Records, record_dtype

# Rows of an error and of its derivatives.
POSITION, VELOCITY, ATTITUDE, RATES = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
STATES = 12


class Moving:
    """Where a body is on its way.

    Attributes:
        displacement: m in the world, since the start.
        attitude: body to world.
        velocity: m/s in the world.
        rates: rad/s in the body.
    """

    displacement: Annotated[Array, 3]
    attitude: Annotated[Array, 4]
    velocity: Annotated[Array, 3]
    rates: Annotated[Array, 3]


MOVING = record_dtype(Moving)


class Rolled(NamedTuple):
    """Errors of W roll-outs at H horizons: predicted less measured.

    Attributes:
        errors: (W, H, 12) position m, velocity m/s in the world, attitude rad, rates rad/s.
        derivatives: (W, H, 12, P) of the errors by the parameters; empty where not asked for.
        path: MOVING (W, S + 1) at each of the S steps to the last horizon.
    """

    errors: Array
    derivatives: Array
    path: Records


class Disturbances(NamedTuple):
    """Residual wrench known at the starts of W roll-outs.

    Attributes:
        wrench: (W, 6) N and Nm, body axes.
        slopes: (W, 6, P) its derivatives by the parameters.
        decay: (6,) share that is left after a step.
    """

    wrench: Array
    slopes: Array
    decay: Array


class Track(NamedTuple):
    """A flight as roll-outs need it.

    Attributes:
        step: s between samples.
        motion: MOTION (N,), rotor speeds as they act at each sample.
        attitude: (N, 4) body to world.
        vehicle: PHYSICAL_VEHICLE (1,).
        mass, gravity: kg, m/s².
        inertia, inverse_inertia: (3, 3) kg m², and its inverse.
    """

    step: float
    motion: Records
    attitude: Array
    vehicle: Records
    mass: float
    gravity: float
    inertia: Array
    inverse_inertia: Array

    def in_rows(self) -> Track:
        """The same with its samples one after another, as the compiled core takes them."""
        motion, attitude = np.ascontiguousarray(self.motion), np.ascontiguousarray(self.attitude)
        return self._replace(motion=motion, attitude=attitude)


def roll_out(
    track: Track,
    starts: npt.NDArray[np.int64],
    horizons: npt.NDArray[np.int64],
    parameters: Array,
    *,
    derivatives: bool,
    disturbances: Disturbances | None = None,
) -> Rolled:
    """Roll the model out from samples of a flight.

    Args:
        track: the flight, on an even time grid.
        starts: (W,) samples to start from; the last horizon after each lies within the flight.
        horizons: (H,) steps after the start, rising.
        parameters: (P,) of the model.
        derivatives: whether to compute them, which takes thirty times as long.
        disturbances: at the starts; without them there are none.
    """
    if disturbances is None:
        none = np.zeros((len(starts), 6, len(parameters)) if derivatives else (0, 0, 0))
        disturbances = Disturbances(np.zeros((len(starts), 6)), none, np.ones(6))
    wrench, own_slopes = map(np.ascontiguousarray, disturbances[:2])
    disturbances = Disturbances(wrench, own_slopes, disturbances.decay)
    errors = np.zeros((len(starts), len(horizons), STATES))
    slopes = np.zeros((len(starts) if derivatives else 0, len(horizons), STATES, len(parameters)))
    rolled = Rolled(errors, slopes, np.zeros((len(starts), horizons[-1] + 1), MOVING))
    compiled.roll_out(track.in_rows(), starts, horizons, parameters, disturbances, rolled)
    return rolled
