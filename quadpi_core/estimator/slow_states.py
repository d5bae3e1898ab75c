# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""States that come too seldom to be interpolated correct the filter instead, each part with its own noise.

The IMU fills the time between them. Their noise is what the messages say, else what the vehicle file says,
else it is estimated from what smoothed states differ from measurements by, to which the smoother's own
variance is added: R. Shumway, D. Stoffer, "An approach to time series smoothing and forecasting using the EM
algorithm" (1982), eq. 14.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core import frames
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import smooth
from quadpi_core.estimator.filter_state import ATTITUDE, POSITION, VELOCITY
from quadpi_core.flight import NO_STAMP, OdometryStream, PoseStream, Recording, Stamps, TwistStream
from quadpi_core.frames import Array
from quadpi_core.screening.flight_runs import BRIDGED_HZ, is_slow_state
from quadpi_core.signals.chain import nominal_rate
from quadpi_core.vehicle import Vehicle

# Of a state by GPS: position m, attitude rad, velocity m/s.
_USUAL = (1.0, 0.03, 0.1)
# Of a long flight as much tells the noise; four rounds change it by less than a tenth from the usual one.
_LEARNED_S, _ROUNDS = 120.0, 4
# No state is surer than this: errors that stay are not seen in what changes.
_SUREST = (0.01, 0.002, 0.01)
# Velocity of a vehicle that nothing tells: unsure by so much, and so often, as errors of it last.
_STILL_M_S, _STILL_S = 2.0, 0.5
# States by which a flight shows how often they come.
_STATES_SEEN = 8
# Steps of velocities by which it is decided how often they come: by GPS of 5 Hz before the state has settled,
# and one step that is lost, or none, decides nothing.
VELOCITY_STEPS = 4
# Poses after which velocities, where there are any, have begun: two seconds at 100 Hz.
_POSES_SEEN = 200

# True or false (3,) for position, attitude and velocity.
_Parts: TypeAlias = npt.NDArray[np.bool_]
_Blocks: TypeAlias = Iterator[Recording]


def _corrects(odometry: OdometryStream) -> bool:
    """Whether states correct the filter: they come too seldom to be interpolated, or lack a part."""
    return is_slow_state(odometry) or bool(np.any(_lacking(odometry)))


def _lacking(odometry: OdometryStream) -> _Parts:
    """Which parts (3,) most of the states do not have."""
    return 2 * np.count_nonzero(odometry.deviation < 0.0, axis=0) > len(odometry)


class VelocityRate:
    """Whether the velocities of a state come as seldom as those of GPS, by the stamps of the first.

    Those of motion capture come often. Where poses have come without any for a while, none counts. It is
    decided once, by the same stamps live and in a replay.

    Attributes:
        slow_since_ns: stamp of the last IMU sample before the velocity by which they are known to come too
            seldom to be interpolated; None before that, and where they come often.
        stamps: of the first.
    """

    def __init__(self) -> None:
        self.slow_since_ns: int | None = None
        self.stamps: list[int] = []
        self._poses = 0

    @property
    def is_known(self) -> bool:
        """Whether no further stamp changes what is said."""
        return len(self.stamps) > VELOCITY_STEPS or (not self.stamps and self._poses > _POSES_SEEN)

    def take(self, time_ns: Sequence[int], imu_ns: Sequence[int], poses: int = 0) -> None:
        """Take so many poses without a velocity, and the next velocities.

        Args:
            time_ns: stamps of the velocities.
            imu_ns: of each, stamp of the last IMU sample that came before it, NO_STAMP for none.
            poses: their number.
        """
        self._poses += poses
        lacking = VELOCITY_STEPS + 1 - len(self.stamps)
        if self.is_known:
            return
        self.stamps += time_ns[:lacking]
        if len(time_ns) >= lacking and BRIDGED_HZ * 1e-9 * np.ptp(self.stamps) > VELOCITY_STEPS:
            self.slow_since_ns = imu_ns[lacking - 1]


def has_slow_velocity(recording: Recording) -> bool:
    """Whether velocities of a recording are of a state as by GPS, in whose flights the wind is sought."""
    state = recording.odometry
    if recording.pose is not None or recording.twist is not None or state is None:
        return with_velocity_rate(iter([recording]))[1] is not None
    return _corrects(state) and not _lacking(state)[2]


def with_velocity_rate(blocks: _Blocks) -> tuple[_Blocks, int | None]:
    """Blocks of a flight by motion capture, and :attr:`VelocityRate.slow_since_ns` of its velocities."""
    seen, velocities, newest_ns = [], VelocityRate(), NO_STAMP
    for block in blocks:
        seen.append(block)
        imu_ns = np.append(newest_ns, block.imu.time_ns)
        newest_ns = int(imu_ns[-1])
        stamps = [] if block.twist is None else block.twist.time_ns.tolist()
        before = [] if block.twist is None else imu_ns[block.arrivals_of(block.twist)].tolist()
        poses = np.empty(0) if block.pose is None else block.pose.time_ns
        velocities.take(stamps, before, int(np.sum(poses < stamps[0])) if stamps else len(poses))
        if velocities.is_known:
            break
    return chain(seen, blocks), velocities.slow_since_ns


