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

from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.models.physical_regressors import MOTION, REGRESSORS, fill_regressors
from quadpi_core.records import Records, record_dtype
from quadpi_core.rotations import (
    from_rotation_vector,
    inverse,
    matrix,
    normalised,
    product,
    to_rotation_vector,
)

# Rows of an error and of its derivatives.
POSITION, VELOCITY, ATTITUDE, RATES = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
STATES = 12
# Steps of the central differences [m/s] and [rad/s]: their error is below 1e-8 of the derivative.
_DIFFERENCE = 1e-4


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


class Held(NamedTuple):
    """A disturbance as it is now: wrench (6,), and its slopes (6, P) by the parameters."""

    wrench: Array
    slopes: Array


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
    # One layout of arrays, none of them read-only: each other takes a quarter of a minute to compile.
    track = track._replace(motion=np.ascontiguousarray(track.motion), vehicle=track.vehicle.copy())
    disturbances = disturbances._replace(slopes=np.ascontiguousarray(disturbances.slopes))
    errors = np.zeros((len(starts), len(horizons), STATES))
    slopes = np.zeros((len(starts) if derivatives else 0, len(horizons), STATES, len(parameters)))
    rolled = Rolled(errors, slopes, np.zeros((len(starts), horizons[-1] + 1), MOVING))
    _roll_all(track, starts, horizons, parameters, disturbances, rolled)
    return rolled


@njit(cache=True, nogil=True)
def _roll_all(
    track: Track,
    starts: npt.NDArray[np.int64],
    horizons: npt.NDArray[np.int64],
    parameters: Array,
    disturbances: Disturbances,
    rolled: Rolled,
) -> None:
    row, now = np.zeros(1, REGRESSORS), np.zeros(1, MOTION)
    with_slopes = len(rolled.derivatives) > 0
    h = track.step
    for window in range(len(starts)):
        path, sample, horizon = rolled.path[window], starts[window], 0
        path[0].attitude[:] = track.attitude[sample]
        path[0].velocity[:] = matrix(track.attitude[sample]) @ track.motion[sample].velocity
        path[0].rates[:] = track.motion[sample].rates
        flown = np.zeros(3)
        held = Held(disturbances.wrench[window].copy(), np.zeros((6, len(parameters))))
        # Derivatives of the state by the parameters, now and halfway; none are computed of no rows.
        sensitivity = np.zeros((STATES if with_slopes else 0, len(parameters)))
        middle = sensitivity
        if with_slopes:
            held.slopes[:] = disturbances.slopes[window]
        for step in range(horizons[-1]):
            left, right = track.motion[sample], track.motion[sample + 1]
            here, there = path[step], path[step + 1]
            set_motion(now[0], left, left, here.attitude, here.velocity, here.rates)
            gained, slopes = _accelerate(now, here.attitude, track, parameters, held, row, sensitivity)
            half_attitude = np.array(product(here.attitude, from_rotation_vector(0.5 * h * here.rates)))
            half_velocity = here.velocity + 0.5 * h * gained[:3]
            half_rates = here.rates + 0.5 * h * gained[3:]
            if with_slopes:
                middle = _slopes_after(sensitivity, sensitivity, here.rates, 0.5 * h, slopes)
            set_motion(now[0], left, right, half_attitude, half_velocity, half_rates)
            gained, slopes = _accelerate(now, half_attitude, track, parameters, held, row, middle)
            if with_slopes:
                sensitivity = _slopes_after(sensitivity, middle, half_rates, h, slopes)
            turned = product(here.attitude, from_rotation_vector(h * half_rates))
            there.displacement[:] = here.displacement + h * half_velocity
            there.attitude[:] = np.array(normalised(turned))
            there.velocity[:] = here.velocity + h * gained[:3]
            there.rates[:] = here.rates + h * gained[3:]
            flown += 0.5 * h * (matrix(track.attitude[sample]) @ left.velocity)
            flown += 0.5 * h * (matrix(track.attitude[sample + 1]) @ right.velocity)
            held.wrench[:] *= disturbances.decay
            held.slopes[:] *= disturbances.decay.reshape(6, 1)
            sample += 1
            if step + 1 == horizons[horizon]:
                error = rolled.errors[window, horizon]
                error[0:3] = there.displacement - flown
                error[3:6] = there.velocity - matrix(track.attitude[sample]) @ right.velocity
                error[6:9] = to_rotation_vector(product(inverse(track.attitude[sample]), there.attitude))
                error[9:12] = there.rates - right.rates
                if with_slopes:
                    by_vector = np.linalg.inv(_right_jacobian(error[6:9])) @ sensitivity[6:9]
                    rolled.derivatives[window, horizon] = sensitivity
                    rolled.derivatives[window, horizon, 6:9] = by_vector
                horizon += 1


@njit(cache=True, nogil=True)
def _slopes_after(begin: Array, during: Array, rates: Array, h: float, slopes: Array) -> Array:
    """Derivatives (12, P) of the state after `h` seconds, of velocity, rates and accelerations that are held.

    Those of the state at the begin are `begin`, of what is held `during` and, for accelerations, `slopes`.
    """
    vector = h * rates
    after = np.empty_like(begin)
    after[0:3] = begin[0:3] + h * during[3:6]
    after[3:6] = begin[3:6] + h * slopes[:3]
    turn = matrix(from_rotation_vector(vector)).T
    after[6:9] = turn @ begin[6:9] + h * (_right_jacobian(vector) @ during[9:12])
    after[9:12] = begin[9:12] + h * slopes[3:]
    return after


