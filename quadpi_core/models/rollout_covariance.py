# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How uncertain the state of a body is along a roll-out: covariance of its errors at each horizon.

What is uncertain is the start state, the parameters, and the wrench that the model lacks: a first-order
Markov process on each axis, known at the start as well as the past of the flight tells it. Their covariance
is carried along the predicted path by the linearised equations of motion, as an extended Kalman filter does
(Jategaonkar, Flight Vehicle System Identification, 2015, 5.3). What an attitude error does to force and
moment is linearised statistically (Gelb, Applied Optimal Estimation, 1974, 6.2): it does not grow beyond a
half turn. Attitude errors are rotation vectors in body axes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.models.physical_regressors import MOTION, REGRESSORS
from quadpi_core.models.physical_rollout import (
    ATTITUDE,
    POSITION,
    RATES,
    STATES,
    VELOCITY,
    Track,
    cross_matrix,
    wrench_of,
    wrench_slopes,
)
from quadpi_core.records import Records
from quadpi_core.rotations import matrix

# Errors of the state, then those of the wrench.
_FORCE, _MOMENT = slice(12, 15), slice(15, 18)
_ALL = STATES + 6


class Uncertainty(NamedTuple):
    """What is not known when a roll-out starts; every number a variance but for the decay.

    Attributes:
        state: (12,) of position, velocity, attitude and rates of a state, at the start and at the horizon.
        wrench: (6,) of the disturbance at the start.
        drive: (6,) of what is new in the disturbance after a step.
        decay: (6,) share of the disturbance that is left after a step.
        parameters: (P, P) covariance of the parameters.
    """

    state: Array
    wrench: Array
    drive: Array
    decay: Array
    parameters: Array


def error_covariance(
    track: Track,
    starts: npt.NDArray[np.int64],
    horizons: npt.NDArray[np.int64],
    path: Records,
    parameters: Array,
    uncertainty: Uncertainty,
) -> Array:
    """Covariance (W, H, 12, 12) of the errors of W roll-outs at H horizons.

    Args:
        track: the flight.
        starts: (W,) samples that the roll-outs started from.
        horizons: (H,) steps after the start, rising.
        path: MOVING (W, S + 1) that they took.
        parameters: (P,) of the model.
        uncertainty: at the start.
    """
    covariance = np.zeros((len(starts), len(horizons), STATES, STATES))
    _propagate(track, starts, horizons, path, parameters, uncertainty, covariance)
    return covariance


@njit(cache=True, nogil=True)
def _propagate(
    track: Track,
    starts: npt.NDArray[np.int64],
    horizons: npt.NDArray[np.int64],
    path: Records,
    parameters: Array,
    uncertainty: Uncertainty,
    covariance: Array,
) -> None:
    row, now = np.zeros(1, REGRESSORS), np.zeros(1, MOTION)
    h = track.step
    measured = np.diag(uncertainty.state)
    for window in range(len(starts)):
        joint = np.zeros((_ALL, _ALL))
        joint[:STATES, :STATES] = measured
        joint[STATES:, STATES:] = np.diag(uncertainty.wrench)
        sensitivity = np.zeros((STATES, len(parameters)))
        horizon = 0
        for step in range(horizons[-1]):
            place, sample = path[window, step], starts[window] + step
            rotation = matrix(place.attitude)
            now[0].velocity[:] = rotation.T @ np.ascontiguousarray(place.velocity)
            now[0].rates[:] = place.rates
            now[0].rotor_speeds[:] = track.motion[sample].rotor_speeds
            now[0].rotor_accelerations[:] = track.motion[sample].rotor_accelerations
            change, by_wrench = _change(now, rotation, track, parameters, row)
            change[VELOCITY, ATTITUDE] *= _sine_share(np.trace(joint[ATTITUDE, ATTITUDE]) / 3.0)
            change[RATES, ATTITUDE] *= _sine_share(np.trace(joint[ATTITUDE, ATTITUDE]) / 3.0)
            transition = np.eye(_ALL) + h * change + (0.5 * h * h) * (change @ change)
            for axis in range(6):
                transition[STATES + axis, STATES + axis] = uncertainty.decay[axis]
            joint = transition @ joint @ transition.T
            for axis in range(6):
                joint[STATES + axis, STATES + axis] += uncertainty.drive[axis]
            own = np.ascontiguousarray(row.view(np.float64).reshape(len(parameters), 6).T)
            sensitivity = np.ascontiguousarray(transition[:STATES, :STATES]) @ sensitivity
            sensitivity += h * (by_wrench @ own)
            if step + 1 == horizons[horizon]:
                of_parameters = sensitivity @ uncertainty.parameters @ sensitivity.T
                covariance[window, horizon] = joint[:STATES, :STATES] + of_parameters + measured
                horizon += 1


@njit(cache=True, nogil=True)
def _sine_share(variance: float) -> float:
    """Deviation of the sine of a normal angle of a variance [rad²] over that of the angle."""
    if variance < 1e-6:
        return 1.0
    return float(np.sqrt(-0.5 * np.expm1(-2.0 * variance) / variance))


@njit(cache=True, nogil=True)
def _change(
    now: Records, rotation: Array, track: Track, parameters: Array, row: Records
) -> tuple[Array, Array]:
    """Rate of change of errors (18, 18) by errors but for their decay, and (12, 6) by the wrench.

    Leaves the regressors in `row`.
    """
    body = track.body[0]
    slopes = wrench_slopes(now, track.vehicle, parameters, row)
    # Last, so that the regressors are those of the motion itself.
    wrench = wrench_of(now, track.vehicle, parameters, row)
    velocity, rates = now[0].velocity.copy(), now[0].rates.copy()
    turning = cross_matrix(rates) @ body.inertia - cross_matrix(body.inertia @ rates)
    by_velocity, by_rates = np.ascontiguousarray(slopes[:, :3]), np.ascontiguousarray(slopes[:, 3:])
    by_attitude = by_velocity @ cross_matrix(velocity)
    to_world = rotation / body.mass
    change = np.zeros((_ALL, _ALL))
    change[POSITION, VELOCITY] = np.eye(3)
    change[VELOCITY, VELOCITY] = to_world @ by_velocity[:3] @ rotation.T
    change[VELOCITY, ATTITUDE] = to_world @ (by_attitude[:3] - cross_matrix(wrench[:3]))
    change[VELOCITY, RATES] = to_world @ by_rates[:3]
    change[VELOCITY, _FORCE] = to_world
    change[ATTITUDE, ATTITUDE] = -cross_matrix(rates)
    change[ATTITUDE, RATES] = np.eye(3)
    change[RATES, VELOCITY] = body.inverse_inertia @ by_velocity[3:] @ rotation.T
    change[RATES, ATTITUDE] = body.inverse_inertia @ by_attitude[3:]
    change[RATES, RATES] = body.inverse_inertia @ (by_rates[3:] - turning)
    change[RATES, _MOMENT] = body.inverse_inertia
    by_wrench = np.zeros((STATES, 6))
    by_wrench[VELOCITY, :3] = to_world
    by_wrench[RATES, 3:] = body.inverse_inertia
    return change, by_wrench
