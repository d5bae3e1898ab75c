# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A controlled quadrotor as a rigid body with first-order motors, by fourth-order Runge-Kutta at 1 kHz.

The command is held and the wind is constant over a step. What is logged of an instant comes from one
evaluation of the equations of motion at that instant's state.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple, cast

import numpy as np
from numba import from_dtype, types

from quadpi_core import rotations
from quadpi_core.compiled import njit, once
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.records import Quaternion4, Records, Vector3, record_dtype
from quadpi_core.simulation.controller import Controls, Demand, control, observe
from quadpi_core.simulation.linear_algebra import cross, product3
from quadpi_core.simulation.state_records import (
    MEMORY,
    STATE,
    STATE_TYPE,
    VEHICLE_TYPE,
    State,
    VehicleNumbers,
)
from quadpi_core.simulation.truth import STEP_HZ
from quadpi_core.simulation.wrench_functions import FUNCTION_TYPE
from quadpi_core.thresholds import CONVENTION, Threshold
from quadpi_core.vehicle import ROTORS


class Motion:
    """The integrated state, or its derivative; position and velocity in the world.

    `memory` is the state of an effect that has one of its own, see `effect_definition.Effect.at_rest`.
    """

    position: Vector3
    velocity: Vector3
    attitude: Quaternion4
    rates: Vector3
    rotor_speeds: Annotated[Array, 4]
    memory: Annotated[Array, MEMORY]


class Logged:
    """One logged instant; position and acceleration in the world, velocity and rates in body axes."""

    position: Vector3
    attitude: Quaternion4
    velocity: Vector3
    rates: Vector3
    acceleration: Vector3
    angular_acceleration: Vector3
    rotor_speeds: Annotated[Array, 4]
    rotor_accelerations: Annotated[Array, 4]
    wrench: Annotated[Array, 6]


MOTION, LOGGED = record_dtype(Motion), record_dtype(Logged)


class Memory(NamedTuple):
    """The integrator's memory.

    Attributes:
        motions: records MOTION (6,): the state, a state ahead of it and the slopes of four stages.
        flat: the same memory as numbers (6, 23).
        state: record STATE (1,), which effects read and add to.
    """

    motions: Records
    flat: Array
    state: Records

    @classmethod
    def at(
        cls, position: Array, velocity: Array, attitude: Array, rotor_speeds: Array, at_rest: Array
    ) -> Memory:
        """The memory with an initial state, without rotation; `at_rest` (6,) is that of an effect."""
        motions = np.zeros(6, dtype=MOTION)
        motions[0]["position"], motions[0]["velocity"] = position, velocity
        motions[0]["attitude"], motions[0]["rotor_speeds"] = attitude, rotor_speeds
        motions[0]["memory"] = at_rest
        return cls(motions, motions.view(np.float64).reshape(len(motions), -1), np.zeros(1, dtype=STATE))


class PhysicsNumbers(NamedTuple):
    """What the compiled functions of a flight take.

    Attributes:
        vehicle: record VEHICLE (1,) as it flies.
        aerodynamics: parameters (K, P) of the aerodynamics.
        effects: parameters (L, Q) of the effects.
    """

    vehicle: Records
    aerodynamics: Array
    effects: Array


_NO_RECOVERY = "a vehicle does not recover beyond it"
TILT_COSINE_MIN = Threshold(
    "least cosine of the tilt", -0.2, "that of 102 degrees", f"nearly upside down: {_NO_RECOVERY}", CONVENTION
)
RATE_MAX_RAD_S = Threshold(
    "largest body rate", 40.0, "rad/s", f"six times any reference: {_NO_RECOVERY}", CONVENTION
)
POSITION_ERROR_MAX_M = Threshold(
    "largest distance from the reference", 10.0, "m", f"far from any reference: {_NO_RECOVERY}", CONVENTION
)
_COSINE, _RATE, _DISTANCE = TILT_COSINE_MIN.value, RATE_MAX_RAD_S.value, POSITION_ERROR_MAX_M.value