@njit(cache=True, nogil=True)
def set_motion(now: Any, left: Any, right: Any, attitude: Array, velocity: Array, rates: Array) -> None:
    """Rotor speeds halfway between two samples, motion as given (velocity in the world)."""
    now.velocity[:] = matrix(attitude).T @ velocity
    now.rates[:] = rates
    now.rotor_speeds[:] = 0.5 * (left.rotor_speeds + right.rotor_speeds)
    now.rotor_accelerations[:] = 0.5 * (left.rotor_accelerations + right.rotor_accelerations)


@njit(cache=True, nogil=True)
def _accelerate(
    now: Records, attitude: Array, track: Track, parameters: Array, held: Held, row: Records, state: Array
) -> tuple[Array, Array]:
    """Accelerations (6,), in the world m/s² and about the body axes rad/s², and their derivatives (6, P).

    Without the derivatives of the state (12, P), of no rows then, those of the accelerations are zero.
    """
    accelerations, slopes = np.empty(6), np.zeros((6, len(parameters)))
    rotation = matrix(attitude)
    wrench = wrench_of(now, track.vehicle, parameters, row) + held.wrench
    rates = now[0].rates.copy()
    accelerations[:3] = rotation @ wrench[:3] / track.mass
    accelerations[2] += track.gravity
    accelerations[3:] = track.inverse_inertia @ (wrench[3:] - np.cross(rates, track.inertia @ rates))
    if len(state) > 0:
        own = np.ascontiguousarray(row.view(np.float64).reshape(len(parameters), 6).T) + held.slopes
        by_motion = wrench_slopes(now, track.vehicle, parameters, row)
        slopes = acceleration_slopes(now, rotation, track, wrench, by_motion, own, state)
    return accelerations, slopes


@njit(cache=True, nogil=True)
def acceleration_slopes(
    now: Records, rotation: Array, track: Track, wrench: Array, by_motion: Array, own: Array, state: Array
) -> Array:
    """Derivatives (6, n) of the accelerations by anything that changes wrench and state.

    Args:
        now: MOTION (1,).
        rotation: (3, 3) body to world.
        track: of the flight.
        wrench: (6,) that acts.
        by_motion: (6, 6) its derivatives by velocity and rates in body axes.
        own: (6, n) its derivatives where the state stays.
        state: (12, n) derivatives of the state.
    """
    slopes = np.empty((6, state.shape[1]))
    velocity, rates = now[0].velocity.copy(), now[0].rates.copy()
    turned, turning = state[6:9].copy(), state[9:12].copy()
    air = rotation.T @ state[3:6].copy() + cross_matrix(velocity) @ turned
    by_velocity, by_rates = np.ascontiguousarray(by_motion[:, :3]), np.ascontiguousarray(by_motion[:, 3:])
    change = own + by_velocity @ air + by_rates @ turning
    slopes[:3] = rotation @ (change[:3] - cross_matrix(wrench[:3]) @ turned) / track.mass
    gyroscopic = cross_matrix(rates) @ track.inertia - cross_matrix(track.inertia @ rates)
    slopes[3:] = track.inverse_inertia @ (change[3:] - gyroscopic @ turning)
    return slopes


@njit(cache=True, nogil=True)
def wrench_slopes(now: Records, vehicle: Records, parameters: Array, row: Records) -> Array:
    """Derivatives (6, 6) of the wrench by velocity and rates in body axes."""
    # One call in a loop: each place of a call costs seconds of compilation.
    slopes = np.zeros((6, 6))
    velocity, rates = now[0].velocity.copy(), now[0].rates.copy()
    for case in range(12):
        axis, sign = case // 2, 1.0 - 2.0 * (case % 2)
        if axis < 3:
            now[0].velocity[axis] = velocity[axis] + sign * _DIFFERENCE
        else:
            now[0].rates[axis - 3] = rates[axis - 3] + sign * _DIFFERENCE
        slopes[:, axis] += sign / (2.0 * _DIFFERENCE) * wrench_of(now, vehicle, parameters, row)
        now[0].velocity[:] = velocity
        now[0].rates[:] = rates
    return slopes


@njit(cache=True, nogil=True)
def wrench_of(now: Records, vehicle: Records, parameters: Array, row: Records) -> Array:
    """Wrench (6,) of a motion; leaves its regressors in `row`."""
    values = row.view(np.float64)
    values[:] = 0.0
    fill_regressors(now[0], vehicle[0], row[0])
    wrench: Array = parameters @ values.reshape(len(parameters), 6)
    return wrench


@njit(cache=True, nogil=True)
def cross_matrix(vector: Array) -> Array:
    """[v]× (3, 3), so that [v]× x = v × x."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -vector[2], vector[1], -vector[0]
    out[1, 0], out[2, 0], out[2, 1] = vector[2], -vector[1], vector[0]
    return out


@njit(cache=True, nogil=True)
def _right_jacobian(vector: Array) -> Array:
    """Right Jacobian (3, 3) of the exponential map: exp(v + δ) ≈ exp(v) exp(J δ)."""
    angle = np.sqrt(np.sum(vector * vector))
    cross = cross_matrix(vector)
    if angle < 1e-4:
        return np.eye(3) - 0.5 * cross + cross @ cross / 6.0
    first = (1.0 - np.cos(angle)) / angle**2
    second = (angle - np.sin(angle)) / angle**3
    jacobian: Array = np.eye(3) - first * cross + second * (cross @ cross)
    return jacobian
