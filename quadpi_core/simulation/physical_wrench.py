# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The wrench of the terms of the physical model on a simulated vehicle, for flights that numba integrates.

As core/include/quadpi/simulation/physical_wrench.hpp has it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.physical_regressors import MOTION, PHYSICAL_VEHICLE
from quadpi_core.models.physical_terms import TERM_INDEX, TERM_NAMES
from quadpi_core.simulation.state_records import State, VehicleNumbers
from quadpi_core.vehicle import ROTORS

# Regressors of one sample: six numbers by the name of their parameter.
REGRESSORS = np.dtype([(name, np.float64, (len(AXES),)) for name in TERM_NAMES])
_SLOWEST_RAD_S = 50.0
_NEWTON_STEPS_MAX = 80
_CONVERGED = 1e-15
# Rows of the numbers of the compiled function.
VALUES, REFERENCE = 0, 1
# Of the terms of a rotor, those along its axis come first, then its torque, then those in its plane.
_TORQUE, _IN_PLANE = TERM_INDEX["torque"], TERM_INDEX["rotor_drag"]


@njit(cache=True, nogil=True)
def add_physical(state: State, vehicle: VehicleNumbers, numbers: Array) -> None:
    """Fill hub velocities, thrusts, torques and wrench of a STATE from the rest of it."""
    motions, bodies = np.zeros(1, MOTION), np.zeros(1, PHYSICAL_VEHICLE)
    rows = np.zeros(1, REGRESSORS)
    motion, body, row = motions[0], bodies[0], rows[0]
    regressors = rows.view(np.float64)
    _set_sample(state, vehicle, numbers, motion, body)
    _set_hubs(state, vehicle)

    # Each rotor by itself, for the effects that scale thrusts and torques.
    lift, torque, mean_induced = 0.0, 0.0, 0.0
    for rotor in range(ROTORS):
        mean_induced += 0.25 * fill_rotor(rotor, motion, body, row)
        lift_so_far, torque_so_far = 0.0, 0.0
        for term in range(_TORQUE):
            lift_so_far -= numbers[VALUES, term] * regressors[6 * term + 2]
        for term in range(_TORQUE, _IN_PLANE):
            torque_so_far += numbers[VALUES, term] * regressors[6 * term + 5]
        state.thrusts[rotor], state.torques[rotor] = lift_so_far - lift, torque_so_far - torque
        lift, torque = lift_so_far, torque_so_far

    fill_body(mean_induced, motion, body, row)
    for axis in range(6):
        state.wrench[axis] = 0.0
    for term in range(numbers.shape[1]):
        for axis in range(6):
            state.wrench[axis] += numbers[VALUES, term] * regressors[6 * term + axis]


@njit(cache=True, nogil=True)
def _set_sample(state: State, vehicle: VehicleNumbers, numbers: Array, motion: Any, body: Any) -> None:
    """Set what the terms of a STATE follow from."""
    body.mass, body.reference_thrust = vehicle.mass, numbers[REFERENCE, 0]
    body.disc = 2.0 * vehicle.air_density * np.pi * vehicle.rotor_radius**2
    for axis in range(3):
        motion.velocity[axis], motion.rates[axis] = state.velocity_air[axis], state.rates[axis]
    for rotor in range(ROTORS):
        motion.rotor_speeds[rotor] = state.rotor_speeds[rotor]
        motion.rotor_accelerations[rotor] = state.rotor_accelerations[rotor]
        body.spins[rotor] = vehicle.rotor_spins[rotor]
        for axis in range(3):
            body.positions[rotor, axis] = vehicle.rotor_positions[rotor, axis]


@njit(cache=True, nogil=True)
def _set_hubs(state: State, vehicle: VehicleNumbers) -> None:
    p, q, r = state.rates[0], state.rates[1], state.rates[2]
    for rotor in range(ROTORS):
        place = vehicle.rotor_positions[rotor]
        state.hub_velocity[rotor, 0] = state.velocity_air[0] + q * place[2] - r * place[1]
        state.hub_velocity[rotor, 1] = state.velocity_air[1] + r * place[0] - p * place[2]
        state.hub_velocity[rotor, 2] = state.velocity_air[2] + p * place[1] - q * place[0]


