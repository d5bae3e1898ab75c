# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tachometers judged in flight by the motor commands: which read another multiple, and which nothing."""

from __future__ import annotations

import math

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.vehicle import HALF_READING, SILENT_SHARE

# Speeds are compared over about this long, so that lags and single samples do not count.
_MEMORY_S = 1.0
_FEWEST_S = 1.0


class TachometerWatch:
    """Compares rotor speeds as measured with those by the commands."""

    def __init__(self) -> None:
        self._measured: Array | None = None
        self._commanded: Array | None = None
        self._began_ns = self._last_ns = 0

    def take(self, time_ns: int, measured: Array, commanded: Array) -> None:
        """Take the speeds (R,) rad/s at an instant, where the rotors are commanded to turn."""
        if not (np.all(commanded > 0.0) and np.all(np.isfinite(measured))):
            return
        if self._measured is None or self._commanded is None or time_ns < self._last_ns:
            self._measured, self._commanded = measured.copy(), commanded.copy()
            self._began_ns = time_ns
        share = 1.0 - math.exp(-1e-9 * (time_ns - self._last_ns) / _MEMORY_S) if self._last_ns else 0.0
        self._measured += share * (measured - self._measured)
        self._commanded += share * (commanded - self._commanded)
        self._last_ns = time_ns

    def found(self, alarm: bool) -> tuple[str, ...]:
        """A sentence for each tachometer that does not read what the others do at their commands.

        Args:
            alarm: whether the model's alarm is raised: a rotor that stands changes the wrench, a sensor none.
        """
        if self._measured is None or self._commanded is None:
            return ()
        if self._last_ns - self._began_ns < 1e9 * _FEWEST_S:
            return ()
        gains = self._measured / self._commanded
        low, high = HALF_READING.value
        told = []
        for rotor, gain in enumerate(gains.tolist()):
            # Of four that are all silent none is odd: they are judged by the commands alone.
            others = float(np.median(np.delete(gains, rotor)))
            ratio = gain / others if others > SILENT_SHARE.value else gain
            if ratio < SILENT_SHARE.value:
                why = (
                    "it stands, the alarm is raised"
                    if alarm
                    else "it is silent, the vehicle flies as commanded"
                )
                told.append(f"the tachometer of rotor {rotor + 1} reads nothing: {why}")
            elif not low < ratio < high:
                told.append(
                    f"the tachometer of rotor {rotor + 1} reads {ratio:.2f} of what its command gives"
                )
        return tuple(told)
