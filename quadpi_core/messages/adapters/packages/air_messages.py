# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Pressure and temperature of the air: sensor_msgs/FluidPressure and Temperature."""

from __future__ import annotations

from collections import Counter

import numpy as np

from quadpi_core.flight import AirStream, TemperatureStream
from quadpi_core.messages.adapters.adapter_definition import STAMP, Adapter, Reading
from quadpi_core.messages.cdr import Columns, header_stamps
from quadpi_core.vehicle import Vehicle


def _pressure(columns: Columns, _items: object) -> AirStream:
    pascal = columns["fluid_pressure"].astype(np.float64)
    return AirStream(header_stamps(columns), pascal, np.full(len(pascal), np.nan))


def _temperature(columns: Columns, _items: object) -> TemperatureStream:
    celsius = columns["temperature"].astype(np.float64)
    return TemperatureStream(header_stamps(columns), np.full(len(celsius), np.nan), celsius)


def _start_pressure(_settings: object, _vehicle: Vehicle | None) -> Reading:
    return Reading(_pressure, Counter)


def _start_temperature(_settings: object, _vehicle: Vehicle | None) -> Reading:
    return Reading(_temperature, Counter)


PRESSURE = Adapter(
    name="fluid_pressure",
    type_name="sensor_msgs/msg/FluidPressure",
    topic="pressure",
    kind="pressure",
    columns=STAMP | {"fluid_pressure": 1},
    start=_start_pressure,
)
TEMPERATURE = Adapter(
    name="temperature",
    type_name="sensor_msgs/msg/Temperature",
    topic="temperature",
    kind="temperature",
    columns=STAMP | {"temperature": 1},
    start=_start_temperature,
)
