# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The consistency check in flight: samples of the first seconds in motion, kept until it can judge them."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadpi_core.flight import STREAM_KINDS, ImuStream, Recording, Stream
from quadpi_core.screening.consistency import findings
from quadpi_core.screening.plausibility import finite_rows, implausibilities
from quadpi_core.screening.wild_samples import screened
from quadpi_core.vehicle import Vehicle

# Of the bundled and the real flights that were cut into stretches, none of 12 s or longer had a finding, and
# one of 37 of 8 s had.
STRETCH_S = 15.0
# Mistakes that show only in some manoeuvres may be missed by the first one.
STRETCHES = 3
# Root mean square of the turn rate in rad/s. A gyro at rest has 0.01, the calmest real flights have 0.2.
MOVES_RAD_S = 0.1

_FIELDS = {kind: name for name, kind in STREAM_KINDS.items()}


class FirstSeconds:
    """Samples of a flight under way, in stretches of STRETCH_S; none are kept after STRETCHES in motion.

    Args:
        source: what the stretches are called in messages.
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._left = STRETCHES
        self._kept: dict[type[Stream], list[Stream]] = {}
        self._start_ns = self._newest_ns = 0

    @property
    def complete(self) -> bool:
        """Whether no more samples are needed."""
        return self._left == 0

    def take(self, *streams: Stream) -> Recording | None:
        """Take samples as they come; the IMU's complete a stretch.

        Returns:
            The stretch, once it is complete and the vehicle moved in it; samples not finite, or whose
            stamps do not rise, are left out.
        """
        stretch = None
        for stream in streams:
            if self.complete:
                break
            self._kept.setdefault(type(stream), []).append(stream)
            if isinstance(stream, ImuStream):
                stretch = self._followed(int(stream.time_ns[-1])) or stretch
        return stretch

    def _followed(self, time_ns: int) -> Recording | None:
        """Go on to the stamp of an IMU sample."""
        first = len(self._kept[ImuStream]) == 1
        if first or time_ns < self._newest_ns:
            self._start_ns = time_ns
            if not first:
                self._kept = {}
        self._newest_ns = time_ns
        if time_ns - self._start_ns < STRETCH_S * 1e9:
            return None
        kept, self._kept = self._kept, {}
        parts: dict[str, Any] = {_FIELDS[kind]: _joined(streams) for kind, streams in kept.items()}
        stretch = Recording(name=self._source, vehicle="", source=self._source, **parts)
        if not np.sqrt(np.mean(np.sum(stretch.imu.angular_velocity**2, axis=1))) >= MOVES_RAD_S:
            return None
        self._left -= 1
        return stretch


def contradictions(stretch: Recording, vehicle: Vehicle | None) -> list[str]:
    """What a stretch says of mistakes in units, frames, clocks and the vehicle's numbers, in sentences.

    Args:
        stretch: of :class:`FirstSeconds`.
        vehicle: whose rotor speeds are in it; without one only the motion is looked at.
    """
    recording = screened(stretch, vehicle)
    wrong_units = list(implausibilities(recording, vehicle))
    return wrong_units or [str(finding) for finding in findings(recording, vehicle)]


def _joined(parts: list[Stream]) -> Stream:
    """One stream of several of a kind, of the samples that are finite and whose stamps rise."""
    kind = type(parts[0])
    names = list(vars(parts[0]))
    joined = kind(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
    before = np.maximum.accumulate(joined.time_ns)
    rises = np.concatenate(([True], joined.time_ns[1:] > before[:-1]))
    values = [getattr(joined, name) for name in names if name != "time_ns"]
    return joined.take(rises & finite_rows(*values))
