# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What messages of other packages do not say of themselves: units, frames, which rotor, which body.

docs/adapters.md explains the keys; config/adapters holds examples.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from quadpi_core.config import nearest, read_config
from quadpi_core.errors import LogError
from quadpi_core.rotor_order import ERPM, LAYOUTS, RPM, RotorOrder
from quadpi_core.vehicle import Vehicle

FLU_ENU, FRD_NED, FUR_EUS = "flu-enu", "frd-ned", "fur-eus"


@dataclass(frozen=True)
class RotorSettings:
    """How ESC reports become rotor speeds.

    Attributes:
        rotors: for each rotor of the vehicle file, the number from 1 of the ESC (mavros) or motor (PX4); or
            the name of a layout (`rotor_order.LAYOUTS`), which the vehicle's rotors fit by their corners.
        unit: "rpm" of the rotor, or "erpm" of the electrical field: the vehicle's pole pairs are needed.
        topic: which, where a bag holds several that could be meant.
    """

    rotors: tuple[int, ...] | str
    unit: str
    topic: str | None = None

    def order(self, vehicle: Vehicle | None) -> RotorOrder:
        """The order that the settings give.

        Raises:
            LogError: if they give none, or not without a vehicle.
        """
        if not isinstance(self.rotors, str):
            return RotorOrder.parse(" ".join(map(str, self.rotors)), self.unit)
        if vehicle is None:
            raise LogError(
                f"the layout {self.rotors} needs the vehicle, whose file says where its rotors are"
            )
        return RotorOrder.by_layout(vehicle, self.rotors, self.unit)


@dataclass(frozen=True)
class BodySettings:
    """Which of the bodies that a motion capture follows, and in what axes.

    Attributes:
        body: its name.
        frames: body and world axes: "flu-enu" (z up), "frd-ned" (z down) or "fur-eus" (y up in both).
        topic: see :class:`RotorSettings`.
    """

    body: str
    frames: str
    topic: str | None = None


@dataclass(frozen=True)
class StateSettings:
    """For messages that name their frames and units themselves."""

    topic: str | None = None


@dataclass(frozen=True)
class AdapterSettings:
    """Settings of every kind of stream; None: messages of other packages are not used for it."""

    rotor_speeds: RotorSettings | None = None
    mocap: BodySettings | None = None
    odometry: StateSettings | None = None
    imu: StateSettings | None = None

    @classmethod
    def load(cls, name_or_path: str | Path) -> AdapterSettings:
        """Read settings by the name of a file in config/adapters, or by path.

        Raises:
            LogError: naming the file and the key that is missing, unknown or has a value that is not known.
        """
        path, data = read_config("adapter", name_or_path, LogError)
        entries = _checked(f"{path}", data, {}, dict.fromkeys(_READERS))
        return cls(**{kind: _READERS[kind](f"{path}: `{kind}`", entries[kind]) for kind in entries})


def _rotors(where: str, data: Any) -> RotorSettings:
    entries = _checked(where, data, {"rotors": None, "unit": (RPM, ERPM)}, {"topic": None})
    rotors = entries["rotors"]
    if isinstance(rotors, list):
        rotors = tuple(rotors)
    elif not isinstance(rotors, str) or rotors not in LAYOUTS:
        raise LogError(f"{where}: `rotors` must list numbers of ESCs or motors, or be {' or '.join(LAYOUTS)}")
    settings = RotorSettings(rotors, entries["unit"], entries.get("topic"))
    if not isinstance(rotors, str):
        try:
            settings.order(None)
        except LogError as error:
            raise LogError(f"{where}: {error}") from None
    return settings


def _body(where: str, data: Any) -> BodySettings:
    required = {"body": None, "frames": (FLU_ENU, FRD_NED, FUR_EUS)}
    entries = _checked(where, data, required, {"topic": None})
    if not isinstance(entries["body"], (str, int)) or entries["body"] == "":
        raise LogError(f"{where}: `body` must be the name of a body")
    return BodySettings(str(entries["body"]), entries["frames"], entries.get("topic"))


def _state(where: str, data: Any) -> StateSettings:
    return StateSettings(_checked(where, data, {}, {"topic": None}).get("topic"))


_READERS: dict[str, Callable[[str, Any], Any]] = {
    "rotor_speeds": _rotors,
    "mocap": _body,
    "odometry": _state,
    "imu": _state,
}

_Choices: TypeAlias = Mapping[str, tuple[str, ...] | None]


def _checked(where: str, data: Any, required: _Choices, optional: _Choices) -> dict[str, Any]:
    """The entries, once every key is known and has one of its values.

    Args:
        where: file and key, for errors.
        data: what stands there.
        required: keys that must be there, with the values that they take; None for any.
        optional: keys that may be there.
    """
    if not isinstance(data, dict):
        raise LogError(f"{where}: expected keys and values, found {type(data).__name__}")
    known = {**required, **optional}
    for key in required:
        if key not in data:
            raise LogError(f"{where}: missing key `{key}`")
    for key, value in data.items():
        if key not in known:
            raise LogError(
                f"{where}: unknown key `{key}`; known: {', '.join(known)}{nearest(str(key), known)}"
            )
        choices = known[key]
        if choices is not None and value not in choices:
            raise LogError(f"{where}: `{key}` is {value!r}; known: {', '.join(choices)}")
        if key == "topic" and not isinstance(value, str):
            raise LogError(f"{where}: `topic` must be the name of a topic")
    return data
