# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights by formulas, as field logs and as small files of flight stacks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from quadpi_core.field.field_log import FieldLog, Series
from quadpi_core.frames import Array

SECONDS, AIRBORNE = 60.0, (5.0, 55.0)
HOVER, DRAG, LAG_S, DEAD_S = 0.4, (0.3, 0.2), 0.05, 0.008
RATE_HZ = 200.0


def example(seed: int = 1, **changes: Any) -> FieldLog:
    """A minute: five seconds on the ground at idle, to and fro along x and y with climbs, and down again.

    Thrust is weight times (command / HOVER)². Rotor speed is 300 + 1 500 u + 80 (V − 15) rad/s, lagged.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    aloft = (time >= AIRBORNE[0]) & (time < AIRBORNE[1])
    load = np.where(aloft, HOVER * (1.0 + 0.1 * np.sin(2.0 * np.pi * 0.4 * time)), 0.05)
    commands = load[:, np.newaxis] + np.where(aloft, 0.02, 0.0)[:, np.newaxis] * _wiggles(time)
    volts = 16.0 - 0.02 * time
    speed = 4.0 * np.stack([np.sin(0.5 * time), np.sin(0.31 * time), 0.0 * time], axis=1)
    velocity = np.where(aloft[:, np.newaxis], speed, 0.0)
    thrust = np.where(aloft, np.mean(commands**2, axis=1) / HOVER**2, 1.0)
    force = np.column_stack([-DRAG[0] * velocity[:, 0], -DRAG[1] * velocity[:, 1], -9.80665 * thrust])
    force += rng.normal(0.0, 0.1, force.shape)
    rates = np.where(aloft[:, np.newaxis], 0.2 * np.sin(3.0 * time)[:, np.newaxis], 0.0) * np.ones(3)
    level = np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1))
    log = FieldLog(
        name="example",
        source="example.log",
        stack="PX4",
        frame="quadcopter",
        rotors=4,
        imu=Series(time, np.hstack([rates, force])),
        attitude=Series(time[::10], level[::10]),
        velocity=Series(time[::20], velocity[::20]),
        position=Series(time[::20], np.cumsum(velocity, axis=0)[::20] / RATE_HZ),
        commands=Series(time, commands),
        rotor_speeds=Series(time, speeds_of(commands, volts)),
        battery=Series(time[::200], volts[::200, np.newaxis]),
    )
    return replace(log, **changes)


def speeds_of(commands: Array, volts: Array) -> Array:
    """Rotor speeds (N, R) of commands (N, R)."""
    late = np.vstack([np.tile(commands[0], (round(DEAD_S * RATE_HZ), 1)), commands])[: len(commands)]
    settled = 300.0 + 1500.0 * late + 80.0 * (volts[:, np.newaxis] - 15.0)
    keep = np.exp(-1.0 / (RATE_HZ * LAG_S))
    lagged: Array = lfilter([1.0 - keep], [1.0, -keep], settled, axis=0, zi=keep * settled[:1])[0]
    return lagged


def _wiggles(time: Array) -> Array:
    return np.stack([np.sin(2.0 * np.pi * (0.7 + 0.3 * rotor) * time) for rotor in range(4)], axis=1)
