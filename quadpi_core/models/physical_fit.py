# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The fitted physical model: parameters by weighted least squares of all axes, and how well they are known.

The measured wrench of all flights and axes is a linear function of the parameters, given the delay of the
rotor speeds and the bandwidth of the force measurement. The parameters are the maximum a posteriori: errors
weigh by their deviation on each axis and by how many independent samples they are worth, the spreads of
`physical_terms` are the prior (Jategaonkar, Flight Vehicle System Identification, 2015, 6 and 11).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from operator import add, sub

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import Real, Text
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.physical_flight import FORCE
from quadpi_core.models.physical_regressors import acting_terms
from quadpi_core.models.physical_terms import TERM_NAMES, TERMS, scales
from quadpi_core.vehicle import Vehicle

# Time [s] over which errors may hang together.
_LONGEST_LAG_S = 5.0
# Lower bound on the effective sample rate [1/s], so that a biased axis keeps weight in the fit; standard
# errors use the true value.
_FEWEST_INDEPENDENT_HZ = 1.0
# A bound holds within this share of the prior spread; what is said of it.
_WITHIN = 1e-6
AT_BOUND = "at its lower bound, 0"
# Standard deviation of the thrust of a flight over that of others at the same rotor speeds, before there are
# flights to tell, and how many flights that is worth. A NeuroBEM flight of another day has 3 % less, five of
# an indiflight quadrotor spread by 2.6 %; 3 °C or 10 hPa are 1 %. Set with the NeuroBEM flights in view.
_THRUST_OF_A_FLIGHT, _WORTH_FLIGHTS = 0.03, 2.0
# Least deviation of an axis, for flights without any error.
LEAST = 1e-12


@cache
def _felt_terms() -> npt.NDArray[np.bool_]:
    """Which axes (P, 6) of a recording each term reaches: smoothing in the world mixes those of forces."""
    felt = acting_terms().copy()
    felt[:, FORCE] = np.any(felt[:, FORCE], axis=1, keepdims=True)
    return felt


@dataclass(frozen=True)
class Information:
    """Sums over the samples of a flight, each axis by itself: all that least squares needs.

    Attributes:
        matrix: (6, P, P) Σ z zᵀ of the regressors.
        moment: (6, P) Σ z y.
        square: (6,) Σ y².
        count: number of samples.
    """

    matrix: Array
    moment: Array
    square: Array
    count: int

    @classmethod
    def from_samples(cls, z: Array, wrench: Array) -> Information:
        """Of regressors (N, P, 6) and the measured wrench (N, 6)."""
        matrix, moment = np.zeros((len(AXES), len(TERMS), len(TERMS))), np.zeros((len(AXES), len(TERMS)))
        for axis, acting in enumerate(_felt_terms().T):
            columns = z[:, acting, axis]
            matrix[axis][np.ix_(acting, acting)] = columns.T @ columns
            moment[axis, acting] = wrench[:, axis] @ columns
        return cls(matrix, moment, np.sum(np.square(wrench), axis=0), len(wrench))

    def __add__(self, other: Information) -> Information:
        return Information(*map(add, vars(self).values(), vars(other).values()))

    def __sub__(self, other: Information) -> Information:
        return Information(*map(sub, vars(self).values(), vars(other).values()))

    def rmse(self, values: Array) -> Array:
        """Root-mean-square error (6,) with parameters (P,)."""
        explained = np.einsum("p,apq,q->a", values, self.matrix, values)
        squares = self.square - 2.0 * self.moment @ values + explained
        result: Array = np.sqrt(np.maximum(squares, 0.0) / self.count)
        return result


@dataclass(frozen=True)
class FitStep:
    """A step of the fit.

    Attributes:
        step: what was tried or done.
        of: with what: a delay, a bandwidth, a group of terms.
        error: that it gave, or what it changed.
    """

    step: Text
    of: str
    error: Real


@dataclass(frozen=True)
class Weights:
    """What an error counts for.

    Attributes:
        deviation: (6,) of the errors.
        independent: (6,) share of the samples that are independent.
        fewest: share that an axis weighs by at least.
    """

    deviation: Array
    independent: Array
    fewest: float

    @classmethod
    def start(cls, information: Sequence[Information]) -> Weights:
        """From the measured wrench, before there are errors: a tenth of its size."""
        sums = total(information)
        deviation = np.maximum(0.1 * np.sqrt(sums.square / sums.count), LEAST)
        return cls(deviation, np.full(len(AXES), 0.01), 0.0)

    @classmethod
    def of_errors(cls, errors: Sequence[Array], rate_hz: float) -> Weights:
        """From the errors (N, 6) of flights, sampled at `rate_hz`."""
        together = np.concatenate(errors)
        deviation = np.sqrt(np.mean(np.square(together), axis=0))
        lags = round(_LONGEST_LAG_S * rate_hz)
        share = np.array(
            [_independent_share([e[:, axis] for e in errors], lags) for axis in range(len(AXES))]
        )
        return cls(np.maximum(deviation, LEAST), share, _FEWEST_INDEPENDENT_HZ / rate_hz)

    @property
    def share(self) -> Array:
        """Share (6,) of the samples that each axis weighs by."""
        return np.maximum(self.independent, self.fewest)

    @property
    def weight(self) -> Array:
        """Of a squared error of each axis (6,)."""
        return self.share / np.square(self.deviation)


