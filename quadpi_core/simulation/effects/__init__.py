# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Physical effects that simulations miss, each one small function that can be switched on by name."""

from quadpi_core.simulation.effects.apply import (
    FUNCTION_TYPE,
    added_wind,
    altered_recording,
    altered_vehicle,
    compose,
    effect_wrench,
    state_modulators,
)
from quadpi_core.simulation.effects.definition import SHAPE, Effect, Effects, Parameter, effect
from quadpi_core.simulation.effects.reading import read_effects
from quadpi_core.simulation.effects.registry import EFFECTS

__all__ = [
    "EFFECTS",
    "FUNCTION_TYPE",
    "SHAPE",
    "Effect",
    "Effects",
    "Parameter",
    "added_wind",
    "altered_recording",
    "altered_vehicle",
    "compose",
    "effect",
    "effect_wrench",
    "read_effects",
    "state_modulators",
]
