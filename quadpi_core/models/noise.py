# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How wide an interval around a polynomial prediction must be.

An interval is ŷ ± factor(confidence) · √(1 + inflation · h) with the leverage h = z (ZᵀZ)⁻¹ zᵀ.
:class:`ResidualNoise` is the paper's textbook rule, :class:`HeldOutNoise` the default.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar
from scipy.stats import t as student_t

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array

# Share of new flights whose coverage should reach the nominal one, given enough flights to tell.
FLIGHT_SHARE = 0.9
# Least share of a flight inside the envelope of the others for its held-out errors to count: the corner of a
# flight that the others happen to touch is no sample of flying inside the envelope.
FEWEST_INSIDE = 0.5
# Confidence levels at which the held-out flights' quantiles are stored.
LEVELS: Array = np.concatenate((np.arange(0.50, 0.99, 0.01), np.arange(0.99, 0.9991, 0.001)))


@dataclass(frozen=True)
class ResidualNoise:
    """Noise from the training residuals, taken as independent (van Beers and de Visser, Eq. 13, 16, 17)."""

    std: float
    freedom: float

    inflation = 1.0

    def factor(self, confidence: float) -> float:
        """Half width at zero leverage."""
        _check_confidence(confidence, 1.0)
        return self.std * float(student_t.ppf(0.5 + confidence / 2.0, self.freedom))

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, as stored with a model."""
        return {"kind": "residual", "std": self.std, "freedom": self.freedom}


@dataclass(frozen=True)
class HeldOutNoise:
    """Noise from flights that the coefficients and the terms never saw, each left out in turn.

    Residuals of flight data are autocorrelated, so neither their training variance nor N − p degrees of
    freedom say how wide an honest interval is. The exchangeable unit is the flight: per flight, the quantile
    of |error| / √(1 + inflation · h) is an interval factor that would have covered that flight. Of the F
    flights' factors the ⌈0.9 (F + 1)⌉-th smallest is used, or the largest while F is too small for that
    rank (split conformal prediction by group).

    Only errors inside the envelope of the other flights, where every input lies in their range, count for
    the factor, and only of flights that lie mostly inside. Outside, the interval widens by the leverage,
    and the alarm, not the interval, is what to go by. A flight's factor also covers its errors in the
    final fit, whose leverage is smaller than that of the model without the flight.

    Attributes:
        inflation: weight κ of the leverage, by which errors on held-out flights grow away from the training
            data: maximum likelihood of e ~ N(0, σ² (1 + κ h)), flights weighing the same. Independent
            residuals of a true model would give κ = 1; correlation and a wrong model give hundreds.
        flight_factors: (F, len(LEVELS)), each flight's own, at the confidence :data:`LEVELS`.
        flights_inside: how many flights lie mostly inside the envelope of the others, so that their errors
            count; 0 means that the factors rest on the training residuals alone.
    """

    inflation: float
    flight_factors: Array
    flights_inside: int

    def factor(self, confidence: float) -> float:
        """Half width at zero leverage."""
        _check_confidence(confidence, float(LEVELS[-1]))
        return _ranked_factor(self.flight_factors, confidence)

    def held_out_coverage(self, held_out: Sequence[FlightErrors], confidence: float) -> Array:
        """Share (F,) of each flight's errors, when it was left out, that the others' factors cover.

        Outside the envelope of the others too: what a flight unlike them can expect.
        """
        factors = [
            _ranked_factor(np.delete(self.flight_factors, k, axis=0), confidence)
            for k in range(len(held_out))
        ]
        return np.array(
            [
                np.mean(flight.scores(self.inflation) <= factor)
                for flight, factor in zip(held_out, factors, strict=True)
            ]
        )

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, as stored with a model."""
        return {
            "kind": "held-out",
            "inflation": self.inflation,
            "flight_factors": self.flight_factors.tolist(),
            "flights_inside": self.flights_inside,
        }