@njit(cache=True, nogil=True)
def fly(
    numbers: PhysicsNumbers,
    aerodynamics: Any,
    effects: Any,
    controls: Controls,
    demand: Demand,
    memory: Memory,
    log: Records,
    done: Stamps,
) -> None:
    """Fly until the demand ends, or until the vehicle is out of control or below the ground.

    Args:
        numbers: of vehicle, aerodynamics and effects; one step lasts 1 / STEP_HZ.
        aerodynamics: compiled, see `simulated_aerodynamics.SimulatedAerodynamics.function`.
        effects: compiled effects, see `applied_effects.compose`.
        controls: parameters and memory of the controller.
        demand: N instants.
        memory: holds the initial state, and the last one at the end.
        log: records LOGGED (L,), filled with every (N - 1) / (L - 1)-th instant.
        done: (1,) number of steps flown so far; N - 1 at the end.
    """
    motions, flat, state = memory.motions, memory.flat, memory.state
    steps = len(demand.yaw)
    every = (steps - 1) // (len(log) - 1)
    step = 1.0 / STEP_HZ
    motion = motions[0]
    _differentiate(
        motion, controls.command, demand.wind[0], numbers, aerodynamics, effects, state, motions[2]
    )
    observe(controls, state[0])
    for k in range(steps):
        control(controls, motion, demand, k)
        wind, command = demand.wind[k], controls.command
        _differentiate(motion, command, wind, numbers, aerodynamics, effects, state, motions[2])
        observe(controls, state[0])
        if k % every == 0:
            _record(motion, motions[2], state[0], log[k // every])
        done[0] = k
        if k == steps - 1 or is_lost(motion, demand.position[k]):
            return
        for stage in range(3):
            ahead = step if stage == 2 else 0.5 * step
            for j in range(flat.shape[1]):
                flat[1, j] = flat[0, j] + ahead * flat[2 + stage, j]
            _differentiate(
                motions[1], command, wind, numbers, aerodynamics, effects, state, motions[3 + stage]
            )
        for j in range(flat.shape[1]):
            flat[0, j] += step / 6.0 * (flat[2, j] + 2.0 * flat[3, j] + 2.0 * flat[4, j] + flat[5, j])
        _normalise(motion.attitude)


@once
def flight_kernel() -> Any:
    """:func:`fly`, compiled once and cached for every function that `wrench_functions.passable` gives.

    Without an explicit signature, numba would compile it again for each of these functions in each process.
    """
    series, vectors, named_tuple = types.float64[::1], types.float64[:, ::1], cast(Any, types.NamedTuple)
    vehicle, log = VEHICLE_TYPE[::1], from_dtype(LOGGED)[::1]
    controls = named_tuple((vehicle, vectors, vectors, series, series), Controls)
    demand = named_tuple(
        (vectors, vectors, vectors, vectors, series, series, vectors, series, vectors), Demand
    )
    memory = named_tuple((from_dtype(MOTION)[::1], vectors, STATE_TYPE[::1]), Memory)
    kernel = cast(Any, fly)
    numbers = named_tuple((vehicle, vectors, vectors), PhysicsNumbers)
    kernel.compile(
        types.void(numbers, FUNCTION_TYPE, FUNCTION_TYPE, controls, demand, memory, log, types.int64[::1])
    )
    kernel.disable_compile()
    return kernel


@njit(cache=True, nogil=True)
def _differentiate(
    motion: Motion,
    command: Array,
    wind: Array,
    numbers: PhysicsNumbers,
    aerodynamics: Any,
    effects: Any,
    states: Records,
    slope: Motion,
) -> None:
    """Equations of motion: m (v̇ − g) = R F, I Ω̇ = M − Ω × IΩ, q̇ = ½ q (0, Ω), ω̇ = (ω_c − ω)/τ."""
    vehicle: VehicleNumbers = numbers.vehicle[0]
    state: State = states[0]
    rotation = rotations.matrix(motion.attitude)
    for axis in range(3):
        slope.position[axis] = motion.velocity[axis]
        state.position[axis] = motion.position[axis]
        state.rates[axis] = motion.rates[axis]
        state.velocity_air[axis] = 0.0
        for world in range(3):
            state.velocity_air[axis] += rotation[world, axis] * (motion.velocity[world] - wind[world])
    for component in range(4):
        state.attitude[component] = motion.attitude[component]
    for rotor in range(ROTORS):
        lag = command[rotor] - motion.rotor_speeds[rotor]
        slope.rotor_speeds[rotor] = lag / vehicle.motor_time_constant
        state.rotor_speeds[rotor] = motion.rotor_speeds[rotor]
        state.rotor_accelerations[rotor] = slope.rotor_speeds[rotor]
    for number in range(MEMORY):
        state.memory[number] = motion.memory[number]
        state.memory_slope[number] = 0.0
    aerodynamics(state, vehicle, numbers.aerodynamics)
    for axis in range(6):
        state.aerodynamics[axis] = state.wrench[axis]
    effects(state, vehicle, numbers.effects)
    for number in range(MEMORY):
        slope.memory[number] = state.memory_slope[number]

    wrench = state.wrench
    for world in range(3):
        slope.velocity[world] = 0.0
        for axis in range(3):
            slope.velocity[world] += rotation[world, axis] * wrench[axis] / vehicle.mass
    slope.velocity[2] += vehicle.gravity
    precession = cross(motion.rates, product3(vehicle.inertia, motion.rates))
    moment = (wrench[3] - precession[0], wrench[4] - precession[1], wrench[5] - precession[2])
    slope.rates[0], slope.rates[1], slope.rates[2] = product3(vehicle.inverse_inertia, moment)
    p, q, r = motion.rates[0], motion.rates[1], motion.rates[2]
    w, x, y, z = motion.attitude[0], motion.attitude[1], motion.attitude[2], motion.attitude[3]
    slope.attitude[0] = 0.5 * (-x * p - y * q - z * r)
    slope.attitude[1] = 0.5 * (w * p + y * r - z * q)
    slope.attitude[2] = 0.5 * (w * q + z * p - x * r)
    slope.attitude[3] = 0.5 * (w * r + x * q - y * p)


@njit(cache=True, nogil=True)
def _record(motion: Motion, slope: Motion, state: State, row: Logged) -> None:
    rotation = rotations.matrix(motion.attitude)
    for axis in range(3):
        row.position[axis] = motion.position[axis]
        row.rates[axis] = motion.rates[axis]
        row.acceleration[axis] = slope.velocity[axis]
        row.angular_acceleration[axis] = slope.rates[axis]
        row.velocity[axis] = 0.0
        for world in range(3):
            row.velocity[axis] += rotation[world, axis] * motion.velocity[world]
    for component in range(4):
        row.attitude[component] = motion.attitude[component]
    for rotor in range(ROTORS):
        row.rotor_speeds[rotor] = motion.rotor_speeds[rotor]
        row.rotor_accelerations[rotor] = slope.rotor_speeds[rotor]
    for axis in range(6):
        row.wrench[axis] = state.wrench[axis]


@njit(cache=True, nogil=True)
def is_lost(motion: Motion, position: Array) -> bool:
    """Whether the vehicle is upside down, spins, is below the ground, off its reference, or no number."""
    cos_tilt = 1.0 - 2.0 * (motion.attitude[1] ** 2 + motion.attitude[2] ** 2)
    spin, error = 0.0, 0.0
    for axis in range(3):
        spin += motion.rates[axis] ** 2
        error += (motion.position[axis] - position[axis]) ** 2
    controlled = cos_tilt > _COSINE and spin < _RATE**2 and error < _DISTANCE**2
    return not controlled or motion.position[2] > 0.0


@njit(cache=True, nogil=True)
def _normalise(attitude: Array) -> None:
    norm = 0.0
    for component in range(4):
        norm += attitude[component] ** 2
    norm = np.sqrt(norm)
    for component in range(4):
        attitude[component] /= norm
