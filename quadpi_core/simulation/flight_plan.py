# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The plan of one simulated flight: all that it takes to fly it again."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from quadpi_core.errors import SimulationError
from quadpi_core.frames import Array
from quadpi_core.simulation.config_section import Section
from quadpi_core.simulation.effect_definition import Effects
from quadpi_core.simulation.effect_registry import read_effects
from quadpi_core.simulation.failures import Fault, read_faults
from quadpi_core.simulation.reference import Reference
from quadpi_core.simulation.reference_motion import (
    AXES,
    Motion,
    motion_as_dict,
    orbit_as_dict,
    read_motion,
    read_orbit,
)
from quadpi_core.simulation.reference_signals import Orbit
from quadpi_core.simulation.truth import LOG_HZ

_LONGEST_S = 3600.0
_HIGHEST_M = 1000.0
_WIND_MAX_M_S = 100.0
# Instants per second at which a flight is looked at for contact with the ground.
_LOOK_HZ = 100.0
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")


@dataclass(frozen=True, kw_only=True)
class FlightPlan:
    """One flight of a scenario; the fields are its keys in a file.

    Attributes:
        name: of the flight and its bag.
        scenario: that the flight stands in.
        vehicle: name or path of its file.
        noise: name or path of the file of its sensors.
        seed: of all that is random in this flight.
        height_m: over ground, of the hover in which the flight begins, nose north.
        head_wind_m_s: from the north, as an anemometer measures it; None where there is none.
        motion: signals of each axis.
        orbit: in the place of motion along x and y.
        effects: that are switched on.
        faults: of the sensors.
        truth_rate_hz: of the truth in the bag.
    """

    name: str
    scenario: str
    vehicle: str
    noise: str = "paper"
    seed: int
    duration_s: float
    height_m: float = 3.0
    head_wind_m_s: float | None = None
    motion: Motion = field(default_factory=dict)
    orbit: Orbit | None = None
    effects: Effects = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    truth_rate_hz: int = LOG_HZ

    @classmethod
    def from_dict(cls, data: Any, where: str) -> FlightPlan:
        """Read what stands in a scenario file about a flight, with its name, scenario and seed.

        Args:
            data: keys and values, as of :meth:`as_dict`.
            where: file and flight, for messages.

        Raises:
            SimulationError: naming the key that is missing, unknown or impossible.
        """
        section = Section(data, where, [column.name for column in fields(cls)])
        flight_s = section.number("duration_s", lowest=0.1, highest=_LONGEST_S)
        wind = section.get("head_wind_m_s", None)
        orbit = section.get("orbit", None)
        plan = cls(
            name=section.text("name"),
            scenario=section.text("scenario"),
            vehicle=section.text("vehicle"),
            noise=section.text("noise", cls.noise),
            seed=section.whole("seed"),
            duration_s=flight_s,
            height_m=section.number("height_m", cls.height_m, highest=_HIGHEST_M),
            head_wind_m_s=None
            if wind is None
            else section.number("head_wind_m_s", lowest=-_WIND_MAX_M_S, highest=_WIND_MAX_M_S),
            motion=read_motion(section.get("motion", None), where, flight_s),
            orbit=None if orbit is None else read_orbit(orbit, where, flight_s),
            effects=read_effects(section.get("effects", None), where),
            faults=read_faults(section.get("faults", None), where),
            truth_rate_hz=section.whole("truth_rate_hz", cls.truth_rate_hz, lowest=1, highest=LOG_HZ),
        )
        plan._check(where)
        return plan

    def as_dict(self) -> dict[str, Any]:
        """All of the plan as JSON can hold it; :meth:`from_dict` makes the plan of it again."""
        parts = {
            "motion": motion_as_dict(self.motion),
            "orbit": None if self.orbit is None else orbit_as_dict(self.orbit),
            "effects": {name: dict(parameters) for name, parameters in self.effects.items()},
            "faults": [fault.as_dict() for fault in self.faults],
        }
        return {column.name: parts.get(column.name, getattr(self, column.name)) for column in fields(self)}

    def overridden(self, **changes: Any) -> FlightPlan:
        """The plan with other values of some keys, as in a scenario file.

        Raises:
            SimulationError: as for :meth:`from_dict`.
        """
        return self.from_dict(self.as_dict() | changes, f"flight {self.name}")

    @property
    def known_wind(self) -> Array | None:
        """Steady wind (3,) m/s of the world that an anemometer measures; None without one."""
        return None if self.head_wind_m_s is None else np.array([-self.head_wind_m_s, 0.0, 0.0])

    def reference(self, rate_hz: float) -> Reference:
        """What the vehicle is to follow, from the first to the last instant of the flight."""
        time = np.arange(math.floor(self.duration_s * rate_hz + 0.5) + 1) / rate_hz
        jets = {axis: self._jets(axis, time) for axis in AXES}
        if self.orbit is not None:
            jets["x"], jets["y"], turn = self.orbit.jets(time)
            jets["yaw"] += turn
        north, east, up = jets["x"], jets["y"], jets["height"]
        up[:, 0] += self.height_m
        position, velocity, acceleration = np.moveaxis(np.stack((north, east, -up), axis=1), 2, 0)
        return Reference(
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            yaw=jets["yaw"][:, 0],
            yaw_rate=jets["yaw"][:, 1],
            tilt=np.stack((jets["roll"][:, 0], jets["pitch"][:, 0]), axis=1),
            thrust=jets["thrust"][:, 0],
        )

    def _jets(self, axis: str, time: Array) -> Array:
        """Sum of the signals of an axis (N, 3), SI."""
        jets = np.zeros((len(time), 3))
        for signal in self.motion.get(axis, ()):
            jets += signal.jets(time)
        return jets * math.radians(1.0) if AXES[axis] == "deg" else jets

    def _check(self, where: str) -> None:
        """Refuse what no flight can be, whatever its vehicle."""
        if not _NAME.fullmatch(self.name):
            raise SimulationError(f"{where}: a flight's name has letters, digits, _ and - only")
        if LOG_HZ % self.truth_rate_hz:
            raise SimulationError(
                f"{where}: `truth_rate_hz` must divide {LOG_HZ}, found {self.truth_rate_hz}"
            )
        moved = [axis for axis in ("x", "y") if axis in self.motion]
        if self.orbit is not None and moved:
            raise SimulationError(f"{where}: `orbit` and motion along {moved[0]} exclude each other")
        height = -self.reference(_LOOK_HZ).position[:, 2]
        lowest = int(np.argmin(height))
        if height[lowest] <= 0.0:
            raise SimulationError(
                f"{where}: comes down to the ground: at {lowest / _LOOK_HZ:.2f} s its height is "
                f"{height[lowest]:.2f} m"
            )
