# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Vibration of the body: what the IMU logs above 5 Hz, and what the stack measured at full rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from quadpi_core.field.airborne import Flown
from quadpi_core.field.field_log import FieldLog
from quadpi_core.records import Threshold

VIBE = Threshold(
    "ArduPilot's VIBE, exceeded in a twentieth of the flight, that is a warning, and an alarm",
    (30.0, 60.0),
    "m/s²",
    "ardupilot.org, Measuring Vibration: below 30 is normal, above 60 nearly always spoils the position",
    "none: the autopilot's documentation",
)
_SLOWEST_HZ = 20.0


@dataclass(frozen=True)
class Vibration:
    """Vibration in the air by body axis; what the log does not tell is None.

    Attributes:
        force: standard deviation of specific force above 5 Hz, m/s². It lacks what is faster than half of
            `rate_hz` or filtered before it is logged: limits of vibration, of raw samples at 1 kHz and more,
            do not hold for it.
        rates: likewise, rad/s.
        rate_hz: of the IMU in the log.
        vibe: ArduPilot's measure of raw samples, m/s², exceeded in a twentieth of the flight.
    """

    force: tuple[float, ...] | None = None
    rates: tuple[float, ...] | None = None
    rate_hz: float = 0.0
    vibe: tuple[float, ...] | None = None

    @property
    def worst(self) -> tuple[str, float] | None:
        """Axis with the most of what can be judged, and how much."""
        return None if self.vibe is None else max(zip("xyz", self.vibe, strict=True), key=lambda own: own[1])


def vibration_of(log: FieldLog, flight: Flown) -> Vibration | str:
    """Vibration, or why it cannot be told."""
    vibe = None
    if log.vibe is not None:
        own = np.vstack([log.vibe.during(one.begin, one.end).values for one in flight.stretches])
        vibe = tuple(np.quantile(own, 0.95, axis=0).tolist()) if len(own) else None
    spread, why = None, ""
    rate = 0.0 if log.imu is None else log.imu.rate_hz
    if log.imu is None:
        why = "the log has no gyro and accelerometer"
    elif rate < _SLOWEST_HZ:
        why = f"the IMU is logged at {rate:.0f} Hz"
    else:
        filtered = signal.butter(2, 5.0, "highpass", fs=rate, output="sos")
        values = [log.imu.during(one.begin, one.end).values for one in flight.stretches]
        parts = [
            signal.sosfilt(filtered, own - own[0], axis=0)[int(0.5 * rate) :]
            for own in values
            if len(own) > rate
        ]
        spread, why = np.std(np.vstack(parts), axis=0) if parts else None, "the flight is too short"
    if spread is not None:
        return Vibration(tuple(spread[3:].tolist()), tuple(spread[:3].tolist()), rate, vibe)
    return why if vibe is None else Vibration(vibe=vibe)
