# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The first estimate of the EKF, from the first second of samples; causal, so live can use it."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from quadpi_core import frames
from quadpi_core.core import compiled, matrix_times, times_each
from quadpi_core.estimator.filter_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    BODY_VELOCITY,
    DELAY,
    ERROR_STATES,
    ESTIMATE,
    GYRO_BIAS,
    POSE,
    POSITION,
    VELOCITY,
)
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array, best_rotation, rotate_body_to_world, rotation_matrix
from quadpi_core.records import Records
from quadpi_core.screening.flight_runs import START_NS, START_POSES
from quadpi_core.signals.chain import interpolate_columns
from quadpi_core.vehicle import SensorNoise, Vehicle

COLLECT_NS = 1_000_000_000
# Motion capture may be this late and still start the filter: its buffer reaches so far back.
_LATEST_NS = 400_000_000
_VELOCITY_FIT_NS = START_NS
_MIN_SAMPLES = START_POSES
# Samples kept of each kind: a second of the fastest IMU and more.
_COLLECTED_MAX = 8192
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
# Measurements of a slow source that start the filter, and how many are kept for it: several seconds' worth.
_FEWEST, _OLDER_MAX = 3, 64


class Initial(NamedTuple):
    """The first estimate.

    Attributes:
        estimate: (1,) an :class:`quadpi_core.estimator.filter_state.Estimate`.
        imu_ns: stamp of the IMU sample at or before it.
    """

    estimate: Records
    imu_ns: int

    @property
    def time_ns(self) -> int:
        """Its instant."""
        return int(self.estimate["time_ns"][0])


class _State(NamedTuple):
    """The state at the last measurement.

    Attributes:
        covariance: (16, 16) as if the delay of motion capture were known.
        by_delay: (16,) change of the state per second of delay.
        acceleration: (3,) m/s² over ground, world.
    """

    position: Array
    velocity: Array
    attitude: Array
    gyro_bias: Array
    covariance: Array
    by_delay: Array
    acceleration: Array


