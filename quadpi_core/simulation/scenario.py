# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Plans of flights, and the scenario files that hold them.

Scenarios are files under config/scenarios, or of the user's own; they can include each other.
"""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from quadpi_core.brief_repr import brief_repr
from quadpi_core.config import is_config_path, nearest
from quadpi_core.config_schema import (
    Expected,
    ReadBy,
    Section,
    Text,
    Within,
    load_config,
    parse_config,
    unknown_key,
)
from quadpi_core.errors import SimulationError, named_in
from quadpi_core.frames import Array
from quadpi_core.simulation.applied_effects import read_effects
from quadpi_core.simulation.effect_definition import Effects
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
        name: name of the flight and its bag.
        scenario: name of the scenario of the flight.
        vehicle: name or path of the vehicle file.
        noise: name or path of the file of the sensors.
        seed: seed of all random numbers of the flight.
        height_m: height over ground of the hover in which the flight begins, nose north.
        head_wind_m_s: wind from the north that an anemometer measures; None without wind or anemometer.
        motion: signals of each axis.
        orbit: circle flown in place of motion along x and y.
        effects: active effects.
        faults: faults of the sensors.
        truth_rate_hz: rate of the truth in the bag.
    """

    __repr__ = brief_repr

    name: Text
    scenario: Text
    vehicle: Text
    noise: Text = "paper"
    seed: Annotated[int, Within(0, 2**32)]
    duration_s: Annotated[float, Within(0.1, 3600.0)]
    height_m: Annotated[float, Within(0.0, 1000.0)] = 3.0
    head_wind_m_s: Annotated[float, Within(-100.0, 100.0)] | None = None
    motion: Annotated[Motion, ReadBy(read_motion)] = field(default_factory=dict)
    orbit: Orbit | None = None
    effects: Annotated[Effects, ReadBy(_read_effects)] = field(default_factory=dict)
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
        """Read a flight of a scenario file, with its name, scenario and seed.

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
        jets = {axis: np.zeros((len(time), 3)) for axis in AXES}
        for axis, signals in self.motion.items():
            for signal in signals:
                jets[axis] += signal.jets(time)
            if AXES[axis] == "deg":
                jets[axis] *= math.radians(1.0)
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


# Keys that a scenario may set for all flights in its file; the key of a flight takes precedence.
_SHARED = ("vehicle", "noise", "duration_s", "height_m", "head_wind_m_s", "truth_rate_hz")
_FLIGHT_KEYS = [column.name for column in fields(FlightPlan) if column.name not in {"name", "scenario"}]


@dataclass(frozen=True, kw_only=True)
class _ScenarioFile(Section):
    """The content of a scenario file; flights are checked when what they share is known."""

    description: Text
    include: Annotated[tuple[Text, ...], Expected("must be a list of names or paths")] = ()
    seed: Annotated[int, Within(0, 2**32)] | None = None
    vehicle: Any = None
    noise: Any = None
    duration_s: Any = None
    height_m: Any = None
    head_wind_m_s: Any = None
    truth_rate_hz: Any = None
    effects: Any = None
    flights: Annotated[dict[Any, Any], Expected("must be flights by name")] = field(default_factory=dict)


@dataclass(frozen=True)
class Scenario:
    """Flights that belong together."""

    __repr__ = brief_repr

    name: str
    description: str
    flights: tuple[FlightPlan, ...]


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario by the name of a file in config/scenarios, or by path.

    Flights of included files come first. The settings of a file apply to its own flights, its effects to the
    included flights, too. A flight without a seed gets one from the seed of its file and its name,
    independent of the other flights.

    Raises:
        SimulationError: naming file, flight and key that is missing, unknown or impossible; for flights of
            the same name, and for files that include each other.
    """
    return _load(name_or_path, ())


def _load(name_or_path: str | Path, including: tuple[Path, ...]) -> Scenario:
    path, content = load_config("scenario", name_or_path, _ScenarioFile, SimulationError)
    if path.resolve() in including:
        circle = " includes ".join(str(file) for file in (*including, path))
        raise SimulationError(f"{circle}: a scenario cannot include itself")
    effects = read_effects(content.effects, str(path))
    included: list[FlightPlan] = []
    for other in content.include:
        with named_in(f"{path}: `include`"):
            plans = _load(_beside(path, other), (*including, path.resolve())).flights
        if effects:
            plans = tuple(plan.overridden(effects={**effects, **plan.effects}) for plan in plans)
        included += plans
    flights = (*included, *_own_flights(path, content, effects))
    if not flights:
        raise SimulationError(f"{path}: holds no flights: `flights` and `include` are empty")
    seen: dict[str, str] = {}
    for plan in flights:
        if plan.name in seen:
            raise SimulationError(
                f"{path}: two flights are named `{plan.name}`: of {seen[plan.name]} and of {plan.scenario}"
            )
        seen[plan.name] = plan.scenario
    return Scenario(path.stem, content.description, flights)


