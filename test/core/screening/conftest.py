# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights of the bundled bags, as read."""

from __future__ import annotations

import pytest

from quadpi_core.flight import Recording
from quadpi_core.logs import read_recording
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle

RECORDINGS = ("train_2", "train_4")


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    """That flew them."""
    return Vehicle.load("bebop2")


@pytest.fixture(scope="session")
def flown(vehicle: Vehicle) -> dict[str, Recording]:
    """Two flights by name."""
    return {name: read_recording(bags_directory() / f"{name}.mcap", vehicle) for name in RECORDINGS}
