# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""References that tests fly: hover at a station, and sines along all axes."""

import numpy as np

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
