# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What motion capture measures of an estimate, and how an estimate is corrected by it.

The delay of motion capture is estimated with the state, after Li and Mourikis, "Online temporal calibration
for camera-IMU systems" (2014): a delay that is longer by δ lets a pose show where the vehicle was δ earlier.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.estimator.propagate import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    DELAY,
    ERROR_STATES,
    GYRO_BIAS,
    VELOCITY,
    Noise,
    Row,
    copy,
    correct_scalar,
    covariance_of,
    inject,
)
from quadpi_core.frames import Array
from quadpi_core.signals import rotations

# Kinds of correction.
POSE, WORLD_VELOCITY, BODY_VELOCITY = 0, 1, 2
VALUES = 7

# Chi-square quantiles at 0.9999 of the six numbers of a pose and the three of a velocity.
POSE_GATE = 27.856
VELOCITY_GATE = 21.108

# One scalar measurement as the smoother needs it: h and gain, innovation and its variance.
SCALAR = 2 * ERROR_STATES + 2

# A correction as it was applied: kind, lag [s], value (7,), the variances by which the state was widened
# first, and the squared innovation in units of its covariance.
KIND, LAG, VALUE, WIDENED, NIS, JOURNAL = 0, 1, 2, 2 + VALUES, 2 + VALUES + 4, 2 + VALUES + 5

Scalars: TypeAlias = Array
Count: TypeAlias = npt.NDArray[np.int64]

_RATES, _FORCE, _POSITION, _VELOCITY = Row.RATES, Row.FORCE, Row.POSITION, Row.VELOCITY
_ATTITUDE, _GYRO_BIAS, _ACCELEROMETER_BIAS = Row.ATTITUDE, Row.GYRO_BIAS, Row.ACCELEROMETER_BIAS
# How fast body rates change in flight [rad/s²]: what a wrong delay does to an attitude, to second order.
ANGULAR_ACCELERATION = 20.0
# And the acceleration [m/s³]: what it does to a velocity.
_JERK = 20.0
# A motion counts in full when it is well above three standard deviations.
_SIGNIFICANCE = 9.0


@njit(cache=True)
def fuse(row: Array, noise: Noise, kind: int, lag: float, value: Array, scalars: Scalars) -> float:
    """Correct an estimate by a pose or a velocity, one scalar at a time.

    Args:
        row: the estimate, renewed; its IMU sample is that of its instant.
        noise: of the sensors.
        kind: POSE, WORLD_VELOCITY or BODY_VELOCITY.
        lag: from the estimate's instant to that of the measurement, s; 0 but where it fell behind another.
        value: (7,) position m and attitude, or velocity m/s in the first three.
        scalars: (6, 34) filled with what the smoother needs, a row per scalar.

    Returns:
        The squared innovation in units of its covariance, of 6 or 3 degrees of freedom.
    """
    residual, left_out = np.empty(6), np.empty(6)
    by = np.zeros((6, ERROR_STATES))
    if kind == POSE:
        measured = _pose(row, noise, lag, value, residual, left_out, by)
    else:
        measured = _velocity(row, noise, kind == BODY_VELOCITY, lag, value, residual, left_out, by)
    covariance = covariance_of(row)
    error = np.zeros(ERROR_STATES)
    nis = 0.0
    for index in range(measured):
        variance = noise.velocity
        if kind == POSE:
            variance = noise.position if index < 3 else noise.attitude
        innovation, expected = correct_scalar(
            covariance,
            error,
            by[index],
            residual[index],
            variance + left_out[index],
            scalars[index, ERROR_STATES : 2 * ERROR_STATES],
        )
        copy(by[index], scalars[index], 0, ERROR_STATES)
        scalars[index, 2 * ERROR_STATES] = innovation
        scalars[index, 2 * ERROR_STATES + 1] = expected
        nis += innovation * innovation / expected
    inject(row, error)
    return nis


@njit(cache=True)
def told(vector: tuple[float, float, float], variance: float) -> float:
    """Share of a motion (3,) that is told from the error of its estimate, of that total variance.

    An error of the velocity, taken for motion, would seem to tell the delay of a vehicle that stands still.
    """
    square = vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2
    return square / (square + _SIGNIFICANCE * variance) if square > 0.0 else 0.0


@njit(cache=True)
def _left_out(covariance: Array, variance: float, curvature: float) -> float:
    """Variance of what a linear model leaves out while the delay is uncertain, to second order.

    The delay multiplies a motion that is itself uncertain, by `variance`, and that changes with `curvature`.
    """
    delay: float = covariance[DELAY, DELAY]
    return delay * variance + 0.5 * (delay * curvature) ** 2


@njit(cache=True)
def _variance(row: Array, first: int) -> float:
    """Total variance of three error states."""
    covariance = covariance_of(row)
    total: float = (
        covariance[first, first] + covariance[first + 1, first + 1] + covariance[first + 2, first + 2]
    )
    return total


