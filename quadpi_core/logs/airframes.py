# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicles other than quadrotors, where a log says that it is of one.

A multicopter of another number of rotors looks like a quadrotor of four of them, and is refused. Of a vehicle
that is none, such as a VTOL, the sensors are read and the rotors left out.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

from quadpi_core.errors import LogError
from quadpi_core.logs.reader_steps import note
from quadpi_core.vehicle import ROTORS

_BY_ROTORS = MappingProxyType(
    {3: "a tricopter", 6: "a hexacopter", 8: "an octocopter", 10: "a decacopter", 12: "a dodecacopter"}
)
# Types of MAVLink's heartbeat, also in PX4's MAV_TYPE, that are no quadrotor, by the number of rotors of a
# multicopter or by name.
_MAV_TYPES: MappingProxyType[int, int | str] = MappingProxyType(
    {
        **{1: "a fixed-wing aircraft", 3: "a coaxial helicopter", 4: "a helicopter", 7: "an airship"},
        **{10: "a rover", 11: "a boat", 12: "a submarine", 16: "an ornithopter"},
        **{13: 6, 14: 8, 15: 3, 29: 12, 35: 10},
        **dict.fromkeys(range(19, 26), "a VTOL aircraft"),
    }
)


class Airframe(NamedTuple):
    """A vehicle that is no quadrotor.

    Attributes:
        said: by what the log says it, such as "FRAME_CLASS 2".
        name: of such a vehicle, with its article.
        is_multicopter: that would pass for a quadrotor.
    """

    said: str
    name: str
    is_multicopter: bool

    def __str__(self) -> str:
        return f"{self.said} is {self.name}; quadpi supports quadrotors"

    @classmethod
    def of_rotors(cls, said: str, rotors: int) -> Airframe | None:
        """A multicopter of so many rotors; None for a quadrotor."""
        if rotors == ROTORS:
            return None
        return cls(said, _BY_ROTORS.get(rotors, f"a vehicle of {rotors} rotors"), True)

    @classmethod
    def of_mav_type(cls, said: str, mav_type: int) -> Airframe | None:
        """The vehicle of a MAV_TYPE; None for a quadrotor, and where the number does not say."""
        known = _MAV_TYPES.get(mav_type)
        if isinstance(known, int):
            return cls.of_rotors(said, known)
        return None if known is None else cls(said, known, False)


def has_quadrotor(source: str, airframe: Airframe | None) -> bool:
    """Whether rotor speeds of a log can be those of a quadrotor; a note says it where they cannot.

    Args:
        source: of the log.
        airframe: that it is of, where it is no quadrotor.

    Raises:
        LogError: naming the vehicle, for a multicopter of another number of rotors.
    """
    if airframe is None:
        return True
    if airframe.is_multicopter:
        raise LogError(f"{source}: {airframe}")
    note(
        source,
        f"{airframe}: its sensors are read, its rotors are not, which rules out identification, prediction "
        "and replay",
    )
    return False
