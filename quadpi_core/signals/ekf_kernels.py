# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The compiled steps of the error-state Kalman filter; :mod:`quadpi_core.signals.ekf` drives them.

Error state, 15 numbers: position and velocity in the world, attitude as a rotation vector in body axes
(true = estimated ⊗ exp(error)), gyro bias, accelerometer bias. After Solà, "Quaternion kinematics for the
error-state Kalman filter" (2017), section 5, with blocks of three exploited throughout.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple, TypeAlias

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.flight import MAX_GAP_NS, RATE_MAX_RAD_S, SPECIFIC_FORCE_MAX_M_S2, Stamps
from quadpi_core.frames import Array
from quadpi_core.signals import rotations

ERROR_STATES = 15
POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ATTITUDE = slice(6, 9)
GYRO_BIAS = slice(9, 12)
ACCELEROMETER_BIAS = slice(12, 15)

# Small vectors travel as tuples inside the kernels: they cost no allocation.
Vector: TypeAlias = tuple[float, float, float]

MAX_LATENESS_NS = 20_000_000
MAX_JUMP_BACK_NS = 1_000_000_000
_MIN_QUATERNION_NORM = 0.5
# Farther than any motion capture sees.
_POSITION_MAX_M = 10_000.0


class Outcome(IntEnum):
    """What became of one sample."""

    USED = 0
    COLLECTED = 1  # kept for the initialisation
    UNUSABLE = 2  # a value is not finite or cannot be, or an attitude is no rotation
    STAMP_NOT_ADVANCING = 3
    TOO_LATE = 4
    TOO_EARLY = 5
    RESET = 6  # the IMU paused too long or its clock jumped back: the filter starts anew with this sample


class Noise(NamedTuple):
    """What the filter assumes, as the kernels take it.

    Attributes:
        gyro, accelerometer: densities, (rad/s)²/Hz and (m/s²)²/Hz.
        gyro_bias, accelerometer_bias: growth of the biases' variances per second.
        position, attitude: variances of a pose, m² and rad².
        gravity: m/s², along the world's third axis.
    """

    gyro: float
    accelerometer: float
    gyro_bias: float
    accelerometer_bias: float
    position: float
    attitude: float
    gravity: float


class State(NamedTuple):
    """The filter's memory; arrays that the kernels change in place.

    Attributes:
        time_ns: (1,) stamp that the state belongs to.
        position, velocity: (3,) m and m/s, world.
        attitude: (4,) body to world.
        gyro_bias, accelerometer_bias: (3,) rad/s and m/s², body axes.
        covariance: (15, 15) of the error state.
        imu_time_ns: (1,) stamp of the last IMU sample.
        rates, specific_force: (3,) the last IMU sample.
    """

    time_ns: Stamps
    position: Array
    velocity: Array
    attitude: Array
    gyro_bias: Array
    accelerometer_bias: Array
    covariance: Array
    imu_time_ns: Stamps
    rates: Array
    specific_force: Array


@njit(cache=True)
def predict(state: State, noise: Noise, time_ns: int, rates: Array, specific_force: Array) -> Outcome:
    """Take one IMU sample: rates (3,) rad/s and specific_force (3,) m/s², and move the state to its stamp.

    The IMU signal is taken as linear between its samples. Gives an :class:`Outcome`; the state is untouched
    unless it is USED.
    """
    if not usable_imu(rates, specific_force):
        return Outcome.UNUSABLE
    since_imu = time_ns - state.imu_time_ns[0]
    if since_imu > MAX_GAP_NS or since_imu < -MAX_JUMP_BACK_NS:
        return Outcome.RESET
    if since_imu <= 0:
        return Outcome.STAMP_NOT_ADVANCING
    step = time_ns - state.time_ns[0]
    if step > 0:
        middle = 1.0 - 0.5 * step / since_imu
        propagate(
            state,
            noise,
            time_ns,
            _between(state.rates, rates, middle),
            _between(state.specific_force, specific_force, middle),
        )
    state.imu_time_ns[0] = time_ns
    state.rates[:] = rates
    state.specific_force[:] = specific_force
    return Outcome.USED


@njit(cache=True)
def update_pose(state: State, noise: Noise, time_ns: int, position: Array, attitude: Array) -> Outcome:
    """Correct the state by a pose: position (3,) m world, attitude (4,) body to world.

    Between IMU samples the last one is held to reach the pose's stamp; a pose late by up to MAX_LATENESS_NS
    is first moved to the state's stamp by the state's own motion. Gives an :class:`Outcome`; the state is
    untouched unless USED.
    """
    if not usable_pose(position, attitude):
        return Outcome.UNUSABLE
    if time_ns < state.time_ns[0] - MAX_LATENESS_NS:
        return Outcome.TOO_LATE
    if time_ns > state.imu_time_ns[0] + MAX_GAP_NS:
        return Outcome.TOO_EARLY
    if time_ns > state.time_ns[0]:
        propagate(state, noise, time_ns, state.rates, state.specific_force)
    late = 1e-9 * (state.time_ns[0] - time_ns)
    turn = _minus(state.rates, state.gyro_bias, late)
    correct(
        state,
        noise,
        (
            position[0] + late * state.velocity[0],
            position[1] + late * state.velocity[1],
            position[2] + late * state.velocity[2],
        ),
        rotations.product(rotations.normalised(attitude), rotations.from_rotation_vector(turn)),
    )
    return Outcome.USED


