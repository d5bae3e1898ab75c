# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Application of effects: in the compiled flight, to vehicle, air and sensors, and to recorded states."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit, once
from quadpi_core.config import nearest
from quadpi_core.errors import SimulationError
from quadpi_core.flight import Recording
from quadpi_core.frames import Array
from quadpi_core.records import Records
from quadpi_core.simulation.effect_definition import (
    MODULATORS,
    SHAPE,
    Effect,
    Effects,
    Wrench,
    modulators,
    shaped,
)
from quadpi_core.simulation.effect_registry import (
    EFFECTS,
    MEMORY_INDEX,
    WRENCH_INDEX,
    added_wrench,
    remembering_wrench,
)
from quadpi_core.simulation.state_records import MEMORY, State, VehicleNumbers
from quadpi_core.simulation.wrench_functions import SIGNATURE, passable
from quadpi_core.vehicle import Vehicle, is_rigid_body

# In place of a registry index: a function that is not in the registry.
_EXTRA = -1
# A row of parameters ends with the shape of its law and that index.
_SHAPES = len(SHAPE)
_SHAPE_AT = -1 - _SHAPES
# Largest change of a number of an effect's own state over a step of a recording: 125 rad/s² of a load at
# 62.5 Hz, which one on a cable of 0.1 m does not reach.
_LARGEST_CHANGE = 2.0


def compose(effects: Effects, extra: Sequence[tuple[Any, Sequence[float]]] = ()) -> tuple[Any, Array]:
    """The wrench effects as one compiled function, and its parameters.

    Without `extra` it is always the same function, compiled once and cached on disk; the parameters say which
    effects act.

    Args:
        effects: effects of any kind, of which only wrench effects are used.
        extra: compiled functions with the signature of a wrench effect that are not in the registry, each
            with its parameters. They act before the effects.

    Returns:
        A function of type `wrench_functions.FUNCTION_TYPE` that adds to `state.wrench`, one effect after the
        other, and its parameters (K, P): a row for each, with the shape of its law and its index in the last
        columns.
    """
    rows = [(np.asarray(values, dtype=float), _shape({}), _EXTRA) for _, values in extra]
    for effect, own in _of_kind(effects, "wrench"):
        rows.append((own, _shape(effects[effect.name]), WRENCH_INDEX[effect.name]))
    longest = max((len(values) for values, _, _ in rows), default=0)
    parameters = np.zeros((len(rows), longest + _SHAPES + 1))
    for row, (values, shape, index) in zip(parameters, rows, strict=True):
        row[: len(values)] = values
        row[_SHAPE_AT:-1] = shape
        row[-1] = index
    if not rows:
        # A flight without effects need not wait until all effects are compiled for the first time.
        return passable(_none), parameters
    return _chain(tuple(function for function, _ in extra)), parameters


@njit(cache=True)
def _registered(state: State, vehicle: VehicleNumbers, parameters: Array) -> None:
    for row in range(len(parameters)):
        p = parameters[row]
        wrench = added_wrench(int(p[-1]), state, vehicle, p)
        _add(state, shaped(wrench, state, vehicle, p[_SHAPE_AT:-1]))


@njit(cache=True)
def _none(state: State, vehicle: VehicleNumbers, parameters: Array) -> None:
    pass


@njit(cache=True)
def _add(state: State, wrench: Wrench) -> None:
    total = state.wrench
    for axis in range(6):
        total[axis] += wrench[axis]


@once
def _chain(extra: tuple[Any, ...], row: int = 0) -> Any:
    """The functions `extra`, whose parameters begin at a row, then the registered effects."""
    if not extra:
        return passable(_registered)
    first, others = extra[0], _chain(extra[1:], row + 1)

    @njit(SIGNATURE)
    def both(state: State, vehicle: VehicleNumbers, parameters: Array) -> None:
        _add(state, first(state, vehicle, parameters[row, :_SHAPE_AT]))
        others(state, vehicle, parameters)

    return both


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
    if name not in WRENCH_INDEX:
        raise SimulationError(f"`{name}` is no effect on the wrench{nearest(name, WRENCH_INDEX)}")
    values, shape = _values(EFFECTS[name], parameters), _shape(parameters)
    return _added_to_all(WRENCH_INDEX[name], states, vehicle, values, shape)


