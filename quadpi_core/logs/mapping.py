# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Mapping files: what the columns of a table, or variables of MATLAB, are, so that a data set needs no code.

docs/add-a-data-set.md explains the keys; config/mappings holds those that come with quadpi.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
import yaml

from quadpi_core.config_schema import (
    OneOf,
    ReadBy,
    Section,
    Share,
    load_config,
    nearest,
    parse_config,
    unknown_key,
)
from quadpi_core.errors import LogError
from quadpi_core.records import ROTORS_MAX, STANDARD_GRAVITY

ERPM = "erpm"
TIME = "time"
QUATERNION_ORDERS = MappingProxyType({"wxyz": (0, 1, 2, 3), "xyzw": (3, 0, 1, 2)})
ROLL_PITCH_YAW = "roll-pitch-yaw"

_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1.0 / 3.6}
_ANGLE = {"rad": 1.0, "deg": np.pi / 180.0}

# Factors to SI. Electrical speeds also need the pole pairs of the vehicle.
UNITS: MappingProxyType[str, dict[str, float]] = MappingProxyType(
    {
        "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
        "angular_velocity": {"rad/s": 1.0, "deg/s": np.pi / 180.0},
        "acceleration": {"m/s2": 1.0, "g": STANDARD_GRAVITY},
        "rotor_speeds": {"rad/s": 1.0, "rpm": 2.0 * np.pi / 60.0, ERPM: 1.0},
        "position": _LENGTH,
        "velocity": _SPEED,
        "attitude": _ANGLE,
        "mocap_position": _LENGTH,
        "mocap_attitude": _ANGLE,
        "wind": _SPEED,
        "battery": {"V": 1.0, "mV": 1e-3},
        "motor_commands": {"share": 1.0, "%": 1e-2, "us": 1e-3, "16 bit": 1.0 / 65535.0},
        "pressure": {"Pa": 1.0, "hPa": 100.0},
        "temperature": {"degC": 1.0, "K": 1.0},
        "simulated_force": {"N": 1.0, "mN": 1e-3},
        "simulated_moment": {"Nm": 1.0, "mNm": 1e-3},
    }
)
# Signals that have a column of each rotor.
BY_ROTOR = ("rotor_speeds", "motor_commands")
_COLUMN_COUNT = MappingProxyType({"time": 1, "battery": 1, "pressure": 1, "temperature": 1})
# Keys that some signals must have beside `columns` and `unit`.
_CHOICES: MappingProxyType[str, tuple[str, ...]] = MappingProxyType(
    {
        "acceleration": ("axes", "gravity"),
        "velocity": ("axes",),
        "attitude": ("form",),
        "mocap_attitude": ("form",),
    }
)


def _read_columns(data: Any) -> tuple[str, ...]:
    if not isinstance(data, list):
        raise ValueError(f"must be a list of columns, found {data!r}")
    return tuple(str(column) for column in data)


@dataclass(frozen=True, kw_only=True)
class Signal(Section):
    """One signal of a table; which keys it has depends on its name.

    Attributes:
        columns: in the order x, y, z, or that of the vehicle's rotors. One name that stands for a matrix of
            several columns becomes NAME.1, NAME.2 and so on; of rotors `*` stands for their numbers.
        unit: a key of UNITS; None for quaternions, and for a time whose unit its intervals tell.
        missing: largest share of rows without a value between the first and the last that have one.
        table: of those named under `tables`; None for the log itself.
        axes: in which a vector is given.
        gravity: whether an acceleration is the specific force, or gravity was removed.
        form: of an attitude.
    """

    columns: Annotated[tuple[str, ...], ReadBy(_read_columns)]
    unit: str | None = None
    missing: Share = 0.0
    table: str | None = None
    axes: Annotated[str, OneOf("body", "world")] | None = None
    gravity: Annotated[str, OneOf("included", "removed")] | None = None
    form: Annotated[str, OneOf(*QUATERNION_ORDERS, ROLL_PITCH_YAW)] | None = None

    def require_keys_of(self, name: str) -> None:
        """Refuse keys that a signal of this name lacks, or should not have: a ValueError names them."""
        choices = _CHOICES.get(name, ())
        units = () if self.form in QUATERNION_ORDERS else ("unit",)
        known = ("columns", *units, *choices, *(() if name == TIME else ("missing", "table")))
        for key in (*units, *choices):
            if getattr(self, key) is None and name != TIME:
                raise ValueError(f"{name}: missing key `{key}`")
        for key, value in vars(self).items():
            if key not in known and value:
                raise ValueError(f"{name}: {unknown_key(key, known)}")
        if self.unit is not None and self.unit not in UNITS[name]:
            raise ValueError(f"{name}: `unit` must be one of {', '.join(UNITS[name])}, found {self.unit!r}")
        # Of rotors as many as the vehicle has, which those who read for one check; of one name as many as
        # the table has.
        count = _COLUMN_COUNT.get(name, 3) if units else 4
        if name in BY_ROTOR:
            count = 1 if len(self.columns) == 1 else max(3, min(len(self.columns), ROTORS_MAX))
        if len(self.columns) == 1 < count:
            several = tuple(f"{self.columns[0]}.{place + 1}" for place in range(count))
            object.__setattr__(self, "columns", several)
        if len(self.columns) != count or len(set(self.columns)) != count:
            raise ValueError(f"{name}: `columns` must list {count} different column{'s'[: count - 1]}")

    def of_rotors(self, names: Iterable[str]) -> Signal:
        """The signal with a column of each rotor, where one name, with `*` or of a matrix, stands for all."""
        name = self.columns[0]
        pattern = re.escape(name).replace(r"\*", r"(\d+)") if "*" in name else re.escape(name) + r"\.(\d+)"
        matches = [match for one in names if (match := re.fullmatch(pattern, one))]
        found = [match[0] for match in sorted(matches, key=lambda match: int(match[1]))]
        return self if len(self.columns) > 1 or not found else replace(self, columns=tuple(found))


