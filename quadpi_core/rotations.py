# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotations: unit quaternions (w, x, y, z) from body to world, rotation vectors in radians, matrices.

All give the bits of the compiled core. Up to :func:`matrix` they take one rotation, then arrays of them.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from quadpi_core.core import compiled
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.linear_algebra import eigen, times_each

Quaternion: TypeAlias = tuple[float, float, float, float]


def product(left: Any, right: Any) -> tuple[Any, Any, Any, Any]:
    """Quaternion product: the rotation `right` followed by `left`; of numbers, or of arrays of one shape."""
    w, x, y, z = left
    a, b, c, d = right
    return (
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    )


def inverse(quaternion: Any) -> tuple[Any, Any, Any, Any]:
    """Inverse of a unit quaternion: world to body; of numbers, or of arrays of one shape."""
    w, x, y, z = quaternion
    return w, -x, -y, -z


def matrix(quaternion: Array | Quaternion) -> Array:
    """Rotation matrix (3, 3), body to world, of a unit quaternion."""
    w, x, y, z = map(float, quaternion)
    return np.array(
        (
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        )
    )


def from_rotation_vector(vector: ArrayLike) -> Array:
    """Unit quaternions (..., 4) of rotation vectors (..., 3) rad (the exponential map)."""
    vectors = np.ascontiguousarray(vector, float)
    quaternions = np.empty((*vectors.shape[:-1], 4))
    compiled.quaternions_of(vectors, quaternions)
    return quaternions


def to_rotation_vector(quaternion: ArrayLike) -> Array:
    """Shortest rotation vectors (..., 3) rad of unit quaternions (..., 4) of either sign (the logarithm)."""
    quaternions = np.ascontiguousarray(quaternion, float)
    vectors = np.empty((*quaternions.shape[:-1], 3))
    compiled.rotation_vectors_of(quaternions, vectors)
    return vectors


def body_rates(time_ns: Stamps, attitude: Array) -> Array:
    """Mean body rates (N-1, 3) rad/s between consecutive attitudes (N, 4) at stamps (N,)."""
    turns = to_rotation_vector(products(inverses(attitude[:-1]), attitude[1:]))
    return turns / (1e-9 * np.diff(time_ns))[:, None]


def rotation_matrix(quaternion: Array) -> Array:
    """Rotation matrices (..., 3, 3), body to world, of unit quaternions (..., 4), w first."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rotate_body_to_world(quaternion: Array, vector: Array) -> Array:
    """Rotate body vectors (..., 3) into the world by unit quaternions (..., 4), w first."""
    return times_each(rotation_matrix(quaternion), vector)


def rotate_world_to_body(quaternion: Array, vector: Array) -> Array:
    """Rotate world vectors (..., 3) into the body by unit quaternions (..., 4), w first."""
    return times_each(np.swapaxes(rotation_matrix(quaternion), -1, -2), vector)


def products(left: Array, right: Array) -> Array:
    """Quaternion products (..., 4): the rotations `right` followed by `left`."""
    w, x, y, z = np.moveaxis(left, -1, 0)
    a, b, c, d = np.moveaxis(right, -1, 0)
    product: Array = np.stack(
        (
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ),
        axis=-1,
    )
    return product


def inverses(quaternions: Array) -> Array:
    """Inverses of unit quaternions (..., 4): world to body."""
    return np.asarray(quaternions * [1.0, -1.0, -1.0, -1.0])


def quaternion_of(rotation: Array) -> Array:
    """Unit quaternion (4,) of a rotation matrix (3, 3)."""
    # Four times the products of its numbers: the row of the largest one has lost the fewest digits.
    products = _attitude_profile(rotation) + np.eye(4)
    row = products[np.argmax(np.diag(products))]
    return np.asarray(row / np.sqrt(np.sum(row * row)))


def best_rotation(vectors: Array, turned: Array) -> tuple[Array, Array]:
    """Rotation R (3, 3) with `turned` ≈ `vectors` Rᵀ, both (K, 3), by least squares; singular values (3,).

    Wahba's problem, solved by Davenport's eigenvectors (Markley and Crassidis, Fundamentals of Spacecraft
    Attitude Determination and Control, section 5.3); singular values are those of the sum of outer products.
    The rotation about an axis is free where the second one vanishes.
    """
    values, quaternions = eigen(_attitude_profile(np.sum(turned[:, :, None] * vectors[:, None, :], axis=0)))
    return rotation_matrix(quaternions[0]), np.abs(0.5 * (values[0] + values[1:]))


def _attitude_profile(matrix: Array) -> Array:
    """Davenport's K (4, 4) of a matrix (3, 3): 4 q qᵀ − 1 of a rotation whose quaternion is q."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    return np.array(
        (
            (a + e + i, h - f, c - g, d - b),
            (h - f, a - e - i, b + d, c + g),
            (c - g, b + d, e - a - i, f + h),
            (d - b, c + g, f + h, i - a - e),
        )
    )
