# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Limits for one more flight, from the signals of held-out flights.

Two distributions are used. How far a flight leaves the envelope varies between flights: each contributes
its largest sustained value, and a one-sided prediction bound for the next flight follows from their scatter
(:func:`next_flight`). How far the sequential test wanders while nothing is wrong varies within flights; in
theory its tail is exponential (:class:`Walk`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import gammaincinv, ndtr, stdtrit

from quadpi_core.core import compiled
from quadpi_core.frames import Array
from quadpi_core.monitor.alarm_kernel import STEP_MAX_S

# Much longer than the correlation time of the samples, much shorter than a flight.
BLOCK_S = 5.0
# Weight of the prior spread between flights, in degrees of freedom.
USUAL_FLIGHTS = 6
# Share of the blocks that the tail is fitted to, and their least number, at most half of all.
_TAIL_SHARE, _TAIL_BLOCKS = 0.1, 10
# Confidence of the upper bound of the tail's mean.
_SURE = 0.8
# Least value, and least mean excess in seconds: a signal that never moved does not justify a tight limit.
_LEAST = 0.02
# Numbers drawn for what is not known of a tail.
DRAWS = 4000
# Bisections in the search for a largest sustained value: to 1e-9 of its range.
_HALVINGS = 30


def next_flight(largest: Array, chance: float, usual_spread: float) -> float:
    """Prediction bound: the value that one more flight exceeds with probability `chance`.

    The logarithms of the flights' largest values are taken to be normal. One more of them then lies about
    the mean of n as Student's t with ν degrees of freedom, times s √(1 + 1/n) (Hahn and Meeker 1991,
    prediction intervals). A dozen flights estimate their own spread poorly, it may come out half as large by
    chance: the usual spread enters as a prior worth :data:`USUAL_FLIGHTS` flights. So s² is the mean of both,
    weighted, and ν the sum of their degrees of freedom (Gelman et al., Bayesian Data Analysis, the scaled
    inverse χ²).

    Args:
        largest: (n,) not negative, of at least two flights.
        chance: between 0 and 1.
        usual_spread: prior standard deviation of the logarithms.
    """
    mean, spread, freedom, n = _spread_between(largest, usual_spread)
    return float(np.exp(mean - stdtrit(freedom, chance) * spread * np.sqrt(1.0 + 1.0 / n)))


def chances_to_exceed(
    limit: float, largest: Array, usual_spread: float, random: np.random.Generator
) -> Array:
    """Chances (:data:`DRAWS`,) that one more flight exceeds a limit, as far as the flights tell.

    Mean and spread are drawn as :func:`next_flight`, whose arguments these are, has them; with its own limit
    the mean of the chances is its chance.
    """
    mean, spread, freedom, n = _spread_between(largest, usual_spread)
    spreads = spread * np.sqrt(freedom / random.chisquare(freedom, DRAWS))
    means = mean + spreads / np.sqrt(n) * random.standard_normal(DRAWS)
    chances: Array = ndtr((means - np.log(max(limit, _LEAST))) / spreads)
    return chances


def _spread_between(largest: Array, usual_spread: float) -> tuple[float, float, int, int]:
    """Mean and spread of the logarithms, the spread's degrees of freedom, and the number of flights."""
    logarithms = np.log(np.maximum(largest, _LEAST))
    n = len(logarithms)
    freedom = USUAL_FLIGHTS + n - 1
    squares = float(np.square(logarithms - logarithms.mean()).sum())
    spread = float(np.sqrt((USUAL_FLIGHTS * usual_spread**2 + squares) / freedom))
    return float(logarithms.mean()), spread, freedom, n


def lasting_maximum(values: Array, time: Array, persistence_s: float, release_s: float) -> float:
    """Highest level that a signal (N,) exceeds long enough to raise the alarm; its least value if none.

    Args:
        values: (N,).
        time: (N,) s.
        persistence_s: time above the level that raises the alarm.
        release_s: time below the level that clears the evidence.
    """
    steps, values = _steps(time), np.ascontiguousarray(values)
    low, high = float(values.min()), float(values.max())
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if compiled.lasts(values, steps, middle, persistence_s, release_s):
            low = middle
        else:
            high = middle
    return low


@dataclass(frozen=True)
class Walk:
    """Tail of the largest values of the sequential test in blocks of :data:`BLOCK_S`.

    The excess beyond the highest tenth is exponential: of a walk that drifts downward theory says so, with
    dependent steps too (Cramér and Lundberg; Glynn and Whitt 1994).

    Attributes:
        start: s.
        mean: of the excess, s, at the upper end of its confidence interval with twice as many degrees of
            freedom as flights.
        per_hour: blocks beyond `start`.
        count: number of these blocks.
        freedom: degrees of freedom of `mean`.
    """

    start: float
    mean: float
    per_hour: float
    count: int
    freedom: float

    @classmethod
    def from_sums(cls, sums: Sequence[Array], times: Sequence[Array]) -> Walk:
        """From sums (N,) of an axis and stamps (N,) in seconds, of each flight."""
        maxima = [
            np.maximum.reduceat(of_flight, _block_starts(time))
            for of_flight, time in zip(sums, times, strict=True)
        ]
        ordered = np.sort(np.concatenate(maxima))[::-1]
        count = min(max(int(_TAIL_SHARE * len(ordered)), _TAIL_BLOCKS), len(ordered) // 2)
        start = float(ordered[count])
        hours = sum(float(time[-1] - time[0]) for time in times) / 3600.0
        freedom = 2.0 * len(sums)
        unsure = 0.5 * freedom / float(gammaincinv(0.5 * freedom, 1.0 - _SURE))
        excess = float(np.maximum(ordered - start, 0.0).sum()) / count
        return cls(start, max(excess * unsure, _LEAST), count / hours, count, freedom)

    def limit(self, rate_per_hour: float) -> float:
        """Level that is exceeded at this rate."""
        folds = float(np.log(max(self.per_hour / rate_per_hour, 1.0)))
        return self.start + self.mean * folds

    def rates(self, limit: float, random: np.random.Generator) -> Array:
        """Rates per hour (:data:`DRAWS`,) at which a level is exceeded, as far as the blocks tell."""
        half = 0.5 * self.freedom
        means = self.mean * float(gammaincinv(half, 1.0 - _SURE)) / random.gamma(half, size=DRAWS)
        beyond = self.per_hour * random.gamma(self.count, size=DRAWS) / self.count
        rates: Array = beyond * np.exp(-max(limit - self.start, 0.0) / means)
        return rates


def sums_of_misses(time: Array, miss: Array, allowed: float) -> Array:
    """The sequential test (N, 6) of a flight, in seconds, without its end at the limit.

    Args:
        time: (N,) s.
        miss: (N, 6) whether the measured wrench left its interval, 0 or 1; NaN where not known.
        allowed: share of misses at which it neither rises nor falls.
    """
    sums = np.empty(miss.shape)
    compiled.sum_misses(_steps(time), np.ascontiguousarray(miss), allowed, sums)
    return sums


def _block_starts(time: Array) -> Any:
    """First samples of blocks of about :data:`BLOCK_S`."""
    count = max(round(float(time[-1] - time[0]) / BLOCK_S), 1)
    return np.linspace(0, len(time), count, endpoint=False).astype(np.int64)


def _steps(time: Array) -> Array:
    """Seconds (N,) since the previous sample; a gap counts as one step, as in the alarm."""
    steps = np.diff(time, prepend=time[0])
    return np.minimum(steps, max(float(np.median(steps)), STEP_MAX_S))
