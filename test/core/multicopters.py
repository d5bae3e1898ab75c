# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicles with other numbers of rotors than four, and flights of them in the simulation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import yaml

from quadpi_core.frames import Array
from quadpi_core.paths import config_directory
from quadpi_core.rotor_order import LAYOUTS, Motor
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.truth import STEP_HZ, Reference, Truth
from quadpi_core.vehicle import SPIN_SIGN, Vehicle


def multicopter_file(folder: Path, rotors: int) -> Path:
    """A vehicle file with the rotors of the Bebop 2 evenly on a circle; of six, two lie on the y axis."""
    bearings = np.pi * (2.0 * np.arange(rotors) + 1.0) / rotors
    motors = [Motor(math.cos(at), math.sin(at), 1.0 - 2.0 * (k % 2)) for k, at in enumerate(bearings)]
    return _file(folder / f"rotors_{rotors}.yaml", motors)


def framed_file(folder: Path, layout: str) -> Path:
    """A vehicle file with the rotors of the Bebop 2 as the motors of a standard frame."""
    return _file(folder / f"{layout}.yaml", LAYOUTS[layout])


def _file(path: Path, motors: Sequence[Motor]) -> Path:
    rotors, spins = len(motors), {sign: word for word, sign in SPIN_SIGN.items()}
    content = yaml.safe_load((config_directory() / "vehicles" / "bebop2.yaml").read_text())
    content["rotors"] = [
        {"position_m": [round(0.16 * m.x, 9) + 0.0, round(0.16 * m.y, 9) + 0.0, 0.0], "spin": spins[m.spin]}
        for m in motors
    ]
    content["mass_kg"] *= rotors / 4.0
    content["inertia_kg_m2"] = [0.0006 * rotors, 0.00055 * rotors, 0.0011 * rotors]
    path.write_text(yaml.safe_dump(content))
    return path


def multicopter(folder: Path, rotors: int) -> Vehicle:
    """The vehicle of such a file."""
    return Vehicle.load(multicopter_file(folder, rotors))


def swung(path: Path, seed: int, seconds: float) -> Truth:
    """A flight on a path of three sines, with roll, pitch, yaw and thrust excited."""
    time = np.arange(round(seconds * STEP_HZ) + 1) / STEP_HZ
    size, rate = np.array([2.0, 1.5, 0.6]), np.random.default_rng(seed).uniform(0.8, 1.6, 3)
    turns = np.outer(time, rate)
    reference = replace(
        Reference.hover(np.array([0.0, 0.0, -3.0]), len(time)),
        position=np.array([0.0, 0.0, -3.0]) + size * np.sin(turns),
        velocity=size * rate * np.cos(turns),
        acceleration=-size * rate * rate * np.sin(turns),
        tilt=np.stack((0.06 * np.sin(7.0 * time + seed), 0.06 * np.sin(9.0 * time + seed)), axis=1),
        thrust=0.1 * np.sin(5.0 * time + seed),
        yaw=0.5 * np.sin(0.7 * time),
        yaw_rate=0.35 * np.cos(0.7 * time),
    )
    return simulate_flight(f"flight {seed}", _simulated(path), reference, seed=seed)


@cache
def _simulated(path: Path) -> SimulatedVehicle:
    return SimulatedVehicle.load(path)


def measured(truth: Truth, seed: int) -> dict[str, Array]:
    """What sensors without delay would give of a flight, by the names of `Flights.from_arrays`."""
    rng, force = np.random.default_rng(seed), truth.wrench[:, :3] / truth.vehicle.mass_kg
    return {
        "velocity": truth.velocity,
        "attitude": truth.attitude,
        "rates": truth.rates + rng.normal(0.0, 0.01, truth.rates.shape),
        "specific_force": force + rng.normal(0.0, 0.1, force.shape),
        "rotor_speeds": truth.rotor_speeds + rng.normal(0.0, 1.0, truth.rotor_speeds.shape),
    }
