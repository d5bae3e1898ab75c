# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A controlled quadrotor as a rigid body with first-order motors, by fourth-order Runge-Kutta at 1 kHz.

The command is held and the wind is constant over a step. What is logged of an instant comes from one
evaluation of the equations of motion at that instant's state.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.linear_algebra import pseudo_inverse
from quadpi_core.records import PerRotor, Quaternion4, Records, Vector3, record_dtype
from quadpi_core.simulation.state_records import MEMORY, AddedEffect, Law, State, called_on
from quadpi_core.thresholds import CONVENTION, Threshold

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


def observe(controls: Controls, state: Records) -> None:
    """Update the disturbance: the wrench of a STATE (1,) less that of rotors in hover at its rotor speeds."""
    compiled.observe(controls, state)


def control(controls: Controls, motion: Records, demand: Demand, step: int) -> None:
    """Set the commanded rotor speeds for one step.

    Args:
        controls: see :class:`Controls`; its `command` is replaced.
        motion: record MOTION (1,) of the true state.
        demand: reference to follow.
        step: index of the instant.
    """
    compiled.control(controls, motion, demand, step)


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
MOTION, LOGGED = record_dtype(IntegratedMotion, 4), record_dtype(Logged, 4)


class Memory(NamedTuple):
    """The integrator's memory.

    Attributes:
        motions: records MOTION (6,): the state, a state ahead of it and the slopes of four stages.
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


def is_lost(motion: Records, position: Array) -> bool:
    """Whether the vehicle is upside down, spins, is below the ground, off its reference, or no number.

    Args:
        motion: record MOTION (1,).
        position: (3,) of the reference.
    """
    return compiled.is_lost(motion, position)