def state_modulators(states: npt.NDArray[np.void], vehicle: npt.NDArray[np.void]) -> Array:
    """Modulators (N, MODULATORS) of recorded states, see :func:`effect_definition.modulators`.

    Args:
        states: (N,) of `state_records.STATE`.
        vehicle: (1,) of `state_records.VEHICLE`.
    """
    found: Array = _modulators_of_all(states, vehicle)
    return found


@njit(cache=True)
def _modulators_of_all(states: Records, vehicles: Records) -> Array:
    found = np.empty((len(states), MODULATORS))
    for i in range(len(states)):
        of = modulators(states[i], vehicles[0])
        for index in range(MODULATORS):
            found[i, index] = of[index]
    return found


@njit(cache=True)
def _added_to_all(index: int, states: Records, vehicles: Records, p: Array, shape: Array) -> Array:
    added = np.empty((len(states), 6))
    for i in range(len(states)):
        wrench = added_wrench(index, states[i], vehicles[0], p)
        wrench = shaped(wrench, states[i], vehicles[0], shape)
        for axis in range(6):
            added[i, axis] = wrench[axis]
    return added


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
    if len(filled):
        filled["memory"][0] = start
        _remember(MEMORY_INDEX[name], filled, vehicle, _values(EFFECTS[name], parameters), step_s)
    return filled


@njit(cache=True)
def _limited(change: float) -> float:
    """A change over one step; what is faster than the steps stays finite."""
    return min(max(change, -_LARGEST_CHANGE), _LARGEST_CHANGE)


@njit(cache=True)
def _remember(index: int, states: Records, vehicles: Records, p: Array, step_s: float) -> None:
    for i in range(len(states) - 1):
        _stepped(index, states[i], states[i + 1], vehicles[0], p, step_s)


@njit(cache=True)
def _stepped(
    index: int, now: State, ahead: State, vehicle: VehicleNumbers, p: Array, step_s: float
) -> Wrench:
    """Wrench of an effect with a state of its own, which is brought forward by a step."""
    wrench = remembering_wrench(index, now, vehicle, p)
    for number in range(MEMORY):
        ahead.memory[number] = now.memory[number] + _limited(step_s * now.memory_slope[number])
    remembering_wrench(index, ahead, vehicle, p)
    for number in range(MEMORY):
        slope = 0.5 * (now.memory_slope[number] + ahead.memory_slope[number])
        ahead.memory[number] = now.memory[number] + _limited(step_s * slope)
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
    values = _values(EFFECTS[name], parameters)
    found: Array = _remembered_wrenches(MEMORY_INDEX[name], states, vehicle, values, starts, step_s)
    return found


@njit(cache=True)
def _remembered_wrenches(
    index: int, states: Records, vehicles: Records, p: Array, starts: Array, step_s: float
) -> Array:
    memory, added = starts.copy(), np.empty((len(states), 6, len(starts)))
    # No copy of the flight: a page of memory costs more than the steps in it.
    pair = np.empty(2, states.dtype)
    now, ahead = pair[0], pair[1]
    for i in range(len(states)):
        pair[0], pair[1] = states[i], states[min(i + 1, len(states) - 1)]
        for start in range(len(starts)):
            for number in range(MEMORY):
                now.memory[number] = memory[start, number]
            wrench = _stepped(index, now, ahead, vehicles[0], p, step_s)
            for number in range(MEMORY):
                memory[start, number] = ahead.memory[number]
            for axis in range(6):
                added[i, axis, start] = wrench[axis]
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
