# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects of wind, airframe, mass, ground and ceiling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core.core import compiled, exponential
from quadpi_core.frames import Array
from quadpi_core.records import Threshold
from quadpi_core.simulation.effect_definition import (
    AERODYNAMIC,
    Parameter,
    Wrench,
    at_hubs,
    effect,
    hub_heights,
    in_plane_speeds,
    three,
    world_to_body,
)
from quadpi_core.simulation.state_records import State, VehicleNumbers
from quadpi_core.vehicle import Vehicle, is_rigid_body


@effect(
    "wind",
    "Fx Fy Fz Mx My Mz",
    Parameter("north_m_s", "m/s", 2.0, -30.0, 30.0),
    Parameter("east_m_s", "m/s", 0.0, -30.0, 30.0),
    Parameter("down_m_s", "m/s", 0.0, -10.0, 10.0),
    shown_by="turns of the heading in hover and in translation",
    formula=r"V = V_g - R_{BE}\,(w_N,\ w_E,\ w_D)",
    symbols="w_N w_E w_D",
)
def wind(time: Array, p: Array, rng: np.random.Generator) -> Array:  # noqa: ARG001
    """Steady wind, blowing towards north, east and down.

    Size: 2 m/s, 0.46 N on 0.5 kg.
    """
    return np.tile(p, (len(time), 1))


@effect(
    "wind",
    "Fx Fy Fz Mx My Mz",
    Parameter("intensity_m_s", "m/s", 1.2, 0.0, 10.0),
    Parameter("time_s", "s", 1.0, 0.01, 100.0),
    formula=r"S_w(\omega) \propto \frac{\sigma^2\,\tau}{1 + (\omega\tau)^2}",
    symbols=r"\sigma \tau",
)
def gust(time: Array, p: Array, rng: np.random.Generator) -> Array:
    """Gusts: coloured noise of the wind in all three directions.

    Each is an Ornstein–Uhlenbeck process, exact on any time grid and stationary from its first sample, with
    standard deviation `intensity_m_s` and autocorrelation e^(−|Δt|/time_s): the longitudinal spectrum of
    Dryden (MIL-F-8785C) at a fixed airspeed. Size: 0.27 N on 0.5 kg.
    """
    return _ornstein_uhlenbeck(time, p[0], p[1], rng.standard_normal((len(time), 3)))


def _ornstein_uhlenbeck(time: Array, deviation: float, time_constant: float, noise: Array) -> Array:
    persistence = exponential(-np.diff(time) / time_constant)
    added = deviation * np.sqrt(1.0 - persistence * persistence)[:, None] * noise[1:]
    x, y, z = (deviation * noise[0]).tolist()
    process = [(x, y, z)]
    for keep, (dx, dy, dz) in zip(persistence.tolist(), added.tolist(), strict=True):
        x, y, z = keep * x + dx, keep * y + dy, keep * z + dz
        process.append((x, y, z))
    return np.array(process)


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
