# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tolerances of a simulation that is known by its wrench alone: columns by part, axis and law.

Nobody can say which coefficients such a simulation has. Its wrench is divided into parts that different laws
cause, and each axis of a part may be wrong by the tolerance of a coefficient. One law acts on several axes: a
force of the rotors in their plane on Fx, Fy and Mz, one along their axes on Fz, Mx and My. So the axes of a
part may be wrong together, as its law is, or one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quadpi_core.discrepancy.simulations import Column, Tolerances
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.thresholds import CONVENTION, Threshold

TOGETHER = Threshold(
    "variance of a coefficient that all axes of its law share",
    0.5,
    "of its variance",
    "a law may be wrong as a whole or differ by axis, and nothing says which is more likely",
    CONVENTION,
)
# Laws of an unknown simulation: what is in proportion to the motion, such as the drag of rotors; what stays
# when the motion is reversed, such as lift; and what reverses with its square, as drag of the airframe.
ROTORS, LINEAR, EVEN, SQUARED = "rotors", "the motion", "airspeed, even", "airspeed, squared"
# Axes that one force of the rotors acts on: along their axes, and in their plane.
_SHARED = (("Fz", "Mx", "My"), ("Fx", "Fy", "Mz"))


class Part(NamedTuple):
    """Part (N, 6) of a wrench that one law causes; parts of the same law may be wrong together."""

    name: str
    wrench: Array
    law: str


def part_columns(parts: Sequence[Part], tolerances: Tolerances) -> list[Column]:
    """One column per part and axis, and one for the axes that each law shares.

    The part `ROTORS`, of rotors in still air without rotation, is thrust and torque: its Fz is known as well
    as the thrust is, and its Mx and My, to which arms contribute, as well as the inertia. Every flight has
    the same columns, even one in which a part is zero.
    """
    known = {"Fz": tolerances.thrust, "Mx": tolerances.inertia, "My": tolerances.inertia}
    columns = []
    for part in parts:
        for axis in AXES:
            name = f"{axis} of {part.name}"
            if part.name == ROTORS:
                share = known.get(axis, tolerances.coefficient)
                columns.append(Column(name, share * _only(part.wrench, (axis,))))
            else:
                share = tolerances.coefficient * np.sqrt(1.0 - TOGETHER.value)
                columns.append(Column(name, share * _only(part.wrench, (axis,)), _law(part, axis)))
    common = [part for part in parts if part.name != ROTORS]
    for axes in _SHARED:
        for law in dict.fromkeys(part.law for part in common):
            whole = np.sum([_only(part.wrench, axes) for part in common if part.law == law], axis=0)
            share = tolerances.coefficient * np.sqrt(TOGETHER.value)
            columns.append(Column(_name(law, axes), share * whole))
    return columns


def of_coefficient(own: float, shared: float) -> float:
    """What a coefficient is wrong by, in its tolerances, from the fit of its own column and of its law's."""
    return float(np.sqrt(1.0 - TOGETHER.value) * own + np.sqrt(TOGETHER.value) * shared)


def _law(part: Part, axis: str) -> str:
    return _name(part.law, next(axes for axes in _SHARED if axis in axes))


def _name(law: str, axes: Sequence[str]) -> str:
    return f"{', '.join(axes[:-1])} and {axes[-1]} of {law}"


def _only(wrench: Array, axes: Sequence[str]) -> Array:
    """The wrench (N, 6) with all other axes zero."""
    kept = np.zeros_like(wrench)
    for axis in map(AXES.index, axes):
        kept[:, axis] = wrench[:, axis]
    return kept
