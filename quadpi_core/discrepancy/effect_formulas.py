# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Export of the formulas of effects: text, LaTeX, and Python that needs numpy alone.

The Python is the source of the effect with all that it calls, so it computes the same.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, Any

from quadpi_core.simulation.effect_definition import SHAPE, Effect, shaped
from quadpi_core.simulation.effect_registry import EFFECTS

if TYPE_CHECKING:
    from quadpi_core.discrepancy.discrepancy_result import FoundEffect

_SYMBOLS = r"""
| symbol | |
| --- | --- |
| $u, v, w$; $V$ | velocity relative to the air, body axes forward-right-down |
| $u_i, v_i, w_i$; $V_i$ | that of the hub of rotor i |
| $p, q, r$; $\Omega$ | body rates |
| $\omega_i$, $s_i$, $T_i$, $Q_i$ | speed, direction (clockwise +1), thrust and torque of rotor i |
| $r_i = (x_i, y_i, z_i)$ | place of rotor i |
| $\omega_h$, $v_h$, $R$ | rotor speed and induced velocity of hover, rotor radius |
| $h_i$ | height of rotor i over ground |
| $F$, $M$ | force and moment in body axes |
| $F_i$, $\Delta T_i$ | forces at rotor i, the second along $-z$; each gives its moment $r_i \times F_i$ too |
"""

# Of `SHAPE`, in its order.
_SHAPE_SYMBOLS = (
    *("{Fx}", "{Fy}", "{Fz}", "{Mx}", "{My}", "{Mz}"),
    *("V", "u", "v", "w", "l", r"\Omega", "g", "{ww}"),
)

# At the end of a line of source: for linters and type checkers alone.
_REMARK = re.compile(r"  # (?:noqa|type:).*$", re.M)
_HEAD = '''"""Effects that quadpi found in flights, as functions of numpy alone.

{names}

Each takes what its first line says; `NAME_PARAMETERS` are the values that were found. Units are SI, body axes
forward-right-down, world north-east-down, quaternions (w, x, y, z) from body to world.
"""

from __future__ import annotations

'''

_WRENCH = '''
class _Row:
    """The attributes of one instant."""

    def __init__(self, values, row=None):
        for name, value in values.items():
            setattr(self, name, value if row is None else value[row])


def wrench_of(effect, p, states, vehicle, shape=np.zeros({shapes})):
    """Wrench (N, 6) [N, Nm] that an effect adds at N instants.

    shape: `NAME_SHAPE` of an effect that has one.
    states: arrays (N, ...) by name: position, attitude, velocity_air, rates, rotor_speeds,
        rotor_accelerations,
        hub_velocity (N, 4, 3), thrusts (N, 4) along -z, torques (N, 4), wrench (N, 6) of all other forces.
    vehicle: by name: mass, rotor_positions (4, 3), rotor_spins (4,), rotor_radius, hover_induced_velocity,
        hover_rotor_speed.
    """
    vehicle = _Row(vehicle)
    count = len(states["rates"])
    rows = [_Row(states, row) for row in range(count)]
    return np.array([shaped(effect(row, vehicle, p), row, vehicle, shape) for row in rows])
'''

_SHAPED = r"""
These flights shape the law: what it adds in an axis $a$ is multiplied by
$1 + s_a + s_V V/v_h + s_u u/v_h + s_v v/v_h + s_w w/v_h + s_{ww} w^2/v_h^2
+ s_l \sum_i \omega_i^2/(4 \omega_h^2) + s_\Omega R |\Omega|/v_h + s_g R/\max(h, R)$,
from 0 to 3, of the height $h$ of the vehicle and
"""


def write_formulas(effects: Sequence[FoundEffect], folder: Path) -> list[Path]:
    """Write `effects.md` and `effects.py` into a folder that exists."""
    text, code = folder / "effects.md", folder / "effects.py"
    text.write_text(formula_text(effects))
    values = {
        effect.name: {**{p.name: p.value for p in effect.parameters}, **effect.shape} for effect in effects
    }
    code.write_text(python_source(values))
    return [text, code]


