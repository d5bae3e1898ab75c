# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What makes a reading of rotor speeds unusable: one record for messages, log readers and screening.

What reports say of themselves is a :class:`Verdict`; :mod:`quadpi_core.screening.rotor_readings` finds the
rest in any stream: a rotor that reads 0 in flight, and speeds of a slow source that are held. Out of range is
what the vehicle file says (:attr:`quadpi_core.vehicle.Vehicle.rotor_speed_spike_rad_s`).
"""

from __future__ import annotations

from enum import IntEnum

# PX4 takes an ESC that has not reported for as long for gone (MavlinkStreamESCStatus).
SILENT_NS = 100_000_000


class Verdict(IntEnum):
    """Whether reports of speed controllers form a sample, or the reason why not."""

    SAMPLE = 0
    NONE_ANNOUNCED = 1
    TOO_FEW = 2
    MOTOR_MISSING = 3
    MOTOR_TWICE = 4
    OFFLINE = 5
    NEVER_REPORTED = 6
    SILENT = 7
    REPEATED = 8


OFFLINE = "an ESC is offline"
REASONS = {
    Verdict.NONE_ANNOUNCED: "no ESC is announced yet",
    Verdict.TOO_FEW: "fewer ESCs than `rotors` names",
    Verdict.MOTOR_MISSING: "no report of a motor that `rotors` names",
    Verdict.MOTOR_TWICE: "two reports of one motor",
    Verdict.OFFLINE: OFFLINE,
    Verdict.NEVER_REPORTED: "an ESC has not reported yet",
    Verdict.SILENT: "an ESC has fallen silent",
    Verdict.REPEATED: "repeats the reports before it",
}
READS_ZERO = "a rotor reads 0 in flight"
HELD = "no rotor speed is new"
