# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Application of effects: in a flight, to vehicle, air and sensors, and to recorded states."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import nearest
from quadpi_core.core import compiled
from quadpi_core.errors import SimulationError
from quadpi_core.flight import Recording
from quadpi_core.frames import Array
from quadpi_core.plugins import Plugins
from quadpi_core.records import Records
from quadpi_core.simulation import effects
from quadpi_core.simulation.effect_definition import (
    EFFECT_KINDS,
    SHAPE,
    Effect,
    Effects,
    Parameter,
    Wrench,
    modulators,
    shaped,
)
from quadpi_core.simulation.state_records import MEMORY, AddedEffect, Law, block_of, six_columns
from quadpi_core.vehicle import Vehicle, is_rigid_body

_PLUGINS = Plugins("effect", effects, "quadpi.effects", Effect, SimulationError)
EFFECTS = {
    effect.name: effect
    for effect in sorted(
        _PLUGINS.by_name().values(), key=lambda effect: (EFFECT_KINDS.index(effect.kind), effect.last)
    )
}


def read_effects(data: Any, where: str) -> Effects:
    """Effects of a file: a mapping from name to parameters, or to null for parameters of typical size.

    Args:
        data: the mapping of YAML; None or empty for no effect.
        where: file and key, for messages.

    Returns:
        Every parameter of every effect, in the order of the registry, and what shapes its law.

    Raises:
        SimulationError: naming `where` and the effect or parameter that is unknown or out of bounds.
    """
    if data is None:
        return {}
    if not isinstance(data, Mapping):
        raise SimulationError(f"{where}: expected names of effects and their parameters, found {data!r}")
    for name in data:
        if name not in EFFECTS:
            raise SimulationError(f"{where}: unknown effect `{name}`{_suggestion(str(name), tuple(EFFECTS))}")
    return {
        name: _read_parameters(effect, data[name], f"{where}: effect `{name}`")
        for name, effect in EFFECTS.items()
        if name in data
    }


def _read_parameters(effect: Effect, data: Any, where: str) -> dict[str, float]:
    if data is None:
        data = {}
    if not isinstance(data, Mapping):
        raise SimulationError(f"{where}: expected parameters and their values, found {data!r}")
    given = [parameter for parameter in effect.shape if parameter.name in data]
    known = tuple(parameter.name for parameter in (*effect.parameters, *effect.shape))
    for name in data:
        if name not in known:
            raise SimulationError(f"{where}: unknown parameter `{name}`{_suggestion(str(name), known)}")
    return {
        parameter.name: _read_value(parameter, data.get(parameter.name, parameter.default), where)
        for parameter in (*effect.parameters, *given)
    }


def _read_value(parameter: Parameter, value: Any, where: str) -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    if not number or (parameter.whole and value != int(value)):
        kind = "whole number" if parameter.whole else "number"
        raise SimulationError(f"{where}: `{parameter.name}` must be a {kind}, found {value!r}")
    if not parameter.lowest <= value <= parameter.highest:
        unit = f" {parameter.unit}" if parameter.unit else ""
        raise SimulationError(
            f"{where}: `{parameter.name}` must be between {parameter.lowest:g} and "
            f"{parameter.highest:g}{unit}, found {value:g}"
        )
    return float(value)


def _suggestion(name: str, known: tuple[str, ...]) -> str:
    return nearest(name, known) or f"; known: {', '.join(known)}"


def compose(effects: Effects, extra: Sequence[tuple[Law, Sequence[float]]] = ()) -> list[AddedEffect]:
    """The wrench effects of a flight, in the order in which they act.

    Args:
        effects: effects of any kind, of which only wrench effects are used.
        extra: functions as those of wrench effects that are not in the registry, each with its parameters,
            of which it gets a copy. They act before the effects.
    """
    added = [AddedEffect(law, np.array(values, dtype=float), _shape({})) for law, values in extra]
    wrench = _of_kind(effects, "wrench")
    return added + [AddedEffect(one.law, values, _shape(effects[one.name])) for one, values in wrench]


def effect_wrench(
    name: str, parameters: Mapping[str, float], states: npt.NDArray[np.void], vehicle: npt.NDArray[np.void]
) -> Array:
    """Wrench (N, 6) [N, Nm] that one effect adds to recorded states.

    Args:
        name: name of a wrench effect.
        parameters: all parameters, within their bounds or not.
        states: (N,) of `state_records.STATE`, with the aerodynamics in them.
        vehicle: (1,) of `state_records.VEHICLE`.

    Raises:
        SimulationError: if there is no such wrench effect.
    """
    known = [effect.name for effect in EFFECTS.values() if effect.kind == "wrench"]
    if name not in known:
        raise SimulationError(f"`{name}` is no effect on the wrench{nearest(name, known)}")
    law, values, shape = EFFECTS[name].law, _values(EFFECTS[name], parameters), _shape(parameters)
    if not isinstance(law, str):
        block = block_of(states, vehicle)
        return six_columns(shaped(law(*block, values), *block, shape), len(states))
    wrench = np.empty((len(states), 6))
    compiled.effect_wrenches(law, states, vehicle, values, shape, wrench)
    return wrench


def state_modulators(states: npt.NDArray[np.void], vehicle: npt.NDArray[np.void]) -> Array:
    """Modulators (N, MODULATORS) of recorded states, see :func:`effect_definition.modulators`.

    Args:
        states: (N,) of `state_records.STATE`.
        vehicle: (1,) of `state_records.VEHICLE`.
    """
    return np.stack(modulators(*block_of(states, vehicle)), axis=1)


