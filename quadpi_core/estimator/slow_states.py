# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""States that come too seldom to be interpolated correct the filter instead, each part with its own noise.

The IMU fills the time between them. Their noise is what the messages say, else what the vehicle file says, else
it is estimated: of the deviations of smoothed states from measurements, by expectation and maximisation, in
which the smoother's own variance counts (R. Shumway, D. Stoffer, An approach to time series smoothing and
forecasting using the EM algorithm, 1982, eq. 14).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core import rotations
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_state import ATTITUDE, POSITION, VELOCITY
from quadpi_core.estimator.smoother import smooth
from quadpi_core.flight import MAX_GAP_NS, OdometryStream, PoseStream, Recording, TwistStream
from quadpi_core.frames import Array
from quadpi_core.screening.rates import BRIDGED_HZ
from quadpi_core.signals.resample import nominal_rate
from quadpi_core.vehicle import Vehicle

# Of a state by GPS: position m, attitude rad, velocity m/s.
_USUAL = (1.0, 0.03, 0.1)
# Of a long flight as much tells the noise; four rounds change it by less than a tenth from the usual one.
_LEARNED_S, _ROUNDS = 120.0, 4
# No state is surer than this: errors that stay are not seen in what changes.
_SUREST = (0.01, 0.002, 0.01)


def is_slow(odometry: OdometryStream) -> bool:
    """Whether states come too seldom to be interpolated."""
    steps = np.diff(odometry.time_ns)
    return len(steps) > 0 and bool(np.any(steps > MAX_GAP_NS)) and nominal_rate(odometry.time_ns) < BRIDGED_HZ


def with_slow_state(recording: Recording, vehicle: Vehicle, *, estimate: bool = True) -> Recording:
    """The recording with a slow state as measurements of a pose and a velocity; any other as it is.

    Args:
        recording: of which motion capture, where it has any, counts before a state.
        vehicle: for the noise where messages do not state it.
        estimate: the noise where nothing tells it; else that of a usual GPS.
    """
    odometry = recording.odometry
    if recording.pose is not None or recording.twist is not None or odometry is None:
        return recording
    if not is_slow(odometry):
        return recording
    usual = np.array([told or usual for told, usual in zip(vehicle.noise.of_state, _USUAL, strict=True)])
    corrected = measured_state(recording, odometry, usual)
    unknown = np.array([told is None for told in vehicle.noise.of_state])
    unknown &= ~np.any(odometry.deviation, axis=0)
    return _learned(corrected, odometry, vehicle, usual, unknown) if estimate and unknown.any() else corrected


def measured_state(recording: Recording, odometry: OdometryStream, usual: Array) -> Recording:
    """The recording with states as measurements, their noise `usual` (3,) where they do not state it."""
    deviation = np.where(odometry.deviation == 0.0, usual, odometry.deviation)
    # As a receiver measures it; in body axes it would hold the error of the attitude twice.
    velocity = rotations.rotate_body_to_world(odometry.attitude, odometry.velocity)
    in_world = np.zeros(len(odometry), dtype=bool)
    arrivals = dict(recording.arrivals)
    arrived = arrivals.pop(OdometryStream.topic, None)
    if arrived is not None:
        arrivals |= {PoseStream.topic: arrived, TwistStream.topic: arrived}
    return replace(
        recording,
        pose=PoseStream(odometry.time_ns, odometry.position, odometry.attitude, deviation[:, :2].copy()),
        twist=TwistStream(odometry.time_ns, velocity, in_world, deviation[:, 2].copy()),
        odometry=None,
        arrivals=arrivals,
    )


def _learned(
    recording: Recording, odometry: OdometryStream, vehicle: Vehicle, usual: Array, unknown: Array
) -> Recording:
    """The recording with the noise of what is unknown (3,) as the flight itself tells it."""
    end_ns = int(recording.imu.time_ns[0]) + round(1e9 * _LEARNED_S)
    part = replace(recording, imu=recording.imu.take(recording.imu.time_ns < end_ns), arrivals={})
    states = odometry.take(odometry.time_ns < end_ns)
    for _ in range(_ROUNDS):
        measured = measured_state(part, states, usual)
        segments = Ekf(vehicle, nominal_rate(part.imu.time_ns)).segments(measured)
        found = smooth(part.imu, segments)
        taken_ns = states.time_ns - np.round(1e9 * np.interp(states.time_ns, found.time_ns, found.delay_s))
        at = np.searchsorted(found.time_ns, taken_ns)
        inside = (at > 0) & (at < len(found))
        at, seen = at[inside], states.take(inside)
        if len(at) == 0:
            break
        assert measured.twist is not None
        turned = rotations.products(rotations.inverses(found.attitude[at]), seen.attitude)
        off = (
            (seen.position - found.position[at], POSITION),
            (rotations.to_rotation_vector(turned), ATTITUDE),
            (measured.twist.velocity[inside] - found.velocity[at], VELOCITY),
        )
        variance = [np.mean(np.square(error) + found.variance[at, own]) for error, own in off]
        usual = np.where(unknown, np.maximum(np.sqrt(variance), _SUREST), usual)
    return measured_state(recording, odometry, usual)
