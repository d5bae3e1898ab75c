# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The plan of one simulated flight, complete enough to repeat it bit for bit."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, fields
from typing import Annotated, Any

import numpy as np
from pydantic import PlainValidator

from quadpi_core.config_schema import Section, Text, Within, parse_config
from quadpi_core.errors import SimulationError
from quadpi_core.frames import Array
from quadpi_core.simulation.effect_definition import Effects
from quadpi_core.simulation.effect_registry import read_effects
from quadpi_core.simulation.failures import Fault
from quadpi_core.simulation.reference_signals import (
    AXES,
    Motion,
    Orbit,
    motion_as_dict,
    read_motion,
    signal_as_dict,
    within_flight,
)
from quadpi_core.simulation.truth import LOG_HZ, Reference

# Rate at which a reference is checked for contact with the ground.
_LOOK_HZ = 100.0
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")


def _read_effects(data: Any) -> Effects:
    try:
        return read_effects(data, "effects")
    except SimulationError as error:
        raise ValueError(str(error).removeprefix("effects: ")) from None


@dataclass(frozen=True, kw_only=True)
class FlightPlan(Section):
    """One flight of a scenario; the fields are its keys in a file.

    Attributes:
        name: of the flight and its bag.
        scenario: to which the flight belongs.
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

    name: Text
    scenario: Text
    vehicle: Text
    noise: Text = "paper"
    seed: Annotated[int, Within(0, 2**32)]
    duration_s: Annotated[float, Within(0.1, 3600.0)]
    height_m: Annotated[float, Within(0.0, 1000.0)] = 3.0
    head_wind_m_s: Annotated[float, Within(-100.0, 100.0)] | None = None
    motion: Annotated[Motion, PlainValidator(read_motion)] = field(default_factory=dict)
    orbit: Orbit | None = None
    effects: Annotated[Effects, PlainValidator(_read_effects)] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    truth_rate_hz: Annotated[int, Within(1, LOG_HZ)] = LOG_HZ

    def __post_init__(self) -> None:
        """Resolve the durations of signals, and refuse plans that are impossible for any vehicle."""
        motion = {
            axis: tuple(
                within_flight(signal, self.duration_s, f"motion.{axis}, entry {number}")
                for number, signal in enumerate(signals, start=1)
            )
            for axis, signals in self.motion.items()
        }
        object.__setattr__(self, "motion", motion)
        if self.orbit is not None:
            object.__setattr__(self, "orbit", within_flight(self.orbit, self.duration_s, "orbit"))
        if not _NAME.fullmatch(self.name):
            raise ValueError("a flight's name has letters, digits, _ and - only")
        if LOG_HZ % self.truth_rate_hz:
            raise ValueError(f"`truth_rate_hz` must divide {LOG_HZ}, found {self.truth_rate_hz}")
        moved = [axis for axis in ("x", "y") if axis in self.motion]
        if self.orbit is not None and moved:
            raise ValueError(f"`orbit` and motion along {moved[0]} exclude each other")
        height = -self.reference(_LOOK_HZ).position[:, 2]
        lowest = int(np.argmin(height))
        if height[lowest] <= 0.0:
            raise ValueError(
                f"comes down to the ground: at {lowest / _LOOK_HZ:.2f} s its height is {height[lowest]:.2f} m"
            )

    @classmethod
    def from_dict(cls, data: Any, where: str) -> FlightPlan:
        """Read what a scenario file says about a flight, with its name, scenario and seed.

        Args:
            data: keys and values, as of :meth:`as_dict`.
            where: file and flight, for messages.

        Raises:
            SimulationError: naming the key that is missing, unknown or impossible.
        """
        return parse_config(cls, data, where, SimulationError)

    def as_dict(self) -> dict[str, Any]:
        """The plan as JSON; :meth:`from_dict` reads it back."""
        parts = {
            "motion": motion_as_dict(self.motion),
            "orbit": None if self.orbit is None else signal_as_dict(self.orbit),
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
        """The reference, from the first to the last instant of the flight."""
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
