# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The content of `report.json`; docs/report.md says what its keys mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from quadpi_core.field.airborne import Flown
from quadpi_core.field.damage import RotorLoss
from quadpi_core.field.drag import DragResult
from quadpi_core.field.field_log import Setting
from quadpi_core.field.inertia import BodyResult
from quadpi_core.field.mass_change import MassChange
from quadpi_core.field.motor_model import MotorModel, Tachometers
from quadpi_core.field.motor_use import MotorUse
from quadpi_core.field.vibration import Vibration
from quadpi_core.flight_files import FlightLeftOut
from quadpi_core.version import __version__

# It grows where a key goes or changes its meaning.
FORMAT = 1


@dataclass(frozen=True)
class Remark:
    """Something that looks wrong: a warning or an alarm, and a sentence."""

    level: str
    sentence: str


@dataclass(frozen=True)
class Untold:
    """In the place of a result: why there is none."""

    reason: str


@dataclass(frozen=True)
class TopicRecord:
    """How much of a topic a log holds."""

    samples: int
    rate_hz: float


@dataclass(frozen=True)
class FlightRecord:
    """An entry of `flights`."""

    name: str
    file: str
    stack: str
    firmware: str
    frame: str
    rotors: int | None
    facts: Mapping[str, str]
    topics: Mapping[str, TopicRecord]
    flown: Flown
    motors: MotorUse
    vibration: Vibration | Untold
    tachometers: Tachometers | Untold
    losses: Sequence[RotorLoss] | Untold | None
    mass_change: MassChange | Untold | None
    looked_at: Mapping[str, str]
    remarks: Sequence[Remark]
    settings: Sequence[Setting]
    notes: Sequence[str]


@dataclass(frozen=True)
class VehicleRecord:
    """An entry of `vehicles`: what all flights of one airframe tell together.

    Attributes:
        name: stack and frame, and a flight where others have the same.
        flights: by name.
        doubt: what is not sure of their being of one vehicle; empty for nothing.
        drag: per mass, with the wind of each of `wind_of`.
        wind_of: flights that it was identified on.
        motor_model: rotor speed from command and battery.
        drag_prefix: of the names of its parameters of drag.
        body: thrust and inertia, where a vehicle file says mass and places of the rotors; else None.
    """

    name: str
    flights: tuple[str, ...]
    doubt: str
    drag: DragResult | Untold
    wind_of: tuple[str, ...]
    motor_model: MotorModel | Untold
    drag_prefix: str
    body: BodyResult | None = None


@dataclass(frozen=True)
class ReportRecord:
    """The whole file."""

    verdict: str
    alarm: bool
    mass_kg: float | None
    vehicles: Sequence[VehicleRecord]
    flights: Sequence[FlightRecord]
    left_out: Sequence[FlightLeftOut]
    format: int = FORMAT
    quadpi: str = __version__
