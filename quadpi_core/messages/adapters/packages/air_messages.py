# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Pressure and temperature of the air: sensor_msgs/FluidPressure and Temperature."""

from __future__ import annotations

from collections import Counter
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import AirStream, TemperatureStream
from quadpi_core.flown_air import is_celsius, is_pressure
from quadpi_core.messages.adapters.adapter_definition import STAMP, Adapter, Reading
from quadpi_core.messages.cdr import Columns, header_stamps
from quadpi_core.vehicle import Vehicle

_Mask: TypeAlias = npt.NDArray[np.bool_]


def _start_pressure(_settings: object, _vehicle: Vehicle | None) -> Reading:
    dropped: Counter[str] = Counter()

    def read(columns: Columns, _items: object) -> AirStream:
        pascal = columns["fluid_pressure"].astype(np.float64)
        known = _counted(is_pressure(pascal), dropped, "no pressure of air in Pa")
        pascal = pascal[known]
        return AirStream(header_stamps(columns)[known], pascal, np.full(len(pascal), np.nan))

    return Reading(read, lambda: dropped)


def _start_temperature(_settings: object, _vehicle: Vehicle | None) -> Reading:
    dropped: Counter[str] = Counter()

    def read(columns: Columns, _items: object) -> TemperatureStream:
        celsius = columns["temperature"].astype(np.float64)
        known = _counted(is_celsius(celsius), dropped, "no temperature of air in °C")
        celsius = celsius[known]
        return TemperatureStream(header_stamps(columns)[known], np.full(len(celsius), np.nan), celsius)

    return Reading(read, lambda: dropped)


def _counted(known: _Mask, dropped: Counter[str], reason: str) -> _Mask:
    """Those that are known, as the others are counted."""
    if not known.all():
        dropped[reason] += int(np.sum(~known))
    return known


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
