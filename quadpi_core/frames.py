# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Frame conversions; every name says both frames.

Inside the core: body axes forward-right-down (FRD), world north-east-down (NED), quaternions
(w, x, y, z) rotating body vectors into the world. ROS and most logs use forward-left-up (FLU) and
east-north-up (ENU, REP-103). Arrays carry the samples on their first axis.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.elementary import arcsine, arctangent, cosine, sine

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
    rotated: Array = np.stack((-x, w, z, -y), axis=-1)
    return rotated


def quaternion_world_enu_to_ned(quaternion: Array) -> Array:
    """Convert quaternions (..., 4), w first, into the ENU world to into NED: (0, √½, √½, 0) * q."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rotated: Array = np.stack((-x - y, w + z, w - z, y - x), axis=-1)
    return _SQRT_HALF * rotated


def quaternion_from_roll_pitch_yaw(angles: Array) -> Array:
    """Quaternions (..., 4), w first, of angles (..., 3) rad: yaw about z, then pitch, then roll."""
    (cr, cp, cy), (sr, sp, sy) = (np.moveaxis(f(0.5 * angles), -1, 0) for f in (cosine, sine))
    quaternion: Array = np.stack(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        axis=-1,
    )
    return quaternion


def roll_pitch_yaw_from_quaternion(quaternion: Array) -> Array:
    """Angles (..., 3) rad of unit quaternions (..., 4), w first: pitch within ±π/2, the others ±π."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    angles: Array = np.stack(
        (
            arctangent(2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
            arcsine(np.clip(2 * (w * y - x * z), -1.0, 1.0)),
            arctangent(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)),
        ),
        axis=-1,
    )
    return angles
