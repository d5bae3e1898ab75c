# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Leverage of a polynomial's regressors, and how much the errors on new flights grow with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from quadpi_core.frames import Array
from quadpi_core.models.rules import FlightErrors


@dataclass(frozen=True)
class LeveragedErrors:
    """Errors (N,) of a polynomial on one flight, its leverages (N,), and what lies inside the others."""

    error: Array
    leverage: Array
    inside: npt.NDArray[np.bool_]

    def spread(self, inflation: float) -> FlightErrors:
        """The errors beside the spread under an inflation."""
        return FlightErrors(self.error, spread_of(self.leverage, inflation), self.inside)


def fit_inflation(flights: Sequence[LeveragedErrors], highest: float) -> float:
    """κ, 1 to `highest`, that maximises the likelihood of held-out errors e ~ N(0, σ² (1 + κ h)).

    Flights weigh the same. Independent residuals of a true model would give κ = 1; correlation and a wrong
    model give hundreds.
    """

    def cost(log_inflation: float) -> float:
        growth = [1.0 + np.exp(log_inflation) * flight.leverage for flight in flights]
        variance = np.mean([np.mean(f.error**2 / g) for f, g in zip(flights, growth, strict=True)])
        return float(np.log(variance) + np.mean([np.mean(np.log(g)) for g in growth]))

    bounds = (0.0, float(np.log(max(highest, 1.0 + 1e-9))))
    return float(np.exp(minimize_scalar(cost, bounds=bounds, method="bounded").x))


def spread_of(leverage: Array, inflation: float) -> Array:
    """Shape (N,) of the interval over the inputs."""
    spread: Array = np.sqrt(1.0 + inflation * leverage)
    return spread


def leverage_of(regressors: Array, whitening: Array) -> Array:
    """Leverage h (N,) = |W z|² for each row z of the regressors (N, s)."""
    leverage: Array = np.square(regressors @ whitening.T).sum(axis=1)
    return leverage