@njit(cache=True)
def _pose(
    row: Array, noise: Noise, lag: float, value: Array, residual: Array, left_out: Array, by: Array
) -> int:
    """Residual (6,), variance that the linear model leaves out (6,) and Jacobian (6, 16) of a pose."""
    position, velocity = row[_POSITION], row[_VELOCITY]
    rates = _corrected(row, _RATES.start, _GYRO_BIAS.start)
    moving = told((velocity[0], velocity[1], velocity[2]), _variance(row, VELOCITY.start))
    turning = told(rates, 3.0 * noise.rates + _variance(row, GYRO_BIAS.start))
    for axis in range(3):
        residual[axis] = value[axis] - position[axis] - lag * velocity[axis]
        by[axis, axis] = 1.0
        by[axis, 3 + axis] = lag
        by[axis, DELAY] = -moving * velocity[axis]
    acceleration = world_acceleration(row, noise.gravity)
    covariance = covariance_of(row)
    for axis in range(3):
        of_velocity, of_bias = covariance[3 + axis, 3 + axis], covariance[9 + axis, 9 + axis]
        left_out[axis] = _left_out(covariance, of_velocity, acceleration[axis])
        left_out[axis] += covariance[3 + axis, DELAY] ** 2
        left_out[3 + axis] = _left_out(covariance, noise.rates + of_bias, ANGULAR_ACCELERATION)
    turned = rotations.product(
        row[_ATTITUDE], rotations.from_rotation_vector((lag * rates[0], lag * rates[1], lag * rates[2]))
    )
    turn = rotations.to_rotation_vector(
        rotations.product(rotations.inverse(turned), rotations.normalised(value[3:7]))
    )
    for axis in range(3):
        residual[3 + axis] = turn[axis]
        by[3 + axis, 6 + axis] = 1.0
        by[3 + axis, DELAY] = -turning * rates[axis]
    return 6


@njit(cache=True)
def _velocity(
    row: Array,
    noise: Noise,
    body: bool,
    lag: float,
    value: Array,
    residual: Array,
    left_out: Array,
    by: Array,
) -> int:
    """Residual (3,), variance that the linear model leaves out (3,) and Jacobian (3, 16) of a velocity."""
    velocity = row[_VELOCITY]
    acceleration = world_acceleration(row, noise.gravity)
    uncertain = 3.0 * noise.force + _variance(row, ACCELEROMETER_BIAS.start)
    uncertain += noise.gravity**2 * _variance(row, ATTITUDE.start)
    for axis in range(3):
        left_out[axis] = _left_out(covariance_of(row), uncertain / 3.0, _JERK)
    pushed = told(acceleration, uncertain)
    if not body:
        for axis in range(3):
            residual[axis] = value[axis] - velocity[axis] - lag * acceleration[axis]
            by[axis, 3 + axis] = 1.0
            by[axis, DELAY] = -pushed * acceleration[axis]
        return 3
    rotation = rotations.matrix(row[_ATTITUDE])
    rates = _corrected(row, _RATES.start, _GYRO_BIAS.start)
    u = _into_body(rotation, (velocity[0], velocity[1], velocity[2]))
    a = _into_body(rotation, acceleration)
    slope = (
        a[0] - rates[1] * u[2] + rates[2] * u[1],
        a[1] - rates[2] * u[0] + rates[0] * u[2],
        a[2] - rates[0] * u[1] + rates[1] * u[0],
    )
    pushed = told(slope, uncertain)
    for axis in range(3):
        residual[axis] = value[axis] - u[axis] - lag * slope[axis]
        for column in range(3):
            by[axis, 3 + column] = rotation[column, axis]
        by[axis, DELAY] = -pushed * slope[axis]
    # Rᵀ δv + u × δθ, with attitude errors in body axes.
    by[0, 7], by[0, 8] = -u[2], u[1]
    by[1, 6], by[1, 8] = u[2], -u[0]
    by[2, 6], by[2, 7] = -u[1], u[0]
    return 3


@njit(cache=True)
def _into_body(rotation: Array, world: tuple[float, float, float]) -> tuple[float, float, float]:
    return (
        rotation[0, 0] * world[0] + rotation[1, 0] * world[1] + rotation[2, 0] * world[2],
        rotation[0, 1] * world[0] + rotation[1, 1] * world[1] + rotation[2, 1] * world[2],
        rotation[0, 2] * world[0] + rotation[1, 2] * world[1] + rotation[2, 2] * world[2],
    )


@njit(cache=True)
def _corrected(row: Array, sample: int, bias: int) -> tuple[float, float, float]:
    """Three numbers of the IMU sample less their biases."""
    return row[sample] - row[bias], row[sample + 1] - row[bias + 1], row[sample + 2] - row[bias + 2]


