# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""quadpi/MotorCommands: in the order of the vehicle file, all of them unless settings name some."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.flight import BatteryStream, MotorCommandStream
from quadpi_core.logs.bags import read_bag, write_bag
from quadpi_core.messages.adapters import known_adapters
from quadpi_core.messages.adapters.adapter_settings import AdapterSettings, CommandSettings
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle

from .vendor_messages import START_NS, motor_commands


def test_all_commands_in_their_order(vendor) -> None:
    adapter = known_adapters()["motor_commands"]
    message = motor_commands(vendor.px4_1_14, "motor_commands", START_NS, [0.1, 0.2, 0.3, 1.4, 0.5, np.nan])
    definition, settings = vendor.px4_1_14.definition(adapter.type_name), AdapterSettings()
    settings = replace(settings, motor_commands=CommandSettings())
    found = adapter.open(definition, settings, None).unpack(message)
    assert found.commands.tolist() == [[0.1, 0.2, 0.3, 1.0, 0.5, 0.0]]
    four = adapter.open(definition, settings, Vehicle.load("bebop2")).unpack(message)
    assert four.commands.tolist() == [[0.1, 0.2, 0.3, 1.0]]


def test_a_bag_keeps_commands_their_source_and_the_battery(tmp_path) -> None:
    flight = read_bag(bags_directory() / "interpolation.mcap", Vehicle.load("bebop2"))
    time_ns = flight.imu.time_ns[::10]
    shares = np.linspace(0.1, 0.9, 4 * len(time_ns)).reshape(-1, 4)
    commands, volts = MotorCommandStream(time_ns, shares), BatteryStream(time_ns, np.full(len(time_ns), 11.5))
    given = replace(flight, commands=commands, battery=volts, command_source="crazyflie pwm")
    write_bag(tmp_path / "with.mcap", given)
    found = read_bag(tmp_path / "with.mcap", Vehicle.load("bebop2"))
    assert found.command_source == "crazyflie pwm"
    np.testing.assert_array_equal(found.commands.commands, shares)
    assert found.battery.voltage == pytest.approx(volts.voltage)
    assert np.array_equal(found.rotor_speeds.speeds, flight.rotor_speeds.speeds)
