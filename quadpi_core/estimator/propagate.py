# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The compiled steps of the error-state Kalman filter on one estimate; :mod:`.ekf_buffer` drives them.

Error state, 16 numbers: position and velocity in the world, attitude as a rotation vector in body axes
(true = estimated ⊗ exp(error)), gyro bias, accelerometer bias, and the delay of motion capture: what it
stamps s was true at s less the delay. After Solà, "Quaternion kinematics for the error-state Kalman filter"
(2017), section 5, with blocks of three exploited throughout.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple, TypeAlias

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.signals import rotations

ERROR_STATES = 16
POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ATTITUDE = slice(6, 9)
GYRO_BIAS = slice(9, 12)
ACCELEROMETER_BIAS = slice(12, 15)
DELAY = 15


class Row:
    """Where an estimate of one instant, a row of numbers, holds what: an IMU sample and the state with it."""

    RATES = slice(0, 3)
    FORCE = slice(3, 6)
    IMU = slice(0, 6)
    POSITION = slice(6, 9)
    VELOCITY = slice(9, 12)
    ATTITUDE = slice(12, 16)
    GYRO_BIAS = slice(16, 19)
    ACCELEROMETER_BIAS = slice(19, 22)
    DELAY = 22
    NOMINAL = slice(6, 23)
    COVARIANCE = slice(23, 23 + ERROR_STATES**2)
    WIDTH = 23 + ERROR_STATES**2


# Kernels take slices of constants from module level only.
_RATES, _FORCE, _POSITION, _VELOCITY = Row.RATES, Row.FORCE, Row.POSITION, Row.VELOCITY
_ATTITUDE, _GYRO_BIAS, _ACCELEROMETER_BIAS = Row.ATTITUDE, Row.GYRO_BIAS, Row.ACCELEROMETER_BIAS
_DELAY, _COVARIANCE = Row.DELAY, Row.COVARIANCE

# Small vectors travel as tuples inside the kernels: they cost no allocation.
Vector: TypeAlias = tuple[float, float, float]

# A motion capture whose stamps are farther off than this cannot be fused from the buffer.
DELAY_MAX_S = 0.35


class Outcome(IntEnum):
    """What became of one sample."""

    USED = 0
    COLLECTED = 1  # kept: for the initialisation, or until it is time to fuse it
    UNUSABLE = 2  # a value is not finite or cannot be, or an attitude is no rotation
    STAMP_NOT_ADVANCING = 3
    TOO_LATE = 4
    TOO_EARLY = 5
    RESET = 6  # the IMU paused too long, its clock jumped back or its rate changed: the filter starts anew
    REJECTED = 7  # contradicts the estimate by more than both uncertainties allow
    FROZEN = 8  # repeats the value before it bit for bit: no new measurement
    STAMP_JUMPED = 9  # an IMU sample far from the one before: RESET if the next one agrees with it


# IMU samples that the monitor has to hear of, though there is no estimate at their stamps: it reports that.
WITHOUT_ESTIMATE = (Outcome.UNUSABLE, Outcome.COLLECTED, Outcome.RESET)


class EstimatorStatus(IntEnum):
    """How far the estimate can be used."""

    INITIALISING = 0
    OK = 1
    DEGRADED = 2  # not settled, no correction for a while, or corrections are being rejected
    LOST = 3  # no correction for so long, or a velocity so uncertain, that there is no usable state


class Noise(NamedTuple):
    """What the filter assumes, as the kernels take it.

    Attributes:
        gyro, accelerometer: densities, (rad/s)²/Hz and (m/s²)²/Hz.
        gyro_bias, accelerometer_bias, delay: growth of their variances per second.
        position, attitude, velocity: variances of a correction, m², rad² and (m/s)².
        delay_prior: variance of the delay before anything is known of it, s²; 0 where stamps are trusted.
        rates, force: variances of one sample of gyro and accelerometer, (rad/s)² and (m/s²)².
        gravity: m/s², along the world's third axis.
    """

    gyro: float
    accelerometer: float
    gyro_bias: float
    accelerometer_bias: float
    delay: float
    position: float
    attitude: float
    velocity: float
    delay_prior: float
    rates: float
    force: float
    gravity: float


@njit(cache=True)
def copy(source: Array, target: Array, begin: int, end: int) -> None:
    """Copy numbers; compiles in a fraction of the time that an assignment of slices takes."""
    for index in range(begin, end):
        target[index] = source[index]


@njit(cache=True)
def covariance_of(row: Array) -> Array:
    """The covariance (16, 16) in a row, as a view."""
    return row[_COVARIANCE].reshape((ERROR_STATES, ERROR_STATES))


