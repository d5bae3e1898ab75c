# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Hover at a station, sines along all axes, and commands to a vehicle that is held."""

import numpy as np

from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.state_records import LOGGED, Controls, Demand, Memory, Physics, fly
from quadpi_core.simulation.truth import STEP_HZ, Reference

STATION = np.array([0.0, 0.0, -3.0])


def sines(amplitude, frequency, seconds=12.0, turns=0.4):
    """Sines along three axes (m, Hz) that grow for 4 s, with slow turns of the nose."""
    time = np.arange(int(seconds * STEP_HZ) + 1) / STEP_HZ
    growth = np.clip(time / 4.0, 0.0, 1.0)
    growth = growth**3 * (10.0 - 15.0 * growth + 6.0 * growth**2)
    position = growth[:, None] * amplitude * np.sin(2.0 * np.pi * np.multiply.outer(time, frequency))
    velocity = np.gradient(position, 1.0 / STEP_HZ, axis=0)
    yaw = turns * growth * np.sin(2.0 * np.pi * 0.2 * time)
    return Reference(
        position=STATION + position,
        velocity=velocity,
        acceleration=np.gradient(velocity, 1.0 / STEP_HZ, axis=0),
        yaw=yaw,
        yaw_rate=np.gradient(yaw, 1.0 / STEP_HZ),
        tilt=np.zeros((len(time), 2)),
        thrust=np.zeros(len(time)),
    )


COUPLED = sines([2.0, 1.5, 0.6], [0.3, 0.23, 0.35])


def held_still(
    steps, *, acceleration=(0.0, 0.0, 0.0), yaw_rate=0.0, disturbance=(0.0,) * 6, aside=0.0, **motion
):
    """Commanded rotor speeds of a Bebop 2 too heavy to move, its motion, and how many steps it flew.

    Args:
        steps: number of them.
        acceleration, yaw_rate: demanded.
        disturbance: wrench that acts beside that of rotors in hover.
        aside: distance of the reference from the vehicle [m].
        motion: what is not as at rest in hover.
    """
    vehicle = SimulatedVehicle.load("bebop2")
    model, heavy = vehicle.aerodynamics, vehicle.record()
    heavy["mass"], heavy["gravity"], heavy["inverse_inertia"] = 1e15, 0.0, 0.0
    heavy["motor_time_constant"] = 0.005
    controls = Controls.from_nominal(vehicle.record(), model.effectiveness)
    level, still = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    memory = Memory.at(STATION, still, level, np.full(4, model.hover_rotor_speed), np.zeros(6))
    for name, value in motion.items():
        memory.motions[0][name] = value

    def wrench_of(state, _vehicle, _numbers):
        lift, *moments = model.effectiveness @ state.rotor_speeds[0, :4] ** 2
        state.wrench[0] = disturbance + np.array([0.0, 0.0, -lift, *moments])

    time = np.arange(steps + 1)[:, np.newaxis] / STEP_HZ
    none, zero = np.zeros((steps + 1, 3)), np.zeros(steps + 1)
    path = STATION + [aside, 0.0, 0.0] + time * memory.motions[0]["velocity"]
    tilt = np.zeros((steps + 1, 2))
    demand = Demand(path, none, none + acceleration, none, zero, zero + yaw_rate, tilt, zero, none)
    log, done = np.zeros(2, dtype=LOGGED), np.zeros(1, dtype=np.int64)
    fly(Physics(heavy, wrench_of, model.numbers, ()), controls, demand, memory, log, done)
    return controls.command.tolist(), memory.motions, int(done[0])
