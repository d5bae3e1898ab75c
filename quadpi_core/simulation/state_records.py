# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records that the compiled physics works on: the state at an instant, and the vehicle.

Body axes forward-right-down, world north-east-down with the ground at height 0, SI units. Rotors in the
order of the vehicle file.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np

from quadpi_core.core import compiled, pseudo_inverse
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.records import (
    CONVENTION,
    ROTORS_MAX,
    PerRotor,
    Quaternion4,
    Records,
    Threshold,
    Vector3,
    record_dtype,
)

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


# Name of a law of the core, or (state, vehicle, numbers): see `effect_definition` for what these are. One of
# the aerodynamics fills fields of the state, an effect gives six forces and moments.
Law: TypeAlias = str | Callable[..., Any]


class AddedEffect(NamedTuple):
    """An effect that acts in a flight.

    Attributes:
        law: gives its wrench.
        parameters: (P,) of the law, which a function of Python may change from call to call.
        shape: (14,) values of `effect_definition.SHAPE`.
    """

    law: Law
    parameters: Array
    shape: Array


_StateBlock = namedtuple("_StateBlock", STATE.names or ())  # type: ignore[misc]
_Vehicle = namedtuple("_Vehicle", VEHICLE.names or ())  # type: ignore[misc]


def block_of(states: Records, vehicle: Records) -> tuple[Any, Any]:
    """States (N,) and a vehicle (1,) as functions of Python take them: by field, the states' as views."""
    # Not records of numpy: to read an attribute of one takes longer than most of what effects compute.
    return _StateBlock._make(states[name] for name in STATE.names or ()), _Vehicle(*vehicle[0])


def called_on(law: Law, states: Records, vehicle: Records, numbers: Array) -> Law:
    """The law as the core calls it on states that change: a function without arguments, or a name."""
    return law if isinstance(law, str) else partial(law, *block_of(states, vehicle), numbers)


def apply_to_all(states: Records, vehicle: Records, law: Law, numbers: Array) -> None:
    """Fill states (N,) by a law of the aerodynamics, for a vehicle (1,)."""
    if isinstance(law, str):
        compiled.fill_aerodynamics(states, vehicle, law, numbers)
    else:
        law(*block_of(states, vehicle), numbers)


def six_columns(wrench: Any, count: int) -> Array:
    """Forces and moments (N, 6) of a function of Python.

    Raises:
        ValueError: unless there are six, each a number or one for each of `count` instants.
    """
    columns = np.empty((count, 6))
    try:
        for axis, values in zip(range(6), wrench, strict=True):
            columns[:, axis] = values
    except (TypeError, ValueError) as error:
        raise ValueError(compiled.NOT_SIX) from error
    return columns


# The command is held and the wind is constant over a step. What is logged of an instant comes from one
# evaluation of the equations of motion at that instant's state.

