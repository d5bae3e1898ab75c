# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The algebra of one estimate against finite differences and the textbook's matrices."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core import frames
from quadpi_core.core import compiled
from quadpi_core.estimator.filter_run import ESTIMATED, Inputs, Tape, imu_records
from quadpi_core.estimator.filter_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    CORRECTION,
    DELAY,
    ERROR_STATES,
    ESTIMATE,
    GYRO_BIAS,
    NOISE,
    POSITION,
    VELOCITY,
)
from quadpi_core.flight import ImuStream
from quadpi_core.frames import Array
from quadpi_core.records import Records

# Short, so that what is of second order in it is small.
STEP_NS = 500_000
FIELDS = {
    "position": POSITION,
    "velocity": VELOCITY,
    "gyro_bias": GYRO_BIAS,
    "accelerometer_bias": ACCELEROMETER_BIAS,
}


@pytest.fixture
def estimate() -> Records:
    """A vehicle that turns and falls, whose errors are correlated."""
    rng = np.random.default_rng(7)
    estimate = np.zeros(1, ESTIMATE)
    for name in FIELDS:
        estimate[name] = rng.normal(size=(1, 3))
    estimate["attitude"] = frames.from_rotation_vector(np.array([0.4, -0.3, 1.1]))
    root = 0.1 * rng.standard_normal((ERROR_STATES, ERROR_STATES))
    estimate["covariance"] = root @ root.T
    return estimate


@pytest.fixture
def noise() -> Records:
    """Another number for each of them."""
    noise = np.zeros(1, NOISE)
    for k, name in enumerate(("gyro", "accelerometer", "gyro_bias", "accelerometer_bias", "delay")):
        noise[name] = 1.0 + k
    noise["gravity"] = 9.81
    return noise


@pytest.fixture
def imu() -> Records:
    """Two samples of a sensor whose signal is linear between them."""
    rates = np.array([[1.0, -2.0, 3.0], [1.2, -1.9, 2.8]])
    return imu_records(ImuStream(np.array([0, STEP_NS]), rates, np.array([[2.0, 1.0, -12], [2.2, 0.8, -11]])))


def erring(estimate: Records, error: Array) -> Records:
    """The estimate of a filter that errs by so much."""
    other = estimate.copy()
    for name, states in FIELDS.items():
        other[name] += error[states]
    turn = frames.from_rotation_vector(error[ATTITUDE])
    other["attitude"] = frames.product(estimate["attitude"][0], turn)
    other["delay"] += error[DELAY]
    return other


def difference(one: Records, other: Records) -> Array:
    """The error state (16,) between two estimates."""
    error = np.zeros(ERROR_STATES)
    for name, states in FIELDS.items():
        error[states] = (other[name] - one[name])[0]
    turn = frames.product(frames.inverse(one["attitude"][0]), other["attitude"][0])
    error[ATTITUDE] = frames.to_rotation_vector(turn)
    error[DELAY] = other["delay"][0] - one["delay"][0]
    return error


def stepped(estimate: Records, noise: Records, imu: Records) -> tuple[Records, Tape]:
    """The estimate after a step between each two samples of the IMU, and its tape."""
    after, tape = estimate.copy(), Tape.empty(len(imu), 0)
    compiled.forward(Inputs(imu, np.zeros(0, CORRECTION), noise), after, 1, len(imu), 0, tape)
    return after, tape


def stepped_back(tape: Tape, adjoint: Array) -> Records:
    """The smoothed estimates of a tape; the adjoint state at its end becomes that at its beginning."""
    smoothed = np.zeros(len(tape.estimates), ESTIMATED)
    compiled.backward(tape, adjoint, np.zeros((ERROR_STATES, ERROR_STATES)), smoothed)
    return smoothed


def measured_transition(estimate: Records, noise: Records, imu: Records) -> Array:
    """F (16, 16): how small errors before the step show after it."""
    after, small = stepped(estimate, noise, imu)[0], 1e-5
    columns = [
        difference(after, stepped(erring(estimate, small * error), noise, imu)[0]) / small
        for error in np.eye(ERROR_STATES)
    ]
    return np.stack(columns, axis=1)


def test_dead_reckoning_on_ideal_sensors_is_of_second_order(noisy_vehicle, true_flight):
    errors = []
    for rate in (100.0, 200.0):
        time = np.arange(0.0, 2.0 + 1e-9, 1.0 / rate)
        time_ns = np.rint(time * 1e9).astype(np.int64)
        true = true_flight(time)
        estimate, noise = np.zeros(1, ESTIMATE), np.zeros(1, NOISE)
        estimate["position"], estimate["velocity"] = true.position[0], true.velocity[0]
        estimate["attitude"], noise["gravity"] = true.attitude[0], noisy_vehicle.gravity_m_s2
        samples = imu_records(ImuStream(time_ns, true.rates, true.specific_force))
        after, _ = stepped(estimate, noise, samples)
        errors.append(np.linalg.norm(after["velocity"][0] - true.velocity[-1]))
    assert errors[0] < 2e-3
    assert errors[1] < 0.3 * errors[0]


def test_the_covariance_is_that_of_the_errors_after_the_step(estimate, noise, imu):
    """F P Fᵀ + Q dt: F as finite differences show it, up to second order in the step."""
    after, _ = stepped(estimate, noise, imu)
    transition = measured_transition(estimate, noise, imu)
    assert np.abs(transition - np.eye(ERROR_STATES)).max() > 0.004
    growth = np.zeros(ERROR_STATES)
    for states, name in (
        (VELOCITY, "accelerometer"),
        (ATTITUDE, "gyro"),
        (GYRO_BIAS, "gyro_bias"),
        (ACCELEROMETER_BIAS, "accelerometer_bias"),
        (DELAY, "delay"),
    ):
        growth[states] = noise[name][0]
    dt = 1e-9 * STEP_NS
    expected = transition @ estimate["covariance"][0] @ transition.T + dt * np.diag(growth)
    np.testing.assert_allclose(after["covariance"][0], expected, atol=3e-6)
    np.testing.assert_array_equal(after["covariance"][0], after["covariance"][0].T)


def test_the_transposed_transition_is_that_of_the_errors(estimate, noise, imu):
    rows = np.eye(ERROR_STATES)
    for row in rows:
        stepped_back(stepped(estimate, noise, imu)[1], row)
    np.testing.assert_allclose(rows, measured_transition(estimate, noise, imu), atol=1e-5)


def test_an_estimated_error_is_added_and_the_delay_stays_within_the_buffer(estimate, noise, imu):
    """With a covariance of one, the smoother adds the adjoint state with the other sign."""

    def corrected(error: Array) -> Records:
        _, tape = stepped(estimate, noise, imu)
        tape.estimates["covariance"] = np.eye(ERROR_STATES)
        return stepped_back(tape, -error)[:1]

    after, _ = stepped(estimate, noise, imu)
    error = 0.1 * np.random.default_rng(9).normal(size=ERROR_STATES)
    smoothed = corrected(error)
    np.testing.assert_allclose(difference(after, smoothed), error, rtol=1e-9)
    assert np.linalg.norm(smoothed["attitude"]) == pytest.approx(1.0, rel=1e-15)
    for sign in (1.0, -1.0):
        error[DELAY] = sign
        assert corrected(error)["delay"] == sign * 0.35
