# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated flights in wind and gusts, logged as PX4 logs by default, whose drag over mass is known."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from scipy.signal import lfilter

from quadpi_core.field.field_log import FieldLog, Series
from quadpi_core.frames import (
    Array,
    from_rotation_vector,
    products,
    rotate_body_to_world,
    rotate_world_to_body,
)
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.simulated_bags import fly_plan

VEHICLE = "bebop2"


class Windy(NamedTuple):
    """A log, and what is true of it: drag over mass along x and y in 1/s, mean wind (2,) in m/s."""

    log: FieldLog
    drag: Array
    wind: Array


def windy_flight(folder: Path, seed: int, *, duration_s: float = 60.0, speed: float = 5.0) -> Windy:
    """One flight to and fro in x and y, with turns, in wind from anywhere and gusts of 0.5 to 1.5 m/s."""
    rng = np.random.default_rng(seed)
    heading, blows = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 5.0)
    wind = {"north_m_s": float(blows * np.cos(heading)), "east_m_s": float(blows * np.sin(heading))}
    gust = {"intensity_m_s": float(rng.uniform(0.5, 1.5)), "time_s": float(rng.uniform(1.0, 4.0))}
    motion = {axis: [{"sine": _sine(rng, duration_s, "m", speed)}] for axis in ("x", "y")}
    motion["yaw"] = [{"sine": _sine(rng, duration_s, "deg", float(rng.uniform(10.0, 40.0)))}]
    scenario = folder / f"windy{seed}.yaml"
    content = {
        **{
            "description": "wind",
            "vehicle": VEHICLE,
            "seed": seed,
            "duration_s": duration_s,
            "height_m": 20.0,
        },
        "flights": {f"windy{seed}": {"motion": motion, "effects": {"wind": wind, "gust": gust}}},
    }
    scenario.write_text(yaml.safe_dump(content))
    truth = fly_plan(load_scenario(scenario).flights[0], SimulatedVehicle.load(VEHICLE))
    time = truth.time
    over_ground = rotate_body_to_world(truth.attitude, truth.velocity)
    force = truth.specific_force
    # Samples of IMU, attitude and velocity at 200, 20 and 10 Hz, with the errors of an autopilot's.
    bias, lean = rng.normal(0.0, 0.1, 3), rng.normal(0.0, 0.01, 2)
    read = force + bias + rng.normal(0.0, 0.5, force.shape)
    read[:, :2] += lean * (force[:, 2:] + 9.81)
    imu = Series(time, np.hstack([truth.rates, read]))
    tilt = from_rotation_vector(_slow(rng, time, 0.015, 5.0, 3))
    attitude = Series(time, products(truth.attitude, tilt))
    velocity = Series(
        time, over_ground + _slow(rng, time, 0.1, 3.0, 3) + rng.normal(0.0, 0.03, over_ground.shape)
    )
    log = FieldLog(
        name=f"windy{seed}",
        source=f"windy{seed}",
        stack="simulation",
        imu=_every(imu, 200.0),
        attitude=_every(attitude, 20.0),
        velocity=_every(velocity, 10.0),
        position=_every(Series(time, truth.position), 10.0),
    )
    # The drag that fits best at the airspeeds flown.
    air = rotate_world_to_body(truth.attitude, over_ground - truth.wind)[:, :2]
    drag: Array = -np.sum(air * force[:, :2], axis=0) / np.sum(air**2, axis=0)
    return Windy(log, drag, truth.wind.mean(axis=0)[:2])


def _sine(rng: np.random.Generator, duration_s: float, unit: str, fastest: float) -> dict[str, float]:
    frequency = float(rng.uniform(0.05, 0.12))
    amplitude = float(rng.uniform(0.6, 1.0)) * fastest / (2.0 * np.pi * frequency)
    return {
        f"amplitude_{unit}": amplitude,
        "frequency_hz": frequency,
        "phase_deg": float(rng.uniform(0.0, 360.0)),
        "start_s": 1.0,
        "duration_s": duration_s - 2.0,
        "fade_s": 5.0,
    }


def _slow(rng: np.random.Generator, time: Array, deviation: float, constant_s: float, count: int) -> Array:
    """Coloured noise (N, count), as an estimator's errors are."""
    keep = np.exp(-(time[1] - time[0]) / constant_s)
    values = rng.normal(0.0, deviation, (len(time), count))
    values[1:] *= np.sqrt(1.0 - keep**2)
    slow: Array = lfilter([1.0], [1.0, -keep], values, axis=0)
    return slow


def _every(series: Series, rate_hz: float) -> Series:
    step = max(1, round(series.rate_hz / rate_hz))
    return Series(series.time[::step], series.values[::step])
