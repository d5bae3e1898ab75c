# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects on mass and inertia: the vehicle differs from its file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.simulation.effect_definition import Parameter, effect
from quadpi_core.vehicle import Vehicle, is_rigid_body

# Share by which a moment of inertia is lowered per step, far below its tolerance of 2 %, and the largest
# number of steps, which lower it to a twelfth.
_STEP, _STEPS_MOST = 0.005, 500


@effect(
    "vehicle",
    "Fx Fy Fz",
    Parameter("mass_kg", "kg", 0.05, 0.0, 5.0),
    shown_by="vertical accelerations with roll and pitch pulses; weighing",
    scales_existing=True,
    scales_thrust=True,
    formula="m = m_0 + m_L",
    symbols="m_L",
)
def payload(vehicle: Vehicle, p: Array) -> Vehicle:
    """A mass carried at the centre of gravity.

    The inertia stays. Size: 50 g, 0.5 N.
    """
    return replace(vehicle, mass_kg=vehicle.mass_kg + float(p[0]))


def _of_a_rigid_body(vehicle: Vehicle, p: Array) -> Array:
    """Changes of the moments of inertia, with the largest lowered until a rigid body can have the three.

    One moment of a flat vehicle is nearly the sum of the others, which noise alone can exceed.
    """
    p = p.copy()
    for _ in range(_STEPS_MOST):
        moments = inertia.function(vehicle, p).inertia
        if is_rigid_body(moments):
            break
        largest = int(np.argmax(np.diag(moments)))
        p[largest] = (1.0 - _STEP) * (1.0 + p[largest]) - 1.0
    return p


@effect(
    "vehicle",
    "Mx My Mz",
    *(Parameter(f"{axis}_change", "", 0.2, -0.5, 1.0) for axis in "xyz"),
    shown_by="attitude doublets and angular chirps about every axis",
    scales_existing=True,
    tolerance="inertia",
    feasible=_of_a_rigid_body,
    formula=r"I_{ij} = I_{0,ij}\sqrt{(1 + k_i)(1 + k_j)},\quad k = (k_x, k_y, k_z)",
    symbols="k_x k_y k_z",
)
def inertia(vehicle: Vehicle, p: Array) -> Vehicle:
    """Moments of inertia other than the file's.

    The matrix stays positive. Size: 20 %.
    """
    scale = np.sqrt(1.0 + p)
    return replace(vehicle, inertia=vehicle.inertia * scale[:, None] * scale)
