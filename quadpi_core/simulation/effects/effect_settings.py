# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How a file switches effects on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from quadpi_core.config import nearest
from quadpi_core.errors import SimulationError
from quadpi_core.simulation.effects.effect_definition import Effect, Effects, Parameter
from quadpi_core.simulation.effects.effect_registry import EFFECTS


def read_effects(data: Any, where: str) -> Effects:
    """Effects as a file gives them: a mapping from name to parameters, or to null for those of typical size.

    Args:
        data: the mapping as YAML gives it; None or empty for no effect.
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
