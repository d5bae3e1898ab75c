# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicles of which a log says that it is: multicopters by their number of rotors, and those that are none.

Of a vehicle that is no multicopter, such as a VTOL, the sensors are read and the rotors left out.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

from quadpi_core.errors import LogError
from quadpi_core.logs.reader_steps import note
from quadpi_core.vehicle import Vehicle

_BY_ROTORS = MappingProxyType(
    {
        3: "a tricopter",
        4: "a quadrotor",
        6: "a hexacopter",
        8: "an octocopter",
        10: "a decacopter",
        12: "a dodecacopter",
    }
)
# Types of MAVLink's heartbeat, also in PX4's MAV_TYPE, by the number of rotors of a multicopter or by name;
# that of a quadrotor is what autopilots announce unless told otherwise.
_MAV_TYPES: MappingProxyType[int, int | str] = MappingProxyType(
    {
        **{1: "a fixed-wing aircraft", 3: "a coaxial helicopter", 4: "a helicopter", 7: "an airship"},
        **{10: "a rover", 11: "a boat", 12: "a submarine", 16: "an ornithopter"},
        **{13: 6, 14: 8, 15: 3, 29: 12, 35: 10},
        **dict.fromkeys(range(19, 26), "a VTOL aircraft"),
    }
)


class Airframe(NamedTuple):
    """A vehicle, as a log says it.

    Attributes:
        said: by what the log says it, such as "FRAME_CLASS 2".
        name: of such a vehicle, with its article.
        rotors: of a multicopter; None for a vehicle that is none.
    """

    said: str
    name: str
    rotors: int | None = None

    def __str__(self) -> str:
        return f"{self.said} is {self.name}"

    @property
    def is_multicopter(self) -> bool:
        """Whether rotors alone hold it in the air."""
        return self.rotors is not None

    @classmethod
    def of_rotors(cls, said: str, rotors: int) -> Airframe:
        """A multicopter of so many rotors."""
        return cls(said, _BY_ROTORS.get(rotors, f"a vehicle of {rotors} rotors"), rotors)

    @classmethod
    def of_mav_type(cls, said: str, mav_type: int) -> Airframe | None:
        """The vehicle of a MAV_TYPE; None for a quadrotor, and where the number does not say."""
        known = _MAV_TYPES.get(mav_type)
        if isinstance(known, int):
            return cls.of_rotors(said, known)
        return None if known is None else cls(said, known)

    def other_than(self, vehicle: Vehicle | None) -> str:
        """Why it is not that vehicle, for messages; empty where it may be."""
        if vehicle is None or self.rotors == vehicle.rotor_count:
            return ""
        return f"{self}; vehicle {vehicle.name} has {vehicle.rotor_count} rotors"


def has_rotors(source: str, airframe: Airframe | None, vehicle: Vehicle | None) -> bool:
    """Whether rotor speeds of a log can be those of a vehicle; a note says it where they cannot.

    Args:
        source: of the log.
        airframe: that the log is of, where it says so.
        vehicle: that it is read for.

    Raises:
        LogError: naming both, for a multicopter of another number of rotors.
    """
    if airframe is None:
        return True
    if not airframe.is_multicopter:
        note(
            source,
            f"{airframe}: its sensors are read, its rotors are not, which rules out identification, "
            "prediction and replay",
        )
        return False
    if why := airframe.other_than(vehicle):
        raise LogError(f"{source}: {why}")
    return True
