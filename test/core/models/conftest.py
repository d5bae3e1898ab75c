# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Models made of ensembles with random weights."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.random_ensembles import random_ensembles, simulation_inputs
from benchmarks.synthetic_inputs import smooth_inputs
from quadpi_core.frames import Array
from quadpi_core.models.aerodynamic import AerodynamicModel, TrainingFlight
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.fitted_ensemble import FittedEnsembles
from quadpi_core.vehicle import Vehicle

VEHICLE = "neurobem"
METHOD_NAMES = ("bootstrap", "quality-driven")


def model_of(fitted: FittedEnsembles, X: Array) -> AerodynamicModel:
    """A model of axes that were fitted to X (N, 19)."""
    evidence = fitted.evaluate(X, np.ones(6))
    return AerodynamicModel(
        name="model",
        vehicle=VEHICLE,
        vehicle_fingerprint=Vehicle.load(VEHICLE).fingerprint,
        settings="default",
        cutoff_hz=30.0,
        confidence=0.95,
        fitted=fitted,
        envelope=Envelope.fit(X, np.zeros(len(X)), evidence.leverage, evidence.relative_width),
        training_range=dict.fromkeys(fitted.axes, 1.0),
        flights=(TrainingFlight("first", "ab" * 32, len(X)),),
        selection={axis: [] for axis in fitted.axes},
        held_out_coverage={axis: [] for axis in fitted.axes},
    )


@pytest.fixture(scope="session", name="X")
def input_vectors() -> Array:
    """Input vectors (1000, 19) as in flight."""
    return smooth_inputs(1000, seed=3, vehicle_name=VEHICLE)


@pytest.fixture(scope="session", params=METHOD_NAMES)
def fitted(request: pytest.FixtureRequest, X: Array) -> FittedEnsembles:
    """All six axes by each method."""
    return random_ensembles(request.param, X, simulation_inputs())


@pytest.fixture(scope="session")
def model(fitted: FittedEnsembles, X: Array) -> AerodynamicModel:
    return model_of(fitted, X)
