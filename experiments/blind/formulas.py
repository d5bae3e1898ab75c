# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""All formulas as one function, and which of them act as the numbers of its row.

A row is a block per formula: its parameters, its memory, its index. The memory begins at zero with each
flight, for `simulate_flight` copies the row; it advances with every evaluation of the equations of motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace

import numpy as np

from blind import bodies, outside, rotors
from blind.geometry import NOTHING, PARAMETERS, plus

_FUNCTIONS = (
    # The airframe's offset looks at the aerodynamics alone.
    bodies.airframe_offset,
    bodies.body_drag,
    bodies.rate_damping,
    bodies.tether,
    bodies.constant,
    rotors.rotor_drag,
    rotors.blade_flapping,
    rotors.translational_lift,
    rotors.inflow_damping,
    rotors.vortex_ring,
    rotors.rotor_interaction,
    rotors.ground_effect,
    rotors.gyroscopic,
    rotors.spin_up,
    rotors.rotor_tilt,
    rotors.weak_rotor,
    outside.beat_vibration,
    outside.fan_jet,
    outside.jerk_force,
    outside.one_sided_drag,
    outside.lagged_drag,
    outside.thrust_fade,
    outside.magnet,
)
# Wind first: it computes the aerodynamics anew.
_INDEX = {"wind": 0} | {function.__name__: index for index, function in enumerate(_FUNCTIONS, 1)}
_MEMORY = 4
_BLOCK = PARAMETERS + _MEMORY + 1


def row(formulas: Mapping[str, Sequence[float]]) -> list[float]:
    """Numbers for :func:`hidden` of formulas with their parameters, in the order in which they act."""
    numbers: list[float] = []
    for name in sorted(formulas, key=_INDEX.__getitem__):
        block = [*map(float, formulas[name])]
        numbers += [*block, *[0.0] * (_BLOCK - 1 - len(block)), float(_INDEX[name])]
    return numbers


def hidden(state, vehicle, p):
    """Wrench of the formulas of a row at one instant; `state` as functions of Python get it, for N = 1."""
    if p[_BLOCK - 1] == _INDEX["wind"]:
        bodies.blow(state, vehicle, p[:_BLOCK].tolist())
    # Numbers of Python: those of numpy take several times as long, one by one.
    now = SimpleNamespace(**{name: values[0].tolist() for name, values in state._asdict().items()})
    craft = SimpleNamespace(
        **{name: np.asarray(values).tolist() for name, values in vehicle._asdict().items()}
    )
    wrench = NOTHING
    for start in range(0, len(p), _BLOCK):
        block = p[start : start + _BLOCK].tolist()
        which = int(block.pop())
        if which != _INDEX["wind"]:
            wrench = plus(wrench, _FUNCTIONS[which - 1](now, craft, block))
            p[start : start + _BLOCK - 1] = block
    return wrench
