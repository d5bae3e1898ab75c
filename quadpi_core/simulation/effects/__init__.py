# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Physical effects that simulations miss, each one small function that can be switched on by name."""

from quadpi_core.simulation.effects.applied_effects import (
    FUNCTION_TYPE,
    added_wind,
    altered_recording,
    altered_vehicle,
    compose,
    effect_wrench,
    state_modulators,
)
from quadpi_core.simulation.effects.effect_definition import SHAPE, Effect, Effects, Parameter, effect
from quadpi_core.simulation.effects.effect_registry import EFFECTS
from quadpi_core.simulation.effects.effect_settings import read_effects

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
