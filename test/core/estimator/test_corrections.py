# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A measurement corrects an estimate as the textbook says."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core import frames
from quadpi_core.core import compiled
from quadpi_core.estimator.filter_run import Inputs, Tape
from quadpi_core.estimator.filter_state import (
    ATTITUDE,
    BODY_VELOCITY,
    CORRECTION,
    DELAY,
    ERROR_STATES,
    ESTIMATE,
    IMU_SAMPLE,
    MEASUREMENT,
    NOISE,
    POSE,
    POSITION,
    VELOCITY,
    WORLD_VELOCITY,
)
from quadpi_core.records import Records

SECOND = 1_000_000_000


@pytest.fixture
def estimate() -> Records:
    """A vehicle in motion, whose errors are correlated, with a delay that is known."""
    rng = np.random.default_rng(11)
    estimate = np.zeros(1, ESTIMATE)
    for name in ("position", "velocity", "rates", "gyro_bias"):
        estimate[name] = rng.normal(size=(1, 3))
    estimate["specific_force"] = 0.3, -0.2, -9.7
    estimate["attitude"] = frames.from_rotation_vector(np.array([0.2, -0.1, 0.7]))
    root = 0.03 * rng.standard_normal((ERROR_STATES - 1, ERROR_STATES - 1))
    estimate["covariance"][0, :-1, :-1] = root @ root.T + 1e-4 * np.eye(ERROR_STATES - 1)
    return estimate


@pytest.fixture
def noise() -> Records:
    noise = np.zeros(1, NOISE)
    noise["position"], noise["attitude"], noise["velocity"], noise["gravity"] = 4e-4, 1e-4, 1e-2, 9.81
    return noise


def measured(kind: int, vector: object, attitude: object = 0.0) -> Records:
    measurement = np.zeros(1, MEASUREMENT)
    measurement["kind"] = kind
    measurement["vector"], measurement["attitude"] = vector, attitude
    return measurement


def scalars_of(
    estimate: Records, noise: Records, measurement: Records, lag: float = 0.0
) -> tuple[Records, Records]:
    """The corrected estimate, and the scalars of the measurement.

    It is of a time `lag` after the estimate, and arrives late by the estimate's delay.
    """
    corrected, imu, correction = estimate.copy(), np.zeros(1, IMU_SAMPLE), np.zeros(1, CORRECTION)
    for name in ("time_ns", "rates", "specific_force"):
        imu[name] = estimate[name]
    correction["time_ns"], correction["measurement"] = estimate["time_ns"], measurement
    stamp = estimate["time_ns"] + np.round(1e9 * (estimate["delay"] + lag)).astype(np.int64)
    correction["measurement"]["time_ns"] = stamp
    tape = Tape.empty(1, 1)
    compiled.forward(Inputs(imu, correction, noise), corrected, 0, 1, 0, tape)
    return corrected, tape.scalars[: tape.length["scalars"][0]]


def fuse(estimate: Records, noise: Records, measurement: Records, lag: float = 0.0) -> tuple[Records, float]:
    """The corrected estimate, and the squared innovation in units of its covariance."""
    corrected, scalars = scalars_of(estimate, noise, measurement, lag)
    return corrected, float(np.sum(scalars["innovation"] ** 2 / scalars["innovation_variance"]))


def kalman(prior: Records, jacobian: np.ndarray, residual: np.ndarray, variance: np.ndarray) -> tuple:
    """Error, covariance and squared innovation of the update in matrices."""
    covariance = prior["covariance"][0]
    innovation = jacobian @ covariance @ jacobian.T + np.diag(variance)
    gain = covariance @ jacobian.T @ np.linalg.inv(innovation)
    left = np.eye(ERROR_STATES) - gain @ jacobian
    nis = residual @ np.linalg.solve(innovation, residual)
    return gain @ residual, left @ covariance, nis


