# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bring the live topics together: one complete sample per IMU stamp.

An IMU sample is complete once the state for its stamp and a rotor speed at or after its stamp have
arrived. Rotor speeds (and the state, where its stamps differ) are interpolated linearly to the IMU stamp;
wind, slow and optional, holds its last value. Everything is bounded: fixed-size buffers, and an IMU sample
that stays incomplete while the IMU runs ahead by the timeout is dropped and counted.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from quadpi_core.flight import Stamps
from quadpi_core.frames import Array

Row: TypeAlias = tuple[Array, ...]

# How long, in stamps, an IMU sample waits for its state and rotor speed; live and in replay.
TIMEOUT_S = 0.1

_CALM: Array = np.zeros(3)
_NO_STATE: Row = (np.full(3, np.nan), np.full(4, np.nan), np.full(3, np.nan))
_NO_ROTOR_SPEEDS: Array = np.full(4, np.nan)
_NEVER = -(2**63)
# A stamp further back than this is a new beginning (a bag that starts over), not a late sample.
_JUMP_BACK_NS = 1_000_000_000


class PairedSamples(NamedTuple):
    """K complete samples: stamps (K,) and the arguments of `Monitor.step` in its order.

    velocity (K, 3) m/s over ground and rates (K, 3) rad/s in body axes, attitude (K, 4) body to world,
    specific_force (K, 3) m/s², rotor_speeds (K, 4) rad/s, wind (K, 3) m/s in the world.
    """

    time_ns: Stamps
    velocity: Array
    attitude: Array
    rates: Array
    specific_force: Array
    rotor_speeds: Array
    wind: Array


@dataclass
class PairingCounts:
    """What became of the samples so far.

    Attributes:
        paired: IMU samples that were completed.
        early: IMU samples from before the first state or rotor speed; nothing could complete them.
        dropped: IMU samples given up because their state or rotor speed did not arrive in time.
        disordered: samples of any topic refused because their stamp did not advance.
    """

    paired: int = 0
    early: int = 0
    dropped: int = 0
    disordered: int = 0


class Pairing:
    """The bounded buffers between the topics and the monitor.

    Args:
        timeout_s: how far, in stamps, the IMU may run ahead of an incomplete sample before it is given up.
        capacity: samples kept per topic; the oldest makes room.
    """

    def __init__(self, timeout_s: float = TIMEOUT_S, capacity: int = 256) -> None:
        self.counts = PairingCounts()
        self._timeout_ns = round(timeout_s * 1e9)
        self._capacity = capacity
        self._imu = _Track(capacity)
        self._state = _Track(capacity)
        self._rotor_speeds = _Track(capacity)
        self._wind = _Track(capacity)

    def add_imu(self, time_ns: int, specific_force: Array) -> None:
        """Take one IMU sample: specific_force (3,) m/s², body axes."""
        self._add(self._imu, time_ns, (specific_force,))

    def add_state(self, time_ns: int, velocity: Array, attitude: Array, rates: Array) -> None:
        """Take one state: velocity (3,) m/s and rates (3,) rad/s, body axes; attitude (4,) body to world."""
        if len(self._state) and float(self._state.newest[1] @ attitude) < 0.0:
            attitude = -attitude
        self._add(self._state, time_ns, (velocity, attitude, rates))

    def add_rotor_speeds(self, time_ns: int, speeds: Array) -> None:
        """Take one sample of the rotor speeds (4,) rad/s."""
        self._add(self._rotor_speeds, time_ns, (speeds,))

    def add_wind(self, time_ns: int, velocity: Array) -> None:
        """Take one sample of the wind (3,) m/s in the world."""
        self._add(self._wind, time_ns, (velocity,))

    def take(self) -> PairedSamples | None:
        """The IMU samples completed or given up since the last call, in order; None if there are none."""
        rows = []
        while len(self._imu):
            time_ns, (specific_force,) = self._imu.oldest
            if self._state.starts_after(time_ns) or self._rotor_speeds.starts_after(time_ns):
                self.counts.early += 1
            elif self._state.reaches(time_ns) and self._rotor_speeds.reaches(time_ns):
                self.counts.paired += 1
                rows.append(self._complete(time_ns, specific_force))
            elif len(self._imu) < self._capacity and self._imu.newest_ns - time_ns <= self._timeout_ns:
                break
            elif self._state and self._rotor_speeds:
                self.counts.dropped += 1
                rows.append((time_ns, *_NO_STATE, specific_force, _NO_ROTOR_SPEEDS, _CALM))
            else:
                self.counts.early += 1
            self._imu.drop_oldest()
        if not rows:
            return None
        return PairedSamples(*(np.array(column) for column in zip(*rows, strict=True)))

    def _complete(self, time_ns: int, specific_force: Array) -> tuple[int | Array, ...]:
        velocity, attitude, rates = self._state.interpolate(time_ns)
        (rotor_speeds,) = self._rotor_speeds.interpolate(time_ns)
        wind = self._wind.hold(time_ns)
        return (
            time_ns,
            velocity,
            attitude / np.sqrt(attitude @ attitude),
            rates,
            specific_force,
            rotor_speeds,
            _CALM if wind is None else wind[0],
        )

    def _add(self, track: _Track, time_ns: int, row: Row) -> None:
        if not track.add(time_ns, row):
            self.counts.disordered += 1


class _Track:
    """The last samples of one topic, each a stamp and a row of arrays; stamps strictly increase."""

    def __init__(self, capacity: int) -> None:
        self.newest_ns = _NEVER
        self._samples: deque[tuple[int, Row]] = deque(maxlen=capacity)

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def oldest(self) -> tuple[int, Row]:
        return self._samples[0]

    @property
    def newest(self) -> Row:
        return self._samples[-1][1]

    def add(self, time_ns: int, row: Row) -> bool:
        """Append a sample; False if its stamp does not advance."""
        if time_ns <= self.newest_ns:
            if self.newest_ns - time_ns <= _JUMP_BACK_NS:
                return False
            self._samples.clear()
        self.newest_ns = time_ns
        self._samples.append((time_ns, row))
        return True

    def drop_oldest(self) -> None:
        self._samples.popleft()

    def reaches(self, time_ns: int) -> bool:
        """Whether a sample at or after the stamp has arrived."""
        return self.newest_ns >= time_ns

    def starts_after(self, time_ns: int) -> bool:
        """Whether every sample kept is later than the stamp: nothing can be interpolated there."""
        return bool(self._samples) and self._samples[0][0] > time_ns

    def hold(self, time_ns: int) -> Row | None:
        """The last row at or before the stamp, forgetting earlier ones; None if there is none."""
        while len(self._samples) > 1 and self._samples[1][0] <= time_ns:
            self._samples.popleft()
        if not self._samples or self._samples[0][0] > time_ns:
            return None
        return self._samples[0][1]

    def interpolate(self, time_ns: int) -> Row:
        """The row at the stamp; asked only where `reaches` holds and `starts_after` does not."""
        self.hold(time_ns)
        before_ns, before = self._samples[0]
        if before_ns == time_ns:
            return before
        after_ns, after = self._samples[1]
        fraction = (time_ns - before_ns) / (after_ns - before_ns)
        return tuple(a + fraction * (b - a) for a, b in zip(before, after, strict=True))
