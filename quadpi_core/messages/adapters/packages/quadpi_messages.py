# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""quadpi/MotorCommands: shares of the range of each motor, in the rotor order of the vehicle file."""

from __future__ import annotations

from collections import Counter

import numpy as np

from quadpi_core.flight import AirStream, MotorCommandStream, Stamps, TemperatureStream
from quadpi_core.frames import Array
from quadpi_core.inputs import is_celsius, is_pressure
from quadpi_core.messages.adapters.adapter_definition import STAMP, Adapter, Reading, start_of_numbers
from quadpi_core.messages.adapters.adapter_settings import CommandSettings
from quadpi_core.messages.adapters.rotor_messages import start_of_battery, start_of_commands
from quadpi_core.messages.cdr import ANY, Columns, header_stamps
from quadpi_core.messages.sensor_messages import MOTOR_COMMANDS
from quadpi_core.vehicle import Vehicle


def _start(settings: CommandSettings, vehicle: Vehicle | None) -> Reading:
    """Those of all rotors, unless the settings name some."""
    if vehicle is not None and settings.rotors is None:
        settings = CommandSettings(tuple(range(1, vehicle.rotor_count + 1)), settings.topic)
    if settings.rotors is not None:
        return start_of_commands("commands", header_stamps, _shares)(settings, vehicle)

    def read(columns: Columns, _items: object) -> MotorCommandStream:
        return MotorCommandStream(header_stamps(columns), _shares(columns["commands"].astype(np.float64)))

    return Reading(read, Counter)


def _shares(values: Array) -> Array:
    return np.clip(np.nan_to_num(values, nan=0.0), 0.0, 1.0)


COMMANDS = Adapter(
    name="motor_commands",
    type_name=MOTOR_COMMANDS,
    topic="motor_commands",
    kind="motor_commands",
    columns=STAMP | {"commands": ANY},
    start=_start,
    battery=("battery_state", "battery"),
)


def _pressures(time_ns: Stamps, pascal: Array) -> AirStream:
    return AirStream(time_ns, pascal, np.full(len(pascal), np.nan))


def _temperatures(time_ns: Stamps, celsius: Array) -> TemperatureStream:
    return TemperatureStream(time_ns, np.full(len(celsius), np.nan), celsius)


PRESSURE = Adapter(
    name="fluid_pressure",
    type_name="sensor_msgs/msg/FluidPressure",
    topic="pressure",
    kind="pressure",
    columns=STAMP | {"fluid_pressure": 1},
    start=start_of_numbers(
        "fluid_pressure", header_stamps, _pressures, is_pressure, "no pressure of air in Pa"
    ),
)
TEMPERATURE = Adapter(
    name="temperature",
    type_name="sensor_msgs/msg/Temperature",
    topic="temperature",
    kind="temperature",
    columns=STAMP | {"temperature": 1},
    start=start_of_numbers(
        "temperature", header_stamps, _temperatures, is_celsius, "no temperature of air in °C"
    ),
)


BATTERY = Adapter(
    name="battery_state",
    type_name="sensor_msgs/msg/BatteryState",
    topic="battery",
    kind="battery",
    columns=STAMP | {"voltage": 1},
    start=start_of_battery("voltage", header_stamps),
)