def formula_text(effects: Sequence[FoundEffect]) -> str:
    """Formulas with the values that were found, as Markdown with LaTeX."""
    parts = ["# What the simulation lacked\n"]
    for found in effects:
        effect = EFFECTS[found.name]
        parts.append(
            f"## {effect.name}\n\n{inspect.cleandoc(effect.function.__doc__)}\n\n$$ {effect.formula} $$\n"
        )
        rows = [
            f"| ${symbol}$ | {p.name} | {p.value:.4g} | {p.lower:.4g} … {p.upper:.4g} | {p.unit} |"
            for symbol, p in zip(effect.symbols, found.parameters, strict=True)
        ]
        parts.append(
            "\n".join(["| | parameter | value | 95 % | |", "| --- | --- | --- | --- | --- |", *rows, ""])
        )
        if found.shape:
            parts.append(_SHAPED + "\n" + _shape_text(found.shape) + ".\n")
    return "\n".join([*parts, "## Symbols", _SYMBOLS])


def _shape_text(shape: Mapping[str, float]) -> str:
    """Parameters that shape a law, by their symbols in :data:`_SHAPED`, as Markdown with LaTeX."""
    names = (p.name for p in SHAPE)
    return ", ".join(
        f"$s_{symbol} = {shape[name]:.3g}$"
        for name, symbol in zip(names, _SHAPE_SYMBOLS, strict=True)
        if name in shape
    )


def python_source(effects: Mapping[str, Mapping[str, float]]) -> str:
    """A Python file with a function for each effect that needs numpy and the standard library alone.

    Args:
        effects: by name the values of their parameters and of those that shape their laws.
    """
    functions = [EFFECTS[name].function for name in effects]
    driver = ""
    if any(EFFECTS[name].kind == "wrench" for name in effects):
        functions.append(shaped)
        driver = _WRENCH.replace("{shapes}", str(len(SHAPE)))
    imports, definitions = _sources(functions)
    names = "\n".join(f"{name}: {EFFECTS[name].summary}." for name in effects)
    values = "\n".join(line for name, found in effects.items() for line in _constants(name, found))
    head = _HEAD.format(names=names) + "\n".join(sorted(imports))
    return "\n\n\n".join([head, *definitions, values]) + "\n" + driver


def _constants(name: str, found: Mapping[str, float]) -> list[str]:
    effect = EFFECTS[name]
    parameters = [found[p.name] for p in effect.parameters]
    lines = [f"{name.upper()}_PARAMETERS = np.array({parameters!r})  # {_described(effect)}"]
    if any(p.name in found for p in effect.shape):
        shape = [found.get(p.name, p.default) for p in SHAPE]
        lines.append(f"{name.upper()}_SHAPE = np.array({shape!r})  # {', '.join(p.name for p in SHAPE)}")
    return lines


def _described(effect: Effect) -> str:
    return ", ".join(f"{p.name} [{p.unit or '-'}]" for p in effect.parameters)


def _sources(functions: Sequence[Any]) -> tuple[set[str], list[str]]:
    """Imports, and the source of functions and of all of quadpi that they use, in order of dependence.

    Raises:
        ValueError: for a name with different meanings in two files of effects.
    """
    imports = {"import numpy as np"}
    definitions: dict[str, tuple[Any, str]] = {}

    def add(name: str, value: Any) -> None:
        if isinstance(value, ModuleType):
            imports.add(f"import {value.__name__} as {name}")
            return
        function = getattr(value, "py_func", value)
        if inspect.isfunction(function) and not function.__module__.startswith("quadpi_core"):
            imports.add(f"from {function.__module__} import {function.__name__} as {name}")
            return
        known = definitions.get(name)
        if known is not None:
            if known[0] is not value:
                raise ValueError(f"two files of effects define `{name}`: an exported file holds one of them")
            return
        if inspect.isfunction(function):
            for used in sorted(_names(function.__code__) & function.__globals__.keys()):
                if used != name:
                    add(used, function.__globals__[used])
            definitions[name] = value, _bare(inspect.getsource(function))
        elif isinstance(value, type) and issubclass(value, Exception):
            definitions[name] = (
                value,
                f'class {name}(Exception):\n    """{(value.__doc__ or name).strip()}"""',
            )
        else:
            definitions[name] = value, f"{name} = {value!r}"

    for function in functions:
        add(function.__name__, function)
    return imports, [source for _, source in definitions.values()]


def _names(code: CodeType) -> set[str]:
    """Global names that code refers to, those of its inner functions included."""
    inner = (value for value in code.co_consts if isinstance(value, CodeType))
    return set(code.co_names).union(*map(_names, inner))


def _bare(source: str) -> str:
    """Source of a function without decorators and remarks for tools."""
    return _REMARK.sub("", source[re.search(r"^def ", source, re.M).start() :]).rstrip()  # type: ignore[union-attr]
