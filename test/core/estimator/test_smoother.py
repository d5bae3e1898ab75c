# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core.core import compiled
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import Inputs, Tape, imu_records, smooth
from quadpi_core.estimator.filter_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    DELAY,
    ERROR_STATES,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
)
from quadpi_core.flight import Recording
from quadpi_core.frames import rotate_world_to_body

RATE = 500.0
# Events of a tape.
STEP, SCALAR_CORRECTION = 0, 1


def dense(transition):
    """The matrix (16, 16) that a transition stands for."""
    matrix = np.eye(ERROR_STATES)
    dt = transition["dt"]
    matrix[POSITION, VELOCITY] = dt * np.eye(3)
    matrix[VELOCITY, ATTITUDE] = transition["velocity_by_attitude"]
    matrix[VELOCITY, ACCELEROMETER_BIAS] = transition["velocity_by_accelerometer_bias"]
    matrix[ATTITUDE, ATTITUDE] = transition["attitude_by_attitude"]
    matrix[ATTITUDE, GYRO_BIAS] = -dt * np.eye(3)
    return matrix


def process_noise(noise, dt):
    growth = np.zeros(ERROR_STATES)
    growth[VELOCITY], growth[ATTITUDE] = noise["accelerometer"], noise["gyro"]
    growth[GYRO_BIAS], growth[ACCELEROMETER_BIAS] = noise["gyro_bias"], noise["accelerometer_bias"]
    growth[15] = noise["delay"]
    return dt * np.diag(growth)


def textbook(tape, covariance, noise):
    """Rauch, Tung and Striebel with dense matrices: smoothed errors and variances at the estimates."""
    steps, transitions, scalars = [], iter(tape.steps), iter(tape.scalars)
    for event in tape.events[: tape.length["events"][0]]:
        if event == STEP:
            transition = next(transitions)
            f = dense(transition)
            predicted = f @ covariance @ f.T + process_noise(noise, transition["dt"])
            steps.append(("step", covariance @ f.T @ np.linalg.inv(predicted), covariance, predicted))
            covariance = predicted
        elif event == SCALAR_CORRECTION:
            scalar = next(scalars)
            innovation, expected = scalar["innovation"], scalar["innovation_variance"]
            gain = covariance @ scalar["jacobian"] / expected
            np.testing.assert_allclose(gain, scalar["gain"], rtol=1e-5, atol=1e-9)
            covariance = covariance - np.outer(gain, gain) * expected
            steps.append(("scalar", gain * innovation, None, None))
        else:
            steps.append(("estimate", None, None, None))
    error, smoothed, results = np.zeros(ERROR_STATES), covariance, []
    for kind, value, before, predicted in reversed(steps):
        if kind == "step":
            error = value @ error
            smoothed = before + value @ (smoothed - predicted) @ value.T
        elif kind == "scalar":
            error = error + value
        else:
            results.append((error, np.diag(smoothed)))
    errors, variances = zip(*reversed(results), strict=True)
    return np.array(errors), np.array(variances)


@pytest.fixture
def brief(simulate_flight) -> Recording:
    return simulate_flight(6, duration=2.2).recording


def test_it_is_the_smoother_of_the_textbook(noisy_vehicle, brief):
    (segment,) = Ekf(noisy_vehicle, RATE).segments(brief)
    inputs = Inputs(imu_records(brief.imu)[segment.samples], segment.journal, segment.noise)
    count = len(segment.samples)
    tape = Tape.empty(count, len(segment.journal))
    assert compiled.forward(inputs, segment.initial.estimate.copy(), 0, count, 0, tape) == len(
        segment.journal
    )
    errors, variances = textbook(tape, segment.initial.estimate["covariance"][0], segment.noise[0])

    smoothed = smooth(brief.imu, Ekf(noisy_vehicle, RATE).segments(brief))
    live = slice(segment.first, None)
    expected, errors = tape.estimates[live], errors[live]
    np.testing.assert_allclose(smoothed.velocity, expected["velocity"] + errors[:, VELOCITY], atol=1e-6)
    np.testing.assert_allclose(smoothed.gyro_bias, expected["gyro_bias"] + errors[:, GYRO_BIAS], atol=1e-7)
    np.testing.assert_allclose(smoothed.delay_s, expected["delay"] + errors[:, DELAY], atol=1e-7)
    np.testing.assert_allclose(smoothed.variance, variances[live], rtol=1e-4)


