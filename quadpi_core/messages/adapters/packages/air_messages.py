# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Pressure and temperature of the air: sensor_msgs/FluidPressure and Temperature."""

from __future__ import annotations

import numpy as np

from quadpi_core.flight import AirStream, Stamps, TemperatureStream
from quadpi_core.frames import Array
from quadpi_core.inputs import is_celsius, is_pressure
from quadpi_core.messages.adapters.adapter_definition import STAMP, Adapter, start_of_numbers
from quadpi_core.messages.cdr import header_stamps


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
