# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled conversion between the numbers of a message (its order, FLU, ENU) and the core's arrays.

A live node converts thousands of single messages a second. One call does it for all fields of a message;
array operations field by field cost several times as much.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.sample_limits import NORM_TOLERANCE

# How many float64 fields end nav_msgs/Odometry and quadpi/WrenchPrediction.
ODOMETRY_VALUES, PREDICTION_VALUES = 85, 30
# Position and orientation among those of nav_msgs/Odometry.
POSE = slice(0, 7)

_SQRT_HALF = float(np.sqrt(0.5))


@njit(cache=True)
def attitude_values(orientation_xyzw: Any, attitude: Any) -> int:
    """Fill `attitude` (N, 4) with quaternions in core frames; the first that is no rotation, else -1.

    All others are of unit length, or not finite.
    """
    first = -1
    for row in range(attitude.shape[0]):
        x, y, z, w = orientation_xyzw[row]
        norm = np.sqrt(x * x + y * y + z * z + w * w)
        if abs(norm - 1.0) > NORM_TOLERANCE:
            first = row if first < 0 else first
            norm = 1.0
        # frames.quaternion_flu_enu_to_frd_ned
        scale = _SQRT_HALF / norm
        attitude[row, 0] = scale * (w + z)
        attitude[row, 1] = scale * (x + y)
        attitude[row, 2] = scale * (x - y)
        attitude[row, 3] = scale * (w - z)
    return first


@njit(cache=True)
def body_values(in_flu: Any, vectors: Any) -> None:
    """Fill `vectors` (N, 3) in body axes FRD; `frames.body_flu_to_frd`."""
    for row in range(vectors.shape[0]):
        vectors[row, 0] = in_flu[row, 0]
        vectors[row, 1], vectors[row, 2] = -1.0 * in_flu[row, 1], -1.0 * in_flu[row, 2]


@njit(cache=True)
def world_values(in_enu: Any, vectors: Any) -> None:
    """Fill `vectors` (N, 3) in the world NED; `frames.world_enu_to_ned`."""
    for row in range(vectors.shape[0]):
        vectors[row, 0], vectors[row, 1] = in_enu[row, 1], in_enu[row, 0]
        vectors[row, 2] = -1.0 * in_enu[row, 2]


@njit(cache=True)
def imu_values(values: Any, rates: Any, force: Any) -> None:
    """Fill what the numbers (N, 37) of sensor_msgs/Imu say: orientation and covariances are not used."""
    body_values(values[:, 13:16], rates)
    body_values(values[:, 25:28], force)


@njit(cache=True)
def pose_values(values: Any, position: Any, attitude: Any) -> int:
    """Fill what the numbers (N, 7) of a pose say; the first row whose attitude is no rotation, else -1."""
    world_values(values[:, :3], position)
    return attitude_values(values[:, 3:7], attitude)


@njit(cache=True)
def state_values(values: Any, position: Any, attitude: Any, velocity: Any, rates: Any) -> int:
    """Fill what the numbers (N, 85) of an odometry say; returns what :func:`pose_values` does."""
    body_values(values[:, 43:46], velocity)
    body_values(values[:, 46:49], rates)
    return pose_values(values, position, attitude)


@njit(cache=True)
def odometry_row(
    position: Any, attitude: Any, velocity: Any, rates: Any, covariances: Any, value: Any
) -> None:
    """Fill the numbers (85,) of an odometry: position, orientation, covariance, linear, angular, covariance.

    `covariances` are those of the pose and of the twist, (6, 6) each.
    """
    pose_covariance, twist_covariance = covariances
    w, x, y, z = attitude
    value[0], value[1], value[2] = position[1], position[0], -position[2]
    value[3], value[4] = _SQRT_HALF * (x + y), _SQRT_HALF * (x - y)
    value[5], value[6] = _SQRT_HALF * (w - z), _SQRT_HALF * (w + z)
    for i in range(2):
        vector = velocity if i == 0 else rates
        value[43 + 3 * i] = vector[0]
        value[44 + 3 * i], value[45 + 3 * i] = -vector[1], -vector[2]
    for i in range(6):
        # Adding zero makes an unknown covariance 0.0 on every axis, not -0.0.
        # NED to ENU swaps the first two of each three axes and turns the third; FRD to FLU turns two.
        from_i = i + 1 - 2 * (i % 3) if i % 3 < 2 else i
        for j in range(6):
            from_j = j + 1 - 2 * (j % 3) if j % 3 < 2 else j
            sign = 1.0 if (i % 3 == 2) == (j % 3 == 2) else -1.0
            value[7 + 6 * i + j] = sign * pose_covariance[from_i, from_j] + 0.0
            sign = 1.0 if (i % 3 == 0) == (j % 3 == 0) else -1.0
            value[49 + 6 * i + j] = sign * twist_covariance[i, j] + 0.0


@njit(cache=True)
def odometry_values(
    position: Any,
    attitude: Any,
    velocity: Any,
    rates: Any,
    pose_covariance: Any,
    twist_covariance: Any,
    values: Any,
) -> None:
    """Fill `values` (N, 85) by :func:`odometry_row`."""
    for row in range(values.shape[0]):
        covariances = pose_covariance[row], twist_covariance[row]
        odometry_row(position[row], attitude[row], velocity[row], rates[row], covariances, values[row])


@njit(cache=True)
def prediction_values(
    predicted: Any, lower: Any, upper: Any, measured: Any, relative_width: Any, first: int, values: Any
) -> None:
    """Fill `values` (N, 30) from row `first` on: five wrenches; bounds swap on the axes that change sign."""
    for i in range(values.shape[0]):
        row = first + i
        for axis in range(6):
            turned = axis % 3 != 0
            sign = -1.0 if turned else 1.0
            values[i, axis] = sign * predicted[row, axis] + 0.0
            values[i, 6 + axis] = sign * (upper if turned else lower)[row, axis] + 0.0
            values[i, 12 + axis] = sign * (lower if turned else upper)[row, axis] + 0.0
            values[i, 18 + axis] = sign * measured[row, axis] + 0.0
            values[i, 24 + axis] = relative_width[row, axis]
