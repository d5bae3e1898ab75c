# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels that convert a message's numbers in one call, against the conversions of frames one by one."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.core import compiled
from quadpi_core.messages import payloads
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.sensor_messages import ODOMETRY, PREDICTION

N = 8
# FRD in FLU, and NED in ENU, as columns.
BODY = np.diag([1.0, -1.0, -1.0])
WORLD = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@pytest.fixture
def rng():
    return np.random.default_rng(8)


@pytest.fixture
def state(rng):
    """Position, attitude, velocity and rates, FRD and NED."""
    position, velocity, rates = rng.normal(size=(3, N, 3))
    return position, Rotation.random(N, rng), velocity, rates


def covariance(rng):
    roots = rng.normal(size=(N, 6, 6))
    return roots @ np.swapaxes(roots, 1, 2)


def test_sizes_are_those_of_the_messages():
    for kind, count in ((ODOMETRY, payloads.ODOMETRY_VALUES), (PREDICTION, payloads.PREDICTION_VALUES)):
        assert max(place.stop for place in codec(kind).places.values()) == count


def test_odometry_is_that_of_rotation_matrices(state, rng):
    """Also its covariances, which turn with the axes that they are of."""
    pose, twist, places = covariance(rng), covariance(rng), codec(ODOMETRY).places
    position, attitude, velocity, rates = state
    numbers = np.full((N, payloads.ODOMETRY_VALUES), np.nan)
    wxyz = attitude.as_quat(scalar_first=True)
    compiled.odometry_values(position, wxyz, velocity, rates, pose, twist, numbers)
    np.testing.assert_array_equal(numbers[:, places["pose.pose.position"]], position @ WORLD.T)
    np.testing.assert_array_equal(numbers[:, places["twist.twist.linear"]], velocity @ BODY)
    np.testing.assert_array_equal(numbers[:, places["twist.twist.angular"]], rates @ BODY)
    sent = Rotation.from_quat(numbers[:, places["pose.pose.orientation"]])
    np.testing.assert_allclose(sent.as_matrix(), WORLD @ attitude.as_matrix() @ BODY, atol=1e-14)
    both = np.kron(np.eye(2), WORLD), np.kron(np.eye(2), BODY)
    for name, turn, given in (("pose", both[0], pose), ("twist", both[1], twist)):
        found = numbers[:, places[f"{name}.covariance"]].reshape(N, 6, 6)
        np.testing.assert_allclose(found, turn @ given @ turn.T, rtol=1e-15)


@pytest.mark.parametrize(("norm", "first"), [(1.049, -1), (0.951, -1), (1.051, 2), (0.949, 2), (0.0, 2)])
def test_an_orientation_is_scaled_to_unit_length_if_it_is_off_by_a_twentieth_at_most(state, norm, first):
    sent = np.zeros((N, 7))
    sent[:, 3:] = state[1].as_quat()
    sent[2] *= norm
    attitude = np.empty((N, 4))
    assert compiled.pose_values(sent, np.empty((N, 3)), attitude) == first
    rows = slice(None) if first < 0 else slice(0, first)
    np.testing.assert_allclose(np.linalg.norm(attitude[rows], axis=1), 1.0)
