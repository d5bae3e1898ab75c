# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Density of the air, by pressure and temperature, and what a coefficient may be off where nothing tells it.

At the same velocities and rotor speeds the wrench of the air goes with its density: 5 K change it by 1.7 %,
1000 m of height by 10 %. Models hold it at the density of the vehicle file, the standard atmosphere's unless
it says another.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import Recording
from quadpi_core.frames import Array
from quadpi_core.thresholds import CONVENTION, Threshold

_Number = TypeVar("_Number", float, Array)

# At the sea, and the gas constant of dry air (ISO 2533).
STANDARD_DENSITY = 1.225
_GAS, ZERO_CELSIUS = 287.053, 273.15
# Of air that multirotors fly in [kg/m³]: from 9 km above the sea (ISO 2533) to sea level at -60 °C.
DENSITY_MIN, DENSITY_MAX = 0.4, 1.8
# Pressures there [Pa], and temperatures [°C], up to a barometer's board 30 K above the warmest air. What is
# beyond is of another unit, hPa or K above all, or of a dead sensor.
PRESSURE_MIN, PRESSURE_MAX = 3e4, 1.1e5
CELSIUS_MIN, CELSIUS_MAX = -60.0, 90.0
NOTICED = Threshold(
    "change of the density from which a flight goes on in another one",
    0.002,
    "",
    "16 m of height, or 0.6 K, change it by as much: a fifth of the percent that is asked of thrust",
    CONVENTION,
)
# What tells the density of a flight: nothing, sensors of the air, or a barometer on a board.
ASSUMED, MEASURED, BOARD = "", "measured", "barometer"
UNKNOWN_AIR = Threshold(
    "least and largest density of the air flown in, over the standard one, where nothing tells it",
    (0.62, 1.15),
    "",
    "multirotors fly from sea level at -30 °C to 3500 m at 30 °C",
    "ISO 2533",
)
STATED_AIR = Threshold(
    "the same, over the density of a vehicle file that says another than the standard one",
    (0.95, 1.05),
    "",
    "whoever wrote it knew the place; weather and season change it by 15 K",
    CONVENTION,
)
BOARD_AIR = Threshold(
    "the same, over the density by a barometer's own temperature",
    (1.0, 1.1),
    "",
    "it is that of its board, which reads up to 30 K above the air (ArduPilot's AP_Baro)",
    "two barometers of px4_sample_small.ulg in ../shared/data differ by 11 K",
)


def density_of(pressure: _Number, celsius: _Number) -> _Number:
    """Density of dry air [kg/m³] from pressure [Pa] and temperature (ideal gas, ISO 2533)."""
    return pressure / (_GAS * (celsius + ZERO_CELSIUS))


def celsius_of(pressure: Array, density: Array) -> Array:
    """Temperature of dry air of a pressure [Pa] and density [kg/m³]."""
    celsius: Array = pressure / (_GAS * density) - ZERO_CELSIUS
    return celsius


def is_pressure(pascal: Array) -> npt.NDArray[np.bool_]:
    """Which pressures (N,) can be of air that multirotors fly in."""
    return (pascal >= PRESSURE_MIN) & (pascal <= PRESSURE_MAX)


def is_celsius(celsius: Array) -> npt.NDArray[np.bool_]:
    """Which temperatures (N,) can be of that air, or of a board in it."""
    return (celsius >= CELSIUS_MIN) & (celsius <= CELSIUS_MAX)


def flown_in(recording: Recording) -> tuple[float, str] | None:
    """Median density of the air of a flight [kg/m³], and what tells it; None where nothing does."""
    pressure, celsius = (
        np.concatenate(
            [getattr(one, name) for one in (recording.pressure, recording.temperature) if one] or [[]]
        )
        for name in ("pressure", "celsius")
    )
    pressure, celsius = pressure[is_pressure(pressure)], celsius[is_celsius(celsius)]
    if not len(pressure) or not len(celsius):
        return None
    density = density_of(float(np.median(pressure)), float(np.median(celsius)))
    if not DENSITY_MIN <= density <= DENSITY_MAX:
        return None
    return density, BOARD if recording.board_air else MEASURED


def density_range(told_by: str, file_density: float) -> tuple[float, float]:
    """Least and largest density of the air over that which a flight is taken to have been in."""
    if told_by == MEASURED:
        return 1.0, 1.0
    if told_by == BOARD:
        least, largest = BOARD_AIR.value
    else:
        least, largest = (UNKNOWN_AIR if file_density == STANDARD_DENSITY else STATED_AIR).value
    return least, largest


class Air:
    """Takes pressures and temperatures as they come, in flight or in replay.

    Attributes:
        density: kg/m³, which follows the last of both in steps of `NOTICED`; 0 before both are known.
    """

    def __init__(self) -> None:
        self.density = 0.0
        self._pressure = self._celsius = float("nan")

    def hear(self, pressure: float, celsius: float) -> bool:
        """Take what a message tells, NaN for what it does not; whether the density is another now.

        What can be no pressure or temperature of the air counts as not told.
        """
        self._pressure = pressure if PRESSURE_MIN <= pressure <= PRESSURE_MAX else self._pressure
        self._celsius = celsius if CELSIUS_MIN <= celsius <= CELSIUS_MAX else self._celsius
        if not isfinite(self._pressure + self._celsius):
            return False
        density = density_of(self._pressure, self._celsius)
        if not DENSITY_MIN <= density <= DENSITY_MAX:
            return False
        if self.density and abs(density / self.density - 1.0) < NOTICED.value:
            return False
        self.density = density
        return True

    def changes(self, block: Recording) -> Iterator[tuple[int, float]]:
        """After how many IMU samples of a block the density is another, and which."""
        rows = []
        for order, stream in enumerate((block.pressure, block.temperature)):
            if stream is not None:
                counts = block.arrivals_of(stream).tolist()
                told = zip(
                    stream.time_ns.tolist(), stream.pressure.tolist(), stream.celsius.tolist(), strict=True
                )
                rows += [
                    (count, time_ns, order, *one) for count, (time_ns, *one) in zip(counts, told, strict=True)
                ]
        for count, _, _, pressure, celsius in sorted(rows, key=lambda row: row[:3]):
            if self.hear(pressure, celsius):
                yield count, self.density
