# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What an effect is: a name, its parameters with their bounds, and one small pure function.

Its kind says what the function changes, and with it what it takes:

    wrench   (state, vehicle, p) -> (fx, fy, fz, mx, my, mz), compiled; adds to the wrench of the aerodynamics
    vehicle  (vehicle, p) -> Vehicle as it truly is
    wind     (time, p, rng) -> (N, 3) m/s of the air over ground, world
    sensor   (recording, vehicle, p) -> Recording as the sensors would give it

`p` holds the parameters in their order, in the unit that their names end with. State and vehicle of a wrench
effect are one record of `records.STATE` and of `records.VEHICLE`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

# Effects that are switched on: name -> every parameter with its value, in the order of the registry.
Effects: TypeAlias = Mapping[str, Mapping[str, float]]
Wrench: TypeAlias = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes:
        name: with its unit at the end, as in a scenario file.
        unit: for people; empty for a share or a count.
        default: the typical size of the effect.
        lowest, highest: what is physically possible, inclusive. An effect whose parameters are all 0, where
            that is within bounds, changes nothing.
        whole: only whole numbers, such as that of a rotor.
    """

    name: str
    unit: str
    default: float
    lowest: float
    highest: float
    whole: bool = False


@dataclass(frozen=True)
class Effect:
    """One physical effect that can be switched on.

    Attributes:
        kind: "wrench", "vehicle", "wind" or "sensor".
        summary: one line.
        axes: those of `flight.AXES` in which it shows: for a wrench effect, all that can be non-zero.
        function: see the module.
    """

    name: str
    kind: str
    summary: str
    axes: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    function: Any


def effect(kind: str, axes: str, *parameters: Parameter) -> Callable[[Any], Effect]:
    """Make an effect of a function: its name and the first line of its docstring are those of the effect.

    Args:
        kind: see the module.
        axes: names of axes with spaces between them.
        parameters: in the order in which the function takes them.
    """

    def declare(function: Any) -> Effect:
        summary = function.__doc__.partition("\n")[0].rstrip(".")
        return Effect(function.__name__, kind, summary, tuple(axes.split()), parameters, function)

    return declare


def three(
    unit_name: str, unit: str, default: float, most: float, *, lowest: float | None = None
) -> tuple[Parameter, ...]:
    """Parameters x, y and z of one size and the same bounds."""
    return tuple(
        Parameter(f"{axis}_{unit_name}", unit, default, -most if lowest is None else lowest, most)
        for axis in "xyz"
    )