@njit(cache=True)
def usable_imu(rates: Array, specific_force: Array) -> bool:
    """Whether rates (3,) rad/s and specific_force (3,) m/s² can be those of a flight; NaN cannot."""
    return bool(
        np.all(np.abs(rates) <= RATE_MAX_RAD_S) and np.all(np.abs(specific_force) <= SPECIFIC_FORCE_MAX_M_S2)
    )


@njit(cache=True)
def usable_pose(position: Array, attitude: Array) -> bool:
    """Whether a position (3,) m can be measured and its attitude (4,) is a rotation, but for scale."""
    if not (np.all(np.abs(position) <= _POSITION_MAX_M) and np.all(np.isfinite(attitude))):
        return False
    return bool(np.sum(attitude * attitude) >= _MIN_QUATERNION_NORM**2)


@njit(cache=True)
def propagate(
    state: State, noise: Noise, time_ns: int, rates: Array | Vector, specific_force: Array | Vector
) -> None:
    """Move the state to `time_ns` under a constant measured rate and specific force."""
    dt = 1e-9 * (time_ns - state.time_ns[0])
    turn = _minus(rates, state.gyro_bias, dt)
    half_turn = (0.5 * turn[0], 0.5 * turn[1], 0.5 * turn[2])
    force = _minus(specific_force, state.accelerometer_bias, 1.0)
    half_turned = rotations.product(state.attitude, rotations.from_rotation_vector(half_turn))
    rotation = rotations.matrix(half_turned)
    for axis in range(3):
        acceleration = (
            rotation[axis, 0] * force[0] + rotation[axis, 1] * force[1] + rotation[axis, 2] * force[2]
        )
        if axis == 2:
            acceleration += noise.gravity
        state.position[axis] += (state.velocity[axis] + 0.5 * acceleration * dt) * dt
        state.velocity[axis] += acceleration * dt
    state.attitude[:] = rotations.normalised(
        rotations.product(state.attitude, rotations.from_rotation_vector(turn))
    )
    state.time_ns[0] = time_ns
    _propagate_covariance(state.covariance, noise, dt, rotation, turn, force)


@njit(cache=True)
def _between(first: Array, second: Array, share: float) -> Vector:
    """The vector (3,) at a share of the way from the first to the second."""
    return (
        first[0] + share * (second[0] - first[0]),
        first[1] + share * (second[1] - first[1]),
        first[2] + share * (second[2] - first[2]),
    )


@njit(cache=True)
def _minus(vector: Array | Vector, other: Array, scale: float) -> Vector:
    """The difference of two vectors (3,), scaled."""
    return scale * (vector[0] - other[0]), scale * (vector[1] - other[1]), scale * (vector[2] - other[2])


@njit(cache=True)
def _propagate_covariance(
    covariance: Array,
    noise: Noise,
    dt: float,
    rotation: Array,
    turn: Vector,
    force: Vector,
) -> None:
    """P ← F P Fᵀ + Q with F = I but for the blocks named below; F acts on rows, then on columns."""
    velocity_by_bias = -dt * rotation
    velocity_by_attitude = np.empty((3, 3))
    for row in range(3):
        a, b, c = velocity_by_bias[row, 0], velocity_by_bias[row, 1], velocity_by_bias[row, 2]
        velocity_by_attitude[row, 0] = b * force[2] - c * force[1]
        velocity_by_attitude[row, 1] = c * force[0] - a * force[2]
        velocity_by_attitude[row, 2] = a * force[1] - b * force[0]
    turned_back = rotations.from_rotation_vector((-turn[0], -turn[1], -turn[2]))
    attitude_by_attitude = rotations.matrix(turned_back)

    _transform_rows(covariance, dt, velocity_by_attitude, velocity_by_bias, attitude_by_attitude)
    _transform_columns(covariance, dt, velocity_by_attitude, velocity_by_bias, attitude_by_attitude)
    for row in range(ERROR_STATES):
        for column in range(row):
            covariance[column, row] = covariance[row, column]
    for axis in range(3):
        covariance[VELOCITY.start + axis, VELOCITY.start + axis] += noise.accelerometer * dt
        covariance[ATTITUDE.start + axis, ATTITUDE.start + axis] += noise.gyro * dt
        covariance[GYRO_BIAS.start + axis, GYRO_BIAS.start + axis] += noise.gyro_bias * dt
        covariance[ACCELEROMETER_BIAS.start + axis, ACCELEROMETER_BIAS.start + axis] += (
            noise.accelerometer_bias * dt
        )


