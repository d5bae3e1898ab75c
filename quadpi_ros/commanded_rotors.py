# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speeds by motor commands in flight: always, or while those that are measured do not come."""

from __future__ import annotations

from quadpi_core.errors import LogError
from quadpi_core.flight import MAX_JUMP_BACK_NS, NO_STAMP, BatteryStream, MotorCommandStream, RotorSpeedStream
from quadpi_core.frames import Array
from quadpi_core.messages.adapters import known_adapters
from quadpi_core.monitor import Monitor
from quadpi_core.monitor.health import SILENT_S
from quadpi_core.monitor.tachometers import TachometerWatch
from quadpi_core.rotor_order import CommandedSpeeds
from quadpi_core.vehicle import Motors
from quadpi_ros.input_sources import AdaptedSources, Source

# Rotor speeds that are measured again must come for this long before they are used again.
_BACK_S = 1.0


class CommandedRotors:
    """Takes commands, battery and measured speeds, and says which speeds count.

    Args:
        motors: of the model that was identified on commands.
        fallback: the monitor that judges while rotor speeds are made of commands; None where the first one
            does, and always.

    Attributes:
        motors: as given.
        fallback: as given.
        counts: whether speeds by the commands are used now.
        watch: of the tachometers.
    """

    def __init__(self, motors: Motors, fallback: Monitor | None = None) -> None:
        self.fallback = fallback
        self.counts = fallback is None
        self.motors = motors
        self.restart()

    def restart(self) -> None:
        """Forget the past."""
        self._speeds = CommandedSpeeds(self.motors)
        self._newest: Array | None = None
        self._newest_ns = NO_STAMP
        self._follow(NO_STAMP)
        self.watch = TachometerWatch()

    def _follow(self, time_ns: int) -> None:
        """Begin to count time anew where the clock fell."""
        if time_ns == NO_STAMP or time_ns <= self._newest_ns - MAX_JUMP_BACK_NS:
            self._newest_ns = NO_STAMP
            self._measured_ns: int | None = None
            self._back_ns: int | None = None
            self._began_ns: int | None = None
        self._newest_ns = max(self._newest_ns, time_ns)

    def take_commands(self, commands: MotorCommandStream) -> RotorSpeedStream:
        """Speeds by a command."""
        speeds = self._speeds.take(commands)
        self._newest = speeds.speeds[-1]
        time_ns = int(commands.time_ns[0])
        self._follow(time_ns)
        if self._began_ns is None:
            self._began_ns = time_ns
        if self.fallback is not None and not self.counts:
            last_ns = self._began_ns if self._measured_ns is None else self._measured_ns
            self.counts = time_ns - last_ns > 1e9 * SILENT_S
        return speeds

    def take_battery(self, battery: BatteryStream) -> None:
        """Take a voltage."""
        self._speeds.hear(battery)

    def take_measured(self, rotor_speeds: RotorSpeedStream) -> bool:
        """Take measured speeds; whether they count."""
        time_ns = int(rotor_speeds.time_ns[0])
        self._follow(time_ns)
        if self._newest is not None:
            self.watch.take(time_ns, rotor_speeds.speeds[0], self._newest)
        if self.fallback is not None and self.counts:
            paused = self._measured_ns is None or time_ns - self._measured_ns > 1e9 * SILENT_S
            if paused or self._back_ns is None:
                self._back_ns = time_ns
            self.counts = time_ns - self._back_ns < 1e9 * _BACK_S
        self._measured_ns = time_ns
        return not self.counts


def command_sources(adapted: AdaptedSources, motors: Motors, topic: str) -> tuple[Source, Source]:
    """The topics of commands and battery that the motors were identified with.

    Args:
        adapted: of the node.
        motors: of a model.
        topic: adapter of the commands as the parameter says; empty for that of the motors.

    Raises:
        LogError: for commands that no message is known to hold.
        AdapterError: if the package of a message is not installed.
    """
    adapter = known_adapters().get(topic or motors.source)
    if adapter is None:
        raise LogError(
            f"the model was identified on commands of {motors.source}, which no message holds: the parameter "
            "command_topic names the adapter whose commands have the same scale"
        )
    battery, default = adapter.battery or ("battery_state", "battery")
    return adapted.self_described(adapter.name), adapted.self_described(battery, default)
