# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated flight whose every number is known: a circle."""

import numpy as np

from quadpi_core.frames import quaternion_from_roll_pitch_yaw, rotate_world_to_body
from quadpi_core.simulation.truth import Reference, Truth
from quadpi_core.vehicle import Vehicle

RADIUS, TURN_RATE, HEIGHT = 3.0, 2.0, 5.0
OFFSET = np.array([0.3, 0.0, -0.4])
PITCH = 0.2
TENTH = 100


def circle(name="circle", samples=1000):
    """Turns clockwise about the origin, nose ahead and 0.2 rad up, always half a metre from its reference."""
    vehicle = Vehicle.load("bebop2")
    time = np.arange(samples) / 100.0
    angle = TURN_RATE * time
    zero = np.zeros_like(time)
    position = np.stack((RADIUS * np.cos(angle), RADIUS * np.sin(angle), zero - HEIGHT), axis=1)
    velocity = RADIUS * TURN_RATE * np.stack((-np.sin(angle), np.cos(angle), zero), axis=1)
    yaw = angle + np.pi / 2
    attitude = quaternion_from_roll_pitch_yaw(np.stack((zero, zero + PITCH, yaw), axis=1))
    still = np.zeros((samples, 3))
    rotor_speeds = np.full((samples, 4), 900.0)
    rotor_speeds[:TENTH, 2] = vehicle.rotor_speed_max_rad_s
    return Truth(
        name=name,
        vehicle=vehicle,
        time_ns=np.round(1e9 * time).astype(np.int64),
        position=position,
        attitude=attitude,
        velocity=rotate_world_to_body(attitude, velocity),
        rates=still,
        acceleration=still,
        angular_acceleration=still,
        rotor_speeds=rotor_speeds,
        rotor_accelerations=np.zeros((samples, 4)),
        wrench=np.zeros((samples, 6)),
        wind=still,
        known_wind=None,
        reference=Reference(position + OFFSET, velocity, still, yaw, zero, np.zeros((samples, 2)), zero),
    )
