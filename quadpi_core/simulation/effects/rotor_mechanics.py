# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects of the rotors as built: inertia, thrust coefficient, mounting, damage."""

from __future__ import annotations

import numpy as np

from quadpi_core.elementary import sine
from quadpi_core.frames import Array
from quadpi_core.records import ROTORS_MAX
from quadpi_core.simulation.effect_definition import (
    AERODYNAMIC,
    STRENGTH_OF_ONE_ROTOR,
    Parameter,
    Wrench,
    at_hubs,
    effect,
)
from quadpi_core.simulation.state_records import State, VehicleNumbers

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
