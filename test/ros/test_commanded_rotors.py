# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which rotor speeds count: by commands always, or while measured ones are silent."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.flight import BatteryStream, MotorCommandStream, RotorSpeedStream
from quadpi_core.monitor import Monitor
from quadpi_core.vehicle import Motors, Vehicle
from quadpi_ros.input_sources import AdaptedSources, CommandedRotors, command_sources

MOTORS = Motors(source="px4_motors", coefficients=((0.0, 1000.0, 0.0, 10.0, 0.0),) * 4, lag_s=0.0, volts=15.0)
FALLBACK = cast("Monitor", object())


def commanded(seconds: float) -> MotorCommandStream:
    return MotorCommandStream(np.array([round(1e9 * seconds)]), np.full((1, 4), 0.5))


def measured(seconds: float) -> RotorSpeedStream:
    return RotorSpeedStream(np.array([round(1e9 * seconds)]), np.full((1, 4), 650.0))


def counting(rotors: CommandedRotors, begin: float, end: float, **given: bool) -> list[bool]:
    """Whether commands count, each 50 ms."""
    found = []
    for seconds in np.arange(begin, end, 0.05).tolist():
        if given.get("telemetry", True):
            rotors.take_measured(measured(seconds))
        rotors.take_commands(commanded(seconds + 0.01))
        found.append(rotors.counts)
    return found


def test_a_model_of_commands_flies_by_them_and_hears_the_battery() -> None:
    rotors = CommandedRotors(MOTORS)
    assert rotors.take_commands(commanded(1.0)).speeds[0, 0] == pytest.approx(650.0)
    rotors.take_battery(BatteryStream(np.array([10**9]), np.array([10.0])))
    assert rotors.take_commands(commanded(1.1)).speeds[0, 0] == pytest.approx(600.0)
    assert not rotors.take_measured(measured(1.2))
    assert rotors.counts


def test_a_fallback_counts_after_silence_until_telemetry_came_again_for_a_second() -> None:
    rotors = CommandedRotors(MOTORS, FALLBACK)
    assert not any(counting(rotors, 1.0, 2.0))
    silent = counting(rotors, 2.0, 3.0, telemetry=False)
    assert silent.index(True) == pytest.approx(6, abs=1)  # 0.3 s
    back = counting(rotors, 3.0, 5.0)
    assert back.index(False) == pytest.approx(20, abs=1)  # 1 s
    assert not any(back[back.index(False) :])


def test_a_fallback_counts_where_telemetry_never_came() -> None:
    assert counting(CommandedRotors(MOTORS, FALLBACK), 1.0, 2.0, telemetry=False)[-1]


def test_a_fallback_counts_as_soon_in_a_flight_that_is_played_again() -> None:
    rotors = CommandedRotors(MOTORS, FALLBACK)
    assert not any(counting(rotors, 100.0, 102.0))
    assert counting(rotors, 10.0, 11.0, telemetry=False).index(True) == pytest.approx(6, abs=1)
    back = counting(rotors, 1.0, 3.0)
    assert back.index(False) == pytest.approx(20, abs=1)


def test_commands_that_no_message_holds_ask_for_a_topic() -> None:
    adapted = AdaptedSources("monitor", "", Vehicle.load("neurobem"))
    other: Any = Motors(source="crazyflie pwm", coefficients=MOTORS.coefficients, lag_s=0.0)
    with pytest.raises(LogError, match=r"of crazyflie pwm, which no message holds: .* command_topic"):
        command_sources(adapted, other, "")