@njit(cache=True)
def _transform_rows(
    covariance: Array,
    dt: float,
    velocity_by_attitude: Array,
    velocity_by_bias: Array,
    attitude_by_attitude: Array,
) -> None:
    """P ← F P in place: position, velocity, attitude in the order in which they feed."""
    position, velocity, attitude = covariance[POSITION], covariance[VELOCITY], covariance[ATTITUDE]
    gyro_bias, accelerometer_bias = covariance[GYRO_BIAS], covariance[ACCELEROMETER_BIAS]
    for axis in range(3):
        for column in range(ERROR_STATES):
            position[axis, column] += dt * velocity[axis, column]
    for axis in range(3):
        a0, a1, a2 = (
            velocity_by_attitude[axis, 0],
            velocity_by_attitude[axis, 1],
            velocity_by_attitude[axis, 2],
        )
        b0, b1, b2 = velocity_by_bias[axis, 0], velocity_by_bias[axis, 1], velocity_by_bias[axis, 2]
        for column in range(ERROR_STATES):
            velocity[axis, column] += (
                a0 * attitude[0, column]
                + a1 * attitude[1, column]
                + a2 * attitude[2, column]
                + b0 * accelerometer_bias[0, column]
                + b1 * accelerometer_bias[1, column]
                + b2 * accelerometer_bias[2, column]
            )
    for column in range(ERROR_STATES):
        a0, a1, a2 = attitude[0, column], attitude[1, column], attitude[2, column]
        for axis in range(3):
            attitude[axis, column] = (
                attitude_by_attitude[axis, 0] * a0
                + attitude_by_attitude[axis, 1] * a1
                + attitude_by_attitude[axis, 2] * a2
                - dt * gyro_bias[axis, column]
            )


@njit(cache=True)
def _transform_columns(
    covariance: Array,
    dt: float,
    velocity_by_attitude: Array,
    velocity_by_bias: Array,
    attitude_by_attitude: Array,
) -> None:
    """P ← P Fᵀ in place, where only the lower triangle is needed."""
    for index in range(ERROR_STATES):
        row = covariance[index]
        position, velocity, attitude = row[POSITION], row[VELOCITY], row[ATTITUDE]
        gyro_bias, accelerometer_bias = row[GYRO_BIAS], row[ACCELEROMETER_BIAS]
        for axis in range(3):
            position[axis] += dt * velocity[axis]
        if index < VELOCITY.start:
            continue
        a0, a1, a2 = attitude[0], attitude[1], attitude[2]
        b0, b1, b2 = accelerometer_bias[0], accelerometer_bias[1], accelerometer_bias[2]
        for axis in range(3):
            velocity[axis] += (
                velocity_by_attitude[axis, 0] * a0
                + velocity_by_attitude[axis, 1] * a1
                + velocity_by_attitude[axis, 2] * a2
                + velocity_by_bias[axis, 0] * b0
                + velocity_by_bias[axis, 1] * b1
                + velocity_by_bias[axis, 2] * b2
            )
        if index < ATTITUDE.start:
            continue
        for axis in range(3):
            attitude[axis] = (
                attitude_by_attitude[axis, 0] * a0
                + attitude_by_attitude[axis, 1] * a1
                + attitude_by_attitude[axis, 2] * a2
                - dt * gyro_bias[axis]
            )


@njit(cache=True)
def correct(state: State, noise: Noise, position: Vector, attitude: rotations.Quaternion) -> None:
    """Measurement update by a pose at the state's own stamp, one scalar at a time, in Joseph form."""
    attitude_error = rotations.to_rotation_vector(
        rotations.product(rotations.inverse(state.attitude), attitude)
    )
    error = np.zeros(ERROR_STATES)
    for axis in range(3):
        _correct_scalar(
            state.covariance,
            error,
            POSITION.start + axis,
            position[axis] - state.position[axis],
            noise.position,
        )
    for axis in range(3):
        _correct_scalar(state.covariance, error, ATTITUDE.start + axis, attitude_error[axis], noise.attitude)
    state.position[:] += error[POSITION]
    state.velocity[:] += error[VELOCITY]
    state.attitude[:] = rotations.normalised(
        rotations.product(state.attitude, rotations.from_rotation_vector(error[ATTITUDE]))
    )
    state.gyro_bias[:] += error[GYRO_BIAS]
    state.accelerometer_bias[:] += error[ACCELEROMETER_BIAS]


@njit(cache=True)
def _correct_scalar(covariance: Array, error: Array, index: int, measured: float, variance: float) -> None:
    """Measure error state `index` directly: P ← (I − k hᵀ) P (I − k hᵀ)ᵀ + k r kᵀ."""
    innovation_variance = covariance[index, index] + variance
    row_before = covariance[index].copy()
    gain = row_before / innovation_variance
    # Column `index` of (I − k hᵀ) P.
    column = row_before - gain * row_before[index]
    innovation = measured - error[index]
    for i in range(ERROR_STATES):
        error[i] += gain[i] * innovation
        for j in range(i + 1):
            updated = (
                covariance[i, j]
                - gain[i] * row_before[j]
                - column[i] * gain[j]
                + gain[i] * variance * gain[j]
            )
            covariance[i, j] = updated
            covariance[j, i] = updated
