# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Frame conversions; every name says both frames.

Inside the core: body axes forward-right-down (FRD), world north-east-down (NED), quaternions
(w, x, y, z) rotating body vectors into the world. ROS and most logs use forward-left-up (FLU) and
east-north-up (ENU, REP-103). Arrays carry the samples on their first axis.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from quadpi_core.core import arcsine, arctangent, compiled, cosine, eigen, sine, times_each

Array: TypeAlias = npt.NDArray[np.float64]

_FLIP_YZ: Array = np.array([1.0, -1.0, -1.0])
_FLIP_Z: Array = np.array([1.0, 1.0, -1.0])
_FLIP_SOUTH: Array = np.array([1.0, -1.0, 1.0])
_SQRT_HALF = float(np.sqrt(0.5))


def body_flu_to_frd(vector: Array) -> Array:
    """Convert body vectors (..., 3) from forward-left-up to forward-right-down."""
    return vector * _FLIP_YZ


def body_frd_to_flu(vector: Array) -> Array:
    """Convert body vectors (..., 3) from forward-right-down to forward-left-up."""
    return vector * _FLIP_YZ


def world_enu_to_ned(vector: Array) -> Array:
    """Convert world vectors (..., 3) from east-north-up to north-east-down."""
    return vector[..., [1, 0, 2]] * _FLIP_Z


def world_ned_to_enu(vector: Array) -> Array:
    """Convert world vectors (..., 3) from north-east-down to east-north-up."""
    return vector[..., [1, 0, 2]] * _FLIP_Z


def world_eus_to_enu(vector: Array) -> Array:
    """Convert world vectors (..., 3) from east-up-south (y up) to east-north-up."""
    return vector[..., [0, 2, 1]] * _FLIP_SOUTH


def quaternion_fur_eus_to_flu_enu(quaternion: Array) -> Array:
    """Convert body-to-world quaternions (..., 4), w first, from FUR-to-EUS (y up in both) to FLU-to-ENU."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    return np.stack((w, x, -z, y), axis=-1)


def quaternion_flu_enu_to_frd_ned(quaternion: Array) -> Array:
    """Convert body-to-world quaternions (..., 4), w first, from FLU-to-ENU to FRD-to-NED.

    The same map serves both directions (see :func:`quaternion_frd_ned_to_flu_enu`): it is
    q_world * q * q_body with q_world = (0, √½, √½, 0) and q_body = (0, 1, 0, 0), both half turns.
    """
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rotated: Array = np.stack((w + z, x + y, x - y, w - z), axis=-1)
    return _SQRT_HALF * rotated


def quaternion_frd_ned_to_flu_enu(quaternion: Array) -> Array:
    """Convert body-to-world quaternions (..., 4), w first, from FRD-to-NED to FLU-to-ENU."""
    return quaternion_flu_enu_to_frd_ned(quaternion)


def quaternion_body_flu_to_frd(quaternion: Array) -> Array:
    """Convert quaternions (..., 4), w first, out of FLU body axes to out of FRD: q * (0, 1, 0, 0)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    return np.stack((-x, w, z, -y), axis=-1)


def quaternion_world_enu_to_ned(quaternion: Array) -> Array:
    """Convert quaternions (..., 4), w first, into the ENU world to into NED: (0, √½, √½, 0) * q."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rotated: Array = np.stack((-x - y, w + z, w - z, y - x), axis=-1)
    return _SQRT_HALF * rotated


def quaternion_from_roll_pitch_yaw(angles: Array) -> Array:
    """Quaternions (..., 4), w first, of angles (..., 3) rad: yaw about z, then pitch, then roll."""
    (cr, cp, cy), (sr, sp, sy) = (np.moveaxis(f(0.5 * angles), -1, 0) for f in (cosine, sine))
    return np.stack(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        axis=-1,
    )


def roll_pitch_yaw_from_quaternion(quaternion: Array) -> Array:
    """Angles (..., 3) rad of unit quaternions (..., 4), w first: pitch within ±π/2, the others ±π."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    return np.stack(
        (
            arctangent(2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
            arcsine(np.clip(2 * (w * y - x * z), -1.0, 1.0)),
            arctangent(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)),
        ),
        axis=-1,
    )


# All give the bits of the compiled core. Up to :func:`matrix` they take one rotation, then arrays of them.

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
    return np.array(_rows(*map(float, quaternion)))


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


def body_rates(time_ns: npt.NDArray[np.int64], attitude: Array) -> Array:
    """Mean body rates (N-1, 3) rad/s between consecutive attitudes (N, 4) at stamps (N,)."""
    turns = to_rotation_vector(products(inverses(attitude[:-1]), attitude[1:]))
    return turns / (1e-9 * np.diff(time_ns))[:, None]


def rotation_matrix(quaternion: Array) -> Array:
    """Rotation matrices (..., 3, 3), body to world, of unit quaternions (..., 4), w first."""
    rows = _rows(*np.moveaxis(quaternion, -1, 0))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _rows(w: Any, x: Any, y: Any, z: Any) -> tuple[tuple[Any, Any, Any], ...]:
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def rotate_body_to_world(quaternion: Array, vector: Array) -> Array:
    """Rotate body vectors (..., 3) into the world by unit quaternions (..., 4), w first."""
    return times_each(rotation_matrix(quaternion), vector)


def rotate_world_to_body(quaternion: Array, vector: Array) -> Array:
    """Rotate world vectors (..., 3) into the body by unit quaternions (..., 4), w first."""
    return times_each(np.swapaxes(rotation_matrix(quaternion), -1, -2), vector)


def products(left: Array, right: Array) -> Array:
    """Quaternion products (..., 4): the rotations `right` followed by `left`."""
    return np.stack(product(np.moveaxis(left, -1, 0), np.moveaxis(right, -1, 0)), axis=-1)


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