def noise_from_json(data: dict[str, Any]) -> ResidualNoise | HeldOutNoise:
    """Read what `to_json` gave.

    Raises:
        ModelError: for an unknown kind, or numbers that no fit gives.
        KeyError, TypeError, ValueError: for missing or malformed numbers.
    """
    if data["kind"] == "residual":
        std, freedom = float(data["std"]), float(data["freedom"])
        if std < 0.0 or freedom <= 0.0:
            raise ModelError(f"noise with standard deviation {std} and {freedom} degrees of freedom")
        return ResidualNoise(std, freedom)
    if data["kind"] == "held-out":
        inflation, factors = float(data["inflation"]), np.array(data["flight_factors"], dtype=float)
        if inflation < 0.0 or factors.ndim != 2 or factors.shape[1] != len(LEVELS) or len(factors) == 0:
            raise ModelError(f"noise with inflation {inflation} and flight factors {factors.shape}")
        return HeldOutNoise(inflation, factors, int(data["flights_inside"]))
    raise ModelError(f"unknown kind of noise {data['kind']!r}")


@dataclass(frozen=True)
class FlightErrors:
    """Errors of a model on one flight.

    Attributes:
        error: (N,) measured − predicted.
        leverage: (N,) in that model.
        inside: (N,) whether every input lies in the range of the samples that the model was fitted to.
    """

    error: Array
    leverage: Array
    inside: npt.NDArray[np.bool_]

    def factors(self, inflation: float) -> Array:
        """Factors (len(LEVELS),) whose intervals would have covered the errors inside."""
        factors: Array = np.quantile(self.scores(inflation)[self.inside], LEVELS, method="higher")
        return factors

    def scores(self, inflation: float) -> Array:
        """Factors (N,) whose intervals would just have covered each error."""
        scores: Array = np.abs(self.error) / np.sqrt(1.0 + inflation * self.leverage)
        return scores


def calibrate(held_out: list[FlightErrors], trained: list[FlightErrors]) -> HeldOutNoise:
    """Noise from the errors of each flight, left out and in the final fit.

    Args:
        held_out: per flight, under the model selected and fitted without it.
        trained: per flight, under the final model.
    """
    # κ = N says that all training samples are worth a single one.
    samples = sum(len(flight.error) for flight in trained)
    inflation = fit_inflation(held_out, highest=samples)
    factors = [flight.factors(inflation) for flight in trained]
    inside = [k for k, flight in enumerate(held_out) if np.mean(flight.inside) >= FEWEST_INSIDE]
    for k in inside:
        factors[k] = np.maximum(factors[k], held_out[k].factors(inflation))
    return HeldOutNoise(inflation, np.stack(factors), len(inside))


def fit_inflation(flights: list[FlightErrors], highest: float) -> float:
    """κ, 1 to `highest`, that maximises the likelihood of held-out errors e ~ N(0, σ² (1 + κ h))."""

    def cost(log_inflation: float) -> float:
        growth = [1.0 + np.exp(log_inflation) * flight.leverage for flight in flights]
        variance = np.mean([np.mean(f.error**2 / g) for f, g in zip(flights, growth, strict=True)])
        return float(np.log(variance) + np.mean([np.mean(np.log(g)) for g in growth]))

    bounds = (0.0, float(np.log(max(highest, 1.0 + 1e-9))))
    return float(np.exp(minimize_scalar(cost, bounds=bounds, method="bounded").x))


def _ranked_factor(flight_factors: Array, confidence: float) -> float:
    """The factor that covers FLIGHT_SHARE of the flights, or all while there are too few to tell."""
    factors = np.sort([np.interp(confidence, LEVELS, row) for row in flight_factors])
    rank = int(np.ceil(FLIGHT_SHARE * (len(factors) + 1)))
    return float(factors[min(rank, len(factors)) - 1])


def _check_confidence(confidence: float, highest: float) -> None:
    if not 0.0 < confidence < 1.0:
        raise ModelError(f"confidence {confidence} is not between 0 and 1")
    if not (LEVELS[0] <= confidence <= highest):
        raise ModelError(
            f"confidence {confidence} is outside {LEVELS[0]:g} to {highest:g}, which can be calibrated"
        )
