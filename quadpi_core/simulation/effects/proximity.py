# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects of surfaces near the rotors: the ground below, a ceiling above."""

from __future__ import annotations

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.frames import Array
from quadpi_core.simulation.effect_definition import (
    AERODYNAMIC,
    Parameter,
    Wrench,
    at_hubs,
    effect,
    hub_heights,
    in_plane_speeds,
)
from quadpi_core.simulation.state_records import State, VehicleNumbers
from quadpi_core.thresholds import Threshold

NEAREST_SURFACE = Threshold(
    "nearest surface",
    compiled.NEAREST_SURFACE,
    "rotor radii",
    "nearer to a surface the formulas are not valid, and the effect grows no more",
    "Cheeseman and Bennett, ARC R&M 3021, 1955",
)
NEAREST = NEAREST_SURFACE.value


@effect(
    "wrench",
    "Fz Mx My",
    Parameter("strength", "", 1.0, 0.0, 10.0),
    shown_by="height sweep from one rotor radius up, in hover",
    form=AERODYNAMIC,
    formula=(
        r"\Delta T_i = k\,T_i"
        r"\left[\left(1 - \frac{(R/4h_i)^2}{1 + (u_i^2 + v_i^2)/v_h^2}\right)^{-1} - 1\right],"
        r"\quad h_i \ge R/2"
    ),
    symbols="k",
)
def ground_effect(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Thrust gained near the ground, at each rotor by its own height.

    Source: Cheeseman and Bennett, ARC R&M 3021, 1955, for which k = 1: 6.7 % at h = R. Whole vehicles gain
    several times more.
    """
    height = np.maximum(hub_heights(state, vehicle), NEAREST * vehicle.rotor_radius)
    ratio = vehicle.rotor_radius / (4.0 * height)
    across = in_plane_speeds(state) / vehicle.hover_induced_velocity
    gain = 1.0 / (1.0 - ratio * ratio / (1.0 + across * across)) - 1.0
    return at_hubs(vehicle, 0.0, 0.0, -p[0] * gain * state.thrusts)


@effect(
    "wrench",
    "Fz Mx My",
    Parameter("strength", "", 0.2, 0.0, 1.0),
    Parameter("ceiling_m", "m", 4.0, 0.1, 1000.0),
    formula=r"\Delta T_i = k\,T_i\left(\frac{R}{d_i}\right)^2,\quad d_i = \max(d - h_i,\ R/2)",
    symbols="k d",
)
def ceiling_effect(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Thrust gained below a ceiling, at each rotor by its own distance.

    Source: leading term of Hsiao and Chirarattananon, "Ceiling effects for hybrid aerial–surface locomotion
    of small rotorcraft", 2019. Size: literature has 10 to 30 % at d = R.
    """
    distance = np.maximum(p[1] - hub_heights(state, vehicle), NEAREST * vehicle.rotor_radius)
    ratio = vehicle.rotor_radius / distance
    return at_hubs(vehicle, 0.0, 0.0, -p[0] * ratio * ratio * state.thrusts)