def memory_at_rest(effects: Effects) -> Array:
    """State (6,) in hover of the effect that has one of its own; zeros where none has.

    Raises:
        SimulationError: for two such effects, as a flight integrates one.
    """
    remembering = [effect for effect, _ in _of_kind(effects, "wrench") if effect.at_rest]
    if len(remembering) > 1:
        names = " and ".join(f"`{effect.name}`" for effect in remembering)
        raise SimulationError(f"effects {names} each have a state of their own; a flight has one of them")
    return np.array(remembering[0].at_rest) if remembering else np.zeros(MEMORY)


def with_memory(
    name: str,
    parameters: Mapping[str, float],
    states: npt.NDArray[np.void],
    vehicle: npt.NDArray[np.void],
    start: Array,
    step_s: float,
) -> npt.NDArray[np.void]:
    """Recorded states with the state that an effect of its own has along the flight, by Heun's method.

    Args:
        name: name of an effect with a state of its own.
        parameters: all parameters, within their bounds or not.
        states: (N,) of `state_records.STATE`, one flight with the measured force in it.
        vehicle: (1,) of `state_records.VEHICLE`.
        start: (6,) the effect's own state at the first of them.
        step_s: seconds between them.
    """
    filled = states.copy()
    law, values = EFFECTS[name].law, _values(EFFECTS[name], parameters)
    if len(filled) == 0:
        return filled
    filled["memory"][0] = start
    if isinstance(law, str):
        compiled.remember(law, filled, vehicle, values, step_s)
    else:
        for i in range(len(filled) - 1):
            _stepped(law, filled[i : i + 1], filled[i + 1 : i + 2], vehicle, values, step_s)
    return filled


def _stepped(
    law: Callable[..., Wrench], now: Records, ahead: Records, vehicle: Records, values: Array, step_s: float
) -> Array:
    """Wrenches (K, 6) of an effect with a state of its own, brought forward by a step as in the core."""
    wrench = six_columns(law(*block_of(now, vehicle), values), len(now))
    most, slope = compiled.OWN_STATE_CHANGE_MAX, now["memory_slope"]
    ahead["memory"] = now["memory"] + np.clip(step_s * slope, -most, most)
    law(*block_of(ahead, vehicle), values)
    slope = 0.5 * (slope + ahead["memory_slope"])
    ahead["memory"] = now["memory"] + np.clip(step_s * slope, -most, most)
    return wrench


def remembered_wrenches(
    name: str,
    parameters: Mapping[str, float],
    states: npt.NDArray[np.void],
    vehicle: npt.NDArray[np.void],
    starts: Array,
    step_s: float,
) -> Array:
    """Wrenches (N, 6, K) [N, Nm] of one effect along a flight, with its own state from K starts on.

    They are what :func:`effect_wrench` gives for the states of :func:`with_memory`.

    Args:
        name: name of an effect with a state of its own.
        parameters: all parameters, within their bounds or not; none shapes the law.
        states: (N,) of `state_records.STATE`, one flight with the measured force in it.
        vehicle: (1,) of `state_records.VEHICLE`.
        starts: (K, 6) the effect's own state at the first of them.
        step_s: seconds between them.
    """
    law, values = EFFECTS[name].law, _values(EFFECTS[name], parameters)
    memory, added = np.array(starts, dtype=float), np.empty((len(states), 6, len(starts)))
    if isinstance(law, str):
        compiled.remembered_wrenches(law, states, vehicle, values, memory, step_s, added)
        return added
    for i, wrenches in enumerate(added):
        now = np.repeat(states[i : i + 1], len(starts))
        ahead = np.repeat(states[min(i + 1, len(states) - 1)], len(starts))
        now["memory"] = memory
        wrenches[:] = _stepped(law, now, ahead, vehicle, values, step_s).T
        memory = ahead["memory"]
    return added


def altered_vehicle(effects: Effects, vehicle: Vehicle) -> Vehicle:
    """The vehicle as it truly flies.

    Raises:
        SimulationError: for a moment of inertia that is more than the sum of the other two.
    """
    for effect, values in _of_kind(effects, "vehicle"):
        altered = effect.function(vehicle, values)
        if altered.inertia is not vehicle.inertia and not is_rigid_body(altered.inertia):
            first, last = ", ".join(f"{value:g}" for value in values[:-1]), values[-1]
            raise SimulationError(
                f"vehicle {vehicle.name}: effect `{effect.name}`: changes of {first} and {last:g} leave "
                "moments that no rigid body has (each is at most the sum of the other two)"
            )
        vehicle = altered
    return vehicle


def added_wind(effects: Effects, time: Array, rng: np.random.Generator) -> Array:
    """Wind (N, 3) m/s that the effects add at times (N,) s, in the world."""
    added = np.zeros((len(time), 3))
    for effect, values in _of_kind(effects, "wind"):
        added += effect.function(time, values, rng)
    return added


def altered_recording(effects: Effects, recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording as sensors with these effects would give it."""
    for effect, values in _of_kind(effects, "sensor"):
        recording = effect.function(recording, vehicle, values)
    return recording


def _of_kind(effects: Effects, kind: str) -> Iterator[tuple[Effect, Array]]:
    for name, effect in EFFECTS.items():
        if effect.kind == kind and name in effects:
            yield effect, _values(effect, effects[name])


def _values(effect: Effect, parameters: Mapping[str, float]) -> Array:
    return np.array([parameters[parameter.name] for parameter in effect.parameters], dtype=float)


def _shape(parameters: Mapping[str, float]) -> Array:
    return np.array([parameters.get(parameter.name, parameter.default) for parameter in SHAPE])
