# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotations: unit quaternions (w, x, y, z) from body to world, rotation vectors in radians, matrices.

The first functions are compiled and take one rotation, as array or tuple. They return tuples: an array would
cost an allocation per operation, several per sample of the filter. The others take arrays of rotations.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array

Quaternion: TypeAlias = tuple[float, float, float, float]
RotationVector: TypeAlias = tuple[float, float, float]

# Below this angle [rad] the next term of the series, angle²/24, is under the rounding of a double.
_SMALL_ANGLE = 1e-8


@njit(cache=True)
def product(left: Array | Quaternion, right: Array | Quaternion) -> Quaternion:
    """Quaternion product: the rotation `right` followed by `left`."""
    w, x, y, z = left[0], left[1], left[2], left[3]
    a, b, c, d = right[0], right[1], right[2], right[3]
    return (
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    )


@njit(cache=True)
def inverse(quaternion: Array | Quaternion) -> Quaternion:
    """Inverse of a unit quaternion: world to body."""
    return quaternion[0], -quaternion[1], -quaternion[2], -quaternion[3]


@njit(cache=True)
def normalised(quaternion: Array | Quaternion) -> Quaternion:
    """The quaternion scaled to unit norm."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    scale = 1.0 / np.sqrt(w * w + x * x + y * y + z * z)
    return w * scale, x * scale, y * scale, z * scale


@njit(cache=True)
def from_rotation_vector(vector: Array | RotationVector) -> Quaternion:
    """Unit quaternion of a rotation vector (3,) rad (the exponential map)."""
    x, y, z = vector[0], vector[1], vector[2]
    angle = np.sqrt(x * x + y * y + z * z)
    scale = 0.5 if angle < _SMALL_ANGLE else np.sin(0.5 * angle) / angle
    return np.cos(0.5 * angle), scale * x, scale * y, scale * z


@njit(cache=True)
def to_rotation_vector(quaternion: Array | Quaternion) -> RotationVector:
    """Shortest rotation vector (3,) rad of a unit quaternion of either sign (the logarithm map)."""
    sign = -1.0 if quaternion[0] < 0.0 else 1.0
    w, x, y, z = sign * quaternion[0], sign * quaternion[1], sign * quaternion[2], sign * quaternion[3]
    sine = np.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < _SMALL_ANGLE else 2.0 * np.arctan2(sine, w) / sine
    return scale * x, scale * y, scale * z


@njit(cache=True)
def matrix(quaternion: Array | Quaternion) -> Array:
    """Rotation matrix (3, 3), body to world, of a unit quaternion."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    rotation = np.empty((3, 3))
    rotation[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    rotation[0, 1] = 2.0 * (x * y - w * z)
    rotation[0, 2] = 2.0 * (x * z + w * y)
    rotation[1, 0] = 2.0 * (x * y + w * z)
    rotation[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    rotation[1, 2] = 2.0 * (y * z - w * x)
    rotation[2, 0] = 2.0 * (x * z - w * y)
    rotation[2, 1] = 2.0 * (y * z + w * x)
    rotation[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return rotation


@njit(cache=True)
def body_rates(time_ns: Stamps, attitude: Array) -> Array:
    """Mean body rates (N-1, 3) rad/s between consecutive attitudes (N, 4) at stamps (N,)."""
    rates = np.empty((len(attitude) - 1, 3))
    for row in range(len(rates)):
        turn = to_rotation_vector(product(inverse(attitude[row]), attitude[row + 1]))
        dt = 1e-9 * (time_ns[row + 1] - time_ns[row])
        for axis in range(3):
            rates[row, axis] = turn[axis] / dt
    return rates


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
    rotated: Array = np.einsum("...ij,...j->...i", rotation_matrix(quaternion), vector)
    return rotated


def rotate_world_to_body(quaternion: Array, vector: Array) -> Array:
    """Rotate world vectors (..., 3) into the body by unit quaternions (..., 4), w first."""
    rotated: Array = np.einsum("...ji,...j->...i", rotation_matrix(quaternion), vector)
    return rotated


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


def from_rotation_vectors(vectors: Array) -> Array:
    """Unit quaternions (..., 4) of rotation vectors (..., 3)."""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.concatenate((np.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / np.pi) * vectors), axis=-1)


def to_rotation_vectors(quaternions: Array) -> Array:
    """Shortest rotation vectors (..., 3) of unit quaternions (..., 4) of either sign."""
    quaternions = np.where(quaternions[..., :1] < 0.0, -quaternions, quaternions)
    vector = quaternions[..., 1:]
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quaternions[..., :1])
    return np.asarray(vector * np.where(sine > _SMALL_ANGLE, angle / np.maximum(sine, _SMALL_ANGLE), 2.0))


def quaternion_of(rotation: Array) -> Array:
    """Unit quaternion (4,) of a rotation matrix (3, 3)."""
    # Slow to import, and much that imports this module never needs it.
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_quat(scalar_first=True))


def best_rotation(vectors: Array, turned: Array) -> tuple[Array, Array]:
    """Rotation R (3, 3) with `turned` ≈ `vectors` Rᵀ, both (K, 3), by least squares; singular values (3,).

    Wahba's problem, solved by the singular values of the sum of outer products as Markley does. The rotation
    about an axis is free where the second singular value vanishes.
    """
    left, sizes, right = np.linalg.svd(turned.T @ vectors)
    handed = np.linalg.det(left) * np.linalg.det(right)
    return np.asarray(left @ np.diag([1.0, 1.0, handed]) @ right), sizes
