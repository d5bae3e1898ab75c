# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""States along a flight that nothing measures: the biases of the estimator, and the swing of a slung load.

Both are the most probable ones, by least squares with a normal prior.
"""

from __future__ import annotations

from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve_banded, cholesky_banded

from quadpi_core.core import compiled
from quadpi_core.estimator.filter_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    DELAY,
    ERROR_STATES,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    assumed_noise,
)
from quadpi_core.flight import Flight
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.records import CONVENTION, Records, Threshold
from quadpi_core.signals.chain import interpolate_columns
from quadpi_core.simulation.applied_effects import remembered_wrenches
from quadpi_core.simulation.effect_definition import Effect
from quadpi_core.simulation.state_records import MEMORY
from quadpi_core.vehicle import Vehicle

STEP_S = 0.04
# Assumed rate of poses, which a flight does not record; twice or half of it changes the biases by a tenth.
MOCAP_HZ = 120.0
# Standard deviation of the EKF's velocity once it has converged.
_VELOCITY_STD_M_S = 0.01
# Priors [rad/s, m/s²] far wider than any bias: they only keep a flight of a few samples solvable.
_GYRO_BIAS_STD, _ACCELEROMETER_BIAS_STD = 1.0, 10.0
# Smallest random walk of a bias: less is negligible over a flight, and would make the equations singular.
_LEAST_WALK = 1e-5
# Standard deviation and random walk of a delay that is known.
_EXACT_S = 1e-6

SEEN_S = Threshold(
    "seconds of a flight from which the state at its start is estimated",
    20.0,
    "s",
    "several swings of any cable up to 5 m; a longer stretch would need the exact length of the cable",
    CONVENTION,
)
INDEPENDENT_HZ = Threshold(
    "independent samples of the residual while a start is estimated",
    5.0,
    "Hz",
    "what aerodynamics leave is correlated over some tenths of a second",
    CONVENTION,
)
STRETCHES_S = Threshold(
    "stretches of a flight from which the state at its start is estimated, one after the other",
    (2.5, 5.0, 10.0, SEEN_S.value),
    "s",
    "a swing or two of any cable up to 1.5 m; each is twice the one before, over which the phase is known",
    CONVENTION,
)
# States from which the first stretch is explained, rest and others, in prior deviations from it.
_FIRST_STATES = np.vstack((np.zeros(MEMORY), np.random.default_rng(0).standard_normal((4, MEMORY))))
# Rate [Hz] at which the state is followed while its start is sought, several tens of samples in a swing.
_RATE_HZ = 62.5
_ITERATIONS, _HALVINGS = 15, 5
# Matrices (3, 3, 3) of the cross products with the axes.
_CROSSED = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)
# Instead of a division by zero.
_TINY = 1e-30
# Iterations end when the state moves by less than this share of its prior deviation.
_SMALL = 1e-5
# Of the state, in prior deviations: a step for derivatives, and the longest of an iteration.
_STEP, _LONGEST = 1e-4, 1.0
# Derivatives are kept while each step is shorter than this share of the one before, and hold this far from
# where they were made.
_SHRINKING, _THERE = 0.1, 0.01
# Least and first size of the contribution while the state is sought, in sizes of the residual: without a
# contribution nothing tells of the state.
_WEAKEST, _FIRST = 0.05, 0.5


class BiasResponse:
    """Biases that the smoother estimates from errors of the IMU over one flight.

    An IMU that is turned or displaced reports rates and forces that motion capture contradicts. The smoother
    absorbs the slow part of that error in its biases; the flight keeps the rest. Which part is slow depends
    on the noise in the vehicle file and on the flight: a wrong rate tilts the attitude, and a tilt looks like
    a force.

    To first order this is a least-squares problem in the error state of the EKF, linear in the error of the
    IMU, so one factorisation per flight serves every error. It is solved in steps of STEP_S, short beside the
    seconds over which biases change.

    Args:
        flight: estimated flight.
        vehicle: vehicle with the noise of its sensors, and gravity.
        imu_rate_hz: rate of the IMU, which its noise refers to; the flight may have been thinned.
    """

    def __init__(self, flight: Flight, vehicle: Vehicle, imu_rate_hz: float) -> None:
        self._flight, self._noises = flight, assumed_noise(vehicle, imu_rate_hz)
        self._samples = max(1, round(STEP_S * flight.rate_hz))
        self._steps = max(1, len(flight) // self._samples)
        self._dt = self._samples / flight.rate_hz

    def __call__(self, rates: Array, force: Array) -> tuple[Array, Array]:
        """Biases of gyro and accelerometer, (N, 3) each.

        Args:
            rates: (N, 3) rad/s, reported less true.
            force: (N, 3) m/s², specific force reported less true.
        """
        rotation, transition, information, factor, scale = self._equations
        moved = np.zeros((self._steps, ERROR_STATES))
        moved[:, ATTITUDE] = self._dt * self._means(rates)
        moved[:, VELOCITY] = self._dt * _turned(rotation, self._means(force))
        moved[:, POSITION] = 0.5 * self._dt * moved[:, VELOCITY]
        right = np.zeros((self._steps + 1, ERROR_STATES))
        right[1:] = moved @ information
        right[:-1] -= np.einsum("nji,nj->ni", transition, right[1:].copy())
        errors = cho_solve_banded((factor, True), (right * scale).ravel(), check_finite=False)
        errors = errors.reshape(right.shape) * scale
        time, ends = self._flight.time - self._flight.time[0], self._dt * np.arange(self._steps + 1.0)
        gyro, accelerometer = errors[:, GYRO_BIAS], errors[:, ACCELEROMETER_BIAS]
        return interpolate_columns(ends, gyro, time), interpolate_columns(ends, accelerometer, time)

    @cached_property
    def _equations(self) -> tuple[Array, Array, Array, Array, Array]:
        """Normal equations of the errors (K + 1, 16) at the ends of steps.

        Returns:
            Rotation (K, 3, 3) to the world in each step, its transition (K, 16, 16), information (16, 16) of
            a step, banded Cholesky factor in units, and these (16,): metres and biases differ by orders.
        """
        flight, dt, noise = self._flight, self._dt, self._noises.view(np.recarray)[0]
        middle = np.arange(self._steps) * self._samples + self._samples // 2
        rotation = rotation_matrix(flight.attitude[np.minimum(middle, len(flight) - 1)])
        rates, force = self._means(flight.rates), self._means(flight.specific_force)
        transition = _transition(rotation, rates, force, dt)
        gyro, accelerometer = (
            max(walk, _LEAST_WALK**2) for walk in (noise.gyro_bias, noise.accelerometer_bias)
        )
        added = (noise.accelerometer * dt**2 / 3.0, noise.accelerometer, noise.gyro, gyro, accelerometer)
        wander = dt * np.diag([*np.repeat(added, 3), max(noise.delay, _EXACT_S**2)])
        wander[POSITION, VELOCITY] = wander[VELOCITY, POSITION] = (
            0.5 * noise.accelerometer * dt**2 * np.eye(3)
        )
        information = np.asarray(np.linalg.inv(wander), dtype=np.float64)
        below = -information @ transition
        diagonal = self._seen(rotation, rates, force)
        diagonal[:-1] -= np.swapaxes(transition, 1, 2) @ below
        diagonal[1:] += information

        scale: Array = np.sqrt(np.diag(wander))
        units = np.outer(scale, scale)
        bands = np.zeros((2 * ERROR_STATES, self._steps + 1, ERROR_STATES))
        row, column = np.tril_indices(ERROR_STATES)
        bands[row - column, :, column] = (diagonal * units)[:, row, column].T
        row, column = np.indices(units.shape).reshape(2, -1)
        bands[ERROR_STATES + row - column, :-1, column] = (below * units)[:, row, column].T
        factor = cholesky_banded(bands.reshape(len(bands), -1), lower=True, check_finite=False)
        return rotation, transition, information, factor, scale

    def _seen(self, rotation: Array, rates: Array, force: Array) -> Array:
        """Information (K + 1, 16, 16) of poses, and of the priors, about the errors at each step."""
        velocity, acceleration = self._means(self._flight.velocity), _turned(rotation, force)
        acceleration[:, 2] += self._noises["gravity"]
        poses = _pose_information(velocity, rates, acceleration, self._noises, MOCAP_HZ * self._dt)
        weight, by_delay = np.zeros((2, self._steps + 1, ERROR_STATES))
        weight[:-1, POSITION], weight[:-1, ATTITUDE] = poses[:, :1], poses[:, 1:]
        by_delay[:-1, POSITION], by_delay[:-1, ATTITUDE] = -_turned(rotation, velocity), -rates
        weight[-1], by_delay[-1] = weight[-2], by_delay[-2]
        information: Array = weight[:, :, None] * np.eye(ERROR_STATES)
        information[:, :, DELAY] = information[:, DELAY] = weight * by_delay
        information[:, DELAY, DELAY] = np.sum(weight * by_delay**2, axis=1)
        before = np.zeros(ERROR_STATES)
        before[GYRO_BIAS], before[ACCELEROMETER_BIAS] = _GYRO_BIAS_STD**-2, _ACCELEROMETER_BIAS_STD**-2
        before[DELAY] = 1.0 / max(float(self._noises["delay_prior"][0]), _EXACT_S**2)
        information[0] += np.diag(before)
        return information

    def _means(self, values: Array) -> Array:
        """Of values (N, 3) over each step (K, 3)."""
        used = values[: self._steps * self._samples]
        return used.reshape(self._steps, -1, 3).mean(axis=1)


def _transition(rotation: Array, rates: Array, force: Array, dt: float) -> Array:
    """Transition (K, 16, 16) of errors, estimated less true, attitude in body axes, over each step."""
    identity, about = np.eye(3), _cross(dt * rates)
    angle = dt * np.linalg.norm(rates, axis=1)[:, None, None]
    transition = np.tile(np.eye(ERROR_STATES), (len(rates), 1, 1))
    transition[:, POSITION, VELOCITY] = dt * identity
    # Rodrigues; numpy's sinc is of π x.
    transition[:, ATTITUDE, ATTITUDE] = (
        identity - np.sinc(angle / np.pi) * about + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * about @ about
    )
    transition[:, ATTITUDE, GYRO_BIAS] = -dt * identity
    for to, time in ((VELOCITY, dt), (POSITION, 0.5 * dt**2)):
        transition[:, to, ATTITUDE] = -time * rotation @ _cross(force)
        transition[:, to, ACCELEROMETER_BIAS] = -time * rotation
    return transition


def _pose_information(velocity: Array, rates: Array, pushed: Array, noises: Records, poses: float) -> Array:
    """Information (K, 2) that the poses of each step give of each position and attitude.

    As in the EKF: an uncertain delay widens a pose, and motion well above its own noise observes it.
    """
    found, limits = np.empty((len(rates), 2)), np.array([_EXACT_S**2, _VELOCITY_STD_M_S**2])
    steps = np.concatenate((velocity, rates, pushed), axis=1)
    compiled.pose_information(steps, noises, limits, poses, found)
    return found


def _turned(rotation: Array, values: Array) -> Array:
    return np.einsum("nij,nj->ni", rotation, values)


def _cross(vectors: Array) -> Array:
    """Matrices (K, 3, 3) that multiply as the cross products with vectors (K, 3) from the left."""
    return np.tensordot(vectors, _CROSSED, axes=1)


class OwnStates(NamedTuple):
    """States (N, 6) of an effect at times (N,) [s] of a flight."""

    time: Array
    memory: Array


class Started(NamedTuple):
    """The state of an effect at the start of a flight.

    Attributes:
        memory: (6,) the state.
        strength: value of the effect's first parameter that fits this flight, not negative.
        explained: share of the squares of the residual, mean removed, that the effect explains.
        cost: evidence [nat] that the freedom of the start takes from the effect.
        slopes: derivatives of its forces of unit strength; None at rest.
    """

    memory: Array
    strength: float
    explained: float
    cost: float
    slopes: Array | None = None


def started(
    effect: Effect,
    values: Array,
    states: npt.NDArray[np.void],
    vehicle: npt.NDArray[np.void],
    residual: Array,
    step_s: float,
    near: Started | None = None,
) -> Started:
    """Estimate the state of an effect at the start of a flight, such as the swing of a slung load.

    A recording begins in mid-air. The state is the most probable one given the residual: least squares with a
    normal prior, by Gauss-Newton. The strength of the effect, its first parameter, is free meanwhile, as the
    state does not depend on it.

    A swing has many optima, the more the longer it is seen. So the first seconds are explained first, from
    several states, then each longer stretch from there. A start that explains less beyond rest than its
    freedom costs is not used, but rest: a swing that was not found would tell of a load without mass.

    Args:
        effect: one with a state of its own.
        values: (P,) its parameters; the first is not used.
        states: (N,) of `state_records.STATE`, with the measured force.
        vehicle: (1,) of `state_records.VEHICLE`.
        residual: (N, 6) measured less simulated wrench, without the effect.
        step_s: seconds between the states.
        near: what was found for all but the same parameters, from which it is found at once.
    """
    stride = max(1, round(1.0 / (_RATE_HZ * step_s)))
    shown = [max(round(seconds / step_s), 2 * stride) for seconds in STRETCHES_S.value]
    needed = 1 + sum(samples < len(states) for samples in shown[:-1])
    stretches = [
        _Stretch(effect, values, states[:samples:stride], vehicle, residual[:samples:stride], stride * step_s)
        for samples in (shown[:needed] if near is None else shown[-1:])
    ]
    rest, last = np.asarray(effect.at_rest, dtype=float), stretches[-1]
    if near is not None:
        at = last.judged(near.memory, last.forces(near.memory[np.newaxis])[:, 0])
    else:
        firsts = rest + _FIRST_STATES * effect.start_spread
        at = max((stretches[0].fitted(first) for first in firsts), key=lambda one: one.explained)
        for stretch in stretches[1:]:
            at = stretch.fitted(at.memory)
    # What is explained is no noise: beside it, the prior would hold a wide swing near rest.
    at = last.fitted(at.memory, 1.0 - at.explained, near and near.slopes)
    resting = last.judged(rest, last.forces(rest[np.newaxis])[:, 0])
    return at if last.gain(at, resting) > at.cost else resting


class _Stretch:
    """The beginning of a flight, as forces that an effect of any strength is to explain.

    They are without their means, which a coefficient explains as well.
    """

    def __init__(
        self,
        effect: Effect,
        values: Array,
        states: npt.NDArray[np.void],
        vehicle: npt.NDArray[np.void],
        residual: Array,
        step_s: float,
    ) -> None:
        self._rest, self._spread = np.asarray(effect.at_rest, dtype=float), np.asarray(effect.start_spread)
        unit = dict(zip((p.name for p in effect.parameters), (1.0, *values[1:].tolist()), strict=True))
        self._wrenches = partial(
            remembered_wrenches, effect.name, unit, states.copy(), vehicle, step_s=step_s
        )
        self._target = _varying_forces(residual[:, :, np.newaxis])[:, 0]
        self._squares = max(float(self._target @ self._target), _TINY)
        self._independent = INDEPENDENT_HZ.value * step_s * len(self._target)

    def fitted(self, memory: Array, left: float = 1.0, slopes: Array | None = None) -> Started:
        """The most probable state near a first one (6,), beside noise of a share of the squares.

        Slopes (·, 6) that are known nearly serve as long as steps shrink fast, but not to the end.
        """
        anew, away = slopes is None, np.inf
        target, weight = self._target, self._independent / (self._squares * max(left, _TINY))

        def cost(strength: float, memory: Array, shape: Array) -> float:
            left, moved = target - strength * shape, (memory - self._rest) / self._spread
            return weight * float(left @ left) + float(moved @ moved)

        shape, size = self.forces(memory[np.newaxis])[:, 0], np.inf
        strength = _FIRST * self._ratio(shape)
        least = cost(strength, memory, shape)
        for _ in range(_ITERATIONS):
            if fresh := slopes is None:
                slopes, away = self._slopes(memory, shape), 0.0
            columns = np.column_stack((shape, slopes))
            # Strength and moved state are linear together: a c + J (a δ).
            precision = np.array([0.0] + MEMORY * [max(strength, _TINY) ** -2])
            prior = strength * precision[1:] * (self._rest - memory) / self._spread
            normal = weight * (columns.T @ columns) + np.diag(precision)
            solved = np.linalg.solve(normal, weight * (columns.T @ target) + np.array([0.0, *prior]))
            strength = max(float(solved[0]), _WEAKEST * self._ratio(shape))
            step = np.clip(solved[1:] / max(strength, _TINY), -_LONGEST, _LONGEST)
            for _ in range(_HALVINGS):
                moved = memory + step * self._spread
                there = self.forces(moved[np.newaxis])[:, 0]
                value = cost(strength, moved, there)
                if value <= least:
                    break
                step = 0.5 * step
            else:
                if fresh:
                    break
                slopes = None
                continue
            before, size = size, float(np.abs(step).max())
            memory, shape, least, away = moved, there, value, away + size
            if size < _SMALL and away < _THERE:
                break
            if anew or size < _SMALL or size > _SHRINKING * before:
                slopes, size = None, np.inf
        return self.judged(memory, shape, self._slopes(memory, shape) if slopes is None else slopes)

    def judged(self, memory: Array, shape: Array, slopes: Array | None = None) -> Started:
        """A state at the start (6,) by its forces of unit strength, and their derivatives if it was free."""
        strength = max(float(shape @ self._target) / max(float(shape @ shape), _TINY), 0.0)
        left = max(float(np.sum(np.square(self._target - strength * shape))), len(shape) * _TINY)
        cost = 0.0
        if slopes is not None:
            information = self._independent * strength**2 / left * (slopes.T @ slopes)
            cost = 0.5 * float(np.linalg.slogdet(np.eye(len(information)) + information)[1])
        return Started(memory, strength, 1.0 - left / self._squares, cost, slopes)

    def gain(self, one: Started, other: Started) -> float:
        """Evidence [nat] that one state gains over another, whose freedom is not counted."""
        left, more = (max(1.0 - start.explained, _TINY) for start in (one, other))
        return 0.5 * self._independent * float(np.log(more / left))

    def forces(self, starts: Array) -> Array:
        """Forces (·, K) of unit strength from states (K, 6) on."""
        return _varying_forces(self._wrenches(starts))

    def _slopes(self, memory: Array, shape: Array) -> Array:
        """Derivatives (·, 6) of the forces (·,) of a state, per prior deviation of it."""
        moved = self.forces(memory + np.diag(_STEP * self._spread))
        return (moved - shape[:, np.newaxis]) / _STEP

    def _ratio(self, shape: Array) -> float:
        return float(np.sqrt(self._squares)) / max(float(np.linalg.norm(shape)), _TINY)


def _varying_forces(wrenches: Array) -> Array:
    """Forces (·, K) of wrenches (N, 6, K) without their means."""
    forces = wrenches[:, :3]
    return (forces - forces.sum(axis=0) / len(forces)).reshape(3 * len(forces), -1)
