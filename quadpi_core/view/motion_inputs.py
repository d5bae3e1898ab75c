# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs of the models from odometry and rotor speeds, where nobody says what the monitor saw.

The monitor low-passes its inputs; the page draws the mean of 50 ms, which is as smooth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from quadpi_core.flight import MAX_GAP_NS, OdometryStream, RotorSpeedStream, Stamps, WindStream
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES, aerodynamic_inputs, relative_to_air
from quadpi_core.vehicle import Vehicle

STRETCH_NS = 50_000_000


class MotionInputs:
    """Input vectors of one vehicle.

    Args:
        vehicle: as in its vehicle file.

    Attributes:
        problem: why they are not known; empty where they are.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.problem = ""
        self._wind = np.zeros(3)
        self._vehicle = vehicle
        self._rotor_ns: Stamps = np.empty(0, dtype=np.int64)
        self._speeds = np.empty((0, vehicle.rotor_count))

    def take(
        self, states: OdometryStream | None, rotors: RotorSpeedStream | None, wind: WindStream | None
    ) -> tuple[Stamps, Array]:
        """Stamps (K,) and inputs (K, 19) of stretches of the states that have rotor speeds near them."""
        nothing = np.empty(0, dtype=np.int64), np.empty((0, len(INPUT_NAMES)))
        if wind is not None and len(wind.velocity):
            self._wind = wind.velocity[-1]
        if rotors is not None and len(rotors.time_ns):
            count = self._vehicle.rotor_count
            if rotors.speeds.shape[1] != count:
                self.problem = (
                    f"topic rotor_speeds: {rotors.speeds.shape[1]} rotors, vehicle {self._vehicle.name} has "
                    f"{count}: its inputs are not known"
                )
                return nothing
            # The last of before, for states between it and the first of now.
            self._rotor_ns = np.append(self._rotor_ns[-1:], rotors.time_ns)
            self._speeds = np.append(self._speeds[-1:], rotors.speeds, axis=0)
        if states is None or not len(self._rotor_ns):
            return nothing
        after = np.clip(np.searchsorted(self._rotor_ns, states.time_ns), 1, len(self._rotor_ns)) - 1
        near = np.abs(states.time_ns - self._rotor_ns[after]) <= MAX_GAP_NS
        if not near.any():
            return nothing
        time_ns = states.time_ns[near]
        speeds = [
            np.interp(time_ns, self._rotor_ns, self._speeds[:, rotor])
            for rotor in range(self._speeds.shape[1])
        ]
        first = np.flatnonzero(np.diff(time_ns // STRETCH_NS, prepend=-1))
        last = np.append(first[1:], len(time_ns)) - 1
        rows = np.column_stack((states.velocity[near], states.rates[near], *speeds))
        rows = np.add.reduceat(rows, first) / (last - first + 1)[:, None]
        attitude = states.attitude[near][last]
        velocity_air = relative_to_air(rows[:, :3], attitude, np.tile(self._wind, (len(rows), 1)))
        inputs = aerodynamic_inputs(
            velocity_air,
            attitude,
            np.ascontiguousarray(rows[:, 3:6]),
            np.ascontiguousarray(rows[:, 6:]),
            self._vehicle,
        )
        return time_ns[last], inputs


class Told(NamedTuple):
    """Words for one thing, from a stamp on; 0 is at once."""

    time_ns: int
    name: str
    words: str


# After this long [s] without a message it is said that none comes: an autopilot sends each at 0.5 Hz or more.
TOLD_S = 5.0
NO_MESSAGE = f"no message for {TOLD_S:.0f} s"


class Report(NamedTuple):
    """Fields that are read of a message, with how many numbers each has (0: text), and the words for them."""

    name: str
    fields: dict[str, int]
    words: Callable[[Mapping[str, Any]], str]


def _battery(given: Mapping[str, Any]) -> str:
    voltage, share = float(given["voltage"]), float(given["percentage"])
    # NaN where it is not measured.
    known = [f"{voltage:.1f} V"] if math.isfinite(voltage) else []
    known += [f"{100.0 * share:.0f} %"] if 0.0 <= share <= 1.0 else []
    return ", ".join(known) or "not measured"


def _autopilot(given: Mapping[str, Any]) -> str:
    armed = "armed" if given["armed"] else "not armed"
    link = "" if given["connected"] else ", link lost"
    mode = given["mode"].decode(errors="replace") if isinstance(given["mode"], bytes) else given["mode"]
    return f"{mode or 'unknown'}, {armed}{link}"


REPORTS = {
    "sensor_msgs/msg/BatteryState": Report("battery", {"voltage": 1, "percentage": 1}, _battery),
    "mavros_msgs/msg/State": Report("flight mode", {"connected": 1, "armed": 1, "mode": 0}, _autopilot),
}
