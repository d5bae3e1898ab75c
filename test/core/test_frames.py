# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Frame conversions against scipy's rotations and against what the axes mean."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core import frames
from quadpi_core.frames import rotate_body_to_world, rotate_world_to_body, rotation_matrix

FLU_TO_FRD = np.diag([1.0, -1.0, -1.0])
ENU_TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@pytest.fixture
def quaternions() -> np.ndarray:
    return np.roll(Rotation.random(200, rng=11).as_quat(), 1, axis=1)


@pytest.fixture
def vectors() -> np.ndarray:
    return np.random.default_rng(12).normal(size=(200, 3))


def matrices(quaternions: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(np.roll(quaternions, -1, axis=1)).as_matrix()


def test_axes_mean_what_their_names_say():
    forward, left, up = np.eye(3)
    np.testing.assert_array_equal(frames.body_flu_to_frd(forward), [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(frames.body_flu_to_frd(left), [0.0, -1.0, 0.0])
    np.testing.assert_array_equal(frames.body_flu_to_frd(up), [0.0, 0.0, -1.0])
    east, north, _ = np.eye(3)
    np.testing.assert_array_equal(frames.world_enu_to_ned(east), [0.0, 1.0, 0.0])
    np.testing.assert_array_equal(frames.world_enu_to_ned(north), [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(frames.world_enu_to_ned(up), [0.0, 0.0, -1.0])


def test_vectors_return_unchanged(vectors: np.ndarray):
    np.testing.assert_array_equal(frames.body_frd_to_flu(frames.body_flu_to_frd(vectors)), vectors)
    np.testing.assert_array_equal(frames.world_ned_to_enu(frames.world_enu_to_ned(vectors)), vectors)


def test_rotation_matrix_is_scipys(quaternions: np.ndarray):
    np.testing.assert_allclose(rotation_matrix(quaternions), matrices(quaternions), atol=1e-12)


def test_rotations_invert_each_other(quaternions: np.ndarray, vectors: np.ndarray):
    world = rotate_body_to_world(quaternions, vectors)
    np.testing.assert_allclose(rotate_world_to_body(quaternions, world), vectors, atol=1e-12)


@pytest.mark.parametrize(
    ("convert", "world", "body"),
    [
        (frames.quaternion_flu_enu_to_frd_ned, ENU_TO_NED, FLU_TO_FRD),
        (frames.quaternion_frd_ned_to_flu_enu, ENU_TO_NED, FLU_TO_FRD),
        (frames.quaternion_body_flu_to_frd, np.eye(3), FLU_TO_FRD),
        (frames.quaternion_world_enu_to_ned, ENU_TO_NED, np.eye(3)),
    ],
)
def test_quaternions_change_both_frames(quaternions: np.ndarray, convert, world, body):
    """Each change of frame is its own inverse, so the matrix is world @ R @ body either way."""
    expected = world @ matrices(quaternions) @ body
    np.testing.assert_allclose(rotation_matrix(convert(quaternions)), expected, atol=1e-12)


def test_both_quaternion_paths_agree(quaternions: np.ndarray):
    at_once = frames.quaternion_flu_enu_to_frd_ned(quaternions)
    in_turn = frames.quaternion_world_enu_to_ned(frames.quaternion_body_flu_to_frd(quaternions))
    np.testing.assert_allclose(np.abs(np.sum(at_once * in_turn, axis=1)), 1.0, atol=1e-12)


def test_level_and_north_is_the_identity_in_both_conventions():
    facing_north_enu = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    ned = frames.quaternion_flu_enu_to_frd_ned(facing_north_enu)
    np.testing.assert_allclose(np.abs(ned), [1.0, 0.0, 0.0, 0.0], atol=1e-12)


def test_roll_pitch_yaw_and_back():
    limits = np.array([np.pi, np.pi / 2, np.pi])
    angles = np.random.default_rng(14).uniform(-limits, limits, size=(100, 3))
    quaternion = frames.quaternion_from_roll_pitch_yaw(angles)
    np.testing.assert_allclose(frames.roll_pitch_yaw_from_quaternion(quaternion), angles, atol=1e-9)
    np.testing.assert_allclose(frames.roll_pitch_yaw_from_quaternion(-quaternion), angles, atol=1e-9)


def test_roll_pitch_yaw_is_scipys():
    angles = np.random.default_rng(13).uniform(-3.0, 3.0, size=(100, 3))
    expected = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    found = rotation_matrix(frames.quaternion_from_roll_pitch_yaw(angles))
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_number_that_is_not_finite_stays_in_what_is_made_of_it(value: float):
    """And is no reason to warn: whoever takes the quaternion says that it is none."""
    bad = np.array([[value, 0.5, 0.5, 0.5], [0.5, 0.5, 0.5, 0.5]])
    converted = frames.quaternion_flu_enu_to_frd_ned(bad)
    np.testing.assert_array_equal(np.isfinite(converted), [[False, True, True, False], [True] * 4])
