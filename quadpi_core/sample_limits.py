# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Beyond which a sample comes from a broken sensor or is in a wrong unit: the same limits live and offline.

NaN is beyond every limit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from quadpi_core.compiled import njit

# Gyros of flight controllers end at 2000 deg/s, 35 rad/s, or 4000 deg/s.
RATE_MAX_RAD_S = 70.0
# Their accelerometers end at 16 g or 32 g.
SPECIFIC_FORCE_MAX_M_S2 = 320.0
# Of a state and of wind; no quadrotor flies as fast.
AIRSPEED_MAX_M_S = 100.0
# Of motion capture or satellites, which measure farther and faster than quadrotors fly.
POSITION_MAX_M = 10_000.0
MEASURED_SPEED_MAX_M_S = 300.0
# Of a state. What an estimator is given may be off by any scale between the last two: it is normalised.
QUATERNION_NORM_TOLERANCE = 0.1
_MIN_QUATERNION_NORM, _MAX_QUATERNION_NORM = 0.5, 1e6


@njit(cache=True)
def within(values: Any, limit: float) -> bool:
    """Whether every magnitude is at most `limit`."""
    for index in range(values.size):  # noqa: SIM110 - numba compiles no generators
        if not abs(values[index]) <= limit:
            return False
    return True


@njit(cache=True)
def usable_imu(sample: Any) -> bool:
    """Whether rates rad/s and specific force m/s² (6,) can be those of a flight."""
    return within(sample[:3], RATE_MAX_RAD_S) and within(sample[3:], SPECIFIC_FORCE_MAX_M_S2)


@njit(cache=True)
def usable_rotor_speeds(speeds: Any, highest: float) -> bool:
    """Whether speeds (4,) rad/s can be those of rotors whose sensors read `highest` at most."""
    for rotor in range(speeds.size):  # noqa: SIM110 - as above
        if not 0.0 <= speeds[rotor] <= highest:
            return False
    return True


@njit(cache=True)
def usable_pose(value: Any) -> bool:
    """Whether a position m can be measured and its attitude (7,) is a rotation, but for scale."""
    norm2 = value[3] ** 2 + value[4] ** 2 + value[5] ** 2 + value[6] ** 2
    return within(value[:3], POSITION_MAX_M) and bool(
        _MIN_QUATERNION_NORM**2 <= norm2 <= _MAX_QUATERNION_NORM**2
    )


@njit(cache=True)
def usable_velocity(value: Any) -> bool:
    """Whether a measured velocity m/s, the first three numbers, can be that of a flight."""
    return within(value[:3], MEASURED_SPEED_MAX_M_S)


@njit(cache=True)
def usable_airspeed(velocity: Any) -> bool:
    """Whether a velocity (3,) m/s of the vehicle's state or of the air can be that of a flight."""
    return within(velocity, AIRSPEED_MAX_M_S)


@njit(cache=True)
def unit_attitude(attitude: Any) -> bool:
    """Whether a quaternion (4,) is near unit length."""
    return bool(abs(np.sqrt(np.sum(attitude * attitude)) - 1.0) <= QUATERNION_NORM_TOLERANCE)
