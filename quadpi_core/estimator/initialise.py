# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The first estimate of the EKF, from the first second of samples; causal, so live can use it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.estimator.corrections import ANGULAR_ACCELERATION, BODY_VELOCITY
from quadpi_core.estimator.propagate import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    DELAY,
    ERROR_STATES,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    Row,
)
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.signals import rotations
from quadpi_core.vehicle import SensorNoise

COLLECT_NS = 1_000_000_000
# Motion capture may be this late and still start the filter: its buffer reaches so far back.
_LATEST_NS = 400_000_000
_VELOCITY_FIT_NS = 200_000_000
_MIN_SAMPLES = 5
# The line fit is wrong by half the fit's span times the acceleration: 10 m/s² for a vehicle in flight.
_VELOCITY_STD_M_S = 1.0
_ACCELEROMETER_BIAS_STD_M_S2 = 0.3
_GYRO_BIAS_STD_RAD_S = 0.02
# Of an attitude from velocities: what the accelerometer's bias tilts it by; a heading that is not known.
_TILT_STD_RAD = 0.1
_HEADING_STD_RAD = 1.8
_HEADING_STD_LEAST_RAD = 0.05
# Accelerations in a second [m/s] by which a heading shows in velocities of the world.
_LEAST_TURNING = 0.3
_BLOCKS = 5

ImuSample: TypeAlias = tuple[int, Array]
Measurement: TypeAlias = tuple[int, int, Array]


class Initial(NamedTuple):
    """An estimate (279,) at `time_ns`, between the IMU sample stamped `imu_ns` and the next."""

    time_ns: int
    imu_ns: int
    row: Array


class _Inertial(NamedTuple):
    """IMU samples: stamps (N,), rates (N, 3) rad/s and specific force (N, 3) m/s²."""

    time_ns: Stamps
    rates: Array
    force: Array


class _Start(NamedTuple):
    """State at the last measurement, its covariance, and how the state changes per second of delay."""

    position: Array
    velocity: Array
    attitude: Array
    gyro_bias: Array
    variance: Array
    by_delay: Array


def initial_from_poses(
    imu: Sequence[ImuSample], poses: Sequence[Measurement], noise: SensorNoise, gravity: float
) -> Initial | None:
    """Estimate at the last pose that is not later than the last IMU sample.

    Position and attitude are that pose, velocity the slope of a line through the last 0.2 s of poses, gyro
    bias the mean of the gyro minus the mean rate of the attitudes, accelerometer bias zero. What the delay of
    motion capture makes of it is in the covariance.

    Args:
        imu: stamp and sample (6,), rates rad/s and specific force m/s², oldest first.
        poses: stamp, kind, position m (world) and attitude (7,), oldest first.
        noise: of the sensors, for the covariance.
        gravity: m/s².

    Returns:
        The estimate, or None if the poses are too few or too old.
    """
    inertial = _inertial(imu)
    time_ns, _, values = _seen(inertial, poses, noise)
    if not _enough(inertial, time_ns):
        return None
    position = values[:, :3]
    attitude = values[:, 3:] / np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    last_ns = int(time_ns[-1])
    recent = time_ns >= last_ns - _VELOCITY_FIT_NS
    rate = np.average(rotations.body_rates(time_ns, attitude), axis=0, weights=np.diff(time_ns))
    within = (inertial.time_ns >= time_ns[0]) & (inertial.time_ns <= last_ns)
    if not within.any():
        return None
    gyro_bias = inertial.rates[within].mean(axis=0) - rate
    span_s = 1e-9 * (last_ns - int(time_ns[0]))
    velocity = _slope(time_ns[recent], position[recent])

    last = int(np.flatnonzero(within)[-1])
    first_rates, last_rates = inertial.rates[within][0], inertial.rates[last]
    acceleration = rotation_matrix(attitude[-1:])[0] @ inertial.force[last] + [0.0, 0.0, gravity]
    variance = np.zeros((ERROR_STATES, ERROR_STATES))
    std = np.empty(15)
    std[POSITION] = noise.mocap_position_m
    std[VELOCITY] = _VELOCITY_STD_M_S
    std[ATTITUDE] = noise.mocap_attitude_rad
    std[GYRO_BIAS] = np.hypot(_GYRO_BIAS_STD_RAD_S, np.sqrt(2.0) * noise.mocap_attitude_rad / span_s)
    std[ACCELEROMETER_BIAS] = _ACCELEROMETER_BIAS_STD_M_S2
    variance[range(15), range(15)] = std**2
    by_delay = np.concatenate(
        (
            velocity,
            acceleration,
            last_rates - gyro_bias,
            (first_rates - last_rates) / span_s,
            np.zeros(3),
            [1.0],
        )
    )
    start = _Start(position[-1], velocity, attitude[-1], gyro_bias, variance, by_delay)
    return _initial(inertial, last_ns, start, noise, acceleration)


