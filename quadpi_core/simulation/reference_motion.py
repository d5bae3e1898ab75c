# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Signals as they stand in scenario files: under their axis, by their kind, amplitudes in its unit."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, asdict, fields
from typing import Any, TypeAlias, TypeVar

from quadpi_core.errors import SimulationError
from quadpi_core.simulation.config_section import Section
from quadpi_core.simulation.reference_signals import ROUNDING_S, SIGNALS, Orbit, Signal

# Axes that a flight can move, each with the unit of its amplitudes in files; shares are of the weight.
AXES = {"x": "m", "y": "m", "height": "m", "yaw": "deg", "roll": "deg", "pitch": "deg", "thrust": "share"}
_KINDS = {signal: kind for kind, signal in SIGNALS.items()}

# The signals of each axis, which add up.
Motion: TypeAlias = Mapping[str, tuple[Signal, ...]]
_Moving = TypeVar("_Moving", bound=Signal | Orbit)


def read_motion(data: Any, where: str, flight_s: float) -> Motion:
    """Read the mapping `motion` of a flight.

    Args:
        data: lists of signals by axis; None for none.
        where: file and flight, for messages.
        flight_s: duration of the flight, within which all signals end; so does one without a duration.

    Raises:
        SimulationError: naming axis, signal and key.
    """
    motion = {}
    section = Section({} if data is None else data, f"{where}: motion", AXES)
    for axis, unit in AXES.items():
        entries = section.get(axis, [])
        if not isinstance(entries, list):
            raise SimulationError(f"{where}: motion: `{axis}` must be a list of signals, found {entries!r}")
        signals = [
            _read_entry(entry, f"{where}: motion: {axis}, signal {number}", unit, flight_s)
            for number, entry in enumerate(entries, start=1)
        ]
        if signals:
            motion[axis] = tuple(signals)
    return motion


def motion_as_dict(motion: Motion) -> dict[str, Any]:
    """What :func:`read_motion` reads."""
    return {
        axis: [{_KINDS[type(signal)]: _as_dict(signal, AXES[axis])} for signal in signals]
        for axis, signals in motion.items()
    }


def read_orbit(data: Any, where: str, flight_s: float) -> Orbit:
    """Read the mapping `orbit` of a flight; arguments and errors as for :func:`read_motion`."""
    return _read(Orbit, data, f"{where}: orbit", "", flight_s)


def orbit_as_dict(orbit: Orbit) -> dict[str, Any]:
    """What :func:`read_orbit` reads."""
    return _as_dict(orbit, "")


def _read_entry(data: Any, where: str, unit: str, flight_s: float) -> Signal:
    section = Section(data, where, SIGNALS)
    given = [kind for kind in SIGNALS if kind in section]
    if len(given) != 1:
        raise SimulationError(f"{where}: expected one of {', '.join(SIGNALS)}, found {data!r}")
    return _read(SIGNALS[given[0]], section.get(given[0], None), f"{where}: {given[0]}", unit, flight_s)


def _read(kind: type[_Moving], data: Any, where: str, unit: str, flight_s: float) -> _Moving:
    """A signal or an orbit, its values judged as the types of its fields demand."""
    columns = fields(kind)
    section = Section(data, where, [_key(column.name, unit) for column in columns])
    values: dict[str, Any] = {}
    for column in columns:
        key = _key(column.name, unit)
        if key in section:
            values[column.name] = _READERS[str(column.type)](section, key)
        elif column.name == "duration_s" and "start_s" in values:
            values["duration_s"] = flight_s - values["start_s"]
        elif column.default is MISSING:
            raise SimulationError(f"{where}: missing key `{key}`")
    try:
        signal = kind(**values)
    except SimulationError as error:
        raise SimulationError(f"{where}: {error}") from None
    if signal.end > flight_s + ROUNDING_S:
        raise SimulationError(
            f"{where}: ends at {signal.end:g} s, after the flight, which lasts {flight_s:g} s"
        )
    return signal


def _as_dict(signal: Signal | Orbit, unit: str) -> dict[str, Any]:
    values = {_key(name, unit): value for name, value in asdict(signal).items() if value is not None}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}


def _key(name: str, unit: str) -> str:
    return f"amplitude_{unit}" if name == "amplitude" else name


_READERS: dict[str, Callable[[Section, str], Any]] = {
    "float": lambda section, key: section.number(key, lowest=-math.inf),
    "float | None": lambda section, key: section.number(key, lowest=-math.inf),
    "int": lambda section, key: section.whole(key),
    "bool": lambda section, key: section.switch(key),
    "str": lambda section, key: section.text(key),
    "tuple[float, ...]": lambda section, key: section.numbers(key),
}
