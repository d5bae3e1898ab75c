# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects of the rotors as built: inertia, thrust coefficient, mounting, damage."""

from __future__ import annotations

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.simulation.effect_definition import (
    AERODYNAMIC,
    NO_WRENCH,
    STRENGTH_OF_ONE_ROTOR,
    Parameter,
    Wrench,
    effect,
    with_hub_force,
)
from quadpi_core.simulation.state_records import State, VehicleNumbers
from quadpi_core.vehicle import ROTORS

_WHICH = Parameter("rotor", "", 1.0, 1.0, float(ROTORS), whole=True)
_INERTIA = Parameter("rotor_inertia_kg_m2", "kg m²", 8e-6, 0.0, 1e-3)


@effect(
    "wrench",
    "Mx My",
    _INERTIA,
    shown_by="yaw with roll and pitch at once",
    formula=r"M = I_r \sum_i s_i \omega_i\,(-q,\ p,\ 0)",
    symbols="I_r",
)
@njit(cache=True)
def gyroscopic(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Precession of the rotors when the body turns; does no work.

    A rotor that turns clockwise seen from above (s = 1) has its angular momentum along z, down. Size: a rotor
    of the Bebop 2 with its motor's bell.
    """
    momentum = 0.0
    for rotor in range(ROTORS):
        momentum += p[0] * vehicle.rotor_spins[rotor] * state.rotor_speeds[rotor]
    return 0.0, 0.0, 0.0, -state.rates[1] * momentum, state.rates[0] * momentum, 0.0


@effect(
    "wrench",
    "Mz",
    _INERTIA,
    shown_by="yaw steps",
    formula=r"M_z = -I_r \sum_i s_i \dot\omega_i",
    symbols="I_r",
)
@njit(cache=True)
def spin_up(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Reaction of the body to rotors that change their speed.

    Size: 0.096 Nm when the rotors of the Bebop 2 begin a step of 100 rad/s.
    """
    torque = 0.0
    for rotor in range(ROTORS):
        torque -= p[0] * vehicle.rotor_spins[rotor] * state.rotor_accelerations[rotor]
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
@njit(cache=True)
def thrust_coefficient(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:  # noqa: ARG001
    """Another air density, or other blades: thrust, torque and drag grow together.

    Aerodynamic forces and moments are in proportion to the density, and those of a rotor to the lift of its
    blades. Size: 10 %.
    """
    f = state.aerodynamics
    return p[0] * f[0], p[0] * f[1], p[0] * f[2], p[0] * f[3], p[0] * f[4], p[0] * f[5]


@effect(
    "wrench",
    "Fz Mx My Mz",
    *(Parameter(f"{name}_change", "", 0.01, -0.9, 1.0) for name in ("first", "second", "third", "fourth")),
    tolerance="thrust",
    formula=r"\Delta T_i = k_i\,T_i,\quad \Delta Q_i = k_i\,Q_i,\quad k = (k_1, k_2, k_3, k_4)",
    symbols="k_1 k_2 k_3 k_4",
)
@njit(cache=True)
def rotor_thrusts(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """Each rotor has a thrust and torque coefficient of its own.

    Size: 1 %, as rotors of one batch differ.
    """
    wrench = NO_WRENCH
    for rotor in range(ROTORS):
        wrench = _with_shares(wrench, state, vehicle, rotor, p[rotor], p[rotor])
    return wrench


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
@njit(cache=True)
def weak_rotor(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """One rotor is damaged and gives less thrust than its speed promises, and another torque.

    Its torque and its drag in the plane H_j grow, or fall: a nick costs lift and adds drag, a blade cut short
    costs both. Size: 10 % less of all.
    """
    rotor = int(p[0]) - 1
    fx, fy, fz, mx, my, mz = _with_shares(NO_WRENCH, state, vehicle, rotor, -p[1], p[2])
    u, v = state.hub_velocity[rotor, 0], state.hub_velocity[rotor, 1]
    x, y = vehicle.rotor_positions[rotor, 0], vehicle.rotor_positions[rotor, 1]
    drag = p[2] * vehicle.rotor_force_along * state.rotor_speeds[rotor]
    return fx + drag * u, fy + drag * v, fz, mx, my, mz + drag * (x * v - y * u)


@njit(cache=True)
def _with_shares(
    wrench: Wrench, state: State, vehicle: VehicleNumbers, rotor: int, of_thrust: float, of_torque: float
) -> Wrench:
    more = -of_thrust * state.thrusts[rotor]
    fx, fy, fz, mx, my, mz = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, more)
    return fx, fy, fz, mx, my, mz + of_torque * state.torques[rotor]


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
@njit(cache=True)
def rotor_tilt(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:
    """One rotor is mounted askew.

    Thrust and torque turn and stay as large; the angles are forward and right. Size: 2° together.
    """
    rotor = int(p[0]) - 1
    thrust, torque = state.thrusts[rotor], state.torques[rotor]
    x, y = np.sin(np.radians(p[1])), np.sin(np.radians(p[2]))
    z = 1.0 - np.sqrt(1.0 - x * x - y * y)
    fx, fy, fz, mx, my, mz = with_hub_force(NO_WRENCH, vehicle, rotor, thrust * x, thrust * y, thrust * z)
    return fx, fy, fz, mx - torque * x, my - torque * y, mz - torque * z
