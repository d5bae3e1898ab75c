# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings whose state is as that of GPS and an autopilot, made of what motion capture told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core import frames
from quadpi_core.flight import Flight, OdometryStream, Recording


def state_by_gps(
    recording: Recording,
    full: Flight,
    rng: np.random.Generator,
    errors: np.ndarray,
    rate_hz: float = 5.0,
    deviation: object = None,
) -> Recording:
    """A state in the place of motion capture.

    Args:
        recording: of the flight.
        full: the flight by motion capture.
        rng: draws the errors.
        errors: standard deviations of position m, attitude rad, velocity m/s.
        rate_hz: of the state.
        deviation: what its messages say of the errors; these unless given.
    """
    rows = np.arange(0, len(full), round(full.rate_hz / rate_hz))
    tilt = frames.from_rotation_vector(rng.normal(0.0, errors[1], (len(rows), 3)))
    attitude = frames.products(full.attitude[rows], tilt)
    velocity = frames.rotate_body_to_world(full.attitude[rows], full.velocity[rows])
    velocity += rng.normal(0.0, errors[2], velocity.shape)
    stated = errors if deviation is None else deviation
    state = OdometryStream(
        full.stamps_ns[rows],
        full.position[rows] + rng.normal(0.0, errors[0], (len(rows), 3)),
        attitude,
        frames.rotate_world_to_body(attitude, velocity),
        full.rates[rows],
        np.broadcast_to(stated, (len(rows), 3)).astype(float),
    )
    return replace(recording, pose=None, odometry=state, arrivals={})
