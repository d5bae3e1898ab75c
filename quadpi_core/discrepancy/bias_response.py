# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Response of the estimated IMU biases to systematic errors of the IMU.

An IMU that is turned or displaced reports rates and forces that motion capture contradicts. The smoother
absorbs the slow part of that error in its biases; the flight keeps the rest. Which part is slow depends on
the noise in the vehicle file and on the flight: a wrong rate tilts the attitude, and a tilt looks like a
force.

To first order this is a least-squares problem in the error state of the EKF, linear in the error of the IMU,
so one factorisation per flight serves every error. It is solved in steps of STEP_S, short beside
the seconds over which biases change.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from quadpi_core.estimator.corrections import ANGULAR_ACCELERATION, significance
from quadpi_core.estimator.filter_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    DELAY,
    ERROR_STATES,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    Noise,
    assumed_noise,
)
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.rotations import rotation_matrix
from quadpi_core.signals.resample import interpolate_columns
from quadpi_core.vehicle import Vehicle

STEP_S = 0.04
# Assumed rate of poses, which a flight does not record; twice or half of it changes the biases by a tenth.
MOCAP_HZ = 120.0
# Standard deviation of the EKF's velocity once it has converged.
_VELOCITY_STD_M_S = 0.01
# Priors far wider than any bias: they only keep a flight of a few samples solvable.
_GYRO_BIAS_STD_RAD_S, _ACCELEROMETER_BIAS_STD_M_S2 = 1.0, 10.0
# Smallest random walk of a bias: less is negligible over a flight, and would make the equations singular.
_LEAST_WALK = 1e-5
# Standard deviation and random walk of a delay that is known.
_EXACT_S = 1e-6


