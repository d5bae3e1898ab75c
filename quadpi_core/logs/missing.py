# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a recording lacks, and what cannot be done with it for that reason."""

from __future__ import annotations

from collections.abc import Iterator

from quadpi_core.flight import Recording
from quadpi_core.signals.resample import nominal_rate

# Of rotors and airframe nothing is left in samples further apart.
_SLOWEST_IMU_HZ = 50.0
_MARGIN = 0.9


def missing(recording: Recording) -> Iterator[str]:
    """One sentence for each thing that is absent and rules something out."""
    if len(recording.imu) > 1 and (rate := nominal_rate(recording.imu.time_ns)) < _MARGIN * _SLOWEST_IMU_HZ:
        yield f"imu at {rate:.3g} Hz: identify, evaluate and replay need {_SLOWEST_IMU_HZ:g} Hz"
    if recording.rotor_speeds is None:
        yield "no rotor speeds: identify, evaluate and replay need them; only info can use this flight"
    if recording.pose is None and recording.odometry is None:
        yield "no velocity, and no pose to get it from: identify, evaluate and replay need one"
    elif recording.pose is None:
        yield "no motion capture: velocity and attitude are the autopilot's own estimate"