@njit(cache=True)
def linearise(row: Array, dt: float, rates: Vector, force: Vector, transition: Array) -> None:
    """What a step of `dt` s does to errors, into `transition` (31,): see :class:`Step`.

    Args:
        row: estimate before the step.
        dt: s.
        rates: measured, mean over the step.
        force: measured specific force, mean over the step.
        transition: to be filled.
    """
    turn = _minus(rates, row[_GYRO_BIAS], dt)
    half_turn = (0.5 * turn[0], 0.5 * turn[1], 0.5 * turn[2])
    f0, f1, f2 = _minus(force, row[_ACCELEROMETER_BIAS], 1.0)
    half_turned = rotations.product(row[_ATTITUDE], rotations.from_rotation_vector(half_turn))
    rotation = rotations.matrix(half_turned)
    turned_back = rotations.matrix(rotations.from_rotation_vector((-turn[0], -turn[1], -turn[2])))
    transition[0] = dt
    for axis in range(3):
        r0, r1, r2 = rotation[axis, 0], rotation[axis, 1], rotation[axis, 2]
        a, b, c = -dt * r0, -dt * r1, -dt * r2
        at = 1 + 3 * axis
        transition[at], transition[at + 1], transition[at + 2] = a, b, c
        transition[at + 9], transition[at + 10] = b * f2 - c * f1, c * f0 - a * f2
        transition[at + 11] = a * f1 - b * f0
        for column in range(3):
            transition[at + 18 + column] = turned_back[axis, column]
        transition[28 + axis] = r0 * f0 + r1 * f1 + r2 * f2


TRANSITION = 31
# Places in a transition: the step, then blocks (3, 3) of its matrix, then the specific force in the world.
BY_ACCELEROMETER_BIAS, BY_ATTITUDE, TURN_BACK, WORLD_FORCE = 1, 10, 19, 28


@njit(cache=True)
def propagate(row: Array, noise: Noise, dt: float, rates: Vector, force: Vector, transition: Array) -> None:
    """Move an estimate by `dt` s under a constant measured rate and specific force."""
    linearise(row, dt, rates, force, transition)
    position, velocity = row[_POSITION], row[_VELOCITY]
    for axis in range(3):
        acceleration = transition[WORLD_FORCE + axis]
        if axis == 2:
            acceleration += noise.gravity
        position[axis] += (velocity[axis] + 0.5 * acceleration * dt) * dt
        velocity[axis] += acceleration * dt
    turn = _minus(rates, row[_GYRO_BIAS], dt)
    attitude = rotations.product(row[_ATTITUDE], rotations.from_rotation_vector(turn))
    w, x, y, z = rotations.normalised(attitude)
    at = _ATTITUDE.start
    row[at], row[at + 1], row[at + 2], row[at + 3] = w, x, y, z

    covariance = covariance_of(row)
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
def _transform_rows(covariance: Array, transition: Array) -> None:
    """P ← F P in place: position, velocity, attitude in the order in which they feed."""
    dt = transition[0]
    position, velocity, attitude = covariance[0:3], covariance[3:6], covariance[6:9]
    gyro_bias, accelerometer_bias = covariance[9:12], covariance[12:15]
    for axis in range(3):
        for column in range(ERROR_STATES):
            position[axis, column] += dt * velocity[axis, column]
    for axis in range(3):
        at = BY_ATTITUDE + 3 * axis
        a0, a1, a2 = transition[at], transition[at + 1], transition[at + 2]
        at = BY_ACCELEROMETER_BIAS + 3 * axis
        b0, b1, b2 = transition[at], transition[at + 1], transition[at + 2]
        for column in range(ERROR_STATES):
            velocity[axis, column] += (
                a0 * attitude[0, column]
                + a1 * attitude[1, column]
                + a2 * attitude[2, column]
                + b0 * accelerometer_bias[0, column]
                + b1 * accelerometer_bias[1, column]
                + b2 * accelerometer_bias[2, column]
            )
    t00, t01, t02 = transition[TURN_BACK], transition[TURN_BACK + 1], transition[TURN_BACK + 2]
    t10, t11, t12 = transition[TURN_BACK + 3], transition[TURN_BACK + 4], transition[TURN_BACK + 5]
    t20, t21, t22 = transition[TURN_BACK + 6], transition[TURN_BACK + 7], transition[TURN_BACK + 8]
    for column in range(ERROR_STATES):
        a0, a1, a2 = attitude[0, column], attitude[1, column], attitude[2, column]
        attitude[0, column] = t00 * a0 + t01 * a1 + t02 * a2 - dt * gyro_bias[0, column]
        attitude[1, column] = t10 * a0 + t11 * a1 + t12 * a2 - dt * gyro_bias[1, column]
        attitude[2, column] = t20 * a0 + t21 * a1 + t22 * a2 - dt * gyro_bias[2, column]


