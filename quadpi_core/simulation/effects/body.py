# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects on the body as a whole: drag, damping, tether, biases, centre of gravity."""

from __future__ import annotations

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.simulation.effect_definition import (
    AERODYNAMIC,
    Parameter,
    Wrench,
    effect,
    three,
    world_to_body,
)
from quadpi_core.simulation.state_records import State, VehicleNumbers


@effect(
    "wrench",
    "Fx Fy Fz",
    Parameter("x_n_s2_m2", "N s²/m²", 0.0015, 0.0, 0.1),
    Parameter("y_n_s2_m2", "N s²/m²", 0.0027, 0.0, 0.1),
    Parameter("z_n_s2_m2", "N s²/m²", 0.0027, 0.0, 0.1),
    shown_by="flight above 5 m/s at two speeds, in all three directions",
    form=AERODYNAMIC,
    formula=r"F = -|V|\,(k_x u,\ k_y v,\ k_z w)",
    symbols="k_x k_y k_z",
)
def body_drag(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:  # noqa: ARG001
    """Parasitic drag of the airframe, with the square of the airspeed.

    Each k is ½ ρ C_D S. Sizes in x and y: Bebop 2 in the wind tunnel; z as y.
    """
    u, v, w = state.velocity_air.T
    airspeed = np.sqrt(u * u + v * v + w * w)
    return -p[0] * airspeed * u, -p[1] * airspeed * v, -p[2] * airspeed * w, 0.0, 0.0, 0.0


@effect(
    "wrench",
    "Fx Fy",
    Parameter("drag_n_s3_m3", "N s³/m³", 7.5e-5, 0.0, 0.01),
    formula=r"(F_x, F_y) = -k\,|V|^2\,(u,\ v)",
    symbols="k",
)
def cubic_drag(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:  # noqa: ARG001
    """In-plane drag with the cube of the airspeed, as where induced and profile power grow in a dash.

    Size: 0.075 N at 10 m/s.
    """
    u, v, w = state.velocity_air.T
    factor = -p[0] * (u * u + v * v + w * w)
    return factor * u, factor * v, 0.0, 0.0, 0.0, 0.0


@effect(
    "wrench",
    "Mx My Mz",
    *three("nm_s", "Nm s", 2.3e-3, 0.1, lowest=0.0),
    shown_by="rate doublets about every axis in hover",
    form=AERODYNAMIC,
    formula=r"M = -(k_x p,\ k_y q,\ k_z r)",
    symbols="k_x k_y k_z",
)
def rate_damping(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:  # noqa: ARG001
    """Moment against the body rates.

    Size: yaw of the Bebop 2.
    """
    roll, pitch, yaw = state.rates.T
    return 0.0, 0.0, 0.0, -p[0] * roll, -p[1] * pitch, -p[2] * yaw


@effect(
    "wrench",
    "Fx Fy Fz Mx My",
    Parameter("stiffness_n_m", "N/m", 0.6, 0.0, 100.0),
    Parameter("length_m", "m", 2.0, 0.0, 100.0),
    Parameter("north_m", "m", 0.0, -1000.0, 1000.0),
    Parameter("east_m", "m", 0.0, -1000.0, 1000.0),
    Parameter("height_m", "m", 0.0, 0.0, 1000.0),
    Parameter("hook_m", "m", 0.01, 0.0, 1.0),
    shown_by="flights outward in every direction",
    composable=False,
    form=AERODYNAMIC,
    formula=(
        r"F = -k\,\max(L - L_0,\ 0)\,R_{BE}\,n,\quad M = h\,(-F_y,\ F_x,\ 0),\quad "
        r"L\,n = x - (a_N,\ a_E,\ -a_h)"
    ),
    symbols="k L_0 a_N a_E a_h h",
)
def tether(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:  # noqa: ARG001
    """Elastic tether from a point of the world to the belly.

    L and n are distance and direction of the centre of gravity from the anchor. It pulls at the hook, h below
    the centre. Size: 0.6 N at 3 m over an anchor on the ground.
    """
    x, y, z = state.position.T
    north, east, down = x - p[2], y - p[3], z + p[4]
    distance = np.sqrt(north * north + east * east + down * down)
    pull = -p[0] * np.maximum(distance - p[1], 0.0) / np.where(distance > 0.0, distance, 1.0)
    fx, fy, fz = world_to_body(state.attitude, pull * north, pull * east, pull * down)
    return fx, fy, fz, -p[5] * fy, p[5] * fx, 0.0


@effect(
    "wrench",
    "Fx Fy Fz",
    *three("n", "N", 0.1, 5.0),
    shown_by="throttle steps; hover in several headings",
    formula=r"F = (b_x,\ b_y,\ b_z)",
    symbols="b_x b_y b_z",
    of_a_flight="a steady pull or an accelerometer that is off",
)
def force_bias(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:  # noqa: ARG001
    """Constant force in body axes.

    Size: that of an accelerometer's bias of 0.2 m/s² on 0.5 kg.
    """
    return p[0], p[1], p[2], 0.0, 0.0, 0.0


@effect(
    "wrench",
    "Mx My Mz",
    Parameter("x_nm", "Nm", 0.005, -0.5, 0.5),
    Parameter("y_nm", "Nm", 0.005, -0.5, 0.5),
    Parameter("z_nm", "Nm", 0.002, -0.5, 0.5),
    shown_by="throttle steps",
    formula=r"M = (b_x,\ b_y,\ b_z)",
    symbols="b_x b_y b_z",
    of_a_flight="a battery mounted elsewhere",
)
def moment_bias(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:  # noqa: ARG001
    """Constant moment in body axes.

    Size: that of a slightly bent frame, a quarter of the moment of a rotor that lost 10 %.
    """
    return 0.0, 0.0, 0.0, p[0], p[1], p[2]


@effect(
    "wrench",
    "Mx My Mz",
    Parameter("x_m", "m", 0.0035, -0.1, 0.1),
    Parameter("y_m", "m", 0.0035, -0.1, 0.1),
    Parameter("z_m", "m", 0.0, -0.1, 0.1),
    shown_by="throttle steps and vertical accelerations",
    # After every other force, since it changes their moments.
    last=True,
    size_grows_with_arm=True,
    tolerance="cg_m",
    formula=r"M = -(d_x,\ d_y,\ d_z) \times F",
    symbols="d_x d_y d_z",
)
def cg_offset(state: State, vehicle: VehicleNumbers, p: Array) -> Wrench:  # noqa: ARG001
    """Centre of gravity away from where the vehicle file has it.

    F is the force of the aerodynamics and of every effect before, d points from the nominal centre to the
    true one. First order in d: inertia and hub velocities are those about the nominal centre. Size: 5 mm.
    """
    fx, fy, fz, *_ = state.wrench.T
    return 0.0, 0.0, 0.0, p[2] * fy - p[1] * fz, p[0] * fz - p[2] * fx, p[1] * fx - p[0] * fy
