# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights of the bundled bags and a model of them, as researchers load and fit them."""

from __future__ import annotations

import pytest

import quadpi_core as qp
from quadpi_core.paths import bags_directory


@pytest.fixture(scope="session")
def training() -> qp.Flights:
    """The four flights that models are identified on."""
    return qp.load_flights(f"{bags_directory()}/train_*.mcap", vehicle="bebop2")


@pytest.fixture(scope="session")
def unseen() -> qp.Flights:
    """A flight of the same kind."""
    return qp.load_flights(bags_directory() / "interpolation.mcap", "bebop2")


@pytest.fixture(scope="session")
def quick(training) -> qp.WrenchModel:
    """A polynomial of two axes, which takes a second."""
    return qp.WrenchModel(estimator="polynomial", axes=["Fx", "Fz"]).fit(training)
