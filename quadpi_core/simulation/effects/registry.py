# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The effects there are, in the order in which they act.

A new effect is one function in a file of this folder and one line here.
"""

from __future__ import annotations

from typing import Any

from numba import literal_unroll

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.simulation.effects import air, body, mass, proximity, rotor_air, rotor_mechanics, sensing
from quadpi_core.simulation.effects.definition import Effect, Wrench
from quadpi_core.simulation.effects.kernels import NO_WRENCH

_ORDER = (
    rotor_air.rotor_drag,
    rotor_air.cross_flow,
    rotor_air.blade_flapping,
    rotor_air.translational_lift,
    rotor_air.inflow_damping,
    rotor_air.rotor_dissymmetry,
    rotor_air.vortex_ring,
    rotor_air.rotor_interaction,
    proximity.ground_effect,
    proximity.ceiling_effect,
    body.body_drag,
    body.cubic_drag,
    body.rate_damping,
    rotor_mechanics.gyroscopic,
    rotor_mechanics.spin_up,
    rotor_mechanics.thrust_coefficient,
    rotor_mechanics.rotor_tilt,
    rotor_mechanics.weak_rotor,
    body.tether,
    body.force_bias,
    body.moment_bias,
    # After every other force, whose moment it changes.
    body.cg_offset,
    mass.payload,
    mass.inertia,
    air.wind,
    air.gust,
    sensing.imu_lever_arm,
    sensing.imu_misalignment,
    sensing.accelerometer_scale,
    sensing.accelerometer_bias,
    sensing.gyro_bias,
    sensing.rotor_speed_scale,
    sensing.sensor_delay,
)
EFFECTS: dict[str, Effect] = {effect.name: effect for effect in _ORDER}

_WRENCH_EFFECTS = tuple(effect for effect in _ORDER if effect.kind == "wrench")
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
