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


class RigidBody:
    """A body that moves: kg, kg m², m/s²."""

    mass: float
    gravity: float
    inertia: Annotated[Array, 3, 3]
    inverse_inertia: Annotated[Array, 3, 3]


class Moving:
    """Where a body is on its way: displacement since the start and velocity in the world, rates in the body.

    Attributes:
        displacement: m.
        attitude: body to world.
        velocity: m/s.
        rates: rad/s.
    """

    displacement: Annotated[Array, 3]
    attitude: Annotated[Array, 4]
    velocity: Annotated[Array, 3]
    rates: Annotated[Array, 3]


RIGID_BODY = record_dtype(RigidBody)
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
    """A disturbance as it is now: wrench (6,) and slopes (6, P) by the parameters."""

    wrench: Array
    slopes: Array


class Accelerations(NamedTuple):
    """In the world m/s², about the body axes rad/s²: values (6,) and slopes (6, P) by the parameters."""

    values: Array
    slopes: Array


class Track(NamedTuple):
    """A flight as roll-outs need it.

    Attributes:
        step: s between samples.
        motion: MOTION (N,), rotor speeds as they act at each sample.
        attitude: (N, 4) body to world.
        vehicle: PHYSICAL_VEHICLE (1,).
        body: RIGID_BODY (1,).
    """

    step: float
    motion: Records
    attitude: Array
    vehicle: Records
    body: Records


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
    errors = np.zeros((len(starts), len(horizons), STATES))
    slopes = np.zeros((len(starts) if derivatives else 0, len(horizons), STATES, len(parameters)))
    path = np.zeros((len(starts), horizons[-1] + 1), MOVING)
    _roll_all(track, starts, horizons, parameters, disturbances, Rolled(errors, slopes, path))
    return Rolled(errors, slopes, path)


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
    sensitivity, middle = np.zeros((STATES, len(parameters))), np.zeros((STATES, len(parameters)))
    out = Accelerations(np.zeros(6), np.zeros((6, len(parameters))))
    with_slopes = len(rolled.derivatives) > 0
    state, halfway = (sensitivity, middle) if with_slopes else (sensitivity[:0], middle[:0])
    h = track.step
    for window in range(len(starts)):
        sample = starts[window]
        attitude = track.attitude[sample].copy()
        velocity = matrix(attitude) @ track.motion[sample].velocity
        rates = track.motion[sample].rates.copy()
        displacement, flown = np.zeros(3), np.zeros(3)
        sensitivity[:] = 0.0
        horizon = 0
        _record(rolled.path[window, 0], displacement, attitude, velocity, rates)
        held = Held(disturbances.wrench[window].copy(), np.zeros((6, len(parameters))))
        if with_slopes:
            held.slopes[:] = disturbances.slopes[window]
        for step in range(horizons[-1]):
            here, there = track.motion[sample], track.motion[sample + 1]
            _set_motion(now[0], here, here, attitude, velocity, rates)
            _accelerate(now, attitude, track, parameters, held, row, state, out)
            half_attitude = np.array(product(attitude, from_rotation_vector(0.5 * h * rates)))
            half_velocity = velocity + 0.5 * h * out.values[:3]
            half_rates = rates + 0.5 * h * out.values[3:]
            if with_slopes:
                _slopes_halfway(sensitivity, rates, h, out.slopes, middle)
            _set_motion(now[0], here, there, half_attitude, half_velocity, half_rates)
            _accelerate(now, half_attitude, track, parameters, held, row, halfway, out)
            if with_slopes:
                _slopes_after(middle, half_rates, h, out.slopes, sensitivity)
            displacement += h * half_velocity
            flown += 0.5 * h * (matrix(track.attitude[sample]) @ here.velocity)
            flown += 0.5 * h * (matrix(track.attitude[sample + 1]) @ there.velocity)
            velocity = velocity + h * out.values[:3]
            attitude = np.array(normalised(product(attitude, from_rotation_vector(h * half_rates))))
            rates = rates + h * out.values[3:]
            for axis in range(6):
                held.wrench[axis] *= disturbances.decay[axis]
                held.slopes[axis] *= disturbances.decay[axis]
            sample += 1
            _record(rolled.path[window, step + 1], displacement, attitude, velocity, rates)
            if step + 1 == horizons[horizon]:
                error = rolled.errors[window, horizon]
                error[0:3] = displacement - flown
                error[3:6] = velocity - matrix(track.attitude[sample]) @ there.velocity
                error[6:9] = to_rotation_vector(product(inverse(track.attitude[sample]), attitude))
                error[9:12] = rates - there.rates
                if with_slopes:
                    by_vector = np.linalg.inv(_right_jacobian(error[6:9])) @ sensitivity[6:9]
                    rolled.derivatives[window, horizon] = sensitivity
                    rolled.derivatives[window, horizon, 6:9] = by_vector
                horizon += 1