class CollectedSamples:
    """Samples from which the filter starts, once they suffice.

    Attributes:
        imu: IMU samples, each (1,), oldest first.
        measurements: poses and velocities, each (1,), in the order of their arrival.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._noise, self._gravity = vehicle.noise, vehicle.gravity_m_s2
        self.imu: deque[Records] = deque(maxlen=_COLLECTED_MAX)
        self.measurements: deque[Records] = deque(maxlen=_COLLECTED_MAX)
        # Measurements before those, for sources of less than twenty a second.
        self._older: deque[Records] = deque(maxlen=_OLDER_MAX)

    def clear(self) -> None:
        """Forget all samples."""
        self.imu.clear()
        self.clear_measurements()

    def clear_measurements(self) -> None:
        """Forget all poses and velocities."""
        self.measurements.clear()
        self._older.clear()

    @property
    def second_of_imu(self) -> Records | None:
        """(N,) the IMU samples if they span a second."""
        if int(self.imu[-1]["time_ns"][0]) - int(self.imu[0]["time_ns"][0]) < COLLECT_NS:
            return None
        return _joined(self.imu)

    def initial(self, imu: Records) -> Initial | None:
        """The first estimate, from the poses or without any from the velocities.

        If they do not suffice, samples more than a second older than the last of `imu` (N,) are forgotten.
        """
        initial = None
        if self.measurements:
            measurements = _joined(self.measurements)
            if np.any(measurements["deviation"]) or not _is_fast(measurements):
                recent = _joined(deque([*self._older, *self.measurements]))
                initial = initial_from_few(imu, recent, self._noise, self._gravity)
            else:
                poses = measurements[measurements["kind"] == POSE]
                start, of = (
                    (initial_from_poses, poses) if len(poses) else (initial_from_velocities, measurements)
                )
                initial = start(imu, of, self._noise, self._gravity)
        if initial is None:
            oldest_ns = int(imu["time_ns"][-1]) - COLLECT_NS
            while self.imu and self.imu[0]["time_ns"][0] < oldest_ns:
                self.imu.popleft()
            while self.measurements and self.measurements[0]["time_ns"][0] < oldest_ns:
                self._older.append(self.measurements.popleft())
        return initial


def _is_fast(measurements: Records) -> bool:
    """Whether poses, or without any velocities, come often enough for a line through START_NS of them."""
    poses = measurements[measurements["kind"] == POSE]
    time_ns = (poses if len(poses) else measurements)["time_ns"]
    return len(time_ns) < 2 or float(np.median(np.diff(time_ns))) <= START_NS / (START_POSES - 1)


def initial_from_few(
    imu: Records, measurements: Records, noise: SensorNoise, gravity: float
) -> Initial | None:
    """Estimate at the last attitude, from a source that is slow or states its noise; gravity in m/s².

    Position and attitude are as measured, the velocity the last one, else the slope of a line through the
    positions; the gyro bias is zero. Without any attitude velocities give it, as of a source that is fast.

    Returns:
        The estimate, or None if the measurements are too few or too old.
    """
    delay_ns = round(1e9 * noise.mocap_delay_s)
    measurements = measurements[np.argsort(measurements["time_ns"], kind="stable")]
    measurements = measurements[measurements["time_ns"] - delay_ns <= imu["time_ns"][-1]]
    is_pose = measurements["kind"] == POSE
    stated = measurements["deviation"]
    turned = measurements[is_pose & (stated[:, 1] >= 0.0)]
    placed, moving = measurements[is_pose & (stated[:, 0] >= 0.0)], measurements[~is_pose]
    if len(turned) == 0:
        noise = replace(noise, mocap_velocity_m_s=_deviation(moving, 0, noise.mocap_velocity_m_s))
        return initial_from_velocities(imu, moving, noise, gravity, fewest=_FEWEST)
    last, time_ns = turned[-1:], int(turned["time_ns"][-1]) - delay_ns
    if time_ns < imu["time_ns"][0] or imu["time_ns"][-1] - time_ns > _LATEST_NS:
        return None
    attitude = last["attitude"][0] / np.linalg.norm(last["attitude"][0])
    position_std = _deviation(placed, 0, noise.mocap_position_m)
    fresh = moving[moving["time_ns"] >= last["time_ns"][0] - COLLECT_NS]
    if len(fresh):
        velocity = fresh["vector"][-1]
        if fresh["kind"][-1] == BODY_VELOCITY:
            velocity = matrix_times(rotation_matrix(attitude), velocity)
        # As old as it may be, it differs by what a vehicle accelerates in the meantime.
        age_s = 1e-9 * abs(int(fresh["time_ns"][-1] - last["time_ns"][0]))
        velocity_std = np.hypot(_deviation(fresh, 0, noise.mocap_velocity_m_s), gravity * age_s)
    elif len(placed) >= _FEWEST:
        span_s = 1e-9 * float(placed["time_ns"][-1] - placed["time_ns"][0])
        velocity = _slope(placed["time_ns"], placed["vector"])
        velocity_std = np.hypot(_VELOCITY_STD_M_S * max(1.0, span_s), np.sqrt(12.0) * position_std / span_s)
    else:
        return None
    covariance = _covariance(
        position=position_std,
        velocity=float(velocity_std),
        attitude=_deviation(last, 1, noise.mocap_attitude_rad),
        gyro_bias=_GYRO_BIAS_STD_RAD_S,
    )
    at = imu[_last_before(imu, time_ns)]
    acceleration = _over_ground(rotation_matrix(attitude), at["specific_force"], gravity)
    by_delay = np.zeros(ERROR_STATES)
    by_delay[POSITION], by_delay[VELOCITY] = velocity, acceleration
    by_delay[ATTITUDE], by_delay[DELAY] = at["rates"], 1.0
    position = placed["vector"][-1] if len(placed) else np.zeros(3)
    state = _State(position, velocity, attitude, np.zeros(3), covariance, by_delay, acceleration)
    return _initial(imu, time_ns, state, noise)


def _deviation(measurements: Records, part: int, unstated: float) -> float:
    """Standard deviation of a part of the last of some measurements, by the vehicle file unless stated."""
    stated = float(measurements["deviation"][-1, part]) if len(measurements) else 0.0
    return stated if stated > 0.0 else unstated


def initial_from_poses(imu: Records, poses: Records, noise: SensorNoise, gravity: float) -> Initial | None:
    """Estimate at the last pose that is not later than the last IMU sample.

    Position and attitude are that pose, velocity the slope of a line through the last 0.2 s of poses, gyro
    bias the mean of the gyro minus the mean rate of the attitudes, accelerometer bias zero. The covariance
    covers the delay of motion capture.

    Args:
        imu: (N,) each :class:`quadpi_core.estimator.filter_state.ImuSample`, oldest first.
        poses: (M,) each :class:`quadpi_core.estimator.filter_state.Measurement`, oldest first.
        noise: of the sensors, for the covariance.
        gravity: m/s².

    Returns:
        The estimate, or None if the poses are too few or too old.
    """
    time_ns, poses = _taken(imu, poses, noise)
    if not _enough(imu, time_ns):
        return None
    within = (imu["time_ns"] >= time_ns[0]) & (imu["time_ns"] <= time_ns[-1])
    if not within.any():
        return None
    position = poses["vector"]
    attitude = poses["attitude"] / np.linalg.norm(poses["attitude"], axis=1, keepdims=True)
    recent = time_ns >= time_ns[-1] - _VELOCITY_FIT_NS
    velocity = _slope(time_ns[recent], position[recent])
    mean_rates = np.average(frames.body_rates(time_ns, attitude), axis=0, weights=np.diff(time_ns))
    gyro_bias = imu["rates"][within].mean(axis=0) - mean_rates

    last = int(np.flatnonzero(within)[-1])
    first_rates, last_rates = imu["rates"][within][0], imu["rates"][last]
    acceleration = _over_ground(rotation_matrix(attitude[-1]), imu["specific_force"][last], gravity)
    span_s = 1e-9 * float(time_ns[-1] - time_ns[0])
    rate_std = np.sqrt(2.0) * noise.mocap_attitude_rad / span_s
    covariance = _covariance(
        position=noise.mocap_position_m,
        velocity=_VELOCITY_STD_M_S,
        attitude=noise.mocap_attitude_rad,
        gyro_bias=float(np.sqrt(np.square(_GYRO_BIAS_STD_RAD_S) + np.square(rate_std))),
    )
    by_delay = np.zeros(ERROR_STATES)
    by_delay[POSITION], by_delay[VELOCITY] = velocity, acceleration
    by_delay[ATTITUDE] = last_rates - gyro_bias
    by_delay[GYRO_BIAS] = (first_rates - last_rates) / span_s
    by_delay[DELAY] = 1.0
    state = _State(position[-1], velocity, attitude[-1], gyro_bias, covariance, by_delay, acceleration)
    return _initial(imu, int(time_ns[-1]), state, noise)


def initial_from_velocities(
    imu: Records, velocities: Records, noise: SensorNoise, gravity: float, fewest: int = _MIN_SAMPLES
) -> Initial | None:
    """Estimate at the last velocity not later than the last IMU sample, of M `velocities`; gravity in m/s².

    The gyro gives how the vehicle turned, so the integral of the specific force can be expressed in the last
    body axes; less the change of velocity it is gravity, which levels the attitude. The heading follows from
    velocities in the world where the vehicle accelerates sideways; else it is free, with a large variance.
    The position counts from here.

    Returns:
        The estimate, or None if the velocities are too few or too old.
    """
    time_ns, velocities = _taken(imu, velocities, noise)
    if not _enough(imu, time_ns, fewest):
        return None
    in_body = bool(np.all(velocities["kind"] == BODY_VELOCITY))
    if not in_body:
        in_world = velocities["kind"] != BODY_VELOCITY
        time_ns, velocities = time_ns[in_world], velocities[in_world]
        if not _enough(imu, time_ns, fewest):
            return None
    last_ns = int(time_ns[-1])
    into_last = rotation_matrix(_relative_attitudes(imu, last_ns))
    edges = np.linspace(time_ns[0], last_ns, _BLOCKS + 1).astype(np.int64)
    pushed = _integrals(imu, times_each(into_last, imu["specific_force"]), edges)
    duration = 1e-9 * np.diff(edges)
    velocity = velocities["vector"]
    if in_body:
        nearest = np.searchsorted(imu["time_ns"], time_ns).clip(0, len(imu) - 1)
        velocity = times_each(into_last[nearest], velocity)
    gained = np.diff(interpolate_columns(time_ns, velocity, edges), axis=0)
    if in_body:
        # Nothing will ever show this heading: it is a choice, as the origin is.
        rotation, heading_std = _level((gained - pushed).sum(axis=0) / duration.sum()), _TILT_STD_RAD
        velocity = times_each(rotation, velocity)
    else:
        gained = gained - gravity * duration[:, None] * [0.0, 0.0, 1.0]
        rotation, heading_std = _align(pushed, gained, noise.mocap_velocity_m_s)

    covariance = _covariance(
        position=noise.mocap_position_m,
        velocity=noise.mocap_velocity_m_s,
        attitude=_TILT_STD_RAD,
        gyro_bias=float(np.sqrt(2.0) * _GYRO_BIAS_STD_RAD_S),
    )
    if in_body:
        covariance[VELOCITY, VELOCITY] += (
            np.square(_TILT_STD_RAD) * np.sum(np.square(velocity[-1])) * np.eye(3)
        )
    down = rotation.T[:, 2]
    covariance[ATTITUDE, ATTITUDE] += np.square(heading_std) * np.outer(down, down)
    last = _last_before(imu, last_ns)
    acceleration = _over_ground(rotation, imu["specific_force"][last], gravity)
    by_delay = np.zeros(ERROR_STATES)
    by_delay[VELOCITY], by_delay[DELAY] = acceleration, 1.0
    attitude, zero = frames.quaternion_of(rotation), np.zeros(3)
    state = _State(zero, velocity[-1], attitude, zero, covariance, by_delay, acceleration)
    return _initial(imu, last_ns, state, noise)


def _over_ground(rotation: Array, specific_force: Array, gravity: float) -> Array:
    """Acceleration (3,) m/s² in the world of a body that feels a specific force (3,) m/s²."""
    return matrix_times(rotation, specific_force) + np.array([0.0, 0.0, gravity])


def _covariance(position: float, velocity: float, attitude: float, gyro_bias: float) -> Array:
    """Covariance (16, 16) of these standard deviations; that of the accelerometer bias is always the same."""
    std = np.zeros(ERROR_STATES)
    std[POSITION], std[VELOCITY], std[ATTITUDE], std[GYRO_BIAS] = position, velocity, attitude, gyro_bias
    std[ACCELEROMETER_BIAS] = _ACCELEROMETER_BIAS_STD_M_S2
    return np.diag(std**2)


def _taken(imu: Records, measurements: Records, noise: SensorNoise) -> tuple[Stamps, Records]:
    """When each measurement was taken, as far as known beforehand; of those within the IMU samples."""
    time_ns = measurements["time_ns"] - round(1e9 * noise.mocap_delay_s)
    keep = (time_ns >= imu["time_ns"][0]) & (time_ns <= imu["time_ns"][-1])
    return time_ns[keep], measurements[keep]


def _enough(imu: Records, time_ns: Stamps, fewest: int = _MIN_SAMPLES) -> bool:
    """Whether measurements at those stamps are enough and recent enough to start from."""
    if len(time_ns) < fewest or imu["time_ns"][-1] - time_ns[-1] > _LATEST_NS:
        return False
    if fewest < _MIN_SAMPLES:
        return bool(time_ns[-1] - time_ns[0] >= COLLECT_NS // 2)
    recent = time_ns >= time_ns[-1] - _VELOCITY_FIT_NS
    spans = time_ns[0] <= time_ns[-1] - _VELOCITY_FIT_NS
    return bool(spans and np.count_nonzero(recent) >= _MIN_SAMPLES)


def _last_before(imu: Records, time_ns: int) -> int:
    """Index of the last IMU sample at or before a stamp."""
    return int(np.searchsorted(imu["time_ns"], time_ns, side="right")) - 1


def _initial(imu: Records, time_ns: int, state: _State, noise: SensorNoise) -> Initial:
    """The estimate, its covariance including the effect of the delay."""
    last = imu[_last_before(imu, time_ns)]
    delay_variance = np.square(noise.mocap_delay_std_s)
    covariance = state.covariance + delay_variance * np.outer(state.by_delay, state.by_delay)
    # Half the curvature times the squared delay, which the linear model leaves out.
    left_out = 0.5 * np.square(delay_variance)
    covariance[POSITION, POSITION] += left_out * np.diag(state.acceleration**2)
    covariance[ATTITUDE, ATTITUDE] += left_out * np.square(compiled.ANGULAR_ACCELERATION) * np.eye(3)
    covariance[DELAY, DELAY] = delay_variance
    estimate = np.zeros(1, ESTIMATE)
    estimate["time_ns"] = time_ns
    estimate["rates"], estimate["specific_force"] = last["rates"], last["specific_force"]
    estimate["position"], estimate["velocity"] = state.position, state.velocity
    estimate["attitude"], estimate["gyro_bias"] = state.attitude, state.gyro_bias
    estimate["delay"], estimate["covariance"] = noise.mocap_delay_s, covariance
    return Initial(estimate, int(last["time_ns"]))


def _slope(time_ns: Stamps, values: Array) -> Array:
    """Slope (3,) per second of the least-squares line through values (N, 3) at stamps (N,)."""
    time = 1e-9 * (time_ns - time_ns[0]).astype(np.float64)
    centred = time - time.mean()
    return np.sum(centred[:, None] * values, axis=0) / np.sum(centred * centred)


def _relative_attitudes(imu: Records, last_ns: int) -> Array:
    """Attitudes (N, 4) at the IMU samples relative to the body at `last_ns`, by the gyro alone."""
    attitude = np.empty((len(imu), 4))
    compiled.relative_attitudes(imu, last_ns, attitude)
    return attitude


def _integrals(imu: Records, values: Array, edges: Stamps) -> Array:
    """Integrals (len(edges) - 1, 3) of values (N, 3) at the IMU's stamps, between consecutive edges."""
    time_ns = imu["time_ns"]
    steps = 0.5e-9 * np.diff(time_ns)[:, None] * (values[1:] + values[:-1])
    total = np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0)))
    return np.diff(interpolate_columns(time_ns, total, edges), axis=0)