def initial_from_velocities(
    imu: Sequence[ImuSample], velocities: Sequence[Measurement], noise: SensorNoise, gravity: float
) -> Initial | None:
    """Estimate at the last velocity that is not later than the last IMU sample.

    The gyro tells how the vehicle turned; what the accelerometer adds up to, less the change of velocity, is
    gravity: that levels the attitude. The heading is found from velocities in the world where the vehicle
    accelerates sideways; else it is free, with a large variance. The position counts from here.

    Args:
        imu: see :func:`initial_from_poses`.
        velocities: stamp, kind, velocity m/s (7,), oldest first.
        noise: see there.
        gravity: see there.

    Returns:
        The estimate, or None if the velocities are too few or too old.
    """
    inertial = _inertial(imu)
    time_ns, kinds, values = _seen(inertial, velocities, noise)
    if not _enough(inertial, time_ns):
        return None
    velocity, last_ns = values[:, :3], int(time_ns[-1])
    body = bool(np.all(kinds == BODY_VELOCITY))
    if not body:
        keep = kinds != BODY_VELOCITY
        time_ns, velocity = time_ns[keep], velocity[keep]
        if not _enough(inertial, time_ns):
            return None
        last_ns = int(time_ns[-1])
    relative = rotation_matrix(_relative_attitudes(inertial.time_ns, inertial.rates, last_ns))
    edges = np.linspace(time_ns[0], last_ns, _BLOCKS + 1).astype(np.int64)
    pushed = _integrated(inertial, np.einsum("nij,nj->ni", relative, inertial.force), edges)
    duration = 1e-9 * np.diff(edges)
    nearest = np.searchsorted(inertial.time_ns, time_ns).clip(0, len(inertial.time_ns) - 1)
    if body:
        velocity = np.einsum("nij,nj->ni", relative[nearest], velocity)
    at_edges = np.stack([np.interp(edges, time_ns, velocity[:, axis]) for axis in range(3)], axis=1)
    gained = np.diff(at_edges, axis=0)
    if body:
        down = (gained - pushed).sum(axis=0) / duration.sum()
        rotation, heading_std = _level(down), _HEADING_STD_RAD
        velocity = velocity @ rotation.T
    else:
        gained = gained - gravity * duration[:, None] * [0.0, 0.0, 1.0]
        rotation, heading_std = _turned_onto(pushed, gained, noise.mocap_velocity_m_s)
    last = int(np.searchsorted(inertial.time_ns, last_ns, side="right")) - 1
    acceleration = rotation @ inertial.force[last] + [0.0, 0.0, gravity]

    variance = np.zeros((ERROR_STATES, ERROR_STATES))
    std = np.empty(15)
    std[POSITION] = noise.mocap_position_m
    std[VELOCITY] = noise.mocap_velocity_m_s
    std[ATTITUDE] = _TILT_STD_RAD
    std[GYRO_BIAS] = np.sqrt(2.0) * _GYRO_BIAS_STD_RAD_S
    std[ACCELEROMETER_BIAS] = _ACCELEROMETER_BIAS_STD_M_S2
    variance[range(15), range(15)] = std**2
    down = rotation.T[:, 2]
    if body:
        # Nothing will ever tell this heading: it is a choice, as the origin is.
        heading_std = _TILT_STD_RAD
        variance[VELOCITY, VELOCITY] += _TILT_STD_RAD**2 * float(velocity[-1] @ velocity[-1]) * np.eye(3)
    variance[ATTITUDE, ATTITUDE] += heading_std**2 * np.outer(down, down)
    by_delay = np.concatenate((np.zeros(3), acceleration, np.zeros(9), [1.0]))
    attitude = _quaternion(rotation)
    start = _Start(np.zeros(3), velocity[-1], attitude, np.zeros(3), variance, by_delay)
    return _initial(inertial, last_ns, start, noise, acceleration)


def _inertial(imu: Sequence[ImuSample]) -> _Inertial:
    time_ns = np.array([stamp for stamp, _ in imu], dtype=np.int64)
    samples = np.array([sample for _, sample in imu])
    return _Inertial(time_ns, np.ascontiguousarray(samples[:, :3]), np.ascontiguousarray(samples[:, 3:]))


def _seen(
    inertial: _Inertial, measurements: Sequence[Measurement], noise: SensorNoise
) -> tuple[Stamps, Stamps, Array]:
    """When each measurement was true as far as known beforehand, its kind and value."""
    known_ns = round(1e9 * noise.mocap_delay_s)
    time_ns = np.array([stamp for stamp, _, _ in measurements], dtype=np.int64) - known_ns
    kinds = np.array([kind for _, kind, _ in measurements], dtype=np.int64)
    values = np.array([value for _, _, value in measurements]).reshape(len(measurements), -1)
    keep = (time_ns >= inertial.time_ns[0]) & (time_ns <= inertial.time_ns[-1])
    return time_ns[keep], kinds[keep], values[keep]


def _enough(inertial: _Inertial, time_ns: Stamps) -> bool:
    """Whether measurements at those stamps are enough and recent enough to start from."""
    if len(time_ns) < _MIN_SAMPLES or inertial.time_ns[-1] - time_ns[-1] > _LATEST_NS:
        return False
    recent = time_ns >= time_ns[-1] - _VELOCITY_FIT_NS
    spans = time_ns[0] <= time_ns[-1] - _VELOCITY_FIT_NS
    return bool(spans and np.count_nonzero(recent) >= _MIN_SAMPLES)


