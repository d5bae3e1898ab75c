# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A table that ensembles learn in a second, and regressors for them."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.models.regressors import Regressor

REGRESSORS = (Regressor.parse("u"), Regressor.parse("|v|*w"))
# Enough to learn the tables of these tests.
QUICK: dict[str, Any] = {"hidden": 10, "epochs": 25, "batch": 100, "fewest_steps": 40, "learning_rate": 5e-3}
FLIGHTS, SAMPLES = 6, 300


def noise(X: Array) -> Array:
    """Standard deviation (N,) of the target."""
    spread: Array = 0.05 + 0.2 * np.abs(X[:, 1])
    return spread


def table(seed: int, flights: int = FLIGHTS) -> tuple[Array, Array, Array]:
    """Inputs (N, 3), of which the last says nothing, targets and labels of flights; noise grows with |x₁|."""
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1.0, 1.0, size=(flights * SAMPLES, 3))
    y = 3.0 + np.sin(3.0 * X[:, 0]) + X[:, 1] ** 2 + noise(X) * rng.normal(size=len(X))
    return X, y, np.repeat(np.arange(flights), SAMPLES)