@njit(cache=True)
def world_acceleration(row: Array, gravity: float) -> tuple[float, float, float]:
    """Acceleration (3,) m/s² over ground, in the world, of an estimate with its IMU sample."""
    f0, f1, f2 = _corrected(row, _FORCE.start, _ACCELEROMETER_BIAS.start)
    rotation = rotations.matrix(row[_ATTITUDE])
    return (
        rotation[0, 0] * f0 + rotation[0, 1] * f1 + rotation[0, 2] * f2,
        rotation[1, 0] * f0 + rotation[1, 1] * f1 + rotation[1, 2] * f2,
        rotation[2, 0] * f0 + rotation[2, 1] * f1 + rotation[2, 2] * f2 + gravity,
    )


@njit(cache=True)
def widening(row: Array, noise: Noise, kind: int, value: Array, widened: Array) -> None:
    """Variances (4,) of position, velocity, attitude and delay by which a measurement is off an estimate.

    Motion capture that began anew elsewhere, a step of its delay or a swapped marker all show as residuals of
    position and attitude: each may be the cause, and with room for all of them the filter finds out which.
    """
    velocity = row[_VELOCITY]
    speed2 = velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2
    widened[0], widened[1], widened[2] = 0.0, 0.0, 0.0
    widened[3] = noise.delay_prior
    if kind != POSE:
        off2 = 0.0
        for axis in range(3):
            off2 += (value[axis] - velocity[axis]) ** 2
        widened[1] = off2 if kind == WORLD_VELOCITY else max(off2, 4.0 * speed2)
        widened[2] = 0.25
        return
    off2 = 0.0
    for axis in range(3):
        off2 += (value[axis] - row[_POSITION.start + axis]) ** 2
    turn = rotations.to_rotation_vector(
        rotations.product(rotations.inverse(row[_ATTITUDE]), rotations.normalised(value[3:7]))
    )
    turn2 = turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2
    widened[0] = off2
    widened[1] = 1.0 + speed2 * min(turn2, 4.0)
    widened[2] = turn2 + noise.attitude


@njit(cache=True)
def widen(row: Array, widened: Array) -> None:
    """Add variances (4,) of position, velocity, attitude and delay to the covariance of an estimate."""
    covariance = covariance_of(row)
    for axis in range(3):
        covariance[axis, axis] += widened[0]
        covariance[3 + axis, 3 + axis] += widened[1]
        covariance[6 + axis, 6 + axis] += widened[2]
    covariance[DELAY, DELAY] += widened[3]


@njit(cache=True)
def same_motion(kind: int, first: Array, second: Array, elapsed: float, row: Array, noise: Noise) -> bool:
    """Whether a vehicle that moves as estimated could be measured as `first`, `elapsed` s later as `second`.

    The margins leave room for an estimate that is far off: spikes and flickering markers are farther apart.
    """
    if elapsed > 0.5:
        return False
    apart = np.sqrt((second[0] - first[0]) ** 2 + (second[1] - first[1]) ** 2 + (second[2] - first[2]) ** 2)
    rates = _corrected(row, _RATES.start, _GYRO_BIAS.start)
    rate = np.sqrt(rates[0] ** 2 + rates[1] ** 2 + rates[2] ** 2)
    velocity = row[_VELOCITY]
    speed = np.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    if kind != POSE:
        force = row[_FORCE]
        push = np.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
        return bool(apart <= 9.0 * np.sqrt(noise.velocity) + (10.0 + push + rate * speed) * elapsed)
    turn = rotations.to_rotation_vector(
        rotations.product(
            rotations.inverse(rotations.normalised(first[3:7])), rotations.normalised(second[3:7])
        )
    )
    angle = np.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    near = apart <= 9.0 * np.sqrt(noise.position) + (3.0 + 1.5 * speed) * elapsed
    alike = angle <= 9.0 * np.sqrt(noise.attitude) + (3.0 + 1.5 * rate) * elapsed
    return bool(near and alike)


@njit(cache=True)
def moves(row: Array, noise: Noise, kind: int, elapsed: float) -> bool:
    """Whether the estimate moves in `elapsed` s by more than motion capture's noise could hide."""
    if kind != POSE:
        a0, a1, a2 = world_acceleration(row, noise.gravity)
        return bool(elapsed * np.sqrt(a0 * a0 + a1 * a1 + a2 * a2) > 4.0 * np.sqrt(noise.velocity))
    velocity = row[_VELOCITY]
    speed = np.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    rates = _corrected(row, _RATES.start, _GYRO_BIAS.start)
    rate = np.sqrt(rates[0] ** 2 + rates[1] ** 2 + rates[2] ** 2)
    return bool(
        elapsed * speed > 4.0 * np.sqrt(noise.position) or elapsed * rate > 4.0 * np.sqrt(noise.attitude)
    )
