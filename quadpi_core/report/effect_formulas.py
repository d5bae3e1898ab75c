# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Formulas of effects that were found: text with LaTeX, and Python that needs numpy alone.

The Python is the source of each effect with all that it calls, elementary functions by numpy, so it computes
the same to the last digits.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from quadpi_core.discrepancy.discrepancy_result import FoundEffect
from quadpi_core.elementary import IN_NUMPY
from quadpi_core.simulation.applied_effects import EFFECTS
from quadpi_core.simulation.effect_definition import SHAPE, shaped

_SYMBOLS = r"""## Symbols

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
_SHAPED = r"""
These flights shape the law: what it adds in an axis $a$ is multiplied by
$1 + s_a + s_V V/v_h + s_u u/v_h + s_v v/v_h + s_w w/v_h + s_{ww} w^2/v_h^2
+ s_l \sum_i \omega_i^2/(4 \omega_h^2) + s_\Omega R |\Omega|/v_h + s_g R/\max(h, R)$,
from 0 to 3, of the height $h$ of the vehicle and
"""
# Of `SHAPE`, in its order.
_SHAPE_SYMBOLS = [
    r"{Fx}",
    r"{Fy}",
    r"{Fz}",
    r"{Mx}",
    r"{My}",
    r"{Mz}",
    r"V",
    r"u",
    r"v",
    r"w",
    r"l",
    r"\Omega",
    r"g",
    r"{ww}",
]
_HEAD = '''"""Effects that quadpi found in flights, as functions of numpy alone.

{names}

Each takes what its first line says; `NAME_PARAMETERS` are the values that were found. Units are SI, body axes
forward-right-down, world north-east-down, quaternions (w, x, y, z) from body to world.
"""

from __future__ import annotations

'''
_WRENCH = f'''
def wrench_of(effect, p, states, vehicle, shape=np.zeros({len(SHAPE)})):
    """Wrench (N, 6) [N, Nm] that an effect adds at N instants.

    shape: `NAME_SHAPE` of an effect that has one.
    states: arrays (N, ...) by name: position, attitude, velocity_air, rates, rotor_speeds,
        rotor_accelerations,
        hub_velocity (N, 4, 3), thrusts (N, 4) along -z, torques (N, 4), wrench (N, 6) of all other forces.
    vehicle: by name: mass, rotor_positions (4, 3), rotor_spins (4,), rotor_radius, hover_induced_velocity,
        hover_rotor_speed.
    """
    state, vehicle = SimpleNamespace(**states), SimpleNamespace(**vehicle)
    wrench = shaped(effect(state, vehicle, p), state, vehicle, shape)
    return np.stack(np.broadcast_arrays(*wrench, state.wrench[:, 0])[:6], axis=1)
'''


def write_formulas(effects: Sequence[FoundEffect], folder: Path) -> list[Path]:
    """Write `effects.md` and `effects.py` into a folder that exists."""
    parts, values = ["# What the simulation lacked"], {}
    for found in effects:
        effect, shape = EFFECTS[found.name], found.shape
        values[found.name] = {**{p.name: p.value for p in found.parameters}, **shape}
        rows = ["| | parameter | value | 95 % | |", "| --- | --- | --- | --- | --- |"]
        for symbol, p in zip(effect.symbols, found.parameters, strict=True):
            rows.append(
                f"| ${symbol}$ | {p.name} | {p.value:.4g} | {p.lower:.4g} … {p.upper:.4g} | {p.unit} |"
            )
        law = inspect.cleandoc(effect.function.__doc__)
        parts += [f"## {effect.name}\n\n{law}\n\n$$ {effect.formula} $$", "\n".join(rows)]
        if shape:
            pairs = zip(SHAPE, _SHAPE_SYMBOLS, strict=True)
            stated = [f"$s_{symbol} = {shape[p.name]:.3g}$" for p, symbol in pairs if p.name in shape]
            parts.append(_SHAPED + "\n" + ", ".join(stated) + ".")
    text, code = folder / "effects.md", folder / "effects.py"
    text.write_text("\n\n".join([*parts, _SYMBOLS]))
    code.write_text(python_source(values))
    return [text, code]


def python_source(effects: Mapping[str, Mapping[str, float]]) -> str:
    """A Python file with a function for each effect that needs numpy and the standard library alone.

    Args:
        effects: by name the values of their parameters and of those that shape their laws.
    """
    imports, definitions, values = {"import numpy as np"}, dict[str, tuple[Any, str]](), list[str]()
    for name, found in effects.items():
        effect = EFFECTS[name]
        _add(name, effect.function, imports, definitions)
        numbers = [found[p.name] for p in effect.parameters]
        described = ", ".join(f"{p.name} [{p.unit or '-'}]" for p in effect.parameters)
        values.append(f"{name.upper()}_PARAMETERS = np.array({numbers!r})  # {described}")
        if any(p.name in found for p in effect.shape):
            shape = [found.get(p.name, p.default) for p in SHAPE]
            values.append(f"{name.upper()}_SHAPE = np.array({shape!r})  # {', '.join(p.name for p in SHAPE)}")
    driver = ""
    if any(EFFECTS[name].kind == "wrench" for name in effects):
        _add(shaped.__name__, shaped, imports, definitions)
        driver = _WRENCH
        imports.add("from types import SimpleNamespace")
    names = "\n".join(f"{name}: {EFFECTS[name].summary}." for name in effects)
    head = _HEAD.format(names=names) + "\n".join(sorted(imports))
    sources = [source for _, source in definitions.values()]
    return "\n\n\n".join([head, *sources, "\n".join(values)]) + "\n" + driver


def _add(name: str, value: Any, imports: set[str], definitions: dict[str, tuple[Any, str]]) -> None:
    """Add what a name stands for and, before it, all of quadpi that it uses, or the import of it.

    Raises:
        ValueError: for a name with different meanings in two files of effects.
    """
    if isinstance(value, ModuleType):
        imports.add(f"import {value.__name__} as {name}")
    elif inspect.isfunction(value) and not value.__module__.startswith("quadpi_core"):
        imports.add(f"from {value.__module__} import {value.__name__} as {name}")
    elif name in definitions:
        if definitions[name][0] is not value:
            raise ValueError(f"two files of effects define `{name}`: an exported file holds one of them")
    elif inspect.isfunction(value) and value in IN_NUMPY:
        definitions[name] = value, f"{name} = {IN_NUMPY[value]}"
    elif inspect.isfunction(value):
        for used in sorted(_names(value.__code__) & value.__globals__.keys() - {name}):
            _add(used, value.__globals__[used], imports, definitions)
        # Without decorators, and without remarks for linters and type checkers.
        source = "def " + f"\n{inspect.getsource(value)}".partition("\ndef ")[2]
        definitions[name] = value, re.sub(r"(?m)  # (?:noqa|type:).*$", "", source).rstrip()
    elif isinstance(value, type) and issubclass(value, Exception):
        text = (value.__doc__ or name).strip()
        definitions[name] = value, f'class {name}(Exception):\n    """{text}"""'
    else:
        definitions[name] = value, f"{name} = {value!r}"


def _names(code: CodeType) -> set[str]:
    """Global names that code refers to, those of its inner functions included."""
    inner = (value for value in code.co_consts if isinstance(value, CodeType))
    return set(code.co_names).union(*map(_names, inner))
