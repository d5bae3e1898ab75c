# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers with confidence intervals from flights: samples that go together are left out together.

Samples of a log are autocorrelated, by gusts above all: an interval that took them for independent would be
several times too narrow. So each estimate is made again without each piece of the flights in turn (the
delete-a-group jackknife), and the interval is that of Student's t on as many pieces as share the information.
Source: B. Efron, R. Tibshirani, An Introduction to the Bootstrap (1993), ch. 11; B. Hansen, The jackknife
standard error (2022), for its being conservative with few groups.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, Threshold

CONFIDENCE = Threshold(
    "confidence of the intervals of a report", 0.95, "", "what most readers expect", CONVENTION
)
PIECES_FEWEST = Threshold(
    "pieces of flight below which there is no interval",
    5,
    "",
    "Student's t with fewer than four degrees of freedom gives intervals of more than three standard errors",
    CONVENTION,
)

_SHORT = "too short for an interval"


@dataclass(frozen=True)
class Estimate:
    """A number with its interval, or why there is none.

    Attributes:
        value: None where it is not identified.
        low, high: ends of the interval; None where there is none.
        unit: of all three.
        reason: why it is not identified, or under what condition it holds; empty where there is none.
    """

    value: float | None
    low: float | None = None
    high: float | None = None
    unit: str = ""
    reason: str = ""

    @property
    def half_width(self) -> float | None:
        """Half the interval."""
        return None if self.low is None or self.high is None else 0.5 * (self.high - self.low)


def not_identified(unit: str, reason: str, low: float | None = None, high: float | None = None) -> Estimate:
    """No number, and why; the interval where there is one, which does not bear a number."""
    return Estimate(None, low, high, unit, f"not identified: {reason}")


def within(ends: Iterable[float], unit: str, condition: str = "") -> Estimate:
    """An estimate of value, low and high, the ends in any order."""
    value, *both = ends
    return Estimate(value, min(both), max(both), unit, condition)


def beyond_zero(estimate: Estimate) -> Estimate:
    """A quantity that is above 0 by physics: not identified where its interval reaches 0, or is below."""
    low, high = estimate.low, estimate.high
    if low is None or high is None:
        return not_identified(estimate.unit, estimate.reason or _SHORT)
    if low > 0.0:
        return estimate
    said = f"its interval {low:.2g} to {high:.2g} {'holds' if high >= 0.0 else 'is below'} 0"
    return not_identified(estimate.unit, said, low, high)


def jackknife(whole: Array, without: Array, information: Array) -> tuple[Array, Array]:
    """Ends of the intervals (P,) of parameters.

    Args:
        whole: (P,) of all pieces.
        without: (B, P) of all but one piece each.
        information: (B, P) that each piece has on each parameter, in any unit.
    """
    count = len(without)
    error = np.sqrt((count - 1) / count * np.sum((without - whole) ** 2, axis=0))
    # One long fast pass among many hovers counts once.
    freedom = np.maximum(effective_pieces(information) - 1.0, 1.0)
    half = stats.t.ppf(0.5 + 0.5 * CONFIDENCE.value, freedom) * error
    return whole - half, whole + half


def effective_pieces(information: Array) -> Array:
    """As many pieces (P,) as would share the information (B, P) evenly."""
    share = information / np.maximum(information.sum(axis=0), 1e-300)
    return 1.0 / np.maximum(np.sum(share**2, axis=0), 1e-300)


def slope_of_pieces(
    columns: Array, target: Array, piece: Array, wanted: Array, unit: str
) -> tuple[Estimate, Array]:
    """A linear combination of least-squares coefficients with its interval, and the coefficients (P,).

    Args:
        columns: (N, P) regressors.
        target: (N,).
        piece: (N,) the piece of each sample.
        wanted: (P,) the combination.
        unit: of it.
    """
    places = [np.flatnonzero(piece == number) for number in np.unique(piece)]
    grams = np.array([columns[rows].T @ columns[rows] for rows in places])
    pulls = np.array([columns[rows].T @ target[rows] for rows in places])
    fitted: Array = np.linalg.lstsq(grams.sum(axis=0), pulls.sum(axis=0), rcond=None)[0]
    value = float(wanted @ fitted)
    if len(places) < PIECES_FEWEST.value:
        return Estimate(value, unit=unit, reason=_SHORT), fitted
    rest = zip(grams.sum(axis=0) - grams, pulls.sum(axis=0) - pulls, strict=True)
    without = [wanted @ np.linalg.lstsq(gram, pull, rcond=None)[0] for gram, pull in rest]
    # The part of the information that other coefficients do not share.
    inverse = np.linalg.pinv(grams.sum(axis=0))
    share = np.array([inverse @ gram @ inverse for gram in grams]) @ wanted @ wanted
    low, high = jackknife(np.array([value]), np.array(without)[:, np.newaxis], share[:, np.newaxis])
    return Estimate(value, float(low[0]), float(high[0]), unit), fitted


def chain_of_pieces(value_of: Callable[[Array], float], piece: Array, unit: str) -> Estimate:
    """A number from several steps with its interval: all steps are taken again without each piece.

    Args:
        value_of: gives it from some of the samples (N,), a mask; NaN where they do not tell it.
        piece: (N,) the piece of each sample.
        unit: of the number.
    """
    numbers, counts = np.unique(piece, return_counts=True)
    value = value_of(np.ones(len(piece), dtype=np.bool_))
    if not np.isfinite(value):
        return not_identified(unit, "the flight does not reach it")
    if len(numbers) < PIECES_FEWEST.value:
        return Estimate(value, unit=unit, reason=_SHORT)
    without = np.array([[value_of(piece != number)] for number in numbers])
    if not np.isfinite(without).all():
        return not_identified(unit, "one piece of the flight tells it alone")
    low, high = jackknife(np.array([value]), without, counts[:, np.newaxis].astype(np.float64))
    return Estimate(value, float(low[0]), float(high[0]), unit)


def mean_of_pieces(values: Array, piece: Array, unit: str) -> Estimate:
    """Mean of samples (N,), of which those that are not finite do not count, with its interval."""
    known = np.isfinite(values)
    if not known.any():
        return not_identified(unit, "no sample")
    ones = np.ones((int(known.sum()), 1))
    return slope_of_pieces(ones, values[known], piece[known], np.ones(1), unit)[0]