@njit(cache=True, nogil=True)
def fill_body(mean_induced: float, motion: Any, vehicle: Any, row: Any) -> None:
    """Set the terms beside those of single rotors, for their mean induced velocity [m/s]."""
    p, q, r = motion.rates[0], motion.rates[1], motion.rates[2]
    mean_speed = 0.0
    for rotor in range(ROTORS):
        mean_speed += 0.25 * motion.rotor_speeds[rotor]
    _fill_airframe(mean_speed, mean_induced, motion, row)

    speed = np.sqrt(motion.velocity[0] ** 2 + motion.velocity[1] ** 2 + motion.velocity[2] ** 2)
    row.damping_p[3], row.damping_q[4], row.damping_r[5] = -p * speed, -q * speed, -r * speed
    row.inertia_x[3], row.inertia_y[4], row.inertia_z[5] = q * r, r * p, p * q
    row.bias_x[0], row.bias_y[1], row.bias_z[2] = 1.0, 1.0, 1.0
    row.bias_roll[3], row.bias_pitch[4], row.bias_yaw[5] = 1.0, 1.0, 1.0
    fill_imu(motion, vehicle.mass, row)


@njit(cache=True, nogil=True)
def fill_imu(motion: Any, m: float, row: Any) -> None:
    """Set the regressors of the position of the accelerometer, for a mass m [kg]."""
    p, q, r = motion.rates[0], motion.rates[1], motion.rates[2]
    # Acceleration of a point at d: α × d + Ω × (Ω × d).
    x, y, z = motion.angular_acceleration[0], motion.angular_acceleration[1], motion.angular_acceleration[2]
    row.imu_x[0], row.imu_x[1], row.imu_x[2] = -m * (q * q + r * r), m * (z + p * q), m * (p * r - y)
    row.imu_y[0], row.imu_y[1], row.imu_y[2] = m * (p * q - z), -m * (p * p + r * r), m * (x + q * r)
    row.imu_z[0], row.imu_z[1], row.imu_z[2] = m * (y + p * r), m * (q * r - x), -m * (p * p + q * q)


class _Hub(NamedTuple):
    """A rotor: place m, spin, speed rad/s, velocity and induced velocity m/s of the air there."""

    x: float
    y: float
    spin: float
    speed: float
    u: float
    v: float
    w: float
    induced: float


@njit(cache=True, nogil=True)
def fill_rotor(rotor: int, motion: Any, vehicle: Any, row: Any) -> float:
    """Add the terms of a rotor; returns its induced velocity [m/s]."""
    p, q, r = motion.rates[0], motion.rates[1], motion.rates[2]
    x, y, z = vehicle.positions[rotor, 0], vehicle.positions[rotor, 1], vehicle.positions[rotor, 2]
    spin, speed = vehicle.spins[rotor], motion.rotor_speeds[rotor]
    u = motion.velocity[0] + q * z - r * y
    v = motion.velocity[1] + r * x - p * z
    w = motion.velocity[2] + p * y - q * x
    h = np.sqrt(u * u + v * v)
    square = speed * speed
    turning = max(speed, _SLOWEST_RAD_S)
    hover = turning * np.sqrt(vehicle.reference_thrust / vehicle.disc)
    induced = solve_induced_velocity(h, w, hover)
    front, right = np.sign(x), np.sign(y)

    _thrust(row.thrust, x, y, square)
    _thrust(row.thrust_axial, x, y, speed * w)
    _thrust(row.thrust_induced, x, y, -speed * induced)
    _thrust(row.thrust_axial_square, x, y, w * abs(w))
    _thrust(row.thrust_in_plane, x, y, h * h)
    _thrust(row.thrust_advance, x, y, speed * h)
    _thrust(row.thrust_axial_in_plane, x, y, w * h)
    _thrust(row.thrust_axial_induced, x, y, w * induced)
    _thrust(row.thrust_axial_even, x, y, w * w)
    _thrust(row.thrust_in_plane_cubed, x, y, h * h * h / turning)
    _thrust(row.thrust_mixed_cubed, x, y, h * w * w / turning)
    _thrust(row.thrust_incline_x, x, y, speed * u)
    _thrust(row.thrust_incline_y, x, y, speed * v)
    _fill_unlike(rotor, x, y, spin * square, square, row)

    _arm(row.arm_thrust, x, y, square)
    row.arm_x[4] += x * square
    _arm(row.arm_axial, x, y, speed * w)
    _arm(row.arm_induced, x, y, -speed * induced)
    _arm(row.arm_in_plane, x, y, h * h)
    _arm(row.arm_advance, x, y, speed * h)
    _arm(row.arm_axial_in_plane, x, y, w * h)
    row.wake_x[2] -= front * speed * u
    row.wake_y[2] -= right * speed * v
    row.wake_axial_x[2] -= front * w * u
    row.wake_axial_y[2] -= right * w * v
    row.thrust_forward[2] -= speed * abs(u)
    row.thrust_sideways[2] -= speed * abs(v)
    _arm(row.wake_moment_x, x, y, front * speed * u)
    _arm(row.wake_moment_y, x, y, right * speed * v)

    hub = _Hub(x, y, spin, speed, u, v, w, induced)
    _fill_hub(hub, motion.rotor_accelerations[rotor], motion.rates, row)
    return induced


