# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Laws that work on states: those of the compiled core by their names, and functions of Python."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.frames import Array
from quadpi_core.records import Records
from quadpi_core.simulation.state_records import STATE, VEHICLE

# Name of a law of the core, or (state, vehicle, numbers): see `effect_definition` for what these are. One of
# the aerodynamics fills fields of the state, an effect gives six forces and moments.
Law: TypeAlias = str | Callable[..., Any]


class AddedEffect(NamedTuple):
    """An effect that acts in a flight.

    Attributes:
        law: gives its wrench.
        parameters: (P,) of the law, which a function of Python may change from call to call.
        shape: (14,) values of `effect_definition.SHAPE`.
    """

    law: Law
    parameters: Array
    shape: Array


_StateBlock = namedtuple("_StateBlock", STATE.names or ())  # type: ignore[misc]
_Vehicle = namedtuple("_Vehicle", VEHICLE.names or ())  # type: ignore[misc]


def block_of(states: Records, vehicle: Records) -> tuple[Any, Any]:
    """States (N,) and a vehicle (1,) as functions of Python take them: by field, the states' as views."""
    # Not records of numpy: to read an attribute of one takes longer than most of what effects compute.
    return _StateBlock._make(states[name] for name in STATE.names or ()), _Vehicle(*vehicle[0])


def called_on(law: Law, states: Records, vehicle: Records, numbers: Array) -> Law:
    """The law as the core calls it on states that change: a function without arguments, or a name."""
    return law if isinstance(law, str) else partial(law, *block_of(states, vehicle), numbers)


def apply_to_all(states: Records, vehicle: Records, law: Law, numbers: Array) -> None:
    """Fill states (N,) by a law of the aerodynamics, for a vehicle (1,)."""
    if isinstance(law, str):
        compiled.fill_aerodynamics(states, vehicle, law, numbers)
    else:
        law(*block_of(states, vehicle), numbers)


def six_columns(wrench: Any, count: int) -> Array:
    """Forces and moments (N, 6) of a function of Python.

    Raises:
        ValueError: unless there are six, each a number or one for each of `count` instants.
    """
    columns = np.empty((count, 6))
    try:
        for axis, values in zip(range(6), wrench, strict=True):
            columns[:, axis] = values
    except (TypeError, ValueError) as error:
        raise ValueError(compiled.NOT_SIX) from error
    return columns
