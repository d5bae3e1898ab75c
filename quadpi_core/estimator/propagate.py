# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The compiled algebra of the error-state Kalman filter on one estimate: propagate, correct, inject.

After Solà, "Quaternion kinematics for the error-state Kalman filter" (2017), section 5, with blocks of three
exploited throughout.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from quadpi_core import rotations
from quadpi_core.compiled import njit
from quadpi_core.estimator.filter_state import (
    ATTITUDE,
    DELAY,
    ERROR_STATES,
    VELOCITY,
    Estimate,
    ImuSample,
    Noise,
    Scalar,
    Transition,
)
from quadpi_core.frames import Array

# Small vectors travel as tuples inside the kernels: they cost no allocation.
Vector: TypeAlias = tuple[float, float, float]

# Motion capture whose stamps are off by more cannot be fused from the buffer [s].
DELAY_MAX_S = 0.35


@njit(cache=True)
def propagate_between(
    estimate: Estimate, noise: Noise, first: ImuSample, second: ImuSample, to_ns: int, transition: Transition
) -> None:
    """Move an estimate to a later instant between two IMU samples, whose signal is taken as linear."""
    from_ns = estimate.time_ns
    share = 0.5 * ((from_ns - first.time_ns) + (to_ns - first.time_ns)) / (second.time_ns - first.time_ns)
    rates = _between(first.rates, second.rates, share)
    force = _between(first.specific_force, second.specific_force, share)
    propagate(estimate, noise, 1e-9 * (to_ns - from_ns), rates, force, transition)
    estimate.time_ns = to_ns


@njit(cache=True)
def propagate(
    estimate: Estimate, noise: Noise, dt: float, rates: Vector, force: Vector, transition: Transition
) -> None:
    """Move the state by `dt` s under a constant measured rate and specific force; fills `transition`."""
    _linearise(estimate, dt, rates, force, transition)
    position, velocity = estimate.position, estimate.velocity
    for axis in range(3):
        acceleration = transition.world_force[axis]
        if axis == 2:
            acceleration += noise.gravity
        position[axis] += (velocity[axis] + 0.5 * acceleration * dt) * dt
        velocity[axis] += acceleration * dt
    _turn(estimate, minus(rates, estimate.gyro_bias, dt))

    covariance = estimate.covariance
    _transform_rows(covariance, transition)
    _transform_columns(covariance, transition)
    for i in range(ERROR_STATES):
        for j in range(i):
            covariance[j, i] = covariance[i, j]
    for axis in range(3):
        covariance[3 + axis, 3 + axis] += noise.accelerometer * dt
        covariance[6 + axis, 6 + axis] += noise.gyro * dt
        covariance[9 + axis, 9 + axis] += noise.gyro_bias * dt
        covariance[12 + axis, 12 + axis] += noise.accelerometer_bias * dt
    covariance[DELAY, DELAY] += noise.delay * dt


@njit(cache=True)
def _linearise(estimate: Estimate, dt: float, rates: Vector, force: Vector, transition: Transition) -> None:
    """Linearise a step about the attitude in its middle."""
    turn = minus(rates, estimate.gyro_bias, dt)
    half_turn = (0.5 * turn[0], 0.5 * turn[1], 0.5 * turn[2])
    f0, f1, f2 = minus(force, estimate.accelerometer_bias, 1.0)
    half_turned = rotations.product(estimate.attitude, rotations.from_rotation_vector(half_turn))
    rotation = rotations.matrix(half_turned)
    turned_back = rotations.matrix(rotations.from_rotation_vector((-turn[0], -turn[1], -turn[2])))
    transition.dt = dt
    by_attitude, by_bias = transition.velocity_by_attitude, transition.velocity_by_accelerometer_bias
    for axis in range(3):
        r0, r1, r2 = rotation[axis, 0], rotation[axis, 1], rotation[axis, 2]
        a, b, c = -dt * r0, -dt * r1, -dt * r2
        by_bias[axis, 0], by_bias[axis, 1], by_bias[axis, 2] = a, b, c
        by_attitude[axis, 0] = b * f2 - c * f1
        by_attitude[axis, 1] = c * f0 - a * f2
        by_attitude[axis, 2] = a * f1 - b * f0
        for column in range(3):
            transition.attitude_by_attitude[axis, column] = turned_back[axis, column]
        transition.world_force[axis] = r0 * f0 + r1 * f1 + r2 * f2


@njit(cache=True)
def _transform_rows(covariance: Array, transition: Transition) -> None:
    """P ← F P in place: position, velocity, attitude in the order in which they feed each other."""
    dt = transition.dt
    position, velocity, attitude = covariance[0:3], covariance[3:6], covariance[6:9]
    gyro_bias, accelerometer_bias = covariance[9:12], covariance[12:15]
    a, b = transition.velocity_by_attitude, transition.velocity_by_accelerometer_bias
    t = transition.attitude_by_attitude
    for axis in range(3):
        for column in range(ERROR_STATES):
            position[axis, column] += dt * velocity[axis, column]
    for axis in range(3):
        for column in range(ERROR_STATES):
            velocity[axis, column] += (
                a[axis, 0] * attitude[0, column]
                + a[axis, 1] * attitude[1, column]
                + a[axis, 2] * attitude[2, column]
                + b[axis, 0] * accelerometer_bias[0, column]
                + b[axis, 1] * accelerometer_bias[1, column]
                + b[axis, 2] * accelerometer_bias[2, column]
            )
    for column in range(ERROR_STATES):
        a0, a1, a2 = attitude[0, column], attitude[1, column], attitude[2, column]
        for axis in range(3):
            attitude[axis, column] = (
                t[axis, 0] * a0 + t[axis, 1] * a1 + t[axis, 2] * a2 - dt * gyro_bias[axis, column]
            )