def test_the_last_estimate_is_that_of_the_filter_in_the_order_of_instants(noisy_vehicle, brief):
    smoothed = smooth(brief.imu, Ekf(noisy_vehicle, RATE).segments(brief))
    trace = Ekf(noisy_vehicle, RATE).run(brief)
    assert np.array_equal(smoothed.time_ns, trace.time_ns)
    np.testing.assert_allclose(smoothed.velocity[-1], trace.velocity[-1], rtol=1e-12)
    np.testing.assert_allclose(smoothed.variance[-1], trace.variance[-1], rtol=1e-9)


def test_errors_are_smaller_and_the_beginning_is_as_good_as_the_middle(noisy_vehicle, simulated):
    recording, true = simulated.recording, simulated.truth
    smoothed = smooth(recording.imu, Ekf(noisy_vehicle, RATE).segments(recording))
    trace = Ekf(noisy_vehicle, RATE).run(recording)
    index = np.searchsorted(recording.imu.time_ns, trace.time_ns)
    expected = rotate_world_to_body(true.attitude[index], true.velocity[index])

    def error(velocity, rows):
        return np.sqrt(np.mean((velocity[rows] - expected[rows]) ** 2))

    whole = slice(None)
    assert error(smoothed.velocity_body, whole) < 0.5 * error(trace.velocity_body, whole)
    assert error(smoothed.velocity_body, slice(0, 200)) < 2.0 * error(smoothed.velocity_body, whole)
    scaled = (smoothed.velocity - true.velocity[index]) ** 2 / smoothed.variance[:, VELOCITY]
    assert 0.4 < np.mean(scaled) < 1.8


def test_a_pause_of_the_imu_makes_two_segments(noisy_vehicle, simulated):
    imu = simulated.recording.imu
    keep = np.ones(len(imu), dtype=bool)
    keep[2000:2100] = False
    parts = {column.name: getattr(imu, column.name)[keep] for column in fields(imu)}
    recording = replace(simulated.recording, imu=replace(imu, **parts))
    smoothed = smooth(recording.imu, Ekf(noisy_vehicle, RATE).segments(recording))
    trace = Ekf(noisy_vehicle, RATE).run(recording)
    assert np.array_equal(smoothed.time_ns, trace.time_ns)
    index = np.searchsorted(imu.time_ns, smoothed.time_ns)
    assert np.max(np.abs(smoothed.velocity - simulated.truth.velocity[index])) < 0.1


def test_a_delay_other_than_that_of_the_filter_does_not_run_away(noisy_vehicle, simulated):
    """By 4 ms at the start, as rounding once grew to: by the end a tenth of it is left."""
    (segment,) = Ekf(noisy_vehicle, RATE).segments(simulated.recording)
    other = segment.initial.estimate.copy()
    other["delay"] += 0.004
    late = segment._replace(initial=segment.initial._replace(estimate=other))
    inputs = Inputs(imu_records(simulated.recording.imu)[segment.samples], segment.journal, segment.noise)
    passes = []
    for begun in (segment, late):
        estimate = begun.initial.estimate.copy()
        compiled.forward(inputs, estimate, 0, len(segment.samples), 0, Tape.empty(0, 0))
        passes.append(estimate)
    one, two = passes
    assert abs(one["delay"][0] - two["delay"][0]) < 4e-4
    np.testing.assert_allclose(one["gyro_bias"], two["gyro_bias"], atol=1e-3)
    np.testing.assert_allclose(one["position"], two["position"], atol=1e-3)