@njit(cache=True, nogil=True)
def _fill_unlike(rotor: int, x: float, y: float, turning: float, square: float, row: Any) -> None:
    """Add what rotors have more than the last: thrust by ω² and torque by s ω²."""
    if rotor == 0:
        _thrust(row.thrust_rotor_1, x, y, square)
        row.torque_rotor_1[5] -= turning
    elif rotor == 1:
        _thrust(row.thrust_rotor_2, x, y, square)
        row.torque_rotor_2[5] -= turning
    elif rotor == 2:
        _thrust(row.thrust_rotor_3, x, y, square)
        row.torque_rotor_3[5] -= turning
    else:
        _thrust(row.thrust_rotor_1, x, y, -square)
        _thrust(row.thrust_rotor_2, x, y, -square)
        _thrust(row.thrust_rotor_3, x, y, -square)
        row.torque_rotor_1[5] += turning
        row.torque_rotor_2[5] += turning
        row.torque_rotor_3[5] += turning


@njit(cache=True, nogil=True)
def _fill_hub(hub: _Hub, acceleration: float, rates: Array, row: Any) -> None:
    """Add torque, force in the plane and moments of the hub of a rotor."""
    x, y, spin, speed = hub.x, hub.y, hub.spin, hub.speed
    u, v, w, induced = hub.u, hub.v, hub.w, hub.induced
    h = np.sqrt(u * u + v * v)
    square = speed * speed
    # The air turns the body against the rotor.
    row.torque[5] -= spin * square
    row.torque_axial[5] -= spin * speed * w
    row.torque_induced[5] -= spin * speed * induced
    row.torque_advance[5] -= spin * speed * h

    _in_plane(row.rotor_drag, x, y, -speed * u, -speed * v)
    _in_plane(row.rotor_drag_advance, x, y, -h * u, -h * v)
    _in_plane(row.rotor_drag_axial, x, y, -w * u, -w * v)
    _in_plane(row.rotor_drag_induced, x, y, -induced * u, -induced * v)
    across_x, across_y = -spin * v, spin * u
    _in_plane(row.rotor_side, x, y, speed * across_x, speed * across_y)
    _in_plane(row.rotor_side_advance, x, y, h * across_x, h * across_y)
    _in_plane(row.rotor_side_axial, x, y, w * across_x, w * across_y)
    _in_plane(row.rotor_side_induced, x, y, induced * across_x, induced * across_y)

    _add(row.hub_height, speed * v, -speed * u)
    _add(row.hub_height_advance, h * v, -h * u)
    _add(row.hub_height_induced, induced * v, -induced * u)
    _add(row.hub_roll, spin * speed * u, spin * speed * v)
    _add(row.hub_roll_induced, spin * induced * u, spin * induced * v)

    row.incline_x[0] += square
    row.incline_y[1] += square
    row.gravity_centre_x[4] -= square
    row.gravity_centre_y[3] += square
    # What changes the angular momentum J s ω of the rotor about z is taken from the body.
    row.rotor_inertia_gyro[3] -= spin * speed * rates[1]
    row.rotor_inertia_gyro[4] += spin * speed * rates[0]
    row.rotor_inertia_spin[5] -= spin * acceleration