@njit(cache=True)
def _transform_columns(covariance: Array, transition: Array) -> None:
    """P ← P Fᵀ in place, where only the lower triangle is needed."""
    for index in range(ERROR_STATES):
        row = covariance[index]
        for axis in range(3):
            row[axis] += transition[0] * row[3 + axis]
        if index < VELOCITY.start:
            continue
        a0, a1, a2 = row[6], row[7], row[8]
        b0, b1, b2 = row[12], row[13], row[14]
        for axis in range(3):
            at, to = BY_ATTITUDE + 3 * axis, BY_ACCELEROMETER_BIAS + 3 * axis
            row[3 + axis] += (
                transition[at] * a0
                + transition[at + 1] * a1
                + transition[at + 2] * a2
                + transition[to] * b0
                + transition[to + 1] * b1
                + transition[to + 2] * b2
            )
        if index < ATTITUDE.start:
            continue
        for axis in range(3):
            at = TURN_BACK + 3 * axis
            row[6 + axis] = (
                transition[at] * a0
                + transition[at + 1] * a1
                + transition[at + 2] * a2
                - transition[0] * row[9 + axis]
            )


@njit(cache=True)
def back(transition: Array, vector: Array) -> None:
    """Fᵀ times a vector (16,), in place."""
    dt = transition[0]
    v0, v1, v2 = vector[3], vector[4], vector[5]
    a0, a1, a2 = vector[6], vector[7], vector[8]
    for axis in range(3):
        at, by = BY_ATTITUDE + axis, BY_ACCELEROMETER_BIAS + axis
        turn = TURN_BACK + axis
        vector[6 + axis] = (
            transition[turn] * a0
            + transition[turn + 3] * a1
            + transition[turn + 6] * a2
            + transition[at] * v0
            + transition[at + 3] * v1
            + transition[at + 6] * v2
        )
        vector[12 + axis] += transition[by] * v0 + transition[by + 3] * v1 + transition[by + 6] * v2
        vector[3 + axis] += dt * vector[axis]
    vector[9] -= dt * a0
    vector[10] -= dt * a1
    vector[11] -= dt * a2


@njit(cache=True)
def correct_scalar(
    covariance: Array, error: Array, by: Array, measured: float, variance: float, gain: Array
) -> tuple[float, float]:
    """Measure `by` · error: P ← (I − k hᵀ) P (I − k hᵀ)ᵀ + k r kᵀ, Joseph's form.

    Args:
        covariance: (16, 16) of the error, renewed.
        error: (16,) estimated so far, renewed.
        by: (16,) h.
        measured: its value.
        variance: r, of the measurement.
        gain: (16,) filled with k.

    Returns:
        The innovation and its variance.
    """
    innovation, expected = measured, variance
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
        # Row i of (I − k hᵀ) P hᵀ, which Joseph's form takes off once more.
        remaining = projected[i] - gain[i] * prior
        for j in range(i + 1):
            updated = (
                covariance[i, j] - gain[i] * projected[j] - remaining * gain[j] + gain[i] * variance * gain[j]
            )
            covariance[i, j] = updated
            covariance[j, i] = updated
    return innovation, expected


@njit(cache=True)
def inject(row: Array, error: Array) -> None:
    """Add an estimated error (16,) to the state of a row."""
    for axis in range(3):
        row[_POSITION.start + axis] += error[axis]
        row[_VELOCITY.start + axis] += error[3 + axis]
        row[_GYRO_BIAS.start + axis] += error[9 + axis]
        row[_ACCELEROMETER_BIAS.start + axis] += error[12 + axis]
    turned = rotations.product(row[_ATTITUDE], rotations.from_rotation_vector((error[6], error[7], error[8])))
    w, x, y, z = rotations.normalised(turned)
    at = _ATTITUDE.start
    row[at], row[at + 1], row[at + 2], row[at + 3] = w, x, y, z
    row[_DELAY] = min(max(row[_DELAY] + error[DELAY], -DELAY_MAX_S), DELAY_MAX_S)


@njit(cache=True)
def between(first: Array, second: Array, at: int, share: float) -> Vector:
    """Three numbers from place `at` on, at a share of the way from the first array to the second."""
    return (
        first[at] + share * (second[at] - first[at]),
        first[at + 1] + share * (second[at + 1] - first[at + 1]),
        first[at + 2] + share * (second[at + 2] - first[at + 2]),
    )


@njit(cache=True)
def _minus(vector: Vector, other: Array, scale: float) -> Vector:
    """The difference of two vectors (3,), scaled."""
    return scale * (vector[0] - other[0]), scale * (vector[1] - other[1]), scale * (vector[2] - other[2])
