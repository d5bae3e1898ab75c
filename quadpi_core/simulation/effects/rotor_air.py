# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Aerodynamic effects of the rotors, each rotor in the airspeed (u_i, v_i, w_i) of its own hub.

Coefficients per speed are those of the four rotors together at the vehicle's hover rotor speed ω_h: rotor i
has the share ¼ ω_i/ω_h of them. Forces act at the hubs, so that each gives its moment r_i × F_i too.
"""

from __future__ import annotations

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.simulation.effect_definition import (
    AERODYNAMIC,
    NO_WRENCH,
    Parameter,
    Wrench,
    effect,
    in_plane_speed,
    with_hub_force,
)
from quadpi_core.simulation.rotor_local import ADVANCE_RATIO_MAX
from quadpi_core.simulation.state_records import State, VehicleNumbers
from quadpi_core.vehicle import ROTORS


@njit(cache=True)
def _share(state: State, vehicle: VehicleNumbers, rotor: int) -> float:
    share: float = state.rotor_speeds[rotor] / (ROTORS * vehicle.hover_rotor_speed)
    return share


@effect(
    "wrench",
    "Fx Fy Mx My Mz",
    Parameter("drag_n_s_m", "N s/m", 0.11, -2.0, 2.0),
    shown_by="fore-aft and sideways sines at two speeds",
    form=AERODYNAMIC,
    formula=r"F_i = -k\,\tfrac14\,\frac{\omega_i}{\omega_h}\,(u_i,\ v_i,\ 0)",
    symbols="k",
)
@njit(cache=True)
def rotor_drag(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Drag of the rotors in their plane (H-force), with rotor speed times airspeed.

    k < 0 where the rotors have less of it than their model. Source: term k4 of the rotor-local model; Martin
    and Salaün, "The true role of accelerometer feedback in quadrotor control", 2010. Size: Bebop 2.
    """
    wrench = NO_WRENCH
    for rotor in range(ROTORS):
        k = -p[0] * _share(state, vehicle, rotor)
        u, v = state.hub_velocity[rotor, 0], state.hub_velocity[rotor, 1]
        wrench = with_hub_force(wrench, vehicle, rotor, k * u, k * v, 0.0)
    return wrench


