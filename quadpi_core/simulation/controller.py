# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Position and yaw controller: geometric, with incremental dynamic inversion of thrust and moments.

Position and attitude errors give a demanded specific force and angular acceleration (geometric tracking
control of Lee, Leok and McClamroch, 2010, with feed-forward of the rates of the reference). The wrench of the
last instant less the rotors' hover thrust and torque, mainly drag, is a disturbance that is assumed constant
until the next step (incremental nonlinear dynamic inversion, Smeur et al., 2016). The controller knows mass,
inertia and hover coefficients of the nominal vehicle, and the true state.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from quadpi_core import rotations
from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.records import Records
from quadpi_core.simulation.linear_algebra import Vector, cross, inverse, product3
from quadpi_core.simulation.state_records import State, VehicleNumbers
from quadpi_core.thresholds import CONVENTION, Threshold
from quadpi_core.vehicle import ROTORS

# Gains of position [1/s²] and velocity [1/s] (damped at 0.9, settled in two seconds), of attitude [1/s] and
# of body rates [1/s], each faster than the one before. A test makes a bundled bag again byte for byte.
_POSITION_GAIN = 5.0
_VELOCITY_GAIN = 4.0
_TILT_GAIN = 8.0
_YAW_GAIN = 3.0
_RATE_GAIN = 18.0
_YAW_RATE_GAIN = 6.0
# The command leads the wanted rotor speed by this factor, to compensate the lag of a first-order motor.
_MOTOR_LEAD = 2.0
TILT_MAX_DEG = Threshold(
    "largest tilt of a path",
    65.0,
    "degrees",
    "a position error must not turn the vehicle over; excitation adds to it",
    CONVENTION,
)
SPECIFIC_FORCE_MIN = Threshold(
    "least upward specific force demanded",
    2.0,
    "m/s²",
    "near zero the attitude of the thrust is undefined",
    CONVENTION,
)
_TAN_TILT_MAX = math.tan(math.radians(TILT_MAX_DEG.value))
_LEAST_SPECIFIC_FORCE = SPECIFIC_FORCE_MIN.value


class Demand(NamedTuple):
    """The reference, its jerk (N, 3) m/s³, and the wind (N, 3) m/s in the world, at every step."""

    position: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    yaw: Array
    yaw_rate: Array
    tilt: Array
    thrust: Array
    wind: Array


class Controls(NamedTuple):
    """Parameters of the nominal vehicle, and memory of the controller.

    Attributes:
        nominal: record VEHICLE (1,).
        allocation: (4, 4) squares of the rotor speeds from thrust and moments.
        effectiveness: (4, 4) its inverse.
        disturbance: (6,) wrench of the last instant less that of the rotors in hover.
        command: (4,) commanded rotor speeds [rad/s].
    """

    nominal: Records
    allocation: Array
    effectiveness: Array
    disturbance: Array
    command: Array

    @classmethod
    def of(cls, nominal: Records, effectiveness: Array) -> Controls:
        """For a nominal vehicle.

        Args:
            nominal: record VEHICLE (1,).
            effectiveness: (4, 4) change of thrust and moments by the squared speed of each rotor, in hover.
        """
        return cls(
            nominal=nominal,
            allocation=inverse(effectiveness),
            effectiveness=effectiveness,
            disturbance=np.zeros(6),
            command=np.full(ROTORS, float(nominal[0]["hover_rotor_speed"])),
        )


@njit(cache=True, nogil=True)
def observe(controls: Controls, state: State) -> None:
    """Update the disturbance: the wrench less that of rotors in hover at the present rotor speeds.

    The torque of rotors that speed up ends with the command that caused it: as a disturbance, the next
    command would answer it, and the rotors would change their speed to and fro at every step.
    """
    rotor_speeds, wrench = state.rotor_speeds, state.wrench
    disturbance, effectiveness = controls.disturbance, controls.effectiveness
    vehicle: VehicleNumbers = controls.nominal[0]
    for axis in range(6):
        disturbance[axis] = wrench[axis]
    for rotor in range(ROTORS):
        square = rotor_speeds[rotor] ** 2
        disturbance[2] += effectiveness[0, rotor] * square
        for axis in range(3):
            disturbance[3 + axis] -= effectiveness[1 + axis, rotor] * square
        spin_up = vehicle.rotor_spins[rotor] * state.rotor_accelerations[rotor]
        disturbance[5] += vehicle.rotor_inertia * spin_up


