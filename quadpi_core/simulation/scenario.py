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
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from quadpi_core.config_schema import (
    Expected,
    ReadBy,
    Section,
    Text,
    Within,
    is_config_path,
    load_config,
    nearest,
    parse_config,
    unknown_key,
)
from quadpi_core.errors import SimulationError, named_in
from quadpi_core.frames import Array
from quadpi_core.records import brief_repr
from quadpi_core.simulation.applied_effects import read_effects
from quadpi_core.simulation.effect_definition import Effects
from quadpi_core.simulation.sensors import Fault
from quadpi_core.simulation.truth import (
    AXES,
    LOG_HZ,
    Motion,
    Orbit,
    Reference,
    motion_as_dict,
    read_motion,
    signal_as_dict,
    within_flight,
)

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
        vehicle, noise: name or path of the files of vehicle and sensors.
        seed: of all random numbers of the flight.
        height_m: height over ground of the hover in which the flight begins, nose north.
        head_wind_m_s: wind from the north that an anemometer measures; None without wind or anemometer.
        motion: signals of each axis.
        orbit: circle flown in place of motion along x and y.
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
        """Read the keys and values of :meth:`as_dict`; `where` are file and flight, for messages.

        Raises:
            SimulationError: naming the key that is missing, unknown or impossible.
        """
        return parse_config(cls, data, where, SimulationError)

    def as_dict(self) -> dict[str, Any]:
        """The plan as JSON; :meth:`from_dict` reads it back."""
        return vars(self) | {
            "motion": motion_as_dict(self.motion),
            "orbit": None if self.orbit is None else signal_as_dict(self.orbit),
            "effects": {name: dict(parameters) for name, parameters in self.effects.items()},
            "faults": [fault.as_dict() for fault in self.faults],
        }

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
        jets["height"][:, 0] += self.height_m
        path = np.stack((jets["x"], jets["y"], -jets["height"]), axis=1)
        tilt = np.stack((jets["roll"][:, 0], jets["pitch"][:, 0]), axis=1)
        yaw, yaw_rate, _ = jets["yaw"].T
        position, velocity, acceleration = np.moveaxis(path, 2, 0)
        thrust = jets["thrust"][:, 0]
        return Reference(position, velocity, acceleration, yaw, yaw_rate, tilt, thrust)


@dataclass(frozen=True, kw_only=True)
class _ScenarioFile(Section):
    """The content of a scenario file; `Any` holds for its flights, and is checked with each of them."""

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


def load_scenario(name_or_path: str | Path, _including: tuple[Path, ...] = ()) -> Scenario:
    """Read a scenario by the name of a file in config/scenarios, or by path.

    Flights of included files come first. The settings of a file apply to its own flights, its effects to the
    included flights, too. A flight without a seed gets one from the seed of its file and its name,
    independent of the other flights.

    Raises:
        SimulationError: naming file, flight and key that is missing, unknown or impossible; for flights of
            the same name, and for files that include each other.
    """
    path, content = load_config("scenario", name_or_path, _ScenarioFile, SimulationError)
    including = (*_including, path.resolve())
    if path.resolve() in _including:
        circle = " includes ".join(str(file) for file in including)
        raise SimulationError(f"{circle}: a scenario cannot include itself")
    effects = read_effects(content.effects, str(path))
    flights: dict[str, FlightPlan] = {}
    for plan in chain(_included(path, content, effects, including), _own_flights(path, content, effects)):
        if (other := flights.setdefault(plan.name, plan)) is not plan:
            scenarios = f"of {other.scenario} and of {plan.scenario}"
            raise SimulationError(f"{path}: two flights are named `{plan.name}`: {scenarios}")
    if not flights:
        raise SimulationError(f"{path}: holds no flights: `flights` and `include` are empty")
    return Scenario(path.stem, content.description, tuple(flights.values()))


def _included(
    path: Path, content: _ScenarioFile, effects: Effects, including: tuple[Path, ...]
) -> Iterator[FlightPlan]:
    for other in content.include:
        with named_in(f"{path}: `include`"):
            plans = load_scenario(_beside(path, other), including).flights
        for plan in plans:
            yield plan.overridden(effects={**effects, **plan.effects}) if effects else plan


def _own_flights(path: Path, content: _ScenarioFile, effects: Effects) -> Iterator[FlightPlan]:
    keys = [column.name for column in fields(FlightPlan) if column.name not in {"name", "scenario"}]
    shared = {key: value for key, value in vars(content).items() if key in keys}
    for name, data in content.flights.items():
        where = f"{path}: flight `{name}`"
        given = {} if data is None else data
        if not isinstance(given, dict):
            raise SimulationError(f"{where}: expected keys and values, found {given!r}")
        if unknown := [key for key in given if key not in keys]:
            raise SimulationError(f"{where}: {unknown_key(unknown[0], keys)}")
        own = {key: value for key, value in given.items() if value is not None}
        merged = {"name": str(name), "scenario": path.stem} | shared | own
        merged["effects"] = {**effects, **read_effects(given.get("effects"), where)}
        if "seed" not in own:
            if content.seed is None:
                raise SimulationError(f"{path}: missing key `seed`")
            merged["seed"] = flight_seed(content.seed, str(name))
        for key in ("vehicle", "noise"):
            if isinstance(merged[key], str):
                merged[key] = str(_beside(path, merged[key]))
        yield FlightPlan.from_dict(merged, where)


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
        vehicle: of every flight.
        noise: sensors of every flight.
        seed: seed from which, with its name, each flight gets its own.
        effects: effects of every flight; they replace those of the same name.

    Raises:
        SimulationError: for a flight that the scenario does not have, and impossible settings.
    """
    known = [plan.name for plan in scenario.flights]
    if unknown := [name for name in names if name not in known]:
        raise SimulationError(
            f"scenario {scenario.name}: no flight `{unknown[0]}`; its flights: {', '.join(known)}"
            f"{nearest(unknown[0], known)}"
        )
    changes = {key: value for key, value in (("vehicle", vehicle), ("noise", noise)) if value is not None}
    return [
        plan.overridden(
            **changes,
            seed=plan.seed if seed is None else flight_seed(seed, plan.name),
            effects={**plan.effects, **(effects or {})},
        )
        for plan in scenario.flights
        if not names or plan.name in names
    ]


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