TILT_MAX_DEG = Threshold(
    "largest tilt of a path",
    compiled.TILT_MAX_DEG,
    "degrees",
    "a position error must not turn the vehicle over; excitation adds to it",
    CONVENTION,
)
SPECIFIC_FORCE_MIN = Threshold(
    "least upward specific force demanded",
    compiled.SPECIFIC_FORCE_MIN,
    "m/s²",
    "near zero the attitude of the thrust is undefined",
    CONVENTION,
)


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
        allocation: (rotors, 4) squares of the rotor speeds from thrust and moments.
        effectiveness: (4, rotors) whose inverse it is, of other numbers of rotors than four its
            pseudo-inverse.
        disturbance: (6,) wrench of the last instant less that of the rotors in hover.
        command: (rotors,) commanded rotor speeds [rad/s].
    """

    nominal: Records
    allocation: Array
    effectiveness: Array
    disturbance: Array
    command: Array

    @classmethod
    def from_nominal(cls, nominal: Records, effectiveness: Array) -> Controls:
        """For a nominal vehicle.

        Args:
            nominal: record VEHICLE (1,).
            effectiveness: (4, rotors) change of thrust and moments by the squared speed of each rotor, in
                hover.
        """
        hover, rotors = float(nominal[0]["hover_rotor_speed"]), effectiveness.shape[1]
        return cls(
            nominal=nominal,
            allocation=pseudo_inverse(effectiveness),
            effectiveness=effectiveness,
            disturbance=np.zeros(6),
            command=np.full(rotors, hover),
        )


class IntegratedMotion:
    """The integrated state, or its derivative; position and velocity in the world.

    `memory` is the state of an effect that has one of its own, see `effect_definition.Effect.at_rest`.
    """

    position: Vector3
    velocity: Vector3
    attitude: Quaternion4
    rates: Vector3
    memory: Annotated[Array, MEMORY]
    rotor_speeds: PerRotor


class Logged:
    """One logged instant; position and acceleration in the world, velocity and rates in body axes."""

    position: Vector3
    attitude: Quaternion4
    velocity: Vector3
    rates: Vector3
    acceleration: Vector3
    angular_acceleration: Vector3
    rotor_speeds: PerRotor
    rotor_accelerations: PerRotor
    wrench: Annotated[Array, 6]


# Of four rotors.
LOGGED = record_dtype(Logged, 4)


class Memory(NamedTuple):
    """The integrator's memory.

    Attributes:
        motions: (6,) :class:`IntegratedMotion`: the state, one ahead of it and the slopes of four stages.
        state: record STATE (1,), which effects read and add to.
    """

    motions: Records
    state: Records

    @classmethod
    def at(
        cls, position: Array, velocity: Array, attitude: Array, rotor_speeds: Array, at_rest: Array
    ) -> Memory:
        """The memory with an initial state, without rotation; `at_rest` (6,) is that of an effect."""
        rotors = len(rotor_speeds)
        motions = np.zeros(6, dtype=record_dtype(IntegratedMotion, rotors))
        motions[0]["position"], motions[0]["velocity"] = position, velocity
        motions[0]["attitude"], motions[0]["rotor_speeds"] = attitude, rotor_speeds
        motions[0]["memory"] = at_rest
        return cls(motions, np.zeros(1, dtype=record_dtype(State, rotors)))


class Physics(NamedTuple):
    """What acts on a vehicle in a flight.

    Attributes:
        vehicle: record VEHICLE (1,) as it flies.
        aerodynamics: law, see `simulated_aerodynamics.SimulatedAerodynamics.function`.
        numbers: parameters (K, P) of the aerodynamics.
        effects: effects, see `applied_effects.compose`.
    """

    vehicle: Records
    aerodynamics: Law
    numbers: Array
    effects: Sequence[AddedEffect]


_NO_RECOVERY = "a vehicle does not recover beyond it"
TILT_COSINE_MIN = Threshold(
    "least cosine of the tilt",
    compiled.TILT_COSINE_MIN,
    "that of 102 degrees",
    f"nearly upside down: {_NO_RECOVERY}",
    CONVENTION,
)
RATE_MAX_RAD_S = Threshold(
    "largest body rate",
    compiled.FLOWN_RATE_MAX_RAD_S,
    "rad/s",
    f"six times any reference: {_NO_RECOVERY}",
    CONVENTION,
)
POSITION_ERROR_MAX_M = Threshold(
    "largest distance from the reference",
    compiled.POSITION_ERROR_MAX_M,
    "m",
    f"far from any reference: {_NO_RECOVERY}",
    CONVENTION,
)


def fly(
    physics: Physics, controls: Controls, demand: Demand, memory: Memory, log: Records, done: Stamps
) -> None:
    """Fly until the demand ends, or until the vehicle is out of control or below the ground.

    Flights in several threads run at once, but for laws that are functions of Python: these are called four
    times in each step, one thread at a time, which takes twenty times as long or more.

    Args:
        physics: vehicle, aerodynamics and effects; one step lasts 1 / STEP_HZ.
        controls: parameters and memory of the controller.
        demand: N instants.
        memory: holds the initial state, and the last one at the end.
        log: records LOGGED (L,), filled with every (N - 1) / (L - 1)-th instant.
        done: (1,) number of steps flown so far; N - 1 at the end.
    """
    vehicle, state = physics.vehicle, memory.state
    compiled.fly(
        vehicle,
        called_on(physics.aerodynamics, state, vehicle, physics.numbers),
        physics.numbers,
        [one._replace(law=called_on(one.law, state, vehicle, one.parameters)) for one in physics.effects],
        controls,
        demand,
        memory.motions,
        state,
        log,
        done,
    )