@dataclass(frozen=True, kw_only=True)
class OtherTable(Section):
    """A further table of the same flight, with a clock of its own rows.

    Attributes:
        time: as that of the log.
        file: its place from the folder of the log; None for variables of the same MATLAB file.
    """

    time: Signal
    file: str | None = None

    def __post_init__(self) -> None:
        self.time.require_keys_of(TIME)


@dataclass(frozen=True, kw_only=True)
class _MappingFile(Section):
    """The content of a mapping file of tables."""

    time: Signal
    body: Annotated[str, OneOf("flu", "frd")]
    world: Annotated[str, OneOf("enu", "ned")]
    angular_velocity: Signal
    acceleration: Signal
    rotor_speeds: Signal | None = None
    position: Signal | None = None
    velocity: Signal | None = None
    attitude: Signal | None = None
    mocap_position: Signal | None = None
    mocap_attitude: Signal | None = None
    wind: Signal | None = None
    battery: Signal | None = None
    motor_commands: Signal | None = None
    pressure: Signal | None = None
    temperature: Signal | None = None
    simulated_force: Signal | None = None
    simulated_moment: Signal | None = None
    tables: dict[str, OtherTable] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, signal in self.signals.items():
            signal.require_keys_of(name)
            if signal.table is not None and signal.table not in self.tables:
                raise ValueError(
                    f"{name}: no table {signal.table} under `tables`{nearest(signal.table, self.tables)}"
                )

    @property
    def signals(self) -> dict[str, Signal]:
        """The signals of the table, in the order of UNITS."""
        named = {name: getattr(self, name) for name in UNITS}
        return {name: signal for name, signal in named.items() if signal is not None}


@dataclass(frozen=True)
class Mapping:
    """What a mapping file says.

    Attributes:
        body: body axes of the table, "flu" or "frd".
        world: world axes of the table, "enu" (any z-up world) or "ned".
        signals: by name, of those in UNITS.
        tables: further ones, by the names that signals give them.
    """

    path: Path
    body: str
    world: str
    signals: dict[str, Signal]
    tables: dict[str, OtherTable]

    def of_rotors(self, names_of: Callable[[str | None], Iterable[str]]) -> Mapping:
        """The mapping with a column of each rotor, as :meth:`Signal.of_rotors` finds them in the tables."""
        signals = {
            name: one.of_rotors(names_of(one.table)) if name in BY_ROTOR and len(one.columns) == 1 else one
            for name, one in self.signals.items()
        }
        return replace(self, signals=signals)

    @classmethod
    def load(cls, name_or_path: str | Path) -> Mapping:
        """Read a mapping by the name of a file in config/mappings, or by path.

        Raises:
            LogError: naming the file and the key that is missing, unknown or has a value that is not known.
        """
        return cls._from_content(*load_config("mapping", name_or_path, _MappingFile, LogError))

    @classmethod
    def draft(cls, text: str, source: Path) -> Mapping:
        """The mapping that a draft for a table is, see :mod:`quadpi_core.logs.table_columns`.

        Raises:
            LogError: naming the table.
        """
        content = parse_config(_MappingFile, yaml.safe_load(text), f"{source}: a guessed mapping", LogError)
        return cls._from_content(source, content)

    @classmethod
    def _from_content(cls, path: Path, content: _MappingFile) -> Mapping:
        return cls(path, content.body, content.world, content.signals, content.tables)