def with_slow_state(recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording with a slow state as measurements of a pose and a velocity; any other as it is.

    Args:
        recording: of which motion capture, where it has any, counts before a state.
        vehicle: for the noise where messages do not state it; else it is estimated.
    """
    odometry = recording.odometry
    if recording.pose is not None or recording.twist is not None or odometry is None:
        return recording
    if not _corrects(odometry):
        return recording
    usual = usual_noise(vehicle)
    unknown = np.array([told is None for told in vehicle.noise.of_state])
    unknown &= ~np.any(odometry.stated, axis=0) & (len(odometry) >= _STATES_SEEN)
    if unknown.any():
        usual = _learned(recording, odometry, vehicle, usual, unknown)
    return _measured_state(recording, usual, _lacking(odometry))


def with_slow_states(blocks: _Blocks, vehicle: Vehicle) -> tuple[_Blocks, bool, int | None]:
    """Blocks of a flight that has odometry alone, whether it is slow, and since when it then has velocities.

    Looked at are the blocks that hold the first states, see :func:`with_slow_state`; noise that nothing tells
    is that of a usual GPS.
    """
    seen, states = [], 0
    for block in blocks:
        seen.append(block)
        states += 0 if block.odometry is None else len(block.odometry)
        if states >= _STATES_SEEN:
            break
    known = [block.odometry for block in seen if block.odometry is not None]
    every = chain(seen, blocks)
    if not known or not _corrects(first := OdometryStream.join(known)):
        return every, False, None
    lacking = _lacking(first)
    measured = map(partial(_measured_state, usual=usual_noise(vehicle), lacking=lacking), every)
    return measured, True, None if lacking[2] else NO_STAMP


def usual_noise(vehicle: Vehicle) -> Array:
    """Deviations (3,) of a state that does not say them."""
    return np.array([told or usual for told, usual in zip(vehicle.noise.of_state, _USUAL, strict=True)])


def _measured_state(recording: Recording, usual: Array, lacking: _Parts) -> Recording:
    """The recording with states as measurements, their noise `usual` (3,) where they do not state it.

    An attitude alone is taken as that of a vehicle that stays about where it is: velocity 0, as unsure as
    people fly, once in a while. Forces along x and y are then hardly told, thrust and moments are.
    """
    odometry = recording.odometry
    if odometry is None:
        return recording
    stated = odometry.stated
    deviation = np.where(stated == 0.0, usual, stated)
    stamps, chosen = odometry.time_ns, np.arange(len(odometry))
    twist: TwistStream | None = None
    if not lacking[2]:
        # As a receiver measures it; in body axes it would hold the error of the attitude twice.
        velocity = frames.rotate_body_to_world(odometry.attitude, odometry.velocity)
        in_world = np.zeros(len(odometry), dtype=bool)
        twist = TwistStream(stamps, velocity, in_world, deviation[:, 2].copy())
    elif lacking[0]:
        chosen, twist = _at_rest(stamps)
    arrivals = dict(recording.arrivals)
    arrived = arrivals.pop(OdometryStream.topic, None)
    if arrived is not None:
        arrivals[PoseStream.topic] = arrived
        if twist is not None:
            arrivals[TwistStream.topic] = arrived[chosen]
    pose = PoseStream(stamps, odometry.position, odometry.attitude, deviation[:, :2].copy())
    return replace(recording, pose=pose, twist=twist, odometry=None, arrivals=arrivals)


def _at_rest(stamps: Stamps) -> tuple[Stamps, TwistStream]:
    """Rows of states once in a while, and velocities of 0 at them, as unsure as people fly."""
    # By the clock, so that blocks of a flight give what the whole gives.
    periods, chosen = np.unique(stamps // round(1e9 * _STILL_S), return_index=True)
    still = np.zeros((len(chosen), 3))
    # A source that repeats itself to the bit is taken for frozen.
    still[:, 0] = 1e-9 * (periods % 2)
    in_world = np.zeros(len(chosen), dtype=bool)
    return chosen, TwistStream(stamps[chosen], still, in_world, np.full(len(chosen), _STILL_M_S))


def _learned(
    recording: Recording, odometry: OdometryStream, vehicle: Vehicle, usual: Array, unknown: Array
) -> Array:
    """The noise (3,) with what is unknown of it as the flight itself tells it."""
    end_ns = int(recording.imu.time_ns[0]) + round(1e9 * _LEARNED_S)
    imu, states = recording.imu.take(recording.imu.time_ns < end_ns), odometry.take(odometry.time_ns < end_ns)
    part = replace(recording, imu=imu, odometry=states, arrivals={})
    for _ in range(_ROUNDS):
        measured = _measured_state(part, usual, _lacking(odometry))
        segments = Ekf(vehicle, nominal_rate(part.imu.time_ns)).segments(measured)
        found = smooth(part.imu, segments)
        taken_ns = states.time_ns - np.round(1e9 * np.interp(states.time_ns, found.time_ns, found.delay_s))
        at = np.searchsorted(found.time_ns, taken_ns)
        inside = (at > 0) & (at < len(found))
        at, seen = at[inside], states.take(inside)
        if len(at) == 0:
            break
        turned = frames.products(frames.inverses(found.attitude[at]), seen.attitude)
        # Of a part that is not measured the number counts nowhere: its noise is not unknown.
        off = (
            (seen.position - found.position[at], POSITION),
            (frames.to_rotation_vector(turned), ATTITUDE),
            (frames.rotate_body_to_world(seen.attitude, seen.velocity) - found.velocity[at], VELOCITY),
        )
        variance = [np.mean(np.square(error) + found.variance[at, own]) for error, own in off]
        usual = np.where(unknown, np.maximum(np.sqrt(variance), _SUREST), usual)
    return usual
