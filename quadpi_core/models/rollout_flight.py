# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights as they are predicted ahead: motion and attitude on an even time grid of about 100 Hz."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import Flight, hole_ends
from quadpi_core.frames import Array
from quadpi_core.inputs import relative_to_air
from quadpi_core.models.physical_regressors import MOTION
from quadpi_core.records import Records
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.vehicle import Vehicle

# Samples that are predicted [Hz], about: signals have passed a low-pass at 30 Hz.
_RATE_HZ = 100.0
# A rotor below this share of its median speed over a flight was not measured: a sensor that drops out reads
# zero, and no flight of the data sets lets a rotor below 0.3.
_MISSING_SHARE = 0.2


@dataclass(frozen=True)
class RolloutFlight:
    """A flight on an even time grid.

    Attributes:
        name: of the flight.
        time: (N,) s.
        attitude: (N, 4) body to world; of flights that training gave, heading counts from their start.
        motion: MOTION (N,), rotor speeds not delayed.
        wrench: (N, 6) measured, N and Nm.
        position: (N, 3) m in the world, measured, relative to the air where there is wind; None where it is
            not measured, or not kept.
    """

    name: str
    time: Array
    attitude: Array
    motion: Records
    wrench: Array
    position: Array | None = None

    @classmethod
    def of(cls, flight: Flight, vehicle: Vehicle) -> RolloutFlight:
        """Of a flight that passed its low-pass, thinned to about 100 Hz."""
        motion = np.zeros(len(flight), MOTION)
        motion["velocity"] = relative_to_air(flight.velocity, flight.attitude, flight.wind)
        motion["rates"] = flight.rates
        motion["angular_acceleration"] = flight.angular_acceleration
        motion["rotor_speeds"] = flight.rotor_speeds
        motion["rotor_accelerations"] = np.gradient(flight.rotor_speeds, flight.time, axis=0)
        steps = 0.5 * np.diff(flight.time)[:, np.newaxis] * (flight.wind[1:] + flight.wind[:-1])
        drift = np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0)))
        every = slice(None, None, max(1, round(flight.rate_hz / _RATE_HZ)))
        return cls(
            flight.name,
            flight.time[every],
            flight.attitude[every],
            motion[every],
            measured_wrench(flight, vehicle)[every],
            (flight.position - drift)[every] if flight.position_measured else None,
        )

    @property
    def step(self) -> float:
        """Seconds between samples."""
        return float(np.median(np.diff(self.time)))

    def delayed(self, delay_s: float) -> RolloutFlight:
        """The flight with rotor speeds as they were so much earlier."""
        if delay_s == 0.0:
            return self
        # Slow to import, and no model in flight needs it.
        from scipy.interpolate import CubicSpline

        motion, earlier = self.motion.copy(), np.clip(self.time - delay_s, self.time[0], None)
        for name in ("rotor_speeds", "rotor_accelerations"):
            motion[name] = CubicSpline(self.time, self.motion[name], axis=0)(earlier)
        return replace(self, motion=motion)

    def starts(self, last: int, every: int) -> npt.NDArray[np.int64]:
        """Every k-th sample, from which on rotor speeds were measured for `last` samples without a hole."""
        starts = np.arange(0, len(self.time) - last, every, dtype=np.int64)
        holes = hole_ends(self.time)
        whole = np.searchsorted(holes, starts, "right") == np.searchsorted(holes, starts + last, "right")
        speeds = self.motion["rotor_speeds"]
        missing = np.any(speeds < _MISSING_SHARE * np.median(speeds, axis=0), axis=1)
        count = np.concatenate(([0], np.cumsum(missing)))
        measured = count[starts + last + 1] == count[starts]
        kept: npt.NDArray[np.int64] = starts[whole & measured]
        return kept


def horizon_steps(horizons_s: Sequence[float], step_s: float) -> npt.NDArray[np.int64]:
    """Samples (H,) nearest to horizons, one at least."""
    return np.maximum(1, np.rint(np.array(horizons_s) / step_s)).astype(np.int64)
