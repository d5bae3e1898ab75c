# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether anything still comes to be judged, by a clock that no sensor can stop."""

from __future__ import annotations

from typing import NamedTuple

# Beyond the longest gap that is bridged, and what a busy machine may hold a message up.
SILENT_S = 0.3
# How often to ask; longer steps count as two: then this process was held up, not the sensors.
WATCH_S = 0.1
_STEP_MAX_S = 2.0 * WATCH_S


class Arrived(NamedTuple):
    """How far the inputs have come.

    Attributes:
        imu_ns, state_ns, rotors_ns: newest stamps; None before the first.
        judged: how many IMU samples have gone on to the monitor, complete or not; 0 while the rate of the IMU
            is not known.
    """

    imu_ns: int | None
    state_ns: int | None
    rotors_ns: int | None
    judged: int


class Silence:
    """Notices that nothing comes, or nothing comes of it.

    Attributes:
        reasons: why nothing has been judged for :data:`SILENT_S`, in plain words; empty while samples are.
        elapsed_s: since the newest IMU stamp came; since the beginning before the first.
    """

    def __init__(self) -> None:
        self.reasons: tuple[str, ...] = ()
        self._arrived = Arrived(None, None, None, 0)
        self._since_s = dict.fromkeys(Arrived._fields, 0.0)
        self._now_s = 0.0
        self._asked_s: float | None = None

    @property
    def elapsed_s(self) -> float:
        """See the class."""
        return self._now_s - self._since_s["imu_ns"]

    def follow(self, clock_s: float, arrived: Arrived) -> None:
        """Take how far things have come at an instant of a steady clock."""
        if self._asked_s is not None:
            self._now_s += min(clock_s - self._asked_s, _STEP_MAX_S)
        self._asked_s = clock_s
        for name, before, after in zip(Arrived._fields, self._arrived, arrived, strict=True):
            if before != after:
                self._since_s[name] = self._now_s
        self._arrived = arrived
        silent_s = {name: self._now_s - since_s for name, since_s in self._since_s.items()}
        self.reasons = () if silent_s["judged"] < SILENT_S else tuple(self._told(silent_s))

    def _told(self, silent_s: dict[str, float]) -> list[str]:
        told: list[str] = []
        for name, what in (("imu_ns", "imu"), ("state_ns", "state"), ("rotors_ns", "rotor speeds")):
            if what == "state" and told:
                continue  # It is made of the IMU's samples.
            if getattr(self._arrived, name) is None:
                told.append(f"no {what} yet")
            elif silent_s[name] >= SILENT_S:
                told.append(f"no {what} for {silent_s[name]:.1f} s")
        if not told and self._arrived.judged == 0:
            return ["no sample is complete yet"]
        return told or ["no sample is complete: imu, state and rotor speeds share no time"]
