# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the filter remembers: arrays that its compiled steps change in place, and where they hold what."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.estimator.corrections import VALUES, Count
from quadpi_core.estimator.propagate import Noise, Outcome, Row
from quadpi_core.flight import NO_STAMP, Stamps
from quadpi_core.frames import Array
from quadpi_core.signals.resample import RATE_SPAN

BUFFER_S = 0.5
# Measurements that wait; more than motion capture sends in the time by which it may be early.
_HELD = 256
_OUTCOMES = len(Outcome)


class Clock:
    """Where the clock (a row of whole numbers) holds what."""

    HEAD = 0  # row of the newest estimate
    FILLED = 1  # rows in use
    CORRECTED_NS = 2  # instant of the last correction
    HELD_FIRST = 3
    HELD_COUNT = 4
    ACCEPTED_NS = 5  # stamp of the IMU sample at which a correction was last accepted
    STATUS = 6
    JOURNALLED = 7
    JUMPED_NS = 8  # stamp of the IMU sample before, where that was far from all before it
    SPAN_NS = 9  # usual time of ten steps of the IMU; 0 where the rate is given
    OFF_NS = 10  # for how long nearly all spans of ten steps differ from that
    WIDTH = 11


class Source:
    """Where the record of one source of corrections holds what."""

    ARRIVED_NS = 0  # stamp of the last measurement that was held
    SEEN_NS = 1  # stamp since which the same value is repeated
    REPEATS = 2
    CHANGES = 3
    REFUSED_SINCE_NS = 4
    REFUSED_NS = 5
    REFUSED = 6
    WIDTH = 7


class Memory(NamedTuple):
    """All that the filter remembers; arrays that the kernels change in place.

    Attributes:
        clock: (11,) see :class:`Clock`.
        stamps: (N,) of the estimates in `rows`, a ring.
        rows: (N + 3, 279) estimates at the stamps of IMU samples, see :class:`Row`; then that after the last
            correction, at its own instant, and two to work on.
        held_ns, held: (H,), (H, 8) measurements that wait, with their kind in the last column; a ring.
        sources: (2, 7) of poses and velocities, see :class:`Source`.
        seen: (2, 14) value that each source measured last, and that it was last refused with.
        counts: (3, outcomes) of IMU samples, poses and velocities.
        noise: (12,) numbers of :class:`Noise`.
    """

    clock: Count
    stamps: Stamps
    rows: Array
    held_ns: Stamps
    held: Array
    sources: Count
    seen: Array
    counts: Count
    noise: Array


def allocate(rate_hz: float, noise: Noise) -> Memory:
    """An empty memory for an IMU of that rate."""
    length = max(int(np.ceil(BUFFER_S * rate_hz)), RATE_SPAN) + 3
    memory = Memory(
        clock=np.zeros(Clock.WIDTH, dtype=np.int64),
        stamps=np.zeros(length, dtype=np.int64),
        rows=np.zeros((length + 3, Row.WIDTH)),
        held_ns=np.zeros(_HELD, dtype=np.int64),
        held=np.zeros((_HELD, VALUES + 1)),
        sources=np.zeros((2, Source.WIDTH), dtype=np.int64),
        seen=np.zeros((2, 2 * VALUES)),
        counts=np.zeros((3, _OUTCOMES), dtype=np.int64),
        noise=np.array(noise, dtype=np.float64),
    )
    forget(memory)
    return memory


def forget(memory: Memory) -> None:
    """Make the memory empty, but for the counts."""
    for array in (memory.clock, memory.rows, memory.sources, memory.seen):
        array[...] = 0
    memory.sources[:, Source.ARRIVED_NS] = NO_STAMP
    memory.clock[Clock.JUMPED_NS] = NO_STAMP


def start(memory: Memory, time_ns: int, estimate: Array, imu_ns: int) -> None:
    """Begin with an estimate (279,) at `time_ns`, whose IMU sample is stamped `imu_ns`, at or before that."""
    forget(memory)
    length = len(memory.stamps)
    memory.stamps[0] = imu_ns
    memory.rows[0] = memory.rows[length] = estimate
    memory.clock[Clock.FILLED] = 1
    memory.clock[Clock.CORRECTED_NS] = time_ns
    memory.clock[Clock.ACCEPTED_NS] = imu_ns


@njit(cache=True)
def noise_of(numbers: Array) -> Noise:
    """The noise that an array of its numbers stands for."""
    return Noise(
        numbers[0],
        numbers[1],
        numbers[2],
        numbers[3],
        numbers[4],
        numbers[5],
        numbers[6],
        numbers[7],
        numbers[8],
        numbers[9],
        numbers[10],
        numbers[11],
    )
