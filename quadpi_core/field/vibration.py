# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Vibration of the body: what the IMU logs above 5 Hz, and what the stack measured at full rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from quadpi_core.field.airborne import Flown
from quadpi_core.field.estimates import Estimate, mean_of_pieces
from quadpi_core.field.field_log import FieldLog
from quadpi_core.records import Threshold

VIBE = Threshold(
    "ArduPilot's VIBE, exceeded in a twentieth of the flight, that is a warning, and an alarm",
    (30.0, 60.0),
    "m/s²",
    "ardupilot.org, Measuring Vibration: below 30 is normal, above 60 nearly always spoils the position",
    "none: the autopilot's documentation",
)
# A tenth of the flight each, within these: intervals leave them out.
_SLOWEST_HZ, _PIECES_S = 20.0, (1.5, 5.0)


@dataclass(frozen=True)
class Vibration:
    """Vibration in the air by body axis; what the log does not tell is None.

    Attributes:
        force, rates: root mean square of specific force, and of rates, above 5 Hz. It lacks what is faster
            than half of `rate_hz` or filtered before it is logged: limits of vibration, of raw samples at
            1 kHz and more, do not hold for it.
        rate_hz: of the IMU in the log.
        vibe: ArduPilot's measure of raw samples, m/s², exceeded in a twentieth of the flight.
    """

    force: tuple[Estimate, ...] = ()
    rates: tuple[Estimate, ...] = ()
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
    rate, parts = 0.0 if log.imu is None else log.imu.rate_hz, []
    why = (
        "the log has no gyro and accelerometer" if log.imu is None else f"the IMU is logged at {rate:.0f} Hz"
    )
    if log.imu is not None and rate >= _SLOWEST_HZ:
        filtered, why = signal.butter(2, 5.0, "highpass", fs=rate, output="sos"), "the flight is too short"
        values = [log.imu.during(one.begin, one.end).values for one in flight.stretches]
        long = [own - own[0] for own in values if len(own) > rate]
        parts = [signal.sosfilt(filtered, own, axis=0)[int(0.5 * rate) :] for own in long]
    if not parts:
        return why if vibe is None else Vibration(vibe=vibe)
    squares = np.vstack(parts) ** 2
    piece = np.arange(len(squares)) // (rate * np.clip(0.1 * len(squares) / rate, *_PIECES_S))
    told = [_root(mean_of_pieces(own, piece, ("rad/s", "m/s²")[n // 3])) for n, own in enumerate(squares.T)]
    return Vibration(tuple(told[3:]), tuple(told[:3]), rate, vibe)


def _root(one: Estimate) -> Estimate:
    value, low, high = (
        None if end is None else float(np.sqrt(max(end, 0.0))) for end in (one.value, one.low, one.high)
    )
    return Estimate(value, low, high, one.unit, one.reason)
