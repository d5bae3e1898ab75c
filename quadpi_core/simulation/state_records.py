# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records that the compiled physics works on: the state at an instant, and the vehicle.

Body axes forward-right-down, world north-east-down with the ground at height 0, SI units. Rotors in the
order of the vehicle file.
"""

from __future__ import annotations

from typing import Annotated

from quadpi_core.frames import Array
from quadpi_core.records import ROTORS_MAX, PerRotor, Quaternion4, Vector3, record_dtype

# Numbers that an effect may keep as a state of its own.
MEMORY = 6


class State:
    """State at an instant, with what the aerodynamics add to it.

    Attributes:
        position: m, world.
        attitude: body to world.
        velocity_air: m/s relative to the air, body axes.
        rates: rad/s, body axes.
        rotor_speeds: rad/s.
        rotor_accelerations: rad/s².
        hub_velocity: m/s of each rotor's hub relative to the air, body axes.
        thrusts: N of each rotor along -z, of the aerodynamics alone.
        torques: Nm of each rotor on the body about z, of the aerodynamics alone.
        aerodynamics: N and Nm of the aerodynamics alone.
        wrench: N and Nm of the aerodynamics and of the effects applied so far.
        force_is_measured: 1 where the force of `wrench` is the measured one, which every effect is already
            part of; else 0.
        memory, memory_slope: state of an effect that has one of its own, such as the swing of a load, and its
            derivative in time, which the effect fills.
    """

    position: Vector3
    attitude: Quaternion4
    velocity_air: Vector3
    rates: Vector3
    rotor_speeds: PerRotor
    rotor_accelerations: PerRotor
    hub_velocity: Annotated[Array, ROTORS_MAX, 3]
    thrusts: PerRotor
    torques: PerRotor
    aerodynamics: Annotated[Array, 6]
    wrench: Annotated[Array, 6]
    force_is_measured: float
    memory: Annotated[Array, MEMORY]
    memory_slope: Annotated[Array, MEMORY]


class VehicleNumbers:
    """A vehicle and its rotor-local aerodynamics, see `rotor_local`.

    Attributes:
        rotors: their number.
        rotor_spins: +1 where the rotor turns clockwise seen from above.
        hover_induced_velocity, hover_rotor_speed: m/s and rad/s in hover, of the vehicle as in its file.
        motor_time_constant: s.
        rotor_speed_max: rad/s.
        rotor_inertia: kg m², of a rotor whose torque while it speeds up is part of the aerodynamics; else 0.
    """

    mass: float
    gravity: float
    air_density: float
    inertia: Annotated[Array, 3, 3]
    inverse_inertia: Annotated[Array, 3, 3]
    rotors: int
    rotor_positions: Annotated[Array, ROTORS_MAX, 3]
    rotor_spins: PerRotor
    rotor_radius: float
    hover_induced_velocity: float
    hover_rotor_speed: float
    motor_time_constant: float
    rotor_speed_max: float
    rotor_inertia: float
    thrust: Annotated[Array, 16]
    torque: Annotated[Array, 16]
    rotor_force_along: float
    rotor_force_across: float
    rotor_moment_along: float
    rotor_moment_across: float
    airframe_area: float
    airframe_fx: Annotated[Array, 2]
    airframe_fy: Annotated[Array, 2]
    airframe_fz: Annotated[Array, 2]
    airframe_mx: Annotated[Array, 6]
    airframe_my: Annotated[Array, 6]
    airframe_mz: Annotated[Array, 6]


# Of four rotors.
STATE, VEHICLE = record_dtype(State, 4), record_dtype(VehicleNumbers, 4)