@njit(cache=True, nogil=True)
def control(controls: Controls, motion: Any, demand: Demand, step: int) -> None:
    """Set the commanded rotor speeds for one step.

    Args:
        controls: see :class:`Controls`; its `command` is replaced.
        motion: record MOTION of the true state.
        demand: reference to follow.
        step: index of the instant.
    """
    vehicle: VehicleNumbers = controls.nominal[0]
    jerk, tilt, thrust = demand.jerk[step], demand.tilt[step], demand.thrust[step]
    rotation = rotations.matrix(motion.attitude)
    # Specific force of the rotors in the world: the demand less the disturbance.
    force = np.empty(3)
    for axis in range(3):
        force[axis] = (
            demand.acceleration[step, axis]
            + _VELOCITY_GAIN * (demand.velocity[step, axis] - motion.velocity[axis])
            + _POSITION_GAIN * (demand.position[step, axis] - motion.position[axis])
        )
        for body in range(3):
            force[axis] -= rotation[axis, body] * controls.disturbance[body] / vehicle.mass
    force[2] -= vehicle.gravity
    # Upward thrust has a tilt limit and never vanishes: the attitude would be undefined.
    horizontal = np.sqrt(force[0] ** 2 + force[1] ** 2)
    force[2] = min(force[2], -_LEAST_SPECIFIC_FORCE)
    limit = -force[2] * _TAN_TILT_MAX
    if horizontal > limit:
        force[0] *= limit / horizontal
        force[1] *= limit / horizontal

    target = _attitude_of(force, demand.yaw[step], tilt)
    along = 0.0
    for axis in range(3):
        along -= force[axis] * rotation[axis, 2]
    specific_thrust = max(along, _LEAST_SPECIFIC_FORCE) + thrust * vehicle.gravity

    # Rates of the target: from jerk (differential flatness) and the turn of the nose.
    rates = np.zeros(3)
    for axis in range(3):
        rates[0] += jerk[axis] * rotation[axis, 1] / specific_thrust
        rates[1] -= jerk[axis] * rotation[axis, 0] / specific_thrust
    # The nose stays in the vertical plane of the heading while the vehicle tilts.
    north, east = np.cos(demand.yaw[step]), np.sin(demand.yaw[step])
    ahead = rotation[0, 0] * north + rotation[1, 0] * east
    side = rotation[1, 1] * north - rotation[0, 1] * east
    tilted_side = rotation[1, 2] * north - rotation[0, 2] * east
    rates[2] = (demand.yaw_rate[step] * ahead + rates[1] * tilted_side) / max(side, 0.3)
    # Twice the attitude error: the vector of R_targetᵀ R − Rᵀ R_target, in body axes.
    error = np.zeros(3)
    for axis in range(3):
        error[0] += rotation[axis, 1] * target[axis, 2] - rotation[axis, 2] * target[axis, 1]
        error[1] += rotation[axis, 2] * target[axis, 0] - rotation[axis, 0] * target[axis, 2]
        error[2] += rotation[axis, 0] * target[axis, 1] - rotation[axis, 1] * target[axis, 0]
    turn = np.empty(3)
    for axis in range(3):
        attitude_gain = _TILT_GAIN if axis < 2 else _YAW_GAIN
        rate_gain = _RATE_GAIN if axis < 2 else _YAW_RATE_GAIN
        wanted = rates[axis] - 0.5 * attitude_gain * error[axis]
        turn[axis] = rate_gain * (wanted - motion.rates[axis])
    precession = cross(motion.rates, product3(vehicle.inertia, motion.rates))
    torque = product3(vehicle.inertia, turn)
    moments = (
        torque[0] + precession[0] - controls.disturbance[3],
        torque[1] + precession[1] - controls.disturbance[4],
        torque[2] + precession[2] - controls.disturbance[5],
    )
    _allocate(controls, motion.rotor_speeds, vehicle.mass * specific_thrust, moments)


@njit(cache=True, nogil=True)
def _attitude_of(force: Array, yaw: float, tilt: Array) -> Array:
    """Rotation (3, 3) whose -z points along a specific force (3,), nose near the yaw, then tilted."""
    size = np.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    z0, z1, z2 = -force[0] / size, -force[1] / size, -force[2] / size
    north, east = np.cos(yaw), np.sin(yaw)
    # x = side × z in the vertical plane of the heading, y = z × x.
    x0, x1, x2 = north * z2, east * z2, -east * z1 - north * z0
    size = np.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
    x0, x1, x2 = x0 / size, x1 / size, x2 / size
    target = np.empty((3, 3))
    target[0, 0], target[1, 0], target[2, 0] = x0, x1, x2
    target[0, 1], target[1, 1], target[2, 1] = z1 * x2 - z2 * x1, z2 * x0 - z0 * x2, z0 * x1 - z1 * x0
    target[0, 2], target[1, 2], target[2, 2] = z0, z1, z2
    if tilt[0] == 0.0 and tilt[1] == 0.0:
        return target
    cos_roll, sin_roll = np.cos(tilt[0]), np.sin(tilt[0])
    cos_pitch, sin_pitch = np.cos(tilt[1]), np.sin(tilt[1])
    tilted = np.empty((3, 3))
    for axis in range(3):
        x, y, z = target[axis, 0], target[axis, 1], target[axis, 2]
        pitched_z = sin_pitch * x + cos_pitch * z
        tilted[axis, 0] = cos_pitch * x - sin_pitch * z
        tilted[axis, 1] = cos_roll * y + sin_roll * pitched_z
        tilted[axis, 2] = cos_roll * pitched_z - sin_roll * y
    return tilted


@njit(cache=True, nogil=True)
def _allocate(controls: Controls, rotor_speeds: Array, thrust: float, moments: Vector) -> None:
    """Command rotor speeds for thrust and moments; where they saturate, yaw gives way first, then thrust."""
    fastest = controls.nominal[0].rotor_speed_max
    largest = fastest**2
    lift, turn = np.empty(ROTORS), np.empty(ROTORS)
    for rotor in range(ROTORS):
        row = controls.allocation[rotor]
        lift[rotor] = row[0] * thrust + row[1] * moments[0] + row[2] * moments[1]
        turn[rotor] = row[3] * moments[2]
    excess = lift.max() - largest
    if excess > 0.0:
        lift -= min(excess, max(lift.min(), 0.0))
    share = 1.0
    for rotor in range(ROTORS):
        if turn[rotor] != 0.0:
            bound = largest if turn[rotor] > 0.0 else 0.0
            share = min(share, max(0.0, (bound - lift[rotor]) / turn[rotor]))
    for rotor in range(ROTORS):
        square = lift[rotor] + share * turn[rotor]
        wanted = np.sqrt(min(max(square, 0.0), largest))
        led = rotor_speeds[rotor] + _MOTOR_LEAD * (wanted - rotor_speeds[rotor])
        controls.command[rotor] = min(max(led, 0.0), fastest)
