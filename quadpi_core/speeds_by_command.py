# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speeds from motor commands and battery voltage, for vehicles without tachometers.

Live, in replay and in identification the same function takes the commands as they come, one or many at once,
and gives the same bits; see :class:`quadpi_core.motors.Motors`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core.elementary import exponential
from quadpi_core.errors import LogError
from quadpi_core.flight import (
    MAX_JUMP_BACK_NS,
    BatteryStream,
    MotorCommandStream,
    Recording,
    RotorSpeedStream,
    Stamps,
)
from quadpi_core.frames import Array
from quadpi_core.motors import Motors

# Commands that come after a longer pause begin anew, without what the rotors did before: no lag is as long.
_PAUSE_NS = 1_000_000_000


class CommandedSpeeds:
    """Takes the commands and the battery voltages of one flight as they come, and gives rotor speeds.

    Args:
        motors: of the vehicle.
    """

    def __init__(self, motors: Motors) -> None:
        self._motors = motors
        self._volts = motors.volts
        self._last_ns: int | None = None
        self._target: list[float] = []
        self._speed: list[float] = []

    def hear(self, battery: BatteryStream) -> None:
        """Take voltages, of the commands that follow."""
        none = np.empty((0, len(self._motors.coefficients)))
        self.take(MotorCommandStream(battery.time_ns[:0], none), battery)

    def take(
        self, commands: MotorCommandStream, battery: BatteryStream | None = None, heard: Stamps | None = None
    ) -> RotorSpeedStream:
        """Speeds of the next commands, N of them, stamped later by the dead time.

        A command that is not above 0 is of a motor that stands. One whose stamp does not rise changes
        nothing, but where the clock fell.

        Args:
            commands: N samples.
            battery: M voltages that came between them.
            heard: (M,) how many of the commands came before each voltage, rising; by the stamps unless given.
        """
        if battery is not None and heard is None:
            # Of stamps that fall the largest counts: what came before something came before what followed it.
            heard = np.searchsorted(np.maximum.accumulate(commands.time_ns), battery.time_ns)
            heard = np.maximum.accumulate(heard)
        volts = np.full(len(commands), self._volts)
        if battery is not None and heard is not None and len(battery):
            known = np.isfinite(battery.voltage) & (battery.voltage > 0.0)
            told = np.concatenate(([self._volts], battery.voltage[known]))
            volts = told[np.searchsorted(heard[known], np.arange(len(commands)), side="right")]
            self._volts = float(told[-1])
        rises, steps_ns = self._steps(commands.time_ns)
        targets = self._targets(commands.commands, volts[:, np.newaxis]).tolist()
        keep, new, old = lag_weights(np.array(steps_ns) * 1e-9, self._motors.lag_s)
        speeds = np.empty(commands.commands.shape)
        for row, target in enumerate(targets):
            if rises[row]:
                if steps_ns[row]:
                    k, a, b = keep[row], new[row], old[row]
                    motors = zip(self._speed, target, self._target, strict=True)
                    self._speed = [k * speed + a * now + b * before for speed, now, before in motors]
                else:
                    self._speed = target
                self._target = target
            speeds[row] = self._speed
        return RotorSpeedStream(commands.time_ns + round(1e9 * self._motors.dead_s), speeds)

    def _steps(self, time_ns: Stamps) -> tuple[list[bool], list[int]]:
        """Of each stamp, whether it rises, and by how much; 0 where the motors begin anew."""
        rises, steps_ns, last_ns = [], [], self._last_ns
        for now_ns in time_ns.tolist():
            step_ns = 0 if last_ns is None else now_ns - last_ns
            fell = step_ns <= -MAX_JUMP_BACK_NS
            rises.append(last_ns is None or step_ns > 0 or fell)
            steps_ns.append(step_ns if 0 < step_ns <= _PAUSE_NS else 0)
            last_ns = now_ns if rises[-1] else last_ns
        self._last_ns = last_ns
        return rises, steps_ns

    def _targets(self, u: Array, volts: Array) -> Array:
        """Speeds (N, R) at which the motors would settle by commands (N, R) and voltages (N, 1)."""
        c = np.array(self._motors.coefficients).T
        told = c[0] + u * (c[1] + u * c[2]) + volts * (c[3] + u * c[4])
        settled: Array = np.where(u > 0.0, np.maximum(told, 0.0), 0.0)
        return settled


def lag_weights(steps_s: Array, lag_s: float) -> tuple[list[float], list[float], list[float]]:
    """Weights (N,) of the last output, the input and the last input of a first-order lag, by steps (N,).

    The input is a straight line between samples: what is logged slower than it is sent is not late by that.
    """
    if lag_s <= 0.0:
        return [0.0] * len(steps_s), [1.0] * len(steps_s), [0.0] * len(steps_s)
    steps = np.maximum(steps_s, 1e-12) / lag_s
    keep = exponential(-steps)
    share = (1.0 - keep) / steps
    return keep.tolist(), (1.0 - share).tolist(), (share - keep).tolist()


def with_commanded_speeds(recording: Recording, motors: Motors | None) -> Recording:
    """The recording with rotor speeds by its commands, where it has any and the vehicle says how.

    Raises:
        LogError: for commands of another source, whose scale is another, or of another number of motors.
    """
    if motors is None or recording.commands is None or recording.commanded:
        return recording
    require_source(recording.source, recording.command_source, motors)
    found, known = recording.commands.commands.shape[1], len(motors.coefficients)
    if found != known:
        raise LogError(
            f"{recording.source}: topic motor_commands: {found} motors, and the vehicle file knows {known}"
        )
    speeds = CommandedSpeeds(motors).take(recording.commands, recording.battery)
    return replace(recording, rotor_speeds=speeds, commanded=True)


def require_source(where: str, source: str, motors: Motors) -> None:
    """Refuse commands of another source than the motors were identified with.

    Raises:
        LogError: naming both.
    """
    if source != motors.source:
        raise LogError(
            f"{where}: topic motor_commands: are of {source}, and the vehicle's motors are known by commands "
            f"of {motors.source}: their scales differ"
        )
