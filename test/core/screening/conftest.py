# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights of the bundled bags, as read, and an excerpt of a flight with sensors without a fault."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.flight import Recording
from quadpi_core.logs import read_recording
from quadpi_core.paths import bags_directory
from quadpi_core.screening.excerpt import STEP_S, Excerpt
from quadpi_core.vehicle import Vehicle

RECORDINGS = ("train_2", "train_4")
# Steps of STEP_S of an excerpt.
CELLS = 250


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    """That flew them."""
    return Vehicle.load("bebop2")


@pytest.fixture(scope="session")
def flown(vehicle: Vehicle) -> dict[str, Recording]:
    """Two flights by name."""
    return {name: read_recording(bags_directory() / f"{name}.mcap", vehicle) for name in RECORDINGS}


def excerpt_of(attitude: np.ndarray, position: np.ndarray, rates: np.ndarray, force: np.ndarray) -> Excerpt:
    """One window."""
    return Excerpt("mocap/pose", STEP_S, attitude[None], position[None], rates[None], force[None])


@pytest.fixture(scope="session")
def sound(true_flight) -> Excerpt:
    """What sensors without a fault see of a flight in all axes."""
    borders = STEP_S * np.arange(CELLS + 1)
    inside = STEP_S * (np.arange(CELLS)[:, None] + (np.arange(8) + 0.5) / 8.0)
    at, within = true_flight(borders), true_flight(inside.ravel())
    rates, force = (
        values.reshape(CELLS, 8, 3).mean(axis=1) for values in (within.rates, within.specific_force)
    )
    return excerpt_of(at.attitude, at.position, rates, force)
