# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""By how much past errors of a flight move the centre of the next interval.

Errors of a model last: a flight has a constant of its own, and an effect that the model lacks acts for a
while. The centre moves by a regression of the error on running means of those before it,

    m_k ← m_k + (1 − exp(−1/(τ_k f))) (e − m_k),      centre = model + Σ_k b_k m_k,

with f the sample rate. Means of short and of long memories together foresee a slope. As the memories τ are
times, the coefficients b hold at any rate. They are learned from errors on flights left out, as the live path
would make them. Among rivals of the literature: experiments/results/intervals-raced.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import NotEmpty, Numbers, OneOf, Positive, parse_config
from quadpi_core.core import exponential
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array

# Memories [s] of the running means: from less than the delay of the low-pass to most of a short flight.
MEMORIES_S = (0.004, 0.01, 0.02, 0.04, 0.1, 0.3, 1.0, 5.0)
# Shortest memory, in samples, of a mean that is learned: a shorter one is the last error, as the next is.
_SHORTEST = 0.4
# An error counts once it is as old as this: the low-pass, which all signals pass, delays by as much.
DELAY_S = 0.014
# Ridge of the regression, in variances of each mean: they are much alike.
_RIDGE = 1e-3
# Shares of the regression's coefficients that are tried.
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class MovedAxis:
    """How the interval of an axis moves.

    Attributes:
        coefficients: (8,) of the running means.
        narrower: half width that covers as often about the centre that moves, over the model's own.
    """

    coefficients: Annotated[Array, Numbers(len(MEMORIES_S))]
    narrower: Positive


@dataclass(frozen=True)
class MovingCentre:
    """How the intervals of a model move, by axis."""

    axes: Annotated[dict[Annotated[str, OneOf(*AXES)], MovedAxis], NotEmpty()]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers for the model file; :meth:`from_json` reads them."""
        return {
            "axes": {
                axis: {"coefficients": own.coefficients.tolist(), "narrower": own.narrower}
                for axis, own in self.axes.items()
            }
        }

    @classmethod
    def from_json(cls, data: Any) -> MovingCentre:
        """What :meth:`to_json` gave.

        Raises:
            ModelError: naming the key that is missing, or whose numbers no flights give.
        """
        return parse_config(cls, data, "moving centre", ModelError)


def shares(rate_hz: float) -> Array:
    """Share (8,) of a new error in each running mean."""
    return 1.0 - exponential(-1.0 / (np.array(MEMORIES_S) * rate_hz))


def usable(rate_hz: float) -> npt.NDArray[np.bool_]:
    """Which running means (8,) errors at a rate can teach."""
    found: npt.NDArray[np.bool_] = np.array(MEMORIES_S) * rate_hz >= _SHORTEST
    return found


def delay(rate_hz: float) -> int:
    """Samples after which an error is known; of a rate that is none, one."""
    return max(int(np.ceil(DELAY_S * rate_hz - 0.1)), 1)


def delayed(errors: Array, samples: int) -> Array:
    """The errors (T, ...) that have become known at each sample, zero before the first and for NaN."""
    known = np.zeros_like(errors)
    known[samples:] = np.nan_to_num(errors[:-samples])
    return known


def means_of(errors: Array, rate_hz: float) -> Array:
    """Running means (T, ..., 8) of errors (T, ...), each with the error of its sample."""
    # Slow to import, and no model in flight needs it.
    from scipy.signal import lfilter

    return np.stack(
        [lfilter([share], [1.0, share - 1.0], errors, axis=0) for share in shares(rate_hz)], axis=-1
    )


def regressed(flights: Sequence[tuple[Array, Array]]) -> tuple[Array, list[Array]]:
    """Coefficients (8,) of running means, by least squares in which each flight counts the same.

    They are shrunk to the share that is best for each flight by the others: where errors do not repeat
    themselves from flight to flight, the centre stays.

    Args:
        flights: errors (N,) of an axis, and the means (N, 8) that were known at each.

    Returns:
        The coefficients, and by how much those of the others move the centre (N,) of each flight.
    """
    squares = [means.T @ means / len(means) for _, means in flights]
    products = [means.T @ error / len(means) for error, means in flights]
    square, product = (np.sum(each, axis=0) for each in (squares, products))
    moved = [
        means @ _solved(square - own, product - mine)
        for (_, means), own, mine in zip(flights, squares, products, strict=True)
    ]
    # Sums of |error| over those about a centre that stays, which all flights have alike.
    costs = [
        sum(
            float(np.sum(np.abs(error - share * by)) / max(np.sum(np.abs(error)), np.finfo(float).tiny))
            for (error, _), by in zip(flights, moved, strict=True)
        )
        for share in _SHARES
    ]
    share = _SHARES[int(np.argmin(costs))] if len(flights) > 1 else 0.0
    return share * _solved(square, product), [share * by for by in moved]


def _solved(square: Array, product: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(square), 0.0))
    # Of errors that are all zero.
    scale[scale == 0.0] = 1.0
    penalised = square / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
    found: Array = np.linalg.solve(penalised, product / scale) / scale
    return found
