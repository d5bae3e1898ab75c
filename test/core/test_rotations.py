# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core import frames
from quadpi_core.frames import rotation_matrix


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
