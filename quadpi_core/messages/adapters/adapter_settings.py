# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Settings for messages of other packages: units, frames, rotors and bodies, which the messages do not name.

docs/adapters.md explains the keys; config/adapters holds examples.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, PlainValidator

from quadpi_core.config_schema import OneOf, Section, Text, load_config
from quadpi_core.errors import LogError
from quadpi_core.rotor_order import ERPM, LAYOUTS, RPM, RotorOrder, controller_numbers
from quadpi_core.vehicle import Vehicle

FLU_ENU, FRD_NED, FUR_EUS = "flu-enu", "frd-ned", "fur-eus"


def _read_rotors(data: Any) -> tuple[int, ...] | str:
    if isinstance(data, str) and data in LAYOUTS:
        return data
    if not isinstance(data, list):
        raise ValueError(f"must list numbers of ESCs or motors, or be {' or '.join(LAYOUTS)}, found {data!r}")
    return controller_numbers(data)


@dataclass(frozen=True)
class RotorSettings(Section):
    """Conversion of ESC reports to rotor speeds.

    Attributes:
        rotors: for each rotor of the vehicle file, the number from 1 of the ESC (mavros) or motor (PX4); or
            the name of a layout (`rotor_order.LAYOUTS`), which the vehicle's rotors fit by their corners.
        unit: "rpm" of the rotor, or "erpm" of the electrical field: the vehicle's pole pairs are needed.
        topic: which, where a bag holds several that could be meant.
    """

    rotors: Annotated[tuple[int, ...] | str, PlainValidator(_read_rotors)]
    unit: Annotated[str, OneOf(RPM, ERPM)]
    topic: Text | None = None

    def order(self, vehicle: Vehicle | None) -> RotorOrder:
        """The order that the settings give.

        Raises:
            LogError: if they give none, or not without a vehicle.
        """
        if not isinstance(self.rotors, str):
            return RotorOrder(tuple(number - 1 for number in self.rotors), self.unit)
        if vehicle is None:
            raise LogError(
                f"the layout {self.rotors} needs the vehicle, whose file says where its rotors are"
            )
        return RotorOrder.by_layout(vehicle, self.rotors, self.unit)


def _read_body(data: Any) -> str:
    if isinstance(data, bool) or not isinstance(data, str | int) or data == "":
        raise ValueError(f"must be the name of a body, found {data!r}")
    return str(data)


@dataclass(frozen=True)
class BodySettings(Section):
    """The body of a motion capture system to use, and its axes.

    Attributes:
        body: its name.
        frames: body and world axes: "flu-enu" (z up), "frd-ned" (z down) or "fur-eus" (y up in both).
        topic: see :class:`RotorSettings`.
    """

    body: Annotated[str, PlainValidator(_read_body)]
    frames: Annotated[str, OneOf(FLU_ENU, FRD_NED, FUR_EUS)]
    topic: Text | None = None


@dataclass(frozen=True)
class StateSettings(Section):
    """For messages that name their frames and units themselves."""

    topic: Text | None = None


def _present(data: Any) -> Any:
    """Refuse a key without a value, which may be meant as a stream with no settings or as none."""
    if data is None:
        raise ValueError("expected keys and values, such as {}, found nothing")
    return data


@dataclass(frozen=True)
class AdapterSettings(Section):
    """Settings of every kind of stream; None: messages of other packages are not used for it."""

    blank_is_absent: ClassVar[bool] = False

    rotor_speeds: Annotated[RotorSettings | None, BeforeValidator(_present)] = None
    mocap: Annotated[BodySettings | None, BeforeValidator(_present)] = None
    odometry: Annotated[StateSettings | None, BeforeValidator(_present)] = None
    imu: Annotated[StateSettings | None, BeforeValidator(_present)] = None

    @classmethod
    def load(cls, name_or_path: str | Path) -> AdapterSettings:
        """Read settings by the name of a file in config/adapters, or by path.

        Raises:
            LogError: naming the file and the key that is missing, unknown or has a value that is not known.
        """
        return load_config("adapter", name_or_path, cls, LogError)[1]
