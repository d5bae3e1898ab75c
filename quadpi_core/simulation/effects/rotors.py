# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects of rotors: of their air and of their mechanics."""

from __future__ import annotations

import numpy as np

from quadpi_core.core import exponential, hyperbolic_tangent, sine
from quadpi_core.frames import Array
from quadpi_core.records import ROTORS_MAX
from quadpi_core.simulation.effect_definition import (
    AERODYNAMIC,
    STRENGTH_OF_ONE_ROTOR,
    Parameter,
    Wrench,
    at_hubs,
    effect,
    in_plane_speeds,
)
from quadpi_core.simulation.rotor_local import ADVANCE_RATIO_MAX
from quadpi_core.simulation.state_records import State, VehicleNumbers

# Coefficients per speed are those of the four rotors together at the vehicle's hover rotor speed ω_h: rotor i
# has the share ¼ ω_i/ω_h of them. Forces act at the hubs, so that each gives its moment r_i × F_i too.


def _shares(state: State, vehicle: VehicleNumbers) -> Array:
    return state.rotor_speeds / (vehicle.rotors * vehicle.hover_rotor_speed)


@effect(
    "wrench",
    "Fx Fy Mx My Mz",
    Parameter("drag_n_s_m", "N s/m", 0.11, -2.0, 2.0),
    shown_by="fore-aft and sideways sines at two speeds",
    form=AERODYNAMIC,
    formula=r"F_i = -k\,\tfrac14\,\frac{\omega_i}{\omega_h}\,(u_i,\ v_i,\ 0)",
    symbols="k",
)
def rotor_drag(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Drag of the rotors in their plane (H-force), with rotor speed times airspeed.

    k < 0 where the rotors have less of it than their model. Source: term k4 of the rotor-local model; Martin
    and Salaün, "The true role of accelerometer feedback in quadrotor control", 2010. Size: Bebop 2.
    """
    k = -p[0] * _shares(state, vehicle)
    u, v, _ = state.hub_velocity.T
    return at_hubs(vehicle, k * u.T, k * v.T, 0.0)


@effect(
    "wrench",
    "Fx Fy Mx My Mz",
    Parameter("force_n_s_m", "N s/m", 0.064, -2.0, 2.0),
    formula=r"F_i = s_i\,k\,\tfrac14\,\frac{\omega_i}{\omega_h}\,(v_i,\ -u_i,\ 0)",
    symbols="k",
)
def cross_flow(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Force of the rotors across the airflow in their plane; cancels where all turn at one speed.

    Source: term k5 of the rotor-local model. Size: Bebop 2.
    """
    k = p[0] * vehicle.rotor_spins * _shares(state, vehicle)
    u, v, _ = state.hub_velocity.T
    return at_hubs(vehicle, k * v.T, -k * u.T, 0.0)


@effect(
    "wrench",
    "Mx My",
    Parameter("moment_nm_s_m", "Nm s/m", 0.0129, -0.5, 0.5),
    shown_by="speed sweep with steady attitude",
    form=AERODYNAMIC,
    formula=r"M = \sum_i k\,\tfrac14\,\frac{\omega_i}{\omega_h}\,(-v_i,\ u_i,\ 0)",
    symbols="k",
)
def blade_flapping(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Moment at the hubs of blades that flap in translation: nose up in forward flight.

    Source: term k6 of the rotor-local model. Size: Bebop 2.
    """
    k = p[0] * _shares(state, vehicle)
    u, v, _ = state.hub_velocity.T
    return 0.0, 0.0, 0.0, -np.sum(k * v.T, axis=1), np.sum(k * u.T, axis=1), 0.0


@effect(
    "wrench",
    "Fz Mx My",
    Parameter("lift_n_s2_m2", "N s²/m²", 0.0058, 0.0, 0.1),
    shown_by="speed sweep at constant height",
    form=AERODYNAMIC,
    formula=r"\Delta T_i = \tfrac14\,k\,\min\!\left(u_i^2 + v_i^2,\ (0.6\,\omega_i R)^2\right)",
    symbols="k",
)
def translational_lift(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Thrust gained by rotors in translation, with the square of the airspeed in their plane.

    Blade element theory, C_T = ½ σ a (θ (⅓ + ½ μ²) − ½ λ), where ω² μ² does not depend on ω. The advance
    ratio μ is held at the largest of the rotor-local model, so that a rotor at rest lifts nothing. Source:
    Leishman, Principles of Helicopter Aerodynamics. Size: 31 % of the weight of the Bebop 2 at 14 m/s.
    """
    fastest = ADVANCE_RATIO_MAX * vehicle.rotor_radius * state.rotor_speeds
    speed = np.minimum(in_plane_speeds(state), fastest)
    return at_hubs(vehicle, 0.0, 0.0, -p[0] / vehicle.rotors * speed * speed)


@effect(
    "wrench",
    "Fz Mx My",
    Parameter("damping_n_s_m", "N s/m", 0.33, 0.0, 5.0),
    shown_by="vertical sines in hover",
    form=AERODYNAMIC,
    formula=r"F_{z,i} = -k\,\tfrac14\,\frac{\omega_i}{\omega_h}\,w_i",
    symbols="k",
)
def inflow_damping(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Thrust lost in climb and gained in descent, by the inflow through each rotor; damps roll and pitch too.

    Blade element theory, the term −½ λ of C_T with λ = −w_i/(ω R). Source: Leishman. Size: 9 % of the weight
    of the Bebop 2 at 1 m/s.
    """
    k = -p[0] * _shares(state, vehicle)
    return at_hubs(vehicle, 0.0, 0.0, k * state.hub_velocity[:, :, 2])


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
def rotor_dissymmetry(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Moment of rotors that meet different airspeeds because the vehicle turns while it translates.

    Of the thrust that it adds the moment alone is taken. Size: 3e-4 Nm, at 10 rad/s of roll with 3 m/s along
    z and 0.1 m to the rotors.
    """
    square = np.sum(state.velocity_air**2, axis=1)
    more = np.sum(state.hub_velocity**2, axis=2) - square[:, None]
    *_, mx, my, _ = at_hubs(vehicle, 0.0, 0.0, -p[0] * _shares(state, vehicle) * more)
    return 0.0, 0.0, 0.0, mx, my, 0.0


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
def vortex_ring(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Thrust lost by rotors that descend into their own wake.

    Measured induced velocities leave those of momentum theory from the first descent on, most where it is as
    fast as the induced velocity of hover v_h, and meet them again in the windmill brake state near twice that
    (Leishman, Principles of Helicopter Aerodynamics, 2006). It is gone once the vehicle flies out of its wake
    (near μ = 1: Johnson, NASA TP-2005-213477). Size: 0.64 N of 4.9 N.
    """
    x = np.maximum(state.hub_velocity[:, :, 2], 0.0) / vehicle.hover_induced_velocity
    across = in_plane_speeds(state) / vehicle.hover_induced_velocity
    loss = p[0] * state.thrusts * x * exponential(0.25 * (1.0 - np.square(x * x)) - across * across)
    return at_hubs(vehicle, 0.0, 0.0, loss)


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
def rotor_interaction(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Thrust lost by the rotors that fly in the wake of those ahead.

    V and e are speed and direction of the airspeed in the plane of the rotors; a rotor straight behind the
    centre loses the whole share k. Size: 10 % of the rear thrust in forward flight of an x layout.
    """
    u, v, _ = state.velocity_air.T
    x, y, _ = vehicle.rotor_positions.T
    speed = np.sqrt(u * u + v * v)
    strength = p[0] * hyperbolic_tangent(speed / vehicle.hover_induced_velocity)
    across = np.outer(np.where(speed > 0.0, speed, 1.0), np.sqrt(x * x + y * y))
    behind = np.maximum(0.0, -(np.outer(u, x) + np.outer(v, y)) / across)
    return at_hubs(vehicle, 0.0, 0.0, strength[:, None] * behind * state.thrusts)


_WHICH = Parameter("rotor", "", 1.0, 1.0, float(ROTORS_MAX), whole=True)
_INERTIA = Parameter("rotor_inertia_kg_m2", "kg m²", 8e-6, 0.0, 1e-3)


@effect(
    "wrench",
    "Mx My",
    _INERTIA,
    shown_by="yaw with roll and pitch at once",
    formula=r"M = I_r \sum_i s_i \omega_i\,(-q,\ p,\ 0)",
    symbols="I_r",
)
def gyroscopic(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Precession of the rotors when the body turns; does no work.

    A rotor that turns clockwise seen from above (s = 1) has its angular momentum along z, down. Size: a rotor
    of the Bebop 2 with its motor's bell.
    """
    momentum = p[0] * np.sum(vehicle.rotor_spins * state.rotor_speeds, axis=1)
    return 0.0, 0.0, 0.0, -state.rates[:, 1] * momentum, state.rates[:, 0] * momentum, 0.0


@effect(
    "wrench",
    "Mz",
    _INERTIA,
    shown_by="yaw steps",
    formula=r"M_z = -I_r \sum_i s_i \dot\omega_i",
    symbols="I_r",
)
def spin_up(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Reaction of the body to rotors that change their speed.

    Size: 0.096 Nm when the rotors of the Bebop 2 begin a step of 100 rad/s.
    """
    torque = -p[0] * np.sum(vehicle.rotor_spins * state.rotor_accelerations, axis=1)
    return 0.0, 0.0, 0.0, 0.0, 0.0, torque


@effect(
    "wrench",
    "Fx Fy Fz Mx My Mz",
    Parameter("change", "", 0.1, -0.9, 1.0),
    shown_by="roll and pitch pulses, throttle steps",
    scales_existing=True,
    scales_thrust=True,
    formula=r"\Delta (F,\ M) = k\,(F,\ M)_{\mathrm{aerodynamic}}",
    symbols="k",
    of_a_flight="the air, or a battery that is low",
)
def thrust_coefficient(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:  # noqa: ARG001
    """Another air density, or other blades: thrust, torque and drag grow together.

    Aerodynamic forces and moments are in proportion to the density, and those of a rotor to the lift of its
    blades. Size: 10 %.
    """
    fx, fy, fz, mx, my, mz = state.aerodynamics.T
    return p[0] * fx, p[0] * fy, p[0] * fz, p[0] * mx, p[0] * my, p[0] * mz


@effect(
    "wrench",
    "Fz Mx My Mz",
    *(Parameter(f"{name}_change", "", 0.01, -0.9, 1.0) for name in ("first", "second", "third", "fourth")),
    tolerance="thrust",
    formula=r"\Delta T_i = k_i\,T_i,\quad \Delta Q_i = k_i\,Q_i,\quad k = (k_1, k_2, k_3, k_4)",
    symbols="k_1 k_2 k_3 k_4",
)
def rotor_thrusts(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Each rotor has a thrust and torque coefficient of its own.

    Size: 1 %, as rotors of one batch differ.
    """
    return _with_shares(state, vehicle, p, p)


@effect(
    "wrench",
    "Fx Fy Fz Mx My Mz",
    _WHICH,
    Parameter("loss", "", 0.1, 0.0, 1.0),
    Parameter("torque_change", "", -0.1, -1.0, 1.0),
    shown_by="throttle steps with yaw steps",
    indistinguishable_group=STRENGTH_OF_ONE_ROTOR,
    form=AERODYNAMIC,
    formula=r"\Delta T_j = -k\,T_j,\quad (\Delta Q_j,\ \Delta H_j) = k_Q\,(Q_j,\ H_j)",
    symbols="j k k_Q",
)
def weak_rotor(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """One rotor is damaged and gives less thrust than its speed promises, and another torque.

    Its torque and its drag in the plane H_j grow, or fall: a nick costs lift and adds drag, a blade cut short
    costs both. Size: 10 % less of all.
    """
    hit = _rotor(p[0], vehicle)
    fx, fy, fz, mx, my, mz = _with_shares(state, vehicle, -p[1] * hit, p[2] * hit)
    u, v, _ = state.hub_velocity.T
    drag = p[2] * vehicle.rotor_force_along * state.rotor_speeds * hit
    ax, ay, _, _, _, az = at_hubs(vehicle, drag * u.T, drag * v.T, 0.0)
    return fx + ax, fy + ay, fz, mx, my, mz + az


def _rotor(number: float, vehicle: VehicleNumbers) -> Array:
    """1 for the rotor of that number, counted from 1, and 0 for others."""
    return np.where(np.arange(vehicle.rotors) == int(number) - 1, 1.0, 0.0)


def _with_shares(state: State, vehicle: VehicleNumbers, of_thrust: Array, of_torque: Array) -> Wrench:
    """Wrench of shares (rotors,) of the rotors' thrusts and torques."""
    fx, fy, fz, mx, my, mz = at_hubs(vehicle, 0.0, 0.0, -of_thrust * state.thrusts)
    return fx, fy, fz, mx, my, mz + np.sum(of_torque * state.torques, axis=1)


@effect(
    "wrench",
    "Fx Fy Fz Mx My Mz",
    _WHICH,
    Parameter("forward_deg", "deg", 1.4, -15.0, 15.0),
    Parameter("right_deg", "deg", 1.4, -15.0, 15.0),
    shown_by="throttle steps with yaw",
    formula=(
        r"F_j = T_j\,n,\quad M_j = -Q_j\,n,\quad "
        r"n = (\sin\alpha,\ \sin\beta,\ 1 - \sqrt{1 - \sin^2\alpha - \sin^2\beta})"
    ),
    symbols=r"j \alpha \beta",
)
def rotor_tilt(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """One rotor is mounted askew.

    Thrust and torque turn and stay as large; the angles are forward and right. Size: 2° together.
    """
    hit = _rotor(p[0], vehicle)
    thrust, torque = state.thrusts * hit, np.sum(state.torques * hit, axis=1)
    x, y = sine(np.radians(p[1])), sine(np.radians(p[2]))
    z = 1.0 - np.sqrt(1.0 - x * x - y * y)
    fx, fy, fz, mx, my, mz = at_hubs(vehicle, thrust * x, thrust * y, thrust * z)
    return fx, fy, fz, mx - torque * x, my - torque * y, mz - torque * z
