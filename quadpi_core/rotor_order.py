# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which speed controller of an autopilot turns which rotor of the vehicle file, and in which unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np

from quadpi_core.config_schema import OneOf, ReadBy, Section, load_config
from quadpi_core.errors import LogError
from quadpi_core.frames import Array
from quadpi_core.vehicle import ROTORS, Vehicle

RPM, ERPM = "rpm", "erpm"
_RAD_S_PER_RPM = 2.0 * np.pi / 60.0
_FRONT_RIGHT, _FRONT_LEFT, _REAR_RIGHT, _REAR_LEFT = (1, 1), (1, -1), (-1, 1), (-1, -1)

# Corners of motors 1 to 4, as signs of x (forward) and y (right).
LAYOUTS: MappingProxyType[str, tuple[tuple[int, int], ...]] = MappingProxyType(
    {
        # PX4 "Generic Quadcopter", ArduPilot FRAME_TYPE 1 (X).
        "quad-x": (_FRONT_RIGHT, _REAR_LEFT, _FRONT_LEFT, _REAR_RIGHT),
        # Betaflight "Quad X", ArduPilot FRAME_TYPE 12.
        "betaflight": (_REAR_RIGHT, _FRONT_RIGHT, _REAR_LEFT, _FRONT_LEFT),
    }
)


@dataclass(frozen=True)
class RotorOrder:
    """The speed controllers of the rotors, in the vehicle's rotor order.

    Attributes:
        controllers: their numbers, counted from 0.
        unit: "rpm", mechanical revolutions per minute, or "erpm", electrical ones; None where the log says.
    """

    controllers: tuple[int, ...]
    unit: str | None = None

    @classmethod
    def load(cls, name_or_path: str | Path) -> RotorOrder:
        """Read a mapping file with the key `rotors`, controllers counted from 1, and optionally `unit`.

        Raises:
            LogError: naming the file and the key.
        """
        _, content = load_config("mapping", name_or_path, _OrderFile, LogError)
        return cls(tuple(number - 1 for number in content.rotors), content.unit)

    @classmethod
    def parse(cls, text: str, unit: str | None = None) -> RotorOrder:
        """The order that numbers in a string give, counted from 1, such as "4 1 2 3".

        Raises:
            LogError: if they are not four different numbers.
        """
        numbers = [int(word) if word.isdecimal() else word for word in text.replace(",", " ").split()]
        try:
            return cls(tuple(number - 1 for number in controller_numbers(numbers)), unit)
        except ValueError as error:
            raise LogError(f"rotor order {error}") from None

    @classmethod
    def by_corner(
        cls, vehicle: Vehicle | None, corners: Sequence[tuple[float, float]], unit: str | None = None
    ) -> RotorOrder | None:
        """The order by where the motors sit; None if they are not one per corner.

        Args:
            vehicle: without one, the motors keep their order.
            corners: of motors 1 to 4: x forward and y right, or their signs.
            unit: see the attribute.
        """
        found = [(np.sign(x), np.sign(y)) for x, y in corners]
        if len(set(found)) != ROTORS or any(0 in corner for corner in found):
            return None
        if vehicle is None:
            return cls(tuple(range(ROTORS)), unit)
        rotors = [tuple(np.sign(position[:2])) for position in vehicle.rotor_positions]
        if set(rotors) != set(found):
            return None
        return cls(tuple(found.index(corner) for corner in rotors), unit)

    @classmethod
    def by_layout(cls, vehicle: Vehicle | None, layout: str, unit: str | None = None) -> RotorOrder:
        """The order in which an autopilot numbers the motors of a standard frame (see :data:`LAYOUTS`).

        Raises:
            LogError: if the vehicle does not have one rotor in each corner.
        """
        order = cls.by_corner(vehicle, LAYOUTS[layout], unit)
        if order is None:
            raise LogError("the vehicle has not one rotor in each corner: give the order of its rotors")
        return order

    def speeds(self, values: Array, vehicle: Vehicle | None, pole_pairs: int | None = None) -> Array:
        """Magnitudes in rad/s (N, 4) of speeds as reported (N, 4), already in the vehicle's rotor order.

        Controllers report a rotor that turns the other way as negative. A log that says the pole pairs, for
        electrical speeds, knows them better than the vehicle's file.

        Raises:
            LogError: for electrical speeds without a vehicle and pole pairs.
            VehicleError: for electrical speeds if the vehicle file does not give the pole pairs.
        """
        magnitudes: Array = np.abs(values)
        if self.unit != ERPM:
            return magnitudes * _RAD_S_PER_RPM
        if pole_pairs is not None:
            return magnitudes * (_RAD_S_PER_RPM / pole_pairs)
        if vehicle is None:
            raise LogError("electrical speeds need the vehicle, whose file gives the pole pairs")
        return vehicle.rotor_speeds_from_erpm(magnitudes)


def controller_numbers(numbers: Any) -> tuple[int, ...]:
    """The key `rotors` of a file, for `config_schema.ReadBy`: speed controllers counted from 1.

    Raises:
        ValueError: for anything but four different numbers.
    """
    is_list = isinstance(numbers, list) and len(numbers) == ROTORS and len(set(map(str, numbers))) == ROTORS
    if not is_list or not all(type(number) is int and number >= 1 for number in numbers):
        raise ValueError(
            f"must be {ROTORS} different numbers of speed controllers, counted from 1, in the order of the "
            f"vehicle's rotors; found {numbers!r}"
        )
    return tuple(numbers)


@dataclass(frozen=True, kw_only=True)
class _OrderFile(Section):
    """The content of a mapping file of an autopilot's logs."""

    rotors: Annotated[tuple[int, ...], ReadBy(controller_numbers)]
    unit: Annotated[str, OneOf(RPM, ERPM)] | None = None