@dataclass(frozen=True)
class Problem:
    """Prior and bounds: mean, spread and lower bound (P,) of the parameters, SI."""

    mean: Array
    spread: Array
    lower: Array

    @classmethod
    def from_vehicle(cls, vehicle: Vehicle, reference: float) -> Problem:
        """Of a vehicle whose rotors have a thrust per ω² of about `reference` [N s²]."""
        scale = scales(vehicle, reference)
        return cls(
            np.array([term.mean for term in TERMS]) * scale,
            np.array([term.spread for term in TERMS]) * scale,
            np.array([0.0 if term.positive else -np.inf for term in TERMS]),
        )

    def solve(
        self, information: Sequence[Information], weighing: Weights, kept: npt.NDArray[np.bool_]
    ) -> Array:
        """Parameters (P,); zero where not kept."""
        matrix, right = self._normal(total(information), weighing, kept)
        change = bounded_solution(matrix, right, (self.lower[kept] - self.mean[kept]) / self.spread[kept])
        values = np.zeros(len(TERMS))
        values[kept] = self.mean[kept] + self.spread[kept] * change
        return values

    def covariance(
        self, information: Sequence[Information], weighing: Weights, kept: npt.NDArray[np.bool_]
    ) -> Array:
        """Covariance (P, P) of what :meth:`solve` gives, with as many errors as are independent.

        H⁻¹ (J + 1) H⁻¹ in units of the prior, H the normal matrix and J the covariance of its right side.
        """
        sums, spread = total(information), self.spread[kept]
        matrix, _ = self._normal(sums, weighing, kept)
        counted = weighing.weight * weighing.share / weighing.independent
        noise = np.einsum("a,apq->pq", counted, sums.matrix)[np.ix_(kept, kept)] * np.outer(spread, spread)
        inverse = np.linalg.inv(matrix)
        covariance = np.zeros((len(TERMS), len(TERMS)))
        covariance[np.ix_(kept, kept)] = (
            inverse @ (noise + np.eye(len(spread))) @ inverse * np.outer(spread, spread)
        )
        return covariance

    def _normal(
        self, sums: Information, weighing: Weights, kept: npt.NDArray[np.bool_]
    ) -> tuple[Array, Array]:
        """Normal equations of the terms kept: matrix (s, s), right side (s,), for (value - mean) / spread."""
        matrix = np.einsum("a,apq->pq", weighing.weight, sums.matrix)[np.ix_(kept, kept)]
        moment = np.einsum("a,ap->p", weighing.weight, sums.moment)[kept]
        spread, mean = self.spread[kept], self.mean[kept]
        right = spread * (moment - matrix @ mean)
        return matrix * np.outer(spread, spread) + np.eye(len(spread)), right


def bounded_solution(matrix: Array, right: Array, lower: Array) -> Array:
    """Least xᵀ M x / 2 - rᵀ x for a positive definite matrix (s, s), right side (s,) and bounds (s,)."""
    from scipy import linalg, optimize

    free: Array = linalg.cho_solve(linalg.cho_factor(matrix), right)
    if not np.any(free < lower):
        return free
    factor = np.linalg.cholesky(matrix)
    bounded: Array = optimize.lsq_linear(factor.T, np.linalg.solve(factor, right), bounds=(lower, np.inf)).x
    return bounded


def total(information: Iterable[Information]) -> Information:
    """The sums over all flights."""
    return reduce(add, information)


def _independent_share(errors: Sequence[Array], lags: int) -> float:
    """Share of samples that are independent: 1 over the integrated autocorrelation (Sokal's window)."""
    sums = np.zeros(lags)
    for series in errors:
        spectrum = np.abs(np.fft.rfft(series, 2 * len(series))) ** 2
        covariance = np.fft.irfft(spectrum)[: min(lags, len(series))]
        sums[: len(covariance)] += covariance
    if sums[0] <= 0.0:
        return 1.0
    time = 2.0 * np.cumsum(sums / sums[0]) - 1.0
    window = int(np.argmax(np.arange(len(time)) >= 5.0 * time)) or len(time) - 1
    return float(1.0 / max(time[window], 1.0))


def bounded_terms(values: Array, spreads: Array) -> list[str]:
    """Terms that physics keeps from becoming negative, of parameters (P,) with spreads (P,)."""
    return [
        term.name
        for term, value, spread in zip(TERMS, values, spreads, strict=True)
        if term.positive and value <= _WITHIN * spread
    ]


def worst_pairs(covariance: Array, count: int = 5) -> list[tuple[str, str, float]]:
    """The most correlated pairs of parameters of a covariance (P, P), with their correlation."""
    errors = np.sqrt(np.diag(covariance))
    fitted = np.flatnonzero(errors > 0.0)
    correlation = covariance[np.ix_(fitted, fitted)] / np.outer(errors[fitted], errors[fitted])
    rows, columns = np.triu_indices(len(fitted), 1)
    worst = np.argsort(-np.abs(correlation[rows, columns]))[:count]
    return [
        (TERM_NAMES[fitted[rows[i]]], TERM_NAMES[fitted[columns[i]]], float(correlation[rows[i], columns[i]]))
        for i in worst
    ]


def thrust_variance(changes: Sequence[float]) -> float:
    """Variance of the thrust from flight to flight, as a share squared.

    Args:
        changes: of flights left out, see `PhysicalFit.thrust_change`.
    """
    known = float(np.sum(np.square(changes)))
    return (_WORTH_FLIGHTS * _THRUST_OF_A_FLIGHT**2 + known) / (_WORTH_FLIGHTS + len(changes))
