# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""All formulas as one compiled function, and which of them act as the numbers of its row.

A row is a block per formula: its parameters, its memory, its index. The memory begins at zero with each
flight, for `simulate_flight` copies the row; it advances with every evaluation of the equations of motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numba
from numba import literal_unroll

from blind import bodies, outside, rotors
from blind.geometry import NOTHING, PARAMETERS, plus

_FUNCTIONS = (
    # Wind first: it computes the aerodynamics anew. The airframe's offset looks at these alone.
    bodies.wind,
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
_INDEX = {function.__name__: index for index, function in enumerate(_FUNCTIONS)}
_MEMORY = 4
_BLOCK = PARAMETERS + _MEMORY + 1


def row(formulas: Mapping[str, Sequence[float]]) -> list[float]:
    """Numbers for :func:`hidden` of formulas with their parameters, in the order in which they act."""
    numbers: list[float] = []
    for name in sorted(formulas, key=_INDEX.__getitem__):
        block = [*map(float, formulas[name])]
        numbers += [*block, *[0.0] * (_BLOCK - 1 - len(block)), float(_INDEX[name])]
    return numbers


# Not cached on disk: a cached function is not renewed when one of another file that it calls is.
@numba.njit
def hidden(state, vehicle, p):
    """Wrench of the formulas of a row."""
    wrench = NOTHING
    for start in range(0, len(p), _BLOCK):
        block = p[start : start + _BLOCK]
        which = int(block[_BLOCK - 1])
        candidate = 0
        for function in literal_unroll(_FUNCTIONS):
            if candidate == which:
                wrench = plus(wrench, function(state, vehicle, block))
            candidate += 1  # noqa: SIM113
    return wrench