def test_a_pose_corrects_as_the_textbook_says(estimate: Records, noise: Records) -> None:
    turn = np.array([0.01, -0.02, 0.015])
    attitude = frames.product(estimate["attitude"][0], frames.from_rotation_vector(turn))
    offset = np.array([0.05, -0.03, 0.02])
    pose = measured(POSE, estimate["position"][0] + offset, attitude)
    jacobian = np.zeros((6, ERROR_STATES))
    jacobian[:3, POSITION] = jacobian[3:, ATTITUDE] = np.eye(3)
    variance = np.repeat([noise["position"][0], noise["attitude"][0]], 3)
    error, covariance, nis = kalman(estimate, jacobian, np.concatenate((offset, turn)), variance)
    corrected, found = fuse(estimate, noise, pose)
    assert found == pytest.approx(nis, rel=1e-6)
    np.testing.assert_allclose(corrected["position"] - estimate["position"], [error[POSITION]], rtol=1e-6)
    np.testing.assert_allclose(corrected["velocity"] - estimate["velocity"], [error[VELOCITY]], rtol=1e-6)
    np.testing.assert_allclose(corrected["covariance"][0], covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(corrected["covariance"][0], corrected["covariance"][0].T)
    turned = frames.product(frames.inverse(estimate["attitude"][0]), corrected["attitude"][0])
    np.testing.assert_allclose(frames.to_rotation_vector(turned), error[ATTITUDE], rtol=1e-4)


def test_a_velocity_of_the_world_corrects_as_the_textbook_says(estimate: Records, noise: Records) -> None:
    offset = np.array([0.2, 0.1, -0.1])
    jacobian = np.zeros((3, ERROR_STATES))
    jacobian[:, VELOCITY] = np.eye(3)
    error, covariance, nis = kalman(estimate, jacobian, offset, np.repeat(noise["velocity"], 3))
    corrected, found = fuse(estimate, noise, measured(WORLD_VELOCITY, estimate["velocity"][0] + offset))
    assert found == pytest.approx(nis, rel=1e-6)
    np.testing.assert_allclose(corrected["position"] - estimate["position"], [error[POSITION]], rtol=1e-6)
    np.testing.assert_allclose(corrected["covariance"][0, :6, :6], covariance[:6, :6], rtol=1e-6, atol=1e-12)


def test_a_velocity_of_the_body_is_that_of_the_world_turned(estimate: Records, noise: Records) -> None:
    """Of an attitude that is known, both correct the velocity alike."""
    estimate["covariance"][0, ATTITUDE] = estimate["covariance"][0, :, ATTITUDE] = 0.0
    world = estimate["velocity"][0] + [0.2, 0.1, -0.1]
    body = frames.rotate_world_to_body(estimate["attitude"], world[None])
    by_world, nis = fuse(estimate, noise, measured(WORLD_VELOCITY, world))
    by_body, nis_of_body = fuse(estimate, noise, measured(BODY_VELOCITY, body))
    assert nis_of_body == pytest.approx(nis)
    np.testing.assert_allclose(by_body["velocity"], by_world["velocity"], rtol=1e-9)


def test_a_lag_moves_what_is_expected_along_the_motion(estimate: Records, noise: Records) -> None:
    """A pose where the vehicle will be agrees with the estimate."""
    lag = 0.02
    rates = estimate["rates"][0] - estimate["gyro_bias"][0]
    attitude = frames.product(estimate["attitude"][0], frames.from_rotation_vector(lag * rates))
    ahead = measured(POSE, estimate["position"][0] + lag * estimate["velocity"][0], attitude)
    assert fuse(estimate, noise, ahead, lag)[1] == pytest.approx(0.0, abs=1e-9)
    assert fuse(estimate, noise, ahead)[1] > 0.01


def test_a_measurement_is_of_the_instant_that_the_own_delay_says(estimate: Records, noise: Records) -> None:
    """Of one that is stamped 20 ms before a longer delay says, the vehicle was that far behind."""
    estimate["time_ns"], estimate["delay"] = 7 * SECOND, 0.05
    pose = measured(POSE, estimate["position"], estimate["attitude"])
    assert fuse(estimate, noise, pose)[1] < 1e-9
    _, scalars = scalars_of(estimate, noise, pose, -0.02)
    assert scalars["residual"][0] == pytest.approx(0.02 * estimate["velocity"][0, 0])


def test_a_motion_of_three_standard_deviations_counts_half(estimate: Records, noise: Records) -> None:
    """Of the whole velocity, of which the delay shows a share."""
    estimate["covariance"][0, VELOCITY, VELOCITY] = np.diag((0.01, 0.01, 0.02))
    for speed, share in ((0.0, 0.0), (0.6, 0.5), (60.0, 1.0)):
        estimate["velocity"] = speed, 0.0, 0.0
        _, scalars = scalars_of(estimate, noise, measured(POSE, estimate["position"], estimate["attitude"]))
        assert scalars["jacobian"][0, DELAY] == pytest.approx(-share * speed, rel=1e-3)


def test_the_delay_is_found_in_motion_only(estimate: Records, noise: Records) -> None:
    estimate["covariance"][0, -1, -1] = 0.05**2
    moving = fuse(estimate, noise, measured(POSE, estimate["position"], estimate["attitude"]))[0]
    estimate["velocity"], estimate["rates"] = 0.0, estimate["gyro_bias"]
    resting = fuse(estimate, noise, measured(POSE, estimate["position"], estimate["attitude"]))[0]
    assert resting["covariance"][0, -1, -1] == pytest.approx(0.05**2)
    assert moving["covariance"][0, -1, -1] < 0.9 * 0.05**2


def test_an_uncertain_delay_widens_a_measurement_by_the_motion_that_it_leaves_out(
    estimate: Records, noise: Records
) -> None:
    """To second order: half the squared delay times 20 rad/s² of an attitude, 20 m/s³ of a velocity."""
    delay_std = 0.1
    estimate["covariance"] = 0.0
    estimate["covariance"][0, -1, -1] = delay_std**2
    left_out = (0.5 * 20.0 * delay_std**2) ** 2 * 2.0
    at_rest = measured(POSE, estimate["position"], estimate["attitude"])
    _, scalars = scalars_of(estimate, noise, at_rest)
    np.testing.assert_allclose(scalars["variance"][3:], noise["attitude"][0] + left_out)
    _, scalars = scalars_of(estimate, noise, measured(WORLD_VELOCITY, 0.0))
    np.testing.assert_allclose(scalars["variance"][:3], noise["velocity"][0] + left_out)