def _initial(
    inertial: _Inertial, time_ns: int, start: _Start, noise: SensorNoise, acceleration: Array
) -> Initial:
    """The estimate as a row, its covariance that of the start and of what the delay makes of it."""
    last = int(np.searchsorted(inertial.time_ns, time_ns, side="right")) - 1
    delay_variance = noise.mocap_delay_std_s**2
    covariance = start.variance + delay_variance * np.outer(start.by_delay, start.by_delay)
    # Half the curvature times the squared delay, which the linear model leaves out.
    left_out = 0.5 * delay_variance**2
    covariance[POSITION, POSITION] += left_out * np.diag(acceleration**2)
    covariance[ATTITUDE, ATTITUDE] += left_out * ANGULAR_ACCELERATION**2 * np.eye(3)
    covariance[DELAY, DELAY] = delay_variance
    row = np.zeros(Row.WIDTH)
    row[Row.RATES], row[Row.FORCE] = inertial.rates[last], inertial.force[last]
    row[Row.POSITION], row[Row.VELOCITY], row[Row.ATTITUDE] = start.position, start.velocity, start.attitude
    row[Row.GYRO_BIAS] = start.gyro_bias
    row[Row.DELAY] = noise.mocap_delay_s
    row[Row.COVARIANCE] = covariance.ravel()
    return Initial(time_ns, int(inertial.time_ns[last]), row)


def _slope(time_ns: Stamps, values: Array) -> Array:
    """Slope (3,) per second of the least-squares line through values (N, 3) at stamps (N,)."""
    time = 1e-9 * (time_ns - time_ns[0]).astype(np.float64)
    centred = time - time.mean()
    slope: Array = centred @ values / (centred @ centred)
    return slope


@njit(cache=True)
def _relative_attitudes(time_ns: Stamps, rates: Array, last_ns: int) -> Array:
    """Attitudes (N, 4) at the stamps relative to the body at `last_ns`, by the gyro alone."""
    attitude = np.zeros((len(time_ns), 4))
    last = np.searchsorted(time_ns, last_ns, side="right") - 1
    attitude[:, 0] = 1.0
    for index in range(last - 1, -1, -1):
        half = 0.5e-9 * (time_ns[index + 1] - time_ns[index])
        turn = (
            -half * (rates[index, 0] + rates[index + 1, 0]),
            -half * (rates[index, 1] + rates[index + 1, 1]),
            -half * (rates[index, 2] + rates[index + 1, 2]),
        )
        w, x, y, z = rotations.product(attitude[index + 1], rotations.from_rotation_vector(turn))
        attitude[index, 0], attitude[index, 1], attitude[index, 2], attitude[index, 3] = w, x, y, z
    return attitude


def _integrated(inertial: _Inertial, values: Array, edges: Stamps) -> Array:
    """Integrals (len(edges) - 1, 3) of values (N, 3) at the IMU's stamps, between consecutive edges."""
    steps = 0.5e-9 * np.diff(inertial.time_ns)[:, None] * (values[1:] + values[:-1])
    total = np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0)))
    at_edges = np.stack([np.interp(edges, inertial.time_ns, total[:, axis]) for axis in range(3)], axis=1)
    integrals: Array = np.diff(at_edges, axis=0)
    return integrals


def _level(down: Array) -> Array:
    """Rotation (3, 3) body to world of heading zero, for which `down` (3,) in body axes points down."""
    x, y, z = down / np.linalg.norm(down)
    roll, pitch = np.arctan2(y, z), -np.arcsin(np.clip(x, -1.0, 1.0))
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    return np.array([[cp, sr * sp, cr * sp], [0.0, cr, -sr], [-sp, sr * cp, cr * cp]])


def _turned_onto(body: Array, world: Array, velocity_std: float) -> tuple[Array, float]:
    """Rotation (3, 3) that best turns vectors (K, 3) of the body onto those of the world; its heading's std.

    Wahba's problem by singular values. Where all vectors are parallel the heading is free: it is zero.
    """
    u, sizes, vt = np.linalg.svd(world.T @ body)
    turning = np.sqrt(max(sizes[1], 0.0))
    if turning > _LEAST_TURNING:
        rotation: Array = u @ np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)]) @ vt
        return rotation, float(
            np.clip(2.0 * velocity_std / turning, _HEADING_STD_LEAST_RAD, _HEADING_STD_RAD)
        )
    level = _level(-body.sum(axis=0))
    tilted, wanted = level @ body.sum(axis=0), world.sum(axis=0)
    axis = np.cross(tilted, wanted) / (np.linalg.norm(tilted) * np.linalg.norm(wanted))
    turn = np.array(rotations.from_rotation_vector(axis))
    return rotation_matrix(turn[None])[0] @ level, _HEADING_STD_RAD


def _quaternion(rotation: Array) -> Array:
    """Unit quaternion (4,) of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation

    quaternion: Array = np.roll(Rotation.from_matrix(rotation).as_quat(), 1)
    return quaternion
