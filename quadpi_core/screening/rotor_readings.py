# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speeds of any source that are no measurements: 0 in flight, or those of a slow source that are held.

Their samples are left out. A rotor that truly stops keeps its samples; one that reads 0 for longer, or all
the time, is a finding of :mod:`quadpi_core.screening.rotors_in_flight`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from quadpi_core.findings import HELD, READS_ZERO
from quadpi_core.flight import Recording, Stamps
from quadpi_core.frames import Array
from quadpi_core.recording_blocks import Column
from quadpi_core.screening.rotors_in_flight import (
    STUCK_S,
    ZERO_RAD_S,
    Inertial,
    has_stopped,
    in_flight,
    resolution,
    runs_of,
)
from quadpi_core.screening.sample_order import Mask, Rows
from quadpi_core.thresholds import STANDARD_GRAVITY, Threshold

RETURNS_S = Threshold(
    "time between two readings with 0 in between, in which no rotor stops and turns again",
    0.15,
    "s",
    "with a time constant of 20 ms a rotor takes 0.1 s to come below 1 % of its speed, and as long to return",
    "motor lags of seven vehicles, 20 to 60 ms",
)
TURNS_SHARE = Threshold(
    "reading before and after a drop-out over the median of the rotor in flight",
    0.4,
    "1",
    "a rotor that stops, or begins to turn, reads less first; half of the thrust of hover is 0.7",
    "14 flights that begin with a throw, their rotors standing (INDIflight)",
)
HELD_SHARE = Threshold(
    "share of readings that more than one sample holds, in a table of a slower source",
    0.75,
    "1",
    "real logs repeat up to half of their readings; a source of half its table's rate, or less, nearly all",
    "118 real recordings of six vehicles; the 17 of the nanodrone benchmark repeat most",
)
HELD_STEPS = Threshold(
    "change of a held rotor speed to the next one",
    3.0,
    "steps of its resolution",
    "readings that stay the same for want of resolution go on by one step, held ones by many",
    "bundled flights in steps of 100 eRPM, and held for 20 to 250 ms",
)


class RotorScreening:
    """Finds samples of rotor speeds that are no measurements, in a flight that comes in blocks.

    Attributes:
        samples: number of samples so far.
    """

    def __init__(self) -> None:
        self.samples = 0
        # Half of the digits do: they are kept for the whole of a long flight.
        self._columns = (Column(), Column(), Column())

    def add(self, block: Recording) -> None:
        """Examine the next block."""
        if block.rotor_speeds is None:
            return
        self.samples += len(block.rotor_speeds)
        values = (block.rotor_speeds.speeds, *Inertial.from_recording(block)[1:])
        for column, part in zip(self._columns, values, strict=True):
            column.extend(part.astype(np.float32))

    def finish(self, rotors_ns: Stamps, imu_ns: Stamps, already: Rows) -> Iterator[tuple[Rows, str]]:
        """Indices of the samples of the rotor speeds that are no measurements, and why, in words.

        Args:
            rotors_ns: (N,) stamps of the rotor speeds.
            imu_ns: (M,) stamps of the IMU.
            already: indices of samples left out for another reason, but for those in which a rotor reads 0.
        """
        if not self.samples:
            return
        speeds, lift, rates = (column.whole() for column in self._columns)
        usable = np.isfinite(speeds).all(axis=1)
        usable[already] &= np.any(speeds[already] < ZERO_RAD_S.value, axis=1)
        repeats = usable & held(speeds)
        if np.any(repeats):
            seconds = float(np.ptp(rotors_ns)) * 1e-9
            rate_hz = np.count_nonzero(usable & ~repeats) / max(seconds, 1e-9)
            yield np.flatnonzero(repeats), f"in which {HELD}: its source gives {rate_hz:.3g} Hz"
            usable &= ~repeats
        inertial = Inertial(imu_ns, lift, rates).finite()
        if np.any(speeds[usable] < ZERO_RAD_S.value) and len(inertial.time_ns):
            zeros = dropped_out(rotors_ns[usable], speeds[usable], inertial)
            yield np.flatnonzero(usable)[zeros], f"in which {READS_ZERO}"


def dropped_out(time_ns: Stamps, speeds: Array, inertial: Inertial) -> Mask:
    """Samples (N,) around readings of 0 in flight, for less than STUCK_S, of a rotor that has not stopped.

    Args:
        time_ns: (N,) stamps.
        speeds: (N, rotors) rad/s, finite.
        inertial: of the flight, finite.
    """
    dropped = np.zeros(len(speeds), dtype=np.bool_)
    standing = speeds < ZERO_RAD_S.value
    if not np.any(standing) or np.any(np.diff(time_ns) <= 0):
        return dropped
    # The last reading before, or at the start the first one after, stands for 0.
    before, after = _whole_around(~standing)
    bridged = np.where(before >= 0, before, np.minimum(after, len(speeds) - 1))
    flying = in_flight(time_ns, np.take_along_axis(speeds, bridged, axis=0), inertial, STANDARD_GRAVITY)
    if flying is None:
        return dropped
    for rotor, column in enumerate(standing.T):
        turning = speeds[flying & ~column, rotor]
        if len(turning) == 0:
            continue
        whole = speeds[:, rotor] >= TURNS_SHARE.value * float(np.median(turning))
        # The ends of a recording are no evidence of a rotor that stands before or after it.
        before, after = _whole_around(whole)
        for begin, end in runs_of(column):
            first, last = int(before[begin]), int(after[end - 1])
            if (first < 0 < begin) or (last == len(speeds) > end):
                continue
            around_s = float(time_ns[min(last, len(speeds) - 1)] - time_ns[max(first, 0)]) * 1e-9
            if around_s >= STUCK_S.value or not np.all(flying[max(first, 0) : last + 1]):
                continue
            if around_s <= RETURNS_S.value or not has_stopped(time_ns, speeds, rotor, begin, inertial):
                dropped[first + 1 : last] = True
    return dropped


def _whole_around(whole: Mask) -> tuple[Rows, Rows]:
    """The last whole sample (N, ...) up to each, and the first from each on; −1 and N without one."""
    count = len(whole)
    rows = np.arange(count).reshape(-1, *[1] * (whole.ndim - 1))
    before = np.maximum.accumulate(np.where(whole, rows, -1), axis=0)
    after = np.minimum.accumulate(np.where(whole, rows, count)[::-1], axis=0)[::-1]
    return before, after


def held(speeds: Array) -> Mask:
    """Samples (N,) that repeat the one before, where a slow source is held in a fast table; else none.

    Args:
        speeds: (N, rotors) rad/s.
    """
    turning = np.any(speeds > ZERO_RAD_S.value, axis=1)
    same = np.zeros(len(speeds), dtype=np.bool_)
    same[1:] = np.all(speeds[1:] == speeds[:-1], axis=1) & turning[1:]
    # Readings, not samples, are counted: rotors that idle at one speed for long are one reading.
    news = turning & ~same
    repeated = int(np.count_nonzero(news[:-1] & same[1:]))
    if repeated < HELD_SHARE.value * max(int(np.count_nonzero(news)), 1):
        return np.zeros_like(same)
    changes = np.abs(np.diff(speeds, axis=0))[turning[1:] & ~same[1:]] / resolution(speeds)
    changes = changes[changes > 0.0]
    return same if len(changes) and np.median(changes) >= HELD_STEPS.value else np.zeros_like(same)