@njit(cache=True)
def _transform_columns(covariance: Array, transition: Transition) -> None:
    """P ← P Fᵀ in place, where only the lower triangle is needed."""
    dt = transition.dt
    a, b = transition.velocity_by_attitude, transition.velocity_by_accelerometer_bias
    t = transition.attitude_by_attitude
    for index in range(ERROR_STATES):
        row = covariance[index]
        for axis in range(3):
            row[axis] += dt * row[3 + axis]
        if index < VELOCITY.start:
            continue
        a0, a1, a2 = row[6], row[7], row[8]
        b0, b1, b2 = row[12], row[13], row[14]
        for axis in range(3):
            row[3 + axis] += (
                a[axis, 0] * a0
                + a[axis, 1] * a1
                + a[axis, 2] * a2
                + b[axis, 0] * b0
                + b[axis, 1] * b1
                + b[axis, 2] * b2
            )
        if index < ATTITUDE.start:
            continue
        for axis in range(3):
            row[6 + axis] = t[axis, 0] * a0 + t[axis, 1] * a1 + t[axis, 2] * a2 - dt * row[9 + axis]


@njit(cache=True)
def apply_transposed(transition: Transition, vector: Array) -> None:
    """Multiply a vector (16,) by Fᵀ in place."""
    dt = transition.dt
    a, b = transition.velocity_by_attitude, transition.velocity_by_accelerometer_bias
    t = transition.attitude_by_attitude
    v0, v1, v2 = vector[3], vector[4], vector[5]
    a0, a1, a2 = vector[6], vector[7], vector[8]
    for axis in range(3):
        vector[6 + axis] = (
            t[0, axis] * a0
            + t[1, axis] * a1
            + t[2, axis] * a2
            + a[0, axis] * v0
            + a[1, axis] * v1
            + a[2, axis] * v2
        )
        vector[12 + axis] += b[0, axis] * v0 + b[1, axis] * v1 + b[2, axis] * v2
        vector[3 + axis] += dt * vector[axis]
    vector[9] -= dt * a0
    vector[10] -= dt * a1
    vector[11] -= dt * a2


@njit(cache=True)
def correct_scalar(covariance: Array, error: Array, scalar: Scalar) -> None:
    """Correct by one scalar: P ← (I − k hᵀ) P (I − k hᵀ)ᵀ + k r kᵀ, Joseph's form.

    Args:
        covariance: (16, 16) of the error state, updated.
        error: (16,) error state as estimated from the scalars before, updated.
        scalar: with its Jacobian h, residual and variance r; gains k and innovation.
    """
    by, gain, variance = scalar.jacobian, scalar.gain, scalar.variance
    innovation, expected = scalar.residual, variance
    projected = np.empty(ERROR_STATES)
    for i in range(ERROR_STATES):
        total = 0.0
        for j in range(ERROR_STATES):
            total += covariance[i, j] * by[j]
        projected[i] = total
        innovation -= by[i] * error[i]
        expected += by[i] * total
    prior = expected - variance
    for i in range(ERROR_STATES):
        gain[i] = projected[i] / expected
    for i in range(ERROR_STATES):
        error[i] += gain[i] * innovation
        # Row i of (I − k hᵀ) P hᵀ, which Joseph's form subtracts once more.
        remaining = projected[i] - gain[i] * prior
        for j in range(i + 1):
            updated = (
                covariance[i, j] - gain[i] * projected[j] - remaining * gain[j] + gain[i] * variance * gain[j]
            )
            covariance[i, j] = updated
            covariance[j, i] = updated
    scalar.innovation, scalar.innovation_variance = innovation, expected


@njit(cache=True)
def inject(estimate: Estimate, error: Array) -> None:
    """Add an estimated error (16,) to the state."""
    for axis in range(3):
        estimate.position[axis] += error[axis]
        estimate.velocity[axis] += error[3 + axis]
        estimate.gyro_bias[axis] += error[9 + axis]
        estimate.accelerometer_bias[axis] += error[12 + axis]
    _turn(estimate, (error[6], error[7], error[8]))
    estimate.delay = min(max(estimate.delay + error[DELAY], -DELAY_MAX_S), DELAY_MAX_S)


@njit(cache=True)
def minus(vector: Vector | Array, other: Array, scale: float) -> Vector:
    """The scaled difference of two vectors (3,)."""
    return scale * (vector[0] - other[0]), scale * (vector[1] - other[1]), scale * (vector[2] - other[2])


@njit(cache=True)
def _turn(estimate: Estimate, turn: Vector) -> None:
    """Turn the attitude by a rotation vector [rad] in body axes."""
    turned = rotations.product(estimate.attitude, rotations.from_rotation_vector(turn))
    w, x, y, z = rotations.normalised(turned)
    attitude = estimate.attitude
    attitude[0], attitude[1], attitude[2], attitude[3] = w, x, y, z


@njit(cache=True)
def _between(first: Array, second: Array, share: float) -> Vector:
    """The vector (3,) at a share of the way from the first to the second."""
    return (
        first[0] + share * (second[0] - first[0]),
        first[1] + share * (second[1] - first[1]),
        first[2] + share * (second[2] - first[2]),
    )
