# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""States that are less sure than in the flights of a model widen its intervals by what that does to them.

A model's intervals hold what the states of its own flights erred by. What goes beyond, the difference of
variances, is handed to the model as the covariance of a state (:class:`.preparation.Conditions`); its own
slopes say what that does to each axis. Live and in replay it is the same.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from quadpi_core.estimator.filter_run import FusedSamples
from quadpi_core.flight import NO_STAMP, OdometryStream, Stamps
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import StateDeviation
from quadpi_core.monitor.preparation import CONDITIONS
from quadpi_core.records import Records, Threshold

UNSURE_S = Threshold(
    "time for which a state must have been less sure than in a model's flights",
    2.0,
    "s",
    "a filter that starts, or meets a jump of motion capture, has settled by then; GPS has not",
    "starts of the filter on imrc_brushless and neurobem of ../shared/data: 0.7 s at most",
)
_UNSURE_NS = round(1e9 * UNSURE_S.value)
# Samples wait for their rotor speeds no longer than this; a filter without states for so long starts anew.
_KEPT_NS = 1_000_000_000
_VELOCITY, _ATTITUDE = slice(0, 3), slice(3, 6)


class StateDeviations(NamedTuple):
    """How unsure states (K) are: root mean squares of standard deviations, 0 where nothing is known.

    Attributes:
        time_ns: (K,) stamps.
        velocity: (K,) m/s.
        attitude: (K,) rad.
    """

    time_ns: Stamps
    velocity: Array
    attitude: Array

    @classmethod
    def of_fused(cls, fused: FusedSamples) -> StateDeviations:
        """Of the filter's estimates, in the numbers that its messages carry."""
        return cls(fused.time_ns, _rms(fused.twist_covariance, 0), _rms(fused.pose_covariance, 3))

    @classmethod
    def of_odometry(cls, odometry: OdometryStream) -> StateDeviations:
        """Of states of another estimator, as far as its messages say."""
        told = np.maximum(odometry.stated, 0.0)
        return cls(odometry.time_ns, told[:, 2], told[:, 1])


def _rms(covariance: Array, first: int) -> Array:
    """Root mean square (K,) of three deviations of covariances (K, 6, 6), added in the order of messages."""
    total = covariance[:, first, first].copy()
    for axis in (first + 1, first + 2):
        total = total + covariance[:, axis, axis]
    return np.sqrt(np.maximum(total / 3.0, 0.0))


def deviation_of_one(fused: FusedSamples) -> tuple[float, float]:
    """Deviations of velocity, m/s, and attitude, rad, of one estimate: those of :class:`StateDeviations`."""
    velocity, attitude = (
        math.sqrt(
            max((own.item(0, at, at) + own.item(0, at + 1, at + 1) + own.item(0, at + 2, at + 2)) / 3.0, 0.0)
        )
        for own, at in ((fused.twist_covariance, 0), (fused.pose_covariance, 3))
    )
    return velocity, attitude


class UnsureStates:
    """Follows how sure states are, and tells what of it a model's intervals do not hold.

    Args:
        known: how unsure the states of the model's flights were.
    """

    def __init__(self, known: StateDeviation) -> None:
        self._known = known
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        # Stamps of the last state, and of the last that was sure, or the first after a pause.
        self._newest_ns = self._sure_ns = NO_STAMP
        # Stamps and variances beyond those known, since the first that is beyond.
        self._beyond: deque[tuple[Stamps, Array, Array]] = deque()

    @property
    def is_beyond(self) -> bool:
        """Whether a state of late was less sure than known."""
        return bool(self._beyond)

    def take_one(self, time_ns: int, velocity: float, attitude: float) -> None:
        """Take the deviations of one state."""
        if velocity <= self._known.velocity_m_s and attitude <= self._known.attitude_rad and not self._beyond:
            self._newest_ns = self._sure_ns = time_ns
            return
        self.take(StateDeviations(np.array([time_ns]), np.array([velocity]), np.array([attitude])))

    def take(self, states: StateDeviations) -> None:
        """Take those of the next states (K); blocks of any length have the same effect."""
        time_ns, velocity, attitude = states
        if len(time_ns) == 0:
            return
        if time_ns[0] < self._sure_ns:
            self.reset()
        known = self._known
        sure = (velocity <= known.velocity_m_s) & (attitude <= known.attitude_rad)
        sure |= np.diff(time_ns, prepend=self._newest_ns) > _KEPT_NS
        last_sure = np.maximum.accumulate(np.where(sure, time_ns, self._sure_ns))
        self._newest_ns, self._sure_ns = int(time_ns[-1]), int(last_sure[-1])
        # Where no sample asks for them, as the IMU is silent, states do not pile up.
        while len(self._beyond) > 1 and self._beyond[1][0][0] < time_ns[0] - 2 * _KEPT_NS:
            self._beyond.popleft()
        counts = time_ns - last_sure >= _UNSURE_NS
        if not self._beyond and not counts.any():
            return
        more = [
            np.where(counts, np.maximum(np.square(own) - limit * limit, 0.0), 0.0)
            for own, limit in ((velocity, known.velocity_m_s), (attitude, known.attitude_rad))
        ]
        self._beyond.append((time_ns, more[0], more[1]))

    def conditions(self, time_ns: Stamps) -> Records | None:
        """The conditions of samples (N,), none before the last; None where their states are sure enough."""
        if not self._beyond or len(time_ns) == 0:
            return None
        stamps, velocity, attitude = (np.concatenate(own) for own in zip(*self._beyond, strict=True))
        at = np.searchsorted(stamps, time_ns, side="right") - 1
        known = at >= 0
        found = np.zeros(len(time_ns), CONDITIONS)
        for part, variance in ((_VELOCITY, velocity), (_ATTITUDE, attitude)):
            own = np.where(known, variance[np.maximum(at, 0)], 0.0)
            for axis in range(part.start, part.stop):
                found["covariance"][:, axis, axis] = own
        kept = stamps >= int(time_ns[-1]) - _KEPT_NS
        kept[-1] = True
        self._beyond.clear()
        if velocity[kept].any() or attitude[kept].any():
            self._beyond.append((stamps[kept], velocity[kept], attitude[kept]))
        return found if found["covariance"].any() else None