@njit(cache=True, nogil=True)
def _slopes_halfway(sensitivity: Array, rates: Array, h: float, slopes: Array, middle: Array) -> None:
    """Derivatives (12, P) of the state half a step on, for rates at the start of the step."""
    vector = 0.5 * h * rates
    turn = matrix(from_rotation_vector(vector)).T
    middle[3:6] = sensitivity[3:6] + 0.5 * h * slopes[:3]
    middle[6:9] = turn @ sensitivity[6:9] + 0.5 * h * (_right_jacobian(vector) @ sensitivity[9:12])
    middle[9:12] = sensitivity[9:12] + 0.5 * h * slopes[3:]


@njit(cache=True, nogil=True)
def _slopes_after(middle: Array, rates: Array, h: float, slopes: Array, sensitivity: Array) -> None:
    """Advance the derivatives (12, P) of the state by a step, for rates halfway."""
    turn = matrix(from_rotation_vector(h * rates)).T
    sensitivity[0:3] += h * middle[3:6]
    sensitivity[3:6] += h * slopes[:3]
    sensitivity[6:9] = turn @ sensitivity[6:9] + h * (_right_jacobian(h * rates) @ middle[9:12])
    sensitivity[9:12] += h * slopes[3:]


@njit(cache=True, nogil=True)
def _record(place: Any, displacement: Array, attitude: Array, velocity: Array, rates: Array) -> None:
    place.displacement[:] = displacement
    place.attitude[:] = attitude
    place.velocity[:] = velocity
    place.rates[:] = rates


@njit(cache=True, nogil=True)
def _set_motion(now: Any, left: Any, right: Any, attitude: Array, velocity: Array, rates: Array) -> None:
    """Rotor speeds halfway between two samples, motion as given (velocity in the world)."""
    now.velocity[:] = matrix(attitude).T @ velocity
    now.rates[:] = rates
    now.rotor_speeds[:] = 0.5 * (left.rotor_speeds + right.rotor_speeds)
    now.rotor_accelerations[:] = 0.5 * (left.rotor_accelerations + right.rotor_accelerations)


@njit(cache=True, nogil=True)
def _accelerate(
    now: Records,
    attitude: Array,
    track: Track,
    parameters: Array,
    held: Held,
    row: Records,
    sensitivity: Array,
    out: Accelerations,
) -> None:
    """Set the accelerations and their derivatives.

    Without the derivatives of the state, `sensitivity` (0, P), there are none.
    """
    body = track.body[0]
    rotation = matrix(attitude)
    wrench = wrench_of(now, track.vehicle, parameters, row) + held.wrench
    rates = now[0].rates.copy()
    momentum = body.inertia @ rates
    out.values[:3] = rotation @ wrench[:3] / body.mass
    out.values[2] += body.gravity
    out.values[3:] = body.inverse_inertia @ (wrench[3:] - np.cross(rates, momentum))
    if len(sensitivity) == 0:
        return
    values = row.view(np.float64).reshape(len(parameters), 6)
    own = np.ascontiguousarray(values.T) + held.slopes
    velocity = now[0].velocity.copy()
    slopes = wrench_slopes(now, track.vehicle, parameters, row)
    turned, turning = sensitivity[6:9].copy(), sensitivity[9:12].copy()
    air = rotation.T @ sensitivity[3:6].copy() + cross_matrix(velocity) @ turned
    by_velocity, by_rates = np.ascontiguousarray(slopes[:, :3]), np.ascontiguousarray(slopes[:, 3:])
    change = own + by_velocity @ air + by_rates @ turning
    out.slopes[:3] = rotation @ (change[:3] - cross_matrix(wrench[:3]) @ turned) / body.mass
    gyroscopic = cross_matrix(rates) @ body.inertia - cross_matrix(momentum)
    out.slopes[3:] = body.inverse_inertia @ (change[3:] - gyroscopic @ turning)


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