def _level(down: Array) -> Array:
    """Rotation (3, 3) body to world of heading zero, for which `down` (3,) in body axes points down."""
    x, y, z = down / np.sqrt(np.sum(np.square(down)))
    cp = np.sqrt(y * y + z * z)
    sr, cr, sp = (y / cp, z / cp, -x) if cp > 0.0 else (0.0, 1.0, -x)
    return np.array([[cp, sr * sp, cr * sp], [0.0, cr, -sr], [-sp, sr * cp, cr * cp]])


def _align(body: Array, world: Array, velocity_std: float) -> tuple[Array, float]:
    """Rotation (3, 3) that best turns vectors (K, 3) of the body onto those of the world; its heading's std.

    Where all vectors are parallel the heading is free: it is zero.
    """
    rotation, sizes = best_rotation(body, world)
    turning = np.sqrt(max(sizes[1], 0.0))
    if turning > _LEAST_TURNING:
        heading_std = 2.0 * velocity_std / turning
        return rotation, float(np.clip(heading_std, _HEADING_STD_LEAST_RAD, _HEADING_STD_RAD))
    level = _level(-body.sum(axis=0))
    tilted, wanted = matrix_times(level, body.sum(axis=0)), world.sum(axis=0)
    axis = np.cross(tilted, wanted) / np.sqrt(np.sum(np.square(tilted)) * np.sum(np.square(wanted)))
    turned = rotate_body_to_world(frames.from_rotation_vector(axis), level.T)
    return turned.T, _HEADING_STD_RAD


def _joined(records: deque[Records]) -> Records:
    """Records (1,) as one array, within microseconds: np.concatenate promotes their dtypes one by one."""
    return np.frombuffer(bytearray().join(record.data for record in records), records[0].dtype)