class BiasResponse:
    """Biases that the smoother estimates from errors of the IMU over one flight.

    Args:
        flight: estimated flight.
        vehicle: vehicle with the noise of its sensors, and gravity.
        imu_rate_hz: rate of the IMU, which its noise refers to; the flight may have been thinned.
    """

    def __init__(self, flight: Flight, vehicle: Vehicle, imu_rate_hz: float) -> None:
        self._flight = flight
        self._noise: Noise = assumed_noise(vehicle, imu_rate_hz).view(np.recarray)[0]
        self._samples = max(1, round(STEP_S * flight.rate_hz))
        self._steps = max(1, len(flight) // self._samples)
        self._dt = self._samples / flight.rate_hz

    def __call__(self, rates: Array, force: Array) -> tuple[Array, Array]:
        """Biases of gyro and accelerometer, (N, 3) each.

        Args:
            rates: (N, 3) rad/s, reported less true.
            force: (N, 3) m/s², specific force reported less true.
        """
        moved = np.zeros((self._steps, ERROR_STATES))
        moved[:, ATTITUDE] = self._dt * self._means(rates)
        moved[:, VELOCITY] = self._dt * self._into_world(self._means(force))
        moved[:, POSITION] = 0.5 * self._dt * moved[:, VELOCITY]
        weighted = moved @ self._information
        right = np.zeros((self._steps + 1, ERROR_STATES))
        right[1:] = weighted
        right[:-1] -= np.einsum("nji,nj->ni", self._transition, weighted)
        factor, scale = self._factor
        errors = cho_solve_banded((factor, True), (right * scale).ravel(), check_finite=False)
        errors = errors.reshape(right.shape) * scale
        return self._at_samples(errors[:, GYRO_BIAS]), self._at_samples(errors[:, ACCELEROMETER_BIAS])

    @cached_property
    def _rotation(self) -> Array:
        """Body to world (K, 3, 3), in the middle of each step."""
        middle = np.arange(self._steps) * self._samples + self._samples // 2
        return rotation_matrix(self._flight.attitude[np.minimum(middle, len(self._flight) - 1)])

    @cached_property
    def _transition(self) -> Array:
        """Of errors over each step (K, 16, 16): estimated less true, attitude in body axes."""
        dt, identity = self._dt, np.eye(3)
        transition = np.tile(np.eye(ERROR_STATES), (self._steps, 1, 1))
        tilted = -self._rotation @ _cross(self._means(self._flight.specific_force))
        turn = dt * self._means(self._flight.rates)
        angle = np.linalg.norm(turn, axis=1)[:, None, None]
        about = _cross(turn)
        # Rodrigues; numpy's sinc is of π x.
        back = identity - np.sinc(angle / np.pi) * about
        back += 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * about @ about
        transition[:, POSITION, VELOCITY] = dt * identity
        transition[:, ATTITUDE, ATTITUDE] = back
        transition[:, ATTITUDE, GYRO_BIAS] = -dt * identity
        for to, time in ((VELOCITY, dt), (POSITION, 0.5 * dt**2)):
            transition[:, to, ATTITUDE] = time * tilted
            transition[:, to, ACCELEROMETER_BIAS] = -time * self._rotation
        return transition

    @cached_property
    def _wander(self) -> Array:
        """Covariance (16, 16) that a step adds."""
        dt, noise = self._dt, self._noise
        diagonal = np.zeros(ERROR_STATES)
        diagonal[POSITION] = noise.accelerometer * dt**3 / 3.0
        diagonal[VELOCITY] = noise.accelerometer * dt
        diagonal[ATTITUDE] = noise.gyro * dt
        diagonal[GYRO_BIAS] = max(noise.gyro_bias, _LEAST_WALK**2) * dt
        diagonal[ACCELEROMETER_BIAS] = max(noise.accelerometer_bias, _LEAST_WALK**2) * dt
        diagonal[DELAY] = max(noise.delay, _EXACT_S**2) * dt
        wander = np.diag(diagonal)
        wander[POSITION, VELOCITY] = wander[VELOCITY, POSITION] = (
            0.5 * noise.accelerometer * dt**2 * np.eye(3)
        )
        return wander

    @cached_property
    def _information(self) -> Array:
        """Of a step (16, 16)."""
        return np.asarray(np.linalg.inv(self._wander), dtype=np.float64)

    def _seen(self) -> Array:
        """Information (K + 1, 16, 16) that motion capture gives of the errors at each step."""
        noise, poses = self._noise, MOCAP_HZ * self._dt
        velocity, rates = self._means(self._flight.velocity), self._means(self._flight.rates)
        acceleration = self._into_world(self._means(self._flight.specific_force))
        acceleration[:, 2] += noise.gravity
        # As in the EKF: an uncertain delay widens a pose, and motion well above its own noise observes it.
        pushed = np.square(acceleration).sum(axis=1) / 3.0
        moving, turning = (
            _significant_squares(velocity, _VELOCITY_STD_M_S**2),
            _significant_squares(rates, noise.rates),
        )
        weight = np.zeros((self._steps + 1, ERROR_STATES))
        delay = known = max(noise.delay_prior, _EXACT_S**2)
        for step in range(self._steps):
            position = poses / (noise.position + 0.5 * delay**2 * pushed[step])
            attitude = poses / (noise.attitude + 0.5 * (delay * ANGULAR_ACCELERATION) ** 2)
            weight[step, POSITION], weight[step, ATTITUDE] = position, attitude
            delay = 1.0 / (1.0 / delay + position * moving[step] + attitude * turning[step])
        weight[-1] = weight[-2]
        by_delay = np.zeros_like(weight)
        by_delay[:-1, POSITION] = -self._into_world(velocity)
        by_delay[:-1, ATTITUDE] = -rates
        by_delay[-1] = by_delay[-2]
        jacobian = np.tile(np.eye(ERROR_STATES), (self._steps + 1, 1, 1))
        jacobian[:, :, DELAY] = by_delay
        information: Array = np.swapaxes(jacobian, 1, 2) @ (weight[:, :, None] * jacobian)
        before = np.zeros(ERROR_STATES)
        before[GYRO_BIAS] = _GYRO_BIAS_STD_RAD_S**-2
        before[ACCELEROMETER_BIAS] = _ACCELEROMETER_BIAS_STD_M_S2**-2
        before[DELAY] = 1.0 / known
        information[0] += np.diag(before)
        return information

    @cached_property
    def _factor(self) -> tuple[Array, Array]:
        """Banded Cholesky factor of the normal equations in units (16,), which come second."""
        weighted = self._information @ self._transition
        diagonal, below = self._seen(), -weighted
        diagonal[:-1] += np.swapaxes(self._transition, 1, 2) @ weighted
        diagonal[1:] += self._information
        # Metres, radians and biases differ by orders of magnitude.
        scale = np.sqrt(np.diag(self._wander))
        units = np.outer(scale, scale)
        diagonal, below = diagonal * units, below * units
        banded = np.zeros((2 * ERROR_STATES, ERROR_STATES * (self._steps + 1)))
        for row in range(ERROR_STATES):
            for column in range(ERROR_STATES):
                if row >= column:
                    banded[row - column, column::ERROR_STATES] = diagonal[:, row, column]
                distant = ERROR_STATES + row - column
                banded[distant, column:-ERROR_STATES:ERROR_STATES] = below[:, row, column]
        return cholesky_banded(banded, lower=True, check_finite=False), scale

    def _into_world(self, values: Array) -> Array:
        """Body vectors (K, 3) of each step in the world."""
        rotated: Array = np.einsum("nij,nj->ni", self._rotation, values)
        return rotated

    def _means(self, values: Array) -> Array:
        """Of values (N, 3) over each step (K, 3)."""
        used = values[: self._steps * self._samples]
        means: Array = used.reshape(self._steps, -1, 3).mean(axis=1)
        return means

    def _at_samples(self, values: Array) -> Array:
        """Values (K + 1, 3) at the ends of steps, at each sample (N, 3)."""
        time = self._flight.time - self._flight.time[0]
        ends: Array = self._dt * np.arange(self._steps + 1, dtype=np.float64)
        return interpolate_columns(ends, values, time)


def _significant_squares(motion: Array, variance: float) -> Array:
    """Squares (K,) of the significant part of motions (K, 3) with that variance in each component."""
    shares = np.array([significance((x, y, z), 3.0 * variance) for x, y, z in motion])
    squares: Array = np.square(motion * shares[:, None]).sum(axis=1)
    return squares


def _cross(vectors: Array) -> Array:
    """Matrices (K, 3, 3) that multiply as the cross products with vectors (K, 3) from the left."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