@njit(cache=True, nogil=True)
def _fill_airframe(mean_speed: float, induced: float, motion: Any, row: Any) -> None:
    u, v, w = motion.velocity[0], motion.velocity[1], motion.velocity[2]
    speed = np.sqrt(u * u + v * v + w * w)
    row.body_x_speed[0], row.body_y_speed[1] = -mean_speed * u, -mean_speed * v
    row.body_x_induced[0], row.body_y_induced[1] = -induced * u, -induced * v
    row.body_x_cross[0], row.body_y_cross[1] = -mean_speed * v, -mean_speed * u
    row.body_x_downwash[0], row.body_y_downwash[1] = induced * w, induced * w
    row.body_roll_downwash[3], row.body_pitch_downwash[4] = induced * w, induced * w
    row.drag_x[0], row.drag_y[1], row.drag_z[2] = -u * abs(u), -v * abs(v), -w * abs(w)
    row.drag_x_speed[0], row.drag_y_speed[1], row.drag_z_speed[2] = -u * speed, -v * speed, -w * speed
    row.lift_w_u[2], row.lift_w_v[2] = -w * abs(u), -w * abs(v)
    row.lift_x[0], row.lift_y[1] = u * w, v * w
    row.pitch_u[4], row.pitch_uw[4] = u * speed, u * w
    row.roll_v[3], row.roll_vw[3] = v * speed, v * w
    row.yaw_uv[5], row.yaw_v[5] = u * v, v * speed


@njit(cache=True, nogil=True)
def _thrust(term: Any, x: float, y: float, thrust: float) -> None:
    """Add a force along -z at (x, y)."""
    term[2] -= thrust
    _arm(term, x, y, thrust)


@njit(cache=True, nogil=True)
def _arm(term: Any, x: float, y: float, thrust: float) -> None:
    """Add the moments alone of a force along -z at (x, y)."""
    term[3] -= y * thrust
    term[4] += x * thrust


@njit(cache=True, nogil=True)
def _in_plane(term: Any, x: float, y: float, force_x: float, force_y: float) -> None:
    """Add a force in the rotor plane at (x, y), with its moment about z."""
    term[0] += force_x
    term[1] += force_y
    term[5] += x * force_y - y * force_x


@njit(cache=True, nogil=True)
def _add(term: Any, roll: float, pitch: float) -> None:
    term[3] += roll
    term[4] += pitch


@njit(cache=True)
def solve_induced_velocity(in_plane: float, through: float, hover: float) -> float:
    """Induced velocity m/s of momentum theory, from the velocity in the rotor plane and through it (Eq. 8).

    Solves v_in = v_h² / √((V cos α)² + (v_in − V sin α)²) with V cos α = √(u² + v²) and V sin α = w, in units
    of v_h. Where descent allows several roots, the largest is taken: it belongs to the working state of the
    rotor and joins hover without a jump.

    The start lies above the largest root, where the quartic rises and is convex, so Newton's method
    falls onto it; a bracket that shrinks with each sign guards the few cases with an inflection between.
    """
    a = (in_plane / hover) ** 2
    b = through / hover
    low = 0.0
    high = max(b, 0.0) + 1.0
    x = high
    for _ in range(_NEWTON_STEPS_MAX):
        excess = x * x * (a + (x - b) ** 2) - 1.0
        slope = 2.0 * x * (a + (x - b) * (2.0 * x - b))
        if excess > 0.0:
            high = x
        else:
            low = x
        newton = x - excess / slope if slope > 0.0 else low
        previous = x
        x = newton if low < newton <= high else 0.5 * (low + high)
        if abs(x - previous) <= _CONVERGED * x:
            break
    return x * hover
