# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Frame conversions against scipy's rotations and against what the axes mean."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core import frames
from quadpi_core.core import eigen, inverse, matrix_times, times_each
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


def random_quaternions(count=20, seed=6):
    quaternions = np.random.default_rng(seed).normal(size=(count, 4))
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def test_matrix_and_product_agree_with_frames():
    for first, second in random_quaternions().reshape(-1, 2, 4):
        np.testing.assert_allclose(frames.matrix(first), rotation_matrix(first), atol=1e-15)
        np.testing.assert_allclose(
            frames.matrix(frames.product(first, second)),
            rotation_matrix(first) @ rotation_matrix(second),
            atol=1e-14,
        )
        np.testing.assert_allclose(frames.matrix(frames.inverse(first)), rotation_matrix(first).T, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-3, 1.0, 3.1])
def test_exponential_and_logarithm_are_inverse(angle):
    vector = angle * np.array([2.0, -3.0, 6.0]) / 7.0
    quaternion = np.array(frames.from_rotation_vector(vector))
    np.testing.assert_allclose(quaternion, np.roll(Rotation.from_rotvec(vector).as_quat(), 1), atol=1e-15)
    for sign in (1.0, -1.0):
        np.testing.assert_allclose(
            frames.to_rotation_vector(sign * quaternion), vector, rtol=1e-9, atol=1e-20
        )


def test_body_rates_of_a_constant_turn():
    rate = np.array([1.0, -2.0, 0.5])
    time_ns = np.array([0, 3, 7, 12], dtype=np.int64) * 1_000_000
    attitude = np.array([frames.from_rotation_vector(rate * t * 1e-9) for t in time_ns])
    attitude[2] *= -1.0
    np.testing.assert_allclose(frames.body_rates(time_ns, attitude), np.tile(rate, (3, 1)), rtol=1e-9)


def test_the_quaternion_of_a_matrix_has_its_largest_number_positive():
    for quaternion in (*random_quaternions(), *np.eye(4), np.array([0.5, -0.5, 0.5, -0.5])):
        sign = np.sign(quaternion[np.argmax(np.abs(quaternion))])
        np.testing.assert_allclose(
            frames.quaternion_of(rotation_matrix(quaternion)), sign * quaternion, atol=1e-15
        )


def test_the_best_rotation_is_that_of_singular_values():
    rng = np.random.default_rng(7)
    for quaternion in random_quaternions():
        vectors = rng.normal(size=(30, 3)) * [3.0, 1.0, 0.3]
        turned = vectors @ rotation_matrix(quaternion).T + rng.normal(scale=0.1, size=(30, 3))
        rotation, sizes = frames.best_rotation(vectors, turned)
        left, expected, right = np.linalg.svd(turned.T @ vectors)
        handed = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
        np.testing.assert_allclose(rotation, left @ handed @ right, atol=1e-13)
        np.testing.assert_allclose(sizes, expected, rtol=1e-12)


# Small linear algebra, beside numpy's.


RANDOM = np.random.default_rng(0)


@pytest.mark.parametrize("size", [1, 3, 6])
def test_inverse_is_that_of_numpy(size):
    for _ in range(20):
        matrix = RANDOM.normal(size=(size, size))
        np.testing.assert_allclose(inverse(matrix), np.linalg.inv(matrix), rtol=1e-8, atol=1e-10)


def test_inverse_takes_the_largest_pivot_of_a_column():
    """Without rows exchanged a zero divides; with a tiny one in its place, digits are lost."""
    np.testing.assert_array_equal(inverse(np.array([[0.0, 2.0], [4.0, 0.0]])), [[0.0, 0.25], [0.5, 0.0]])
    matrix = np.array([[1e-20, 1.0], [1.0, 1.0]])
    np.testing.assert_allclose(inverse(matrix), [[-1.0, 1.0], [1.0, 0.0]], atol=1e-15)


def test_a_singular_matrix_has_no_finite_inverse():
    assert not np.isfinite(inverse(np.array([[1.0, 2.0], [2.0, 4.0]]))).all()


def test_a_matrix_times_a_vector():
    matrix, vector = RANDOM.normal(size=(4, 6)), RANDOM.normal(size=6)
    np.testing.assert_allclose(matrix_times(matrix, vector), matrix @ vector, rtol=1e-12)
    other = RANDOM.normal(size=(6, 3))
    np.testing.assert_allclose(matrix_times(matrix, other), matrix @ other, rtol=1e-12)


def test_matrices_times_vectors_of_their_own():
    matrices, vectors = RANDOM.normal(size=(5, 3, 3)), RANDOM.normal(size=(5, 3))
    np.testing.assert_allclose(
        times_each(matrices, vectors), [m @ v for m, v in zip(matrices, vectors, strict=True)], rtol=1e-12
    )


@pytest.mark.parametrize("spread", [0.0, 1e-12, 1.0, 1e12])
def test_eigenvectors_are_those_of_numpy(spread):
    """Of equal eigenvalues, of nearly equal ones and of such of very different size."""
    for _ in range(20):
        basis = np.linalg.qr(RANDOM.normal(size=(4, 4)))[0]
        matrix = basis @ np.diag([1.0, 1.0, 1.0 + spread, 2.0 + spread]) @ basis.T
        matrix = 0.5 * (matrix + matrix.T)
        values, vectors = eigen(matrix)
        np.testing.assert_allclose(
            values, np.linalg.eigvalsh(matrix)[::-1], rtol=1e-14, atol=1e-14 * values[0]
        )
        np.testing.assert_allclose(vectors @ vectors.T, np.eye(4), atol=1e-14)
        np.testing.assert_allclose(matrix @ vectors.T, vectors.T * values, atol=1e-14 * values[0])