def _own_flights(path: Path, content: _ScenarioFile, effects: Effects) -> Iterator[FlightPlan]:
    shared = {key: getattr(content, key) for key in _SHARED}
    for name, data in content.flights.items():
        where = f"{path}: flight `{name}`"
        keys = {} if data is None else data
        if not isinstance(keys, dict):
            raise SimulationError(f"{where}: expected keys and values, found {keys!r}")
        for key in keys:
            if key not in _FLIGHT_KEYS:
                raise SimulationError(f"{where}: {unknown_key(key, _FLIGHT_KEYS)}")
        merged: dict[str, Any] = shared | {key: value for key, value in keys.items() if value is not None}
        merged["effects"] = dict(effects) | dict(read_effects(keys.get("effects"), where))
        if merged.get("seed") is None:
            if content.seed is None:
                raise SimulationError(f"{path}: missing key `seed`")
            merged["seed"] = flight_seed(content.seed, str(name))
        for key in ("vehicle", "noise"):
            if isinstance(merged[key], str):
                merged[key] = str(_beside(path, merged[key]))
        yield FlightPlan.from_dict(merged | {"name": str(name), "scenario": path.stem}, where)


def flight_seed(scenario_seed: int, name: str) -> int:
    """The seed of a flight that does not set one."""
    return zlib.crc32(f"{scenario_seed} {name}".encode())


def _beside(path: Path, other: str) -> str | Path:
    """A path relative to the folder of the file that names it; the name of a file in config unchanged."""
    return path.parent / other if is_config_path(other) else other


def choose_flights(
    scenario: Scenario,
    names: Sequence[str] = (),
    *,
    vehicle: str | None = None,
    noise: str | None = None,
    seed: int | None = None,
    effects: Effects | None = None,
) -> list[FlightPlan]:
    """Flights of a scenario in its order, with settings that replace those of the scenario unless None.

    Args:
        scenario: scenario to fly.
        names: names of the flights; none for all.
        vehicle: vehicle of every flight.
        noise: sensors of every flight.
        seed: seed from which, with its name, each flight gets its own.
        effects: effects of every flight; they replace those of the same name.

    Raises:
        SimulationError: for a flight that the scenario does not have, and impossible settings.
    """
    known = [plan.name for plan in scenario.flights]
    for name in names:
        if name not in known:
            raise SimulationError(
                f"scenario {scenario.name}: no flight `{name}`; its flights: {', '.join(known)}"
                f"{nearest(name, known)}"
            )
    chosen = []
    for plan in scenario.flights:
        changes: dict[str, Any] = {"vehicle": vehicle, "noise": noise}
        if seed is not None:
            changes["seed"] = flight_seed(seed, plan.name)
        if effects:
            changes["effects"] = {**plan.effects, **effects}
        given = {key: value for key, value in changes.items() if value is not None}
        if not names or plan.name in names:
            chosen.append(plan.overridden(**given) if given else plan)
    return chosen


def parse_effects(texts: Iterable[str]) -> Effects:
    """Effects from texts NAME or NAME:PARAMETER=VALUE[,PARAMETER=VALUE…].

    Raises:
        SimulationError: naming the text that is no such thing, and the unknown effect or parameter.
    """
    data: dict[str, dict[str, float]] = {}
    for text in texts:
        name, colon, listed = text.partition(":")
        for part in listed.split(",") if colon else ():
            parameter, _, value = part.partition("=")
            try:
                number = float(value)
            except ValueError:
                raise SimulationError(
                    f"--effect {text}: expected NAME or NAME:PARAMETER=VALUE[,PARAMETER=VALUE…]"
                ) from None
            if parameter in data.setdefault(name, {}):
                raise SimulationError(f"--effect {text}: `{parameter}` is given twice")
            data[name][parameter] = number
        data.setdefault(name, {})
    return read_effects(data, "--effect")
