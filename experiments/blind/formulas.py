# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""All formulas as one function of a flight, which calls those that act in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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
_BY_NAME = {function.__name__: function for function in _FUNCTIONS}
_MEMORY = 4


class Formulas:
    """Formulas with their parameters as one law of a flight, (state, vehicle, numbers) -> wrench.

    Their memory begins at zero and advances with every evaluation of the equations of motion: one for each
    flight.
    """

    def __init__(self, formulas: Mapping[str, Sequence[float]]) -> None:
        def block(name):
            return [*map(float, formulas[name])] + [0.0] * (PARAMETERS + _MEMORY - len(formulas[name]))

        # Wind first: it computes the aerodynamics anew. The others act in the order of their table.
        self._wind = block("wind") if "wind" in formulas else None
        self._acting = [(function, block(name)) for name, function in _BY_NAME.items() if name in formulas]
        self._vehicle, self._craft = None, None

    def __call__(self, state, vehicle, numbers):  # noqa: ARG002
        """Wrench at one instant; `state` as functions of Python get it, for N = 1."""
        if self._wind is not None:
            bodies.blow(state, vehicle, self._wind)
        if vehicle is not self._vehicle:
            self._vehicle, self._craft = vehicle, _Plain(vehicle, np.asarray)
        now, wrench = _Plain(state, lambda values: values[0]), NOTHING
        for function, block in self._acting:
            wrench = plus(wrench, function(now, self._craft, block))
        return wrench


class _Plain:
    """Fields as numbers of Python, each when it is first read: those of numpy take several times as long."""

    def __init__(self, fields, array_of) -> None:
        self._fields, self._array_of = fields, array_of

    def __getattr__(self, name):
        value = self.__dict__[name] = self._array_of(getattr(self._fields, name)).tolist()
        return value
