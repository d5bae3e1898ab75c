# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What single flights have of their own: parameters of an effect about what all flights share of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadpi_core.discrepancy.whitening import Indices
from quadpi_core.frames import Array
from quadpi_core.thresholds import CONVENTION, Threshold

# Rounds in which the sizes converge, and the least of them, in prior deviations.
_ROUNDS, _LEAST_DIFFERENCE = 12, 1e-4
# Precision of what flights share, in prior ones.
_FREE = 1e-4
TAILS = Threshold(
    "tails of what flights have of their own",
    1.0,
    "degrees of freedom of Student's t",
    "most flights are alike, and one with a turned IMU differs by ten times as much: it must not hide "
    "what the others share",
    CONVENTION,
)


@dataclass(frozen=True, eq=False)
class Condition:
    """Parameters of a candidate that each flight has of its own.

    Attributes:
        index: of the candidate.
        sizes: (F, k) standard deviation of each parameter of each flight about what all share, in prior ones.
    """

    index: int
    sizes: Array


def own_sizes(per_flight: Array, residual: Array, shared: Indices, own: Indices) -> Array:
    """Standard deviations (F, k) of what each flight has of k columns about what all share of them.

    Those of the largest evidence, by expectation and maximisation for a Student's t: an effect that all
    flights have is no condition of one, and a flight that differs by much says nothing of the others.

    Args:
        per_flight: (F, K, K) Gram matrices of the residual and columns.
        residual: (K,) weights of the residual in these.
        shared: columns that all flights share, with a prior of 1; `own` among them.
        own: the k columns.
    """
    # However large what flights share is, it is no difference between them.
    prior = np.diag(np.where(np.isin(shared, own), _FREE, 1.0))
    sizes, typical = np.ones((len(per_flight), len(own))), np.ones(len(own))
    for _ in range(_ROUNDS):
        information, projection, inner = prior.copy(), np.zeros(len(shared)), []
        for gram, size in zip(per_flight, sizes, strict=True):
            solved = np.linalg.inv(gram[np.ix_(own, own)] + np.diag(1.0 / np.square(size)))
            gain = gram[np.ix_(shared, own)] @ solved
            information += gram[np.ix_(shared, shared)] - gain @ gram[np.ix_(own, shared)]
            projection += gram[shared] @ residual - gain @ (gram[own] @ residual)
            inner.append((solved, gain, gram[own] @ residual))
        covariance = np.linalg.inv(information)
        mean = covariance @ projection
        squares = np.array(
            [
                np.square(solved @ seen - gain.T @ mean) + np.diag(solved + gain.T @ covariance @ gain)
                for solved, gain, seen in inner
            ]
        )
        weights = student_weights(squares / np.square(typical))
        typical = np.maximum(np.sqrt(np.mean(weights * squares, axis=0)), _LEAST_DIFFERENCE)
        sizes = np.clip(typical / np.sqrt(weights), _LEAST_DIFFERENCE, 1.0)
    return sizes


def student_weights(squares: Array) -> Array:
    """Weights of deviations with these squares, in typical ones, by the tails of Student's t."""
    weights: Array = (TAILS.value + 1.0) / (TAILS.value + squares)
    return weights
