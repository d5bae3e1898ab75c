# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fits of one axis to tables that are learned in a second."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import DERIVATIVES, INPUT_NAMES
from quadpi_core.models.model_kind import Fit, Fitted, IdentifyOptions, Kind, TrainingSamples
from quadpi_core.models.regressors import CandidatePool, Regressor
from quadpi_core.parallel import ignore_progress
from quadpi_core.vehicle import Vehicle

AXIS = "Fz"
REGRESSORS = (Regressor.parse("u"), Regressor.parse("|v|*w"))
# For networks, all that the tables have.
COLUMNS = CandidatePool((), (), tuple(map(Regressor.parse, "uvw")))
# Enough to learn the tables of these tests.
QUICK: dict[str, Any] = {"hidden": 10, "epochs": 25, "batch": 100, "fewest_steps": 40, "learning_rate": 5e-3}
FLIGHTS, SAMPLES = 6, 300


def noise(X: Array) -> Array:
    """Standard deviation (N,) of the target."""
    spread: Array = 0.05 + 0.2 * np.abs(X[:, 1])
    return spread


def input_vectors(columns: Array) -> Array:
    """Input vectors (N, 19) whose first columns are these; zero beyond."""
    return np.pad(columns, ((0, 0), (0, len(INPUT_NAMES) - columns.shape[1])))


def table(seed: int, flights: int = FLIGHTS) -> tuple[Array, Array, npt.NDArray[np.int64]]:
    """Inputs, of which the third says nothing, targets and flights; noise grows with |v|."""
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1.0, 1.0, size=(flights * SAMPLES, 3))
    y = 3.0 + np.sin(3.0 * X[:, 0]) + X[:, 1] ** 2 + noise(X) * rng.normal(size=len(X))
    return input_vectors(X), y, np.repeat(np.arange(flights), SAMPLES)


def samples_of(X: Array, y: Array, flights: npt.NDArray[np.int64]) -> TrainingSamples:
    """Samples of some flights with the target on one axis."""
    wrench = np.zeros((len(X), len(AXES)))
    wrench[:, AXES.index(AXIS)] = y
    still = np.zeros(len(X), DERIVATIVES)
    return TrainingSamples(Vehicle.load("bebop2"), np.arange(len(X)) / 100.0, X, still, wrench, flights, [])


def fit(
    kind: Kind,
    X: Array,
    y: Array,
    flights: npt.NDArray[np.int64],
    pool: CandidatePool = COLUMNS,
    **options: Any,
) -> Fit:
    """One axis fitted to a table."""
    return kind.fit(samples_of(X, y, flights), {AXIS: pool}, IdentifyOptions(**options), ignore_progress)


def axis_of(fit: Fit) -> Any:
    """What was fitted of the axis."""
    return fit.fitted.axes[AXIS]


def interval(fitted: Fitted, X: Array, confidence: float = 0.95) -> tuple[Array, Array]:
    """Lower and upper bounds (N,) of the one axis of a model."""
    (axis,) = fitted.axes
    evaluation, k = fitted.evaluate(X, fitted.factors(confidence)), AXES.index(axis)
    return evaluation.lower[:, k], evaluation.upper[:, k]


def prediction(fitted: Fitted, X: Array) -> Array:
    """Predictions (N,) of the one axis of a model."""
    (axis,) = fitted.axes
    predicted: Array = fitted.evaluate(X, np.zeros(len(AXES))).predicted[:, AXES.index(axis)]
    return predicted


def spread(fitted: Fitted, X: Array) -> Array:
    """Spread (N,) of the one axis of a model."""
    (axis,) = fitted.axes
    evaluation, k = fitted.evaluate(X, np.ones(len(AXES))), AXES.index(axis)
    half: Array = 0.5 * (evaluation.upper - evaluation.lower)[:, k]
    return half
