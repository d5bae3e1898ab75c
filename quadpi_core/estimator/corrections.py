# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What motion capture measures of an estimate, and how a measurement corrects it.

The delay of motion capture is estimated with the state, after Li and Mourikis, "Online temporal calibration
for camera-IMU systems" (2014): a delay that is longer by δ lets a pose show where the vehicle was δ earlier.
"""

from __future__ import annotations

import numpy as np

from quadpi_core import rotations
from quadpi_core.compiled import njit
from quadpi_core.estimator.filter_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    DELAY,
    ERROR_STATES,
    GYRO_BIAS,
    POSE,
    VELOCITY,
    WORLD_VELOCITY,
    Estimate,
    Measurement,
    Noise,
    Widening,
)
from quadpi_core.estimator.propagate import Vector, correct_scalar, inject, minus
from quadpi_core.frames import Array
from quadpi_core.records import Records

# Chi-square quantiles at 0.9999 of the six numbers of a pose and the three of a velocity.
POSE_GATE = 27.856
VELOCITY_GATE = 21.108
# How fast body rates change in flight [rad/s²]: the second-order effect of a wrong delay on an attitude.
ANGULAR_ACCELERATION = 20.0
# How fast accelerations change [m/s³]: its second-order effect on a velocity.
_JERK = 20.0
# Weight of the variance of a motion estimate in its significance: three standard deviations count half.
_SIGNIFICANCE = 9.0
# Two rejected measurements agree if they are apart by no more than noise and a plausible motion explain: a
# vehicle whose estimate is off by this speed [m/s] and rate [rad/s], or acceleration [m/s²]. Spikes and
# flickering markers are farther apart.
_AGREE_STDS, _AGREE_LATEST_S = 9.0, 0.5
_AGREE_SPEED_M_S, _AGREE_RATE_RAD_S, _AGREE_FACTOR, _AGREE_ACCELERATION_M_S2 = 3.0, 3.0, 1.5, 10.0
# A motion shows if it is beyond this many standard deviations of the measurement's noise.
_SHOWS_STDS = 4.0


@njit(cache=True)
def taken_ns(estimate: Estimate, measurement: Measurement) -> int:
    """Stamp of the instant at which a measurement was taken, by the delay of an estimate."""
    return measurement.time_ns - round(1e9 * estimate.delay)


@njit(cache=True)
def fuse(estimate: Estimate, noise: Noise, measurement: Measurement, scalars: Records) -> float:
    """Correct an estimate by a pose or a velocity, one scalar at a time.

    The measurement was taken earlier than it is stamped, by the delay of this estimate and of no other:
    innovations that did not feel the delay that they correct would let it run away, from no more than
    rounding. What lies between the estimate's instant and that one, where the measurement precedes a
    correction already made or follows the newest IMU sample, is the estimate's own motion.

    Args:
        estimate: updated; its IMU sample is that of its instant.
        noise: of the sensors.
        measurement: to be fused.
        scalars: (6,) :class:`Scalar`, filled for the smoother.

    Returns:
        The squared innovation in units of its covariance, chi-square of 6 or 3 degrees of freedom.
    """
    for index in range(len(scalars)):
        for column in range(ERROR_STATES):
            scalars[index].jacobian[column] = 0.0
    lag = 1e-9 * (taken_ns(estimate, measurement) - estimate.time_ns)
    if measurement.kind == POSE:
        count = 6
        _linearise_pose(estimate, noise, measurement, lag, scalars)
    else:
        count = 3
        _linearise_velocity(estimate, noise, measurement, lag, scalars)
    error = np.zeros(ERROR_STATES)
    nis = 0.0
    for index in range(count):
        scalar = scalars[index]
        correct_scalar(estimate.covariance, error, scalar)
        nis += scalar.innovation * scalar.innovation / scalar.innovation_variance
    inject(estimate, error)
    return nis


@njit(cache=True)
def significance(motion: Vector, variance: float) -> float:
    """Significance of a motion estimate: |v|² / (|v|² + k · variance), near 0 within its own error.

    It scales how far a motion tells the delay: else the error of the velocity of a vehicle at rest would.
    """
    square = motion[0] ** 2 + motion[1] ** 2 + motion[2] ** 2
    return square / (square + _SIGNIFICANCE * variance) if square > 0.0 else 0.0


@njit(cache=True)
def _delay_variance(covariance: Array, variance: float, curvature: float) -> float:
    """Variance that a model linear in the delay leaves out, to second order.

    The delay multiplies a motion that is itself uncertain, by `variance`, and that changes with `curvature`.
    """
    delay: float = covariance[DELAY, DELAY]
    return delay * variance + 0.5 * (delay * curvature) ** 2


@njit(cache=True)
def _total_variance(covariance: Array, first: int) -> float:
    """Total variance of three error states."""
    total: float = (
        covariance[first, first] + covariance[first + 1, first + 1] + covariance[first + 2, first + 2]
    )
    return total


@njit(cache=True)
def _linearise_pose(
    estimate: Estimate, noise: Noise, measurement: Measurement, lag: float, scalars: Records
) -> None:
    """Fill the residual, Jacobian and variance of three scalars of position and three of attitude."""
    position, velocity, covariance = estimate.position, estimate.velocity, estimate.covariance
    rates = minus(estimate.rates, estimate.gyro_bias, 1.0)
    moving = significance(
        (velocity[0], velocity[1], velocity[2]), _total_variance(covariance, VELOCITY.start)
    )
    turning = significance(rates, 3.0 * noise.rates + _total_variance(covariance, GYRO_BIAS.start))
    acceleration = world_acceleration(estimate, noise.gravity)
    turned = rotations.product(
        estimate.attitude, rotations.from_rotation_vector((lag * rates[0], lag * rates[1], lag * rates[2]))
    )
    turn = _turn_from(turned, measurement.attitude)
    for axis in range(3):
        scalar = scalars[axis]
        scalar.residual = measurement.vector[axis] - position[axis] - lag * velocity[axis]
        scalar.jacobian[axis] = 1.0
        scalar.jacobian[3 + axis] = lag
        scalar.jacobian[DELAY] = -moving * velocity[axis]
        left_out = _delay_variance(covariance, covariance[3 + axis, 3 + axis], acceleration[axis])
        left_out += covariance[3 + axis, DELAY] ** 2
        scalar.variance = noise.position + left_out
    for axis in range(3):
        scalar = scalars[3 + axis]
        scalar.residual = turn[axis]
        scalar.jacobian[6 + axis] = 1.0
        scalar.jacobian[DELAY] = -turning * rates[axis]
        scalar.variance = noise.attitude + _delay_variance(
            covariance, noise.rates + covariance[9 + axis, 9 + axis], ANGULAR_ACCELERATION
        )


@njit(cache=True)
def _linearise_velocity(
    estimate: Estimate, noise: Noise, measurement: Measurement, lag: float, scalars: Records
) -> None:
    """Fill the residual, Jacobian and variance of three scalars of a velocity."""
    velocity, covariance = estimate.velocity, estimate.covariance
    acceleration = world_acceleration(estimate, noise.gravity)
    uncertain = 3.0 * noise.specific_force + _total_variance(covariance, ACCELEROMETER_BIAS.start)
    uncertain += noise.gravity**2 * _total_variance(covariance, ATTITUDE.start)
    for axis in range(3):
        scalars[axis].variance = noise.velocity + _delay_variance(covariance, uncertain / 3.0, _JERK)
    if measurement.kind == WORLD_VELOCITY:
        accelerating = significance(acceleration, uncertain)
        for axis in range(3):
            scalar = scalars[axis]
            scalar.residual = measurement.vector[axis] - velocity[axis] - lag * acceleration[axis]
            scalar.jacobian[3 + axis] = 1.0
            scalar.jacobian[DELAY] = -accelerating * acceleration[axis]
        return
    rotation = rotations.matrix(estimate.attitude)
    rates = minus(estimate.rates, estimate.gyro_bias, 1.0)
    u = _into_body(rotation, (velocity[0], velocity[1], velocity[2]))
    a = _into_body(rotation, acceleration)
    slope = (
        a[0] - rates[1] * u[2] + rates[2] * u[1],
        a[1] - rates[2] * u[0] + rates[0] * u[2],
        a[2] - rates[0] * u[1] + rates[1] * u[0],
    )
    accelerating = significance(slope, uncertain)
    for axis in range(3):
        scalar = scalars[axis]
        scalar.residual = measurement.vector[axis] - u[axis] - lag * slope[axis]
        for column in range(3):
            scalar.jacobian[3 + column] = rotation[column, axis]
        scalar.jacobian[DELAY] = -accelerating * slope[axis]
    # Rᵀ δv + u × δθ, with attitude errors in body axes.
    x, y, z = scalars[0].jacobian, scalars[1].jacobian, scalars[2].jacobian
    x[7], x[8] = -u[2], u[1]
    y[6], y[8] = u[2], -u[0]
    z[6], z[7] = -u[1], u[0]


@njit(cache=True)
def _into_body(rotation: Array, world: Vector) -> Vector:
    """A vector of the world in body axes."""
    return (
        rotation[0, 0] * world[0] + rotation[1, 0] * world[1] + rotation[2, 0] * world[2],
        rotation[0, 1] * world[0] + rotation[1, 1] * world[1] + rotation[2, 1] * world[2],
        rotation[0, 2] * world[0] + rotation[1, 2] * world[1] + rotation[2, 2] * world[2],
    )


@njit(cache=True)
def _turn_from(attitude: Array | rotations.Quaternion, measured: Array) -> Vector:
    """Rotation vector [rad] from an attitude to a measured one of any norm and sign, body axes."""
    return rotations.to_rotation_vector(
        rotations.product(rotations.inverse(attitude), rotations.normalised(measured))
    )


@njit(cache=True)
def world_acceleration(estimate: Estimate, gravity: float) -> Vector:
    """Acceleration m/s² over ground, in the world, of an estimate with its IMU sample."""
    f0, f1, f2 = minus(estimate.specific_force, estimate.accelerometer_bias, 1.0)
    rotation = rotations.matrix(estimate.attitude)
    return (
        rotation[0, 0] * f0 + rotation[0, 1] * f1 + rotation[0, 2] * f2,
        rotation[1, 0] * f0 + rotation[1, 1] * f1 + rotation[1, 2] * f2,
        rotation[2, 0] * f0 + rotation[2, 1] * f1 + rotation[2, 2] * f2 + gravity,
    )


@njit(cache=True)
def fill_widening(widening: Widening, estimate: Estimate, noise: Noise, measurement: Measurement) -> None:
    """Fill the variances that let an estimate follow a measurement beyond its gate.

    Motion capture that restarted elsewhere, a step of its delay or a swapped marker all show as residuals of
    position and attitude: each may be the cause, and with room for all of them the filter finds out which.
    """
    velocity = estimate.velocity
    speed2 = velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2
    widening.delay = noise.delay_prior
    if measurement.kind != POSE:
        off2 = _distance2(measurement.vector, velocity)
        widening.position = 0.0
        widening.velocity = off2 if measurement.kind == WORLD_VELOCITY else max(off2, 4.0 * speed2)
        widening.attitude = 0.25
        return
    turn = _turn_from(estimate.attitude, measurement.attitude)
    turn2 = turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2
    widening.position = _distance2(measurement.vector, estimate.position)
    widening.velocity = 1.0 + speed2 * min(turn2, 4.0)
    widening.attitude = turn2 + noise.attitude


@njit(cache=True)
def _distance2(first: Array, second: Array) -> float:
    """Squared distance of two vectors (3,)."""
    total = 0.0
    for axis in range(3):
        total += (first[axis] - second[axis]) ** 2
    return total


@njit(cache=True)
def widen(estimate: Estimate, widening: Widening) -> None:
    """Add variances of position, velocity, attitude and delay to the covariance of an estimate."""
    covariance = estimate.covariance
    for axis in range(3):
        covariance[axis, axis] += widening.position
        covariance[3 + axis, 3 + axis] += widening.velocity
        covariance[6 + axis, 6 + axis] += widening.attitude
    covariance[DELAY, DELAY] += widening.delay


@njit(cache=True)
def same_motion(first: Measurement, second: Measurement, estimate: Estimate, noise: Noise) -> bool:
    """Whether two measurements of one kind can be of one vehicle that moves roughly as estimated."""
    elapsed = 1e-9 * (second.time_ns - first.time_ns)
    if elapsed > _AGREE_LATEST_S:
        return False
    x, y, z = minus(second.vector, first.vector, 1.0)
    apart = np.sqrt(x**2 + y**2 + z**2)
    rate, speed = _turning_speed(estimate), _length(estimate.velocity)
    if second.kind != POSE:
        acceleration = _AGREE_ACCELERATION_M_S2 + _length(estimate.specific_force) + rate * speed
        return bool(apart <= _AGREE_STDS * np.sqrt(noise.velocity) + acceleration * elapsed)
    turn = _turn_from(rotations.normalised(first.attitude), second.attitude)
    angle = np.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    near = (
        apart <= _AGREE_STDS * np.sqrt(noise.position) + (_AGREE_SPEED_M_S + _AGREE_FACTOR * speed) * elapsed
    )
    alike = (
        angle <= _AGREE_STDS * np.sqrt(noise.attitude) + (_AGREE_RATE_RAD_S + _AGREE_FACTOR * rate) * elapsed
    )
    return bool(near and alike)


@njit(cache=True)
def motion_shows(estimate: Estimate, noise: Noise, kind: int, elapsed: float) -> bool:
    """Whether the estimate moves in `elapsed` s by more than the noise of a measurement could hide."""
    if kind != POSE:
        a0, a1, a2 = world_acceleration(estimate, noise.gravity)
        acceleration = np.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
        return bool(elapsed * acceleration > _SHOWS_STDS * np.sqrt(noise.velocity))
    return bool(
        elapsed * _length(estimate.velocity) > _SHOWS_STDS * np.sqrt(noise.position)
        or elapsed * _turning_speed(estimate) > _SHOWS_STDS * np.sqrt(noise.attitude)
    )


@njit(cache=True)
def _turning_speed(estimate: Estimate) -> float:
    """Magnitude [rad/s] of the body rates."""
    p, q, r = minus(estimate.rates, estimate.gyro_bias, 1.0)
    return float(np.sqrt(p**2 + q**2 + r**2))


@njit(cache=True)
def _length(vector: Array) -> float:
    """Length of a vector (3,)."""
    return float(np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2))
