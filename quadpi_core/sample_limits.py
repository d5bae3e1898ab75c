# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Limits beyond which a sample comes from a broken sensor or is in a wrong unit, the same live and offline.

NaN is beyond every limit.
"""

from __future__ import annotations

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.core import compiled
from quadpi_core.frames import Array

# Gyros of flight controllers end at 2000 deg/s, 35 rad/s, or 4000 deg/s.
RATE_MAX_RAD_S = 70.0
# One g, in which accelerometers are specified.
STANDARD_GRAVITY = 9.80665
# Accelerometers of flight controllers end at 16 g or 32 g.
SPECIFIC_FORCE_MAX_M_S2 = 320.0
# Of a state and of wind; no quadrotor flies as fast.
AIRSPEED_MAX_M_S = 100.0
# Of motion capture or satellites, which measure farther and faster than quadrotors fly.
POSITION_MAX_M = 10_000.0
MEASURED_SPEED_MAX_M_S = 300.0
# Of a state. What an estimator is given may be off by any scale between the last two: it is normalised.
QUATERNION_NORM_TOLERANCE = 0.1
# Of an attitude in a log or message.
NORM_TOLERANCE = compiled.NORM_TOLERANCE
_MIN_QUATERNION_NORM, _MAX_QUATERNION_NORM = 0.5, 1e6


@njit(cache=True)
def within(values: Array, limit: float) -> bool:
    """Whether every magnitude is at most `limit`."""
    for index in range(values.size):  # noqa: SIM110 - numba compiles no generators
        if not abs(values[index]) <= limit:
            return False
    return True


@njit(cache=True)
def usable_imu(rates: Array, specific_force: Array) -> bool:
    """Whether rates (3,) rad/s and specific force (3,) m/s² can be those of a flight."""
    return within(rates, RATE_MAX_RAD_S) and within(specific_force, SPECIFIC_FORCE_MAX_M_S2)


@njit(cache=True)
def usable_rotor_speeds(speeds: Array, highest: float) -> bool:
    """Whether speeds (4,) rad/s can be those of rotors whose sensors read `highest` at most."""
    for rotor in range(speeds.size):  # noqa: SIM110 - as above
        if not 0.0 <= speeds[rotor] <= highest:
            return False
    return True


@njit(cache=True)
def usable_pose(position: Array, attitude: Array) -> bool:
    """Whether a position (3,) m can be measured, and an attitude (4,) is a rotation, but for its norm."""
    norm2 = attitude[0] ** 2 + attitude[1] ** 2 + attitude[2] ** 2 + attitude[3] ** 2
    return within(position, POSITION_MAX_M) and bool(
        _MIN_QUATERNION_NORM**2 <= norm2 <= _MAX_QUATERNION_NORM**2
    )


@njit(cache=True)
def usable_velocity(velocity: Array) -> bool:
    """Whether a measured velocity (3,) m/s can be that of a flight."""
    return within(velocity, MEASURED_SPEED_MAX_M_S)


@njit(cache=True)
def usable_airspeed(velocity: Array) -> bool:
    """Whether a velocity (3,) m/s of the vehicle's state or of the air can be that of a flight."""
    return within(velocity, AIRSPEED_MAX_M_S)


@njit(cache=True)
def unit_attitude(attitude: Array) -> bool:
    """Whether a quaternion (4,) is near unit length."""
    return bool(abs(np.sqrt(np.sum(attitude * attitude)) - 1.0) <= QUATERNION_NORM_TOLERANCE)