@effect(
    "wrench",
    "Fx Fy Mx My Mz",
    Parameter("force_n_s_m", "N s/m", 0.064, -2.0, 2.0),
    formula=r"F_i = s_i\,k\,\tfrac14\,\frac{\omega_i}{\omega_h}\,(v_i,\ -u_i,\ 0)",
    symbols="k",
)
@njit(cache=True)
def cross_flow(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Force of the rotors across the airflow in their plane; cancels where all turn at one speed.

    Source: term k5 of the rotor-local model. Size: Bebop 2.
    """
    wrench = NO_WRENCH
    for rotor in range(ROTORS):
        k = p[0] * vehicle.rotor_spins[rotor] * _share(state, vehicle, rotor)
        u, v = state.hub_velocity[rotor, 0], state.hub_velocity[rotor, 1]
        wrench = with_hub_force(wrench, vehicle, rotor, k * v, -k * u, 0.0)
    return wrench


@effect(
    "wrench",
    "Mx My",
    Parameter("moment_nm_s_m", "Nm s/m", 0.0129, -0.5, 0.5),
    shown_by="speed sweep with steady attitude",
    form=AERODYNAMIC,
    formula=r"M = \sum_i k\,\tfrac14\,\frac{\omega_i}{\omega_h}\,(-v_i,\ u_i,\ 0)",
    symbols="k",
)
@njit(cache=True)
def blade_flapping(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Moment at the hubs of blades that flap in translation: nose up in forward flight.

    Source: term k6 of the rotor-local model. Size: Bebop 2.
    """
    mx = my = 0.0
    for rotor in range(ROTORS):
        k = p[0] * _share(state, vehicle, rotor)
        mx -= k * state.hub_velocity[rotor, 1]
        my += k * state.hub_velocity[rotor, 0]
    return 0.0, 0.0, 0.0, mx, my, 0.0


@effect(
    "wrench",
    "Fz Mx My",
    Parameter("lift_n_s2_m2", "N s²/m²", 0.0058, 0.0, 0.1),
    shown_by="speed sweep at constant height",
    form=AERODYNAMIC,
    formula=r"\Delta T_i = \tfrac14\,k\,\min\!\left(u_i^2 + v_i^2,\ (0.6\,\omega_i R)^2\right)",
    symbols="k",
)
@njit(cache=True)
def translational_lift(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Thrust gained by rotors in translation, with the square of the airspeed in their plane.

    Blade element theory, C_T = ½ σ a (θ (⅓ + ½ μ²) − ½ λ), where ω² μ² does not depend on ω. The advance
    ratio μ is held at the largest of the rotor-local model, so that a rotor at rest lifts nothing. Source:
    Leishman, Principles of Helicopter Aerodynamics. Size: 31 % of the weight of the Bebop 2 at 14 m/s.
    """
    wrench = NO_WRENCH
    for rotor in range(ROTORS):
        fastest = ADVANCE_RATIO_MAX * vehicle.rotor_radius * state.rotor_speeds[rotor]
        speed = min(in_plane_speed(state, rotor), fastest)
        wrench = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, -p[0] / ROTORS * speed * speed)
    return wrench


@effect(
    "wrench",
    "Fz Mx My",
    Parameter("damping_n_s_m", "N s/m", 0.33, 0.0, 5.0),
    shown_by="vertical sines in hover",
    form=AERODYNAMIC,
    formula=r"F_{z,i} = -k\,\tfrac14\,\frac{\omega_i}{\omega_h}\,w_i",
    symbols="k",
)
@njit(cache=True)
def inflow_damping(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Thrust lost in climb and gained in descent, by the inflow through each rotor; damps roll and pitch too.

    Blade element theory, the term −½ λ of C_T with λ = −w_i/(ω R). Source: Leishman. Size: 9 % of the weight
    of the Bebop 2 at 1 m/s.
    """
    wrench = NO_WRENCH
    for rotor in range(ROTORS):
        k = -p[0] * _share(state, vehicle, rotor)
        wrench = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, k * state.hub_velocity[rotor, 2])
    return wrench


@effect(
    "wrench",
    "Mx My",
    Parameter("lift_n_s2_m2", "N s²/m²", 5e-4, -0.1, 0.1),
    formula=(
        r"(M_x, M_y) = \sum_i k\,\tfrac14\,\frac{\omega_i}{\omega_h}\left(|V_i|^2"
        r" - |V|^2\right)(-y_i,\ x_i)"
    ),
    symbols="k",
)
@njit(cache=True)
def rotor_dissymmetry(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Moment of rotors that meet different airspeeds because the vehicle turns while it translates.

    Of the thrust that it adds the moment alone is taken. Size: 3e-4 Nm, at 10 rad/s of roll with 3 m/s along
    z and 0.1 m to the rotors.
    """
    u, v, w = state.velocity_air[0], state.velocity_air[1], state.velocity_air[2]
    square = u * u + v * v + w * w
    wrench = NO_WRENCH
    for rotor in range(ROTORS):
        hub = state.hub_velocity[rotor]
        more = hub[0] * hub[0] + hub[1] * hub[1] + hub[2] * hub[2] - square
        thrust = p[0] * _share(state, vehicle, rotor) * more
        wrench = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, -thrust)
    return 0.0, 0.0, 0.0, wrench[3], wrench[4], 0.0


@effect(
    "wrench",
    "Fz Mx My",
    Parameter("loss", "", 0.13, 0.0, 1.0),
    shown_by="vertical descents at half to one and a half times the induced velocity of hover",
    form=AERODYNAMIC,
    formula=(
        r"\Delta T_i = -k\,T_i\,x_i\,e^{(1 - x_i^4)/4 - \mu_i^2},\quad "
        r"x_i = \frac{\max(w_i, 0)}{v_h},\quad "
        r"\mu_i = \frac{\sqrt{u_i^2 + v_i^2}}{v_h}"
    ),
    symbols="k",
)
@njit(cache=True)
def vortex_ring(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Thrust lost by rotors that descend into their own wake.

    Measured induced velocities leave those of momentum theory from the first descent on, most where it is as
    fast as the induced velocity of hover v_h, and meet them again in the windmill brake state near twice that
    (Leishman, Principles of Helicopter Aerodynamics, 2006). It is gone once the vehicle flies out of its wake
    (near μ = 1: Johnson, NASA TP-2005-213477). Size: 0.64 N of 4.9 N.
    """
    wrench = NO_WRENCH
    for rotor in range(ROTORS):
        x = max(state.hub_velocity[rotor, 2], 0.0) / vehicle.hover_induced_velocity
        across = in_plane_speed(state, rotor) / vehicle.hover_induced_velocity
        loss = p[0] * state.thrusts[rotor] * x * np.exp(0.25 * (1.0 - x**4) - across * across)
        wrench = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, loss)
    return wrench


@effect(
    "wrench",
    "Fz Mx My",
    Parameter("loss", "", 0.15, 0.0, 1.0),
    shown_by="slow forward and sideways flight at several speeds",
    form=AERODYNAMIC,
    formula=(
        r"\Delta T_i = -k\,T_i \tanh\!\left(\frac{V}{v_h}\right) "
        r"\max\!\left(0,\ -\frac{r_i \cdot e}{|r_i|}\right),\quad "
        r"V e = (u, v)"
    ),
    symbols="k",
)
@njit(cache=True)
def rotor_interaction(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Thrust lost by the rotors that fly in the wake of those ahead.

    V and e are speed and direction of the airspeed in the plane of the rotors; a rotor straight behind the
    centre loses the whole share k. Size: 10 % of the rear thrust in forward flight of an x layout.
    """
    u, v = state.velocity_air[0], state.velocity_air[1]
    speed = np.sqrt(u * u + v * v)
    if speed == 0.0:
        return NO_WRENCH
    strength = p[0] * np.tanh(speed / vehicle.hover_induced_velocity)
    wrench = NO_WRENCH
    for rotor in range(ROTORS):
        x, y = vehicle.rotor_positions[rotor, 0], vehicle.rotor_positions[rotor, 1]
        behind = max(0.0, -(x * u + y * v) / (speed * np.sqrt(x * x + y * y)))
        loss = strength * behind * state.thrusts[rotor]
        wrench = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, loss)
    return wrench
