# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The consistency check in flight: collects samples of the first seconds in motion, then checks them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadpi_core.errors import LogError
from quadpi_core.flight import STREAM_KINDS, ImuStream, Recording, RotorSpeedStream, Stream
from quadpi_core.screening.consistency import findings
from quadpi_core.screening.plausibility import implausibilities
from quadpi_core.screening.sample_order import usable_recording
from quadpi_core.screening.wild_samples import screened
from quadpi_core.signals.chain import RATES, ROTOR_SPEEDS, SPECIFIC_FORCE
from quadpi_core.vehicle import Vehicle

# Length of a stretch. Of the bundled and the real flights, no stretch of 12 s or longer had a finding; one of
# 37 stretches of 8 s had.
STRETCH_S = 15.0
# Some mistakes show only in some manoeuvres, which the first stretch may lack.
STRETCHES = 3
# Root mean square of the turn rate above which the vehicle moves. A gyro at rest has 0.01, the calmest real
# flights have 0.2.
MOVES_RAD_S = 0.1
# Share of a stretch's samples that must have a state: of fewer, as on a slow computer, nothing is said.
PAIRED_SHARE = 0.5
# Arrays of samples that a topic beside the IMU may send within a stretch: 1 kHz, more than motion capture or
# speed controllers send. More come where the IMU has fallen silent; they are not kept.
ARRAYS_MAX = 15_000

_FIELDS = {kind: name for name, kind in STREAM_KINDS.items()}


class FirstSeconds:
    """Collects samples in flight into stretches of STRETCH_S, until there are STRETCHES in motion.

    Args:
        source: name of the stretches in messages.

    Attributes:
        lacking: why there is no stretch yet, or why the last one was of no use.
    """

    def __init__(self, source: str) -> None:
        self.lacking = f"it takes {STRETCH_S:g} s of motion"
        self._source = source
        self._left = STRETCHES
        self._kept: dict[type[Stream] | None, list[tuple[NDArray[Any], ...]]] = {}
        self._start_ns: int | None = None
        self._newest_ns = 0

    @property
    def complete(self) -> bool:
        """Whether no more samples are needed."""
        return self._left == 0

    def take(self, kind: type[Stream] | None, *columns: NDArray[Any]) -> Recording | None:
        """Collect samples as they arrive; those of the IMU complete a stretch.

        Args:
            kind: of their stream; None for samples of IMU and rotors with the columns of
                :mod:`quadpi_core.signals.chain`.
            columns: their stamps and values.

        Returns:
            The stretch, once it is complete, if the vehicle moved in it. Samples of other topics before the
            first of the IMU are left out.
        """
        if self.complete:
            return None
        is_imu = kind in (ImuStream, None)
        if is_imu or (self._start_ns is not None and len(self._kept.get(kind, ())) < ARRAYS_MAX):
            self._kept.setdefault(kind, []).append(columns)
        return self._advance(int(columns[0][-1])) if is_imu else None

    def _advance(self, time_ns: int) -> Recording | None:
        """Advance to the stamp of an IMU sample; the stretch that it completes, if the vehicle moved."""
        if self._start_ns is None:
            self._start_ns = time_ns
        elif time_ns < self._newest_ns:
            self._kept, self._start_ns = {}, None
        self._newest_ns = time_ns
        if self._start_ns is None or time_ns - self._start_ns < STRETCH_S * 1e9:
            return None
        kept, self._kept, self._start_ns = self._kept, {}, None
        joined = {kind: list(map(np.concatenate, zip(*parts, strict=True))) for kind, parts in kept.items()}
        if None in joined:
            stamps, values = joined.pop(None)
            # Rates come with the state: one that came too late is no fault of the gyro.
            paired = np.isfinite(values[:, RATES]).all(axis=1)
            if np.mean(paired) < PAIRED_SHARE:
                self.lacking = f"only {np.mean(paired):.0%} of the samples had a state"
                return None
            stamps, values = stamps[paired], values[paired]
            joined[ImuStream] = [stamps, values[:, RATES], values[:, SPECIFIC_FORCE]]
            joined[RotorSpeedStream] = [stamps, values[:, ROTOR_SPEEDS]]
        streams: dict[str, Any] = {_FIELDS[kind]: kind(*columns) for kind, columns in joined.items() if kind}
        stretch = Recording(name=self._source, vehicle="", source=self._source, **streams)
        if not np.sqrt(np.nanmean(np.sum(stretch.imu.angular_velocity**2, axis=1))) >= MOVES_RAD_S:
            self.lacking = f"in the last {STRETCH_S:g} s the vehicle did not move"
            return None
        self._left -= 1
        return stretch


def contradictions(stretch: Recording, vehicle: Vehicle | None) -> list[str]:
    """Sentences on mistakes in units, frames, clocks and the vehicle file that a stretch shows.

    Args:
        stretch: of :class:`FirstSeconds`.
        vehicle: whose rotor speeds are in it; without one only the motion is checked.
    """
    try:
        recording = screened(usable_recording(stretch), vehicle)
    except LogError as error:
        return [str(error).removeprefix(f"{stretch.source}: ")]
    wrong_units = list(implausibilities(recording, vehicle))
    return wrong_units or [str(finding) for finding in findings(recording, vehicle)]
