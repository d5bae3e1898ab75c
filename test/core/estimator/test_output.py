# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np

from quadpi_core import frames
from quadpi_core.core import compiled
from quadpi_core.estimator.filter_run import FUSED, FusedSamples, with_gyro_faults
from quadpi_core.estimator.filter_state import (
    ATTITUDE,
    ERROR_STATES,
    ESTIMATE,
    FILTER,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    State,
)
from quadpi_core.flight import ImuStream
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.payloads import ODOMETRY_VALUES
from quadpi_core.messages.sensor_messages import ODOMETRY, pack_odometry
from quadpi_core.records import SPECIFIC_FORCE_MAX_M_S2

GYRO_NOISE = 0.02


def make_state(rng: np.random.Generator) -> State:
    root = 0.02 * rng.standard_normal((ERROR_STATES, ERROR_STATES))
    estimate = np.zeros(1, ESTIMATE)
    for name in ("rates", "specific_force", "position", "velocity", "attitude"):
        estimate[name] = rng.standard_normal(estimate[name].shape)
    estimate["gyro_bias"], estimate["accelerometer_bias"] = rng.standard_normal((2, 1, 3))
    estimate["velocity"] *= 10.0
    estimate["attitude"] /= np.linalg.norm(estimate["attitude"])
    estimate["covariance"] = root @ root.T
    return State(estimate)


def fused(state: State) -> FusedSamples:
    sample, memory = np.empty(1, FUSED), np.zeros(1, FILTER)
    memory["noise"]["rates"] = GYRO_NOISE**2
    compiled.fill_newest(memory, state.estimate, sample)
    return FusedSamples.from_rows(sample)


def test_imu_is_corrected_and_velocity_in_body_axes() -> None:
    state = make_state(np.random.default_rng(3))
    sample = fused(state)
    np.testing.assert_allclose(sample.imu.angular_velocity[0], state.rates - state.gyro_bias)
    np.testing.assert_allclose(sample.imu.specific_force[0], state.specific_force - state.accelerometer_bias)
    np.testing.assert_allclose(
        sample.odometry.velocity[0], rotate_world_to_body(state.attitude, state.velocity), rtol=1e-12
    )
    state.position[:] = np.nan
    assert np.isfinite(sample.odometry.position).all()


def test_odometry_is_that_of_the_states() -> None:
    sample = fused(make_state(np.random.default_rng(5)))
    values = np.empty((1, ODOMETRY_VALUES))
    compiled.fill_odometry(sample.rows, values)
    packed = pack_odometry(sample.odometry, sample.pose_covariance, sample.twist_covariance)
    np.testing.assert_array_equal(codec(ODOMETRY).decode_stamped(packed)[1], values)


def test_covariances_match_the_spread_of_perturbed_states() -> None:
    rng = np.random.default_rng(4)
    state = make_state(rng)
    errors = rng.multivariate_normal(np.zeros(ERROR_STATES), state.covariance, 20_000)
    gyro_errors = GYRO_NOISE * rng.standard_normal((len(errors), 3))
    pose, twist = np.empty((len(errors), 6)), np.empty((len(errors), 6))
    for row, (error, gyro_error) in enumerate(zip(errors, gyro_errors, strict=True)):
        turned = frames.product(state.attitude, frames.from_rotation_vector(error[ATTITUDE]))
        world_turn = frames.product(turned, frames.inverse(state.attitude))
        pose[row] = *error[POSITION], *frames.to_rotation_vector(world_turn)
        twist[row, :3] = rotate_world_to_body(turned, state.velocity + error[VELOCITY])
        twist[row, 3:] = gyro_error - error[GYRO_BIAS]
    sample = fused(state)
    assert_close(sample.pose_covariance[0], np.cov(pose.T))
    assert_close(sample.twist_covariance[0], np.cov(twist.T))


def assert_close(actual: Array, expected: Array) -> None:
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(actual / scale, expected / scale, atol=0.06)


def test_a_gyro_that_cannot_be_shows_in_the_specific_force() -> None:
    rates = np.zeros((4, 3))
    rates[1, 2], rates[2, 0], rates[3, 1] = np.nan, -71.0, 69.0
    force = np.tile([0.0, 0.0, -9.8], (4, 1))
    shown = with_gyro_faults(ImuStream(np.arange(4), rates, force)).specific_force
    np.testing.assert_array_equal(shown[[0, 3]], force[[0, 3]])
    assert np.isnan(shown[1, 2])
    assert np.isfinite(shown[2]).all()
    assert np.abs(shown[2]).max() > SPECIFIC_FORCE_MAX_M_S2
