# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A measurement corrects an estimate as the textbook says; gates are quantiles of chi-square."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from quadpi_core import frames
from quadpi_core.core import compiled
from quadpi_core.estimator.filter_state import (
    ATTITUDE,
    BODY_VELOCITY,
    ERROR_STATES,
    ESTIMATE,
    MEASUREMENT,
    NOISE,
    POSE,
    POSITION,
    SCALAR,
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


def measured(kind: int, vector: object, attitude: object = 0.0, time_ns: int = 0) -> Records:
    measurement = np.zeros(1, MEASUREMENT)
    measurement["time_ns"], measurement["kind"] = time_ns, kind
    measurement["vector"], measurement["attitude"] = vector, attitude
    return measurement


def fuse(estimate: Records, noise: Records, measurement: Records, lag: float = 0.0) -> tuple[Records, float]:
    """The corrected estimate, and the squared innovation in units of its covariance.

    The measurement is of a time `lag` after the estimate, and arrives late by the estimate's delay.
    """
    corrected, late = estimate.copy(), measurement.copy()
    late["time_ns"] = estimate["time_ns"] + np.round(1e9 * (estimate["delay"] + lag)).astype(np.int64)
    nis = compiled.fuse(corrected, noise, late, np.zeros(6, SCALAR))
    return corrected, nis


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
    np.testing.assert_allclose(corrected["covariance"][0, :6, :6], covariance[:6, :6], rtol=1e-6, atol=1e-12)
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
    """With a delay that is 20 ms longer, it was taken 20 ms earlier: along the motion, that far behind."""
    estimate["time_ns"], estimate["delay"] = 7 * SECOND, 0.05
    pose = measured(POSE, estimate["position"], estimate["attitude"], time_ns=7 * SECOND + SECOND // 20)
    assert compiled.taken_ns(estimate, pose) == 7 * SECOND
    assert compiled.fuse(estimate.copy(), noise, pose, np.zeros(6, SCALAR)) < 1e-9
    late, scalars = estimate.copy(), np.zeros(6, SCALAR)
    late["delay"] += 0.02
    compiled.fuse(late, noise, pose, scalars)
    assert scalars["residual"][0] == pytest.approx(0.02 * estimate["velocity"][0, 0])


def test_the_delay_is_found_in_motion_only(estimate: Records, noise: Records) -> None:
    estimate["covariance"][0, -1, -1] = 0.05**2
    moving = fuse(estimate, noise, measured(POSE, estimate["position"], estimate["attitude"]))[0]
    estimate["velocity"], estimate["rates"] = 0.0, estimate["gyro_bias"]
    resting = fuse(estimate, noise, measured(POSE, estimate["position"], estimate["attitude"]))[0]
    assert resting["covariance"][0, -1, -1] == pytest.approx(0.05**2)
    assert moving["covariance"][0, -1, -1] < 0.9 * 0.05**2


def test_gates_are_quantiles_of_chi_square() -> None:
    assert chi2.cdf(compiled.POSE_GATE, 6) == pytest.approx(0.9999, abs=1e-6)
    assert chi2.cdf(compiled.VELOCITY_GATE, 3) == pytest.approx(0.9999, abs=1e-6)


def test_a_motion_of_three_standard_deviations_counts_half() -> None:
    assert compiled.significance(*(0.0, 0.0, 0.0), 0.04) == 0.0
    assert compiled.significance(*(0.6, 0.0, 0.0), 0.04) == pytest.approx(0.5)
    assert compiled.significance(*(0.0, 60.0, 0.0), 0.04) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("apart", "seconds", "speed_m_s", "agree"),
    [
        ((0.47, 0.38), 0.1, 0.0, True),  # 9 · 0.02 m + 3 m/s · 0.1 s, 9 · 0.01 rad + 3 rad/s · 0.1 s
        ((0.49, 0.38), 0.1, 0.0, False),
        ((0.47, 0.40), 0.1, 0.0, False),
        ((0.17, 0.08), 0.0, 0.0, True),
        ((0.19, 0.08), 0.0, 0.0, False),
        ((0.77, 0.0), 0.1, 2.0, True),  # and half as much again as it moves, 3 m/s · 0.1 s
        ((0.79, 0.0), 0.1, 2.0, False),
        ((0.3, 0.1), 0.49, 0.0, True),
        ((0.3, 0.1), 0.51, 0.0, False),
    ],
)
def test_poses_agree_that_one_plausible_motion_explains(
    estimate: Records,
    noise: Records,
    apart: tuple[float, float],
    seconds: float,
    speed_m_s: float,
    agree: bool,
) -> None:
    """Apart by metres and radians."""
    metres, radians = apart
    estimate["velocity"], estimate["rates"] = (speed_m_s, 0.0, 0.0), estimate["gyro_bias"]
    turned = frames.product(estimate["attitude"][0], frames.from_rotation_vector(np.array([0, 0, radians])))
    first = measured(POSE, (0.0, 0.0, 0.0), estimate["attitude"])
    second = measured(POSE, (metres, 0.0, 0.0), turned, round(seconds * SECOND))
    assert compiled.same_motion(np.concatenate((first, second)), estimate, noise) == agree


@pytest.mark.parametrize(("change_m_s", "agree"), [(2.85, True), (2.90, False)])
def test_velocities_agree_that_a_plausible_acceleration_explains(
    estimate: Records, noise: Records, change_m_s: float, agree: bool
) -> None:
    """9 · 0.1 m/s, and in 0.1 s 10 m/s² beside the specific force of 9.7 m/s²."""
    estimate["rates"] = estimate["gyro_bias"]
    first = measured(WORLD_VELOCITY, (0.0, 0.0, 0.0))
    second = measured(WORLD_VELOCITY, (0.0, change_m_s, 0.0), time_ns=SECOND // 10)
    assert compiled.same_motion(np.concatenate((first, second)), estimate, noise) == agree


def test_an_uncertain_delay_widens_a_measurement_by_the_motion_that_it_leaves_out(
    estimate: Records, noise: Records
) -> None:
    """To second order: half the squared delay times 20 rad/s² of an attitude, 20 m/s³ of a velocity."""
    delay_std, scalars = 0.1, np.zeros(6, SCALAR)
    estimate["covariance"] = 0.0
    estimate["covariance"][0, -1, -1] = delay_std**2
    left_out = (0.5 * 20.0 * delay_std**2) ** 2 * 2.0
    at_rest = measured(POSE, estimate["position"], estimate["attitude"])
    compiled.fuse(estimate.copy(), noise, at_rest, scalars)
    np.testing.assert_allclose(scalars["variance"][3:], noise["attitude"][0] + left_out)
    compiled.fuse(estimate.copy(), noise, measured(WORLD_VELOCITY, 0.0), scalars)
    np.testing.assert_allclose(scalars["variance"][:3], noise["velocity"][0] + left_out)


def test_motion_shows_once_noise_cannot_hide_it(estimate: Records, noise: Records) -> None:
    """At 1 m/s, four standard deviations of 2 cm take 80 ms."""
    estimate["velocity"], estimate["rates"] = (1.0, 0.0, 0.0), estimate["gyro_bias"]
    assert not compiled.motion_shows(estimate, noise, POSE, 0.079)
    assert compiled.motion_shows(estimate, noise, POSE, 0.081)
