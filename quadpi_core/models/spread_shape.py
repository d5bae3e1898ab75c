# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How the intervals of models with a leverage widen over the inputs, fitted to errors on flights left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array
from quadpi_core.inputs import VELOCITY_INPUTS
from quadpi_core.models.interval_rules import FlightErrors, flights_peak

# Least and most that the variance due to airspeed can be on average, relative to that of a hover.
_LEAST_GROWTH, _MOST_GROWTH = 1e-6, 1e2
# Mean squared airspeed, m²/s², below which flights do not determine the growth with airspeed.
_HOVER = 0.01


@dataclass(frozen=True)
class SpreadShape:
    """Spread √(1 + κ h + γ V²) of leverage h and airspeed V: how errors on new flights grow.

    They grow with leverage, where the training samples constrain the coefficients poorly, and with airspeed,
    as the terms that the model lacks do, however many samples there were.

    Attributes:
        inflation: κ.
        growth: γ, s²/m².
    """

    inflation: float
    growth: float

    def of(self, leverage: Array, speed_squared: Array) -> Array:
        """Spread (N,) at leverages (N,) and squared airspeeds (N,) in m²/s²."""
        spread: Array = np.sqrt(1.0 + self.inflation * leverage + self.growth * speed_squared)
        return spread


@dataclass(frozen=True)
class PlacedErrors:
    """Errors of a model on one flight, and where they were made.

    Attributes:
        error: (N,).
        leverage: (N,).
        speed_squared: (N,) of the airspeed, m²/s².
        inside: (N,) whether every input lies in the range of the samples that the model was fitted to.
        others: leverage (M,) and squared airspeed (M,) of some samples of each flight that it was fitted to.
    """

    error: Array
    leverage: Array
    speed_squared: Array
    inside: npt.NDArray[np.bool_]
    others: Sequence[tuple[Array, Array]] = ()

    def under(self, shape: SpreadShape) -> FlightErrors:
        """The errors beside the spread of a shape."""
        spread = shape.of(self.leverage, self.speed_squared)
        if not self.others:
            return FlightErrors(self.error, spread, self.inside)
        return FlightErrors(
            self.error,
            spread,
            self.inside,
            width=spread / flights_peak(shape.of(*causes) for causes in self.others),
            leverage=self.leverage / flights_peak(leverage for leverage, _ in self.others),
        )


def fit_shape(flights: Sequence[PlacedErrors], most_inflation: float) -> SpreadShape:
    """κ, 1 to `most_inflation`, and γ that maximise the likelihood of held-out errors e ~ N(0, σ² spread²).

    Flights weigh the same. Independent residuals of a true model would give κ = 1 and γ = 0; correlation and
    a wrong model give hundreds, and a γ that doubles the variance at some speed of the flights.
    """
    squares = [np.square(flight.error) for flight in flights]
    if not any(np.any(square) for square in squares):
        return SpreadShape(1.0, 0.0)
    causes = [np.stack((flight.leverage, flight.speed_squared)) for flight in flights]
    typical = max(float(np.mean([np.mean(cause[1]) for cause in causes])), _HOVER)

    def cost(logs: Array) -> tuple[float, Array]:
        """Negative log-likelihood with the best σ, and its gradient, for logarithms of κ and γ."""
        weights = np.exp(logs)
        variances = [1.0 + weights @ cause for cause in causes]
        pairs = list(zip(squares, causes, variances, strict=True))
        scale = np.mean([np.mean(e / v) for e, _, v in pairs])
        pull = np.mean([c @ (e / v**2) / len(e) for e, c, v in pairs], axis=0) / scale
        push = np.mean([c @ (1.0 / v) / len(v) for _, c, v in pairs], axis=0)
        value = np.log(scale) + np.mean([np.mean(np.log(v)) for v in variances])
        return float(value), weights * (push - pull)

    bounds = np.log([(1.0, max(most_inflation, 1.0)), (_LEAST_GROWTH / typical, _MOST_GROWTH / typical)])
    low, high = bounds.T
    # From either cause alone, as the likelihood may have a maximum near each.
    starts = [(0.5 * (low[0] + high[0]), low[1]), (low[0], np.log(1.0 / typical))]
    from scipy.optimize import minimize  # here, as no model in flight needs it

    fits = [minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds) for start in starts]
    inflation, growth = np.exp(min(fits, key=lambda fit: fit.fun).x)
    return SpreadShape(float(inflation), float(growth))


def squared_speed(inputs: Array) -> Array:
    """Squared airspeed (N,), m²/s², of input vectors (N, 19)."""
    squared: Array = np.square(inputs[:, VELOCITY_INPUTS]).sum(axis=1)
    return squared


def leverage_of(regressors: Array, whitening: Array) -> Array:
    """Leverage h (N,) = |W z|² for each row z of the regressors (N, s)."""
    leverage: Array = np.square(regressors @ whitening.T).sum(axis=1)
    return leverage
