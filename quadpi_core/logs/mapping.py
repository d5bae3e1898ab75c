# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Mapping files: what the columns of a CSV or Parquet table are, so that a data set needs no code.

docs/add-a-data-set.md explains the keys; config/mappings holds those that come with quadpi.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from quadpi_core.config import read_config
from quadpi_core.errors import LogError
from quadpi_core.units import STANDARD_GRAVITY

ERPM = "erpm"
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
        "simulated_force": {"N": 1.0, "mN": 1e-3},
        "simulated_moment": {"Nm": 1.0, "mNm": 1e-3},
    }
)
_COLUMN_COUNT = MappingProxyType({"time": 1, "rotor_speeds": 4, "battery": 1})
_ATTITUDES = ("attitude", "mocap_attitude")
_REQUIRED = ("time", "body", "world", "angular_velocity", "acceleration")

# Keys that some signals have beside `columns`, `unit` and `missing`, with the values that they take.
_CHOICES: MappingProxyType[str, dict[str, tuple[str, ...]]] = MappingProxyType(
    {
        "acceleration": {"axes": ("body", "world"), "gravity": ("included", "removed")},
        "velocity": {"axes": ("body", "world")},
        "attitude": {"form": (*QUATERNION_ORDERS, ROLL_PITCH_YAW)},
        "mocap_attitude": {"form": (*QUATERNION_ORDERS, ROLL_PITCH_YAW)},
    }
)


@dataclass(frozen=True)
class Signal:
    """One signal of a table.

    Attributes:
        columns: in the order x, y, z, or that of the vehicle's rotors.
        unit: a key of UNITS; None for quaternions.
        missing: largest share of rows without a value between the first and the last that have one.
        choices: `axes`, `gravity` and `form`, for the signals that have them.
    """

    columns: tuple[str, ...]
    unit: str | None
    missing: float
    choices: dict[str, str]


@dataclass(frozen=True)
class Mapping:
    """What a mapping file says.

    Attributes:
        body: body axes of the table, "flu" or "frd".
        world: world axes of the table, "enu" (any z-up world) or "ned".
        signals: by name, of those in UNITS.
    """

    path: Path
    body: str
    world: str
    signals: dict[str, Signal]

    @classmethod
    def load(cls, name_or_path: str | Path) -> Mapping:
        """Read a mapping by the name of a file in config/mappings, or by path.

        Raises:
            LogError: naming the file and the key that is missing, unknown or has a value that is not known.
        """
        path, data = read_config("mapping", name_or_path, LogError)
        _check_keys(f"{path}", data, _REQUIRED, ("body", "world", *UNITS))
        return cls(
            path=path,
            body=_choice(f"{path}: `body`", data["body"], ("flu", "frd")),
            world=_choice(f"{path}: `world`", data["world"], ("enu", "ned")),
            signals={name: _signal(f"{path}: `{name}`", name, data[name]) for name in UNITS if name in data},
        )


def _signal(where: str, name: str, data: Any) -> Signal:
    choices: dict[str, tuple[str, ...]] = _CHOICES.get(name, {})
    form = data.get("form") if isinstance(data, dict) else None
    is_quaternion = name in _ATTITUDES and isinstance(form, str) and form in QUATERNION_ORDERS
    units = () if is_quaternion else ("unit",)
    _check_keys(where, data, ("columns", *units, *choices), ("missing",))
    count = 4 if is_quaternion else _COLUMN_COUNT.get(name, 3)
    columns = data["columns"]
    if not isinstance(columns, list) or len(columns) != count or len(set(map(str, columns))) != count:
        raise LogError(f"{where}: `columns` must list {count} different column{'s'[: count - 1]}")
    missing = data.get("missing", 0.0)
    if isinstance(missing, bool) or not isinstance(missing, (int, float)) or not 0.0 <= missing < 1.0:
        raise LogError(f"{where}: `missing` must be a share of the rows, from 0 to below 1")
    return Signal(
        columns=tuple(str(column) for column in columns),
        unit=_choice(f"{where}: `unit`", data["unit"], UNITS[name]) if units else None,
        missing=float(missing),
        choices={key: _choice(f"{where}: `{key}`", data[key], known) for key, known in choices.items()},
    )


def _check_keys(where: str, data: Any, required: tuple[str, ...], optional: tuple[str, ...]) -> None:
    if not isinstance(data, dict):
        raise LogError(f"{where}: expected keys and values, found {type(data).__name__}")
    for key in required:
        if key not in data:
            raise LogError(f"{where}: missing key `{key}`")
    known = dict.fromkeys(required + optional)
    for key in data:
        if key not in known:
            raise LogError(f"{where}: unknown key `{key}`; known: {', '.join(known)}")


def _choice(where: str, value: Any, known: Iterable[str]) -> str:
    if value not in list(known):
        raise LogError(f"{where} is {value!r}; known: {', '.join(known)}")
    return str(value)
