# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The effects there are, in the order in which they act: whatever the files of this folder declare.

Kind after kind; within one, file after file by name, and as they stand in the file. One that has to act after
all others of its kind, whatever they are, says so itself (`last`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from numba import literal_unroll

from quadpi_core.compiled import modules_beside, njit
from quadpi_core.frames import Array
from quadpi_core.simulation.effects.effect_definition import Effect, Wrench
from quadpi_core.simulation.effects.effect_kernels import NO_WRENCH

_KINDS = ("wrench", "vehicle", "wind", "sensor")
# Of this folder, but no effects.
_MACHINERY = ("applied_effects", "effect_definition", "effect_kernels", "effect_registry", "effect_settings")


def _declared() -> Iterator[Effect]:
    for module in modules_beside(__file__, but=_MACHINERY):
        for value in vars(module).values():
            if isinstance(value, Effect) and value.function.__module__ == module.__name__:
                yield value


def _in_order() -> dict[str, Effect]:
    effects: dict[str, Effect] = {}
    for effect in sorted(_declared(), key=lambda effect: (_KINDS.index(effect.kind), effect.last)):
        if effect.name in effects:
            raise TypeError(f"two effects are named `{effect.name}`")
        effects[effect.name] = effect
    return effects


EFFECTS = _in_order()

_WRENCH_EFFECTS = tuple(effect for effect in EFFECTS.values() if effect.kind == "wrench")
WRENCH_INDEX = {effect.name: index for index, effect in enumerate(_WRENCH_EFFECTS)}
_WRENCH_FUNCTIONS = tuple(effect.function for effect in _WRENCH_EFFECTS)


# Here, beside the order, for the cache on disk is renewed when a file with kernels changes.
@njit(cache=True)
def added_wrench(index: int, state: Any, vehicle: Any, p: Array) -> Wrench:
    """What the effect with an index of `WRENCH_INDEX` adds; nothing for another index."""
    wrench = NO_WRENCH
    candidate = 0
    for function in literal_unroll(_WRENCH_FUNCTIONS):
        if candidate == index:
            wrench = function(state, vehicle, p)
        candidate += 1  # noqa: SIM113
    return wrench
