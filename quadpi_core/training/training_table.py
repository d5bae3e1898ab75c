# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of several axes, made ready for the networks of all of them."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.ensembles.network import Scaling
from quadpi_core.models.interval_rules import FEWEST_INSIDE
from quadpi_core.models.regressors import Regressor, RegressorProgram, check_inputs
from quadpi_core.training.ensemble_plan import Flags, Indices

_log = logging.getLogger(__name__)
# Contiguous parts that stand in for flights where the samples are not grouped.
_PARTS_WITHOUT_GROUPS = 5


@dataclass(frozen=True)
class Table:
    """Samples of A axes.

    Attributes:
        X: (N, 19) input vectors, or (N, D) of any table.
        features: (N, A, D) standardised inputs of the networks, zero beyond the last of an axis.
        targets: (A, N) standardised.
        flights: (N,) numbered from 0.
        scalings: of each axis.
        rejected: rows that were not finite.
    """

    X: Array
    features: npt.NDArray[np.float32]
    targets: npt.NDArray[np.float32]
    flights: Indices
    scalings: tuple[Scaling, ...]
    rejected: int

    @classmethod
    def make(
        cls,
        inputs: Sequence[tuple[Regressor, ...] | None],
        names: Sequence[str],
        X: Array,
        Y: Array,
        groups: npt.ArrayLike | None,
        most_samples: int | None,
    ) -> Table:
        """Prepare samples for axes with their `inputs` and targets Y (N, A).

        Inputs and targets are standardised over all flights, those that will be left out included: a choice
        of units, from which no network learns anything of a flight.

        Raises:
            ModelError: for shapes that do not fit, no finite row, and a constant target, naming the axis.
        """
        X, Y, flights, rejected = _finite(X, Y, groups)
        if most_samples is not None:
            kept = _every_other(flights, -(-len(X) // most_samples))
            X, Y, flights = X[kept], Y[kept], flights[kept]
        scaled, scalings = [], []
        for name, regressors, y in zip(names, inputs, Y.T, strict=True):
            features = X
            if regressors is not None:
                check_inputs(X)
                features = RegressorProgram.compile(regressors).evaluate(X)
            try:
                scaling = Scaling.of(features, y)
            except ModelError as error:
                raise ModelError(f"{name}: {error}" if name else str(error)) from error
            scaled.append(scaling.standardised(features))
            scalings.append(scaling)
        filled = np.zeros((len(X), len(scaled), max(part.shape[1] for part in scaled)), dtype=np.float32)
        for axis, part in enumerate(scaled):
            filled[:, axis, : part.shape[1]] = part
        targets = [(y - s.target_mean) / s.target_scale for y, s in zip(Y.T, scalings, strict=True)]
        return cls(X, filled, np.array(targets, dtype=np.float32), flights, tuple(scalings), rejected)

    @cached_property
    def rows(self) -> list[Indices]:
        """Samples of each flight."""
        return [np.flatnonzero(self.flights == flight) for flight in range(int(self.flights.max()) + 1)]

    @cached_property
    def _ranges(self) -> tuple[Array, Array]:
        lowest, highest = ([edge(self.X[rows], axis=0) for rows in self.rows] for edge in (np.min, np.max))
        return np.array(lowest), np.array(highest)

    def inside(self, flight: int, others: Indices) -> Flags:
        """Which samples of a flight lie in the range of the others in every input; none without others."""
        lowest, highest = (edges[np.setdiff1d(others, flight)] for edges in self._ranges)
        X = self.X[self.rows[flight]]
        if len(lowest) == 0:
            return np.zeros(len(X), dtype=bool)
        inside: Flags = ((lowest.min(axis=0) <= X) & (highest.max(axis=0) >= X)).all(axis=1)
        return inside

    def mostly_inside(self, flight: int, others: Indices) -> bool:
        """Whether a flight tells of errors inside the envelope of the others (see `rules.HeldOutRule`)."""
        return float(np.mean(self.inside(flight, others))) >= FEWEST_INSIDE


def _finite(X: Array, Y: Array, groups: npt.ArrayLike | None) -> tuple[Array, Array, Indices, int]:
    """Finite rows of inputs and targets, their flights numbered from 0, and how many rows are not finite."""
    X, Y = np.ascontiguousarray(X, dtype=float), np.ascontiguousarray(Y, dtype=float)
    if X.ndim != 2 or Y.ndim != 2 or len(X) != len(Y):
        raise ModelError(f"inputs of shape {X.shape} and targets of shape {Y.shape} do not fit together")
    if groups is None:
        labels: npt.NDArray[Any] = np.arange(len(X)) * _PARTS_WITHOUT_GROUPS // max(len(X), 1)
    else:
        labels = np.asarray(groups)
        if labels.shape != X.shape[:1]:
            raise ModelError(f"groups has shape {labels.shape}, expected {X.shape[:1]}")
    finite = np.isfinite(X).all(axis=1) & np.isfinite(Y).all(axis=1)
    rejected = len(X) - int(finite.sum())
    if rejected == len(X):
        raise ModelError(f"none of {len(X)} rows is finite: there is nothing to train on")
    if rejected:
        _log.warning("%d of %d rows are not finite: left out", rejected, len(X))
    flights = np.unique(labels[finite], return_inverse=True)[1].astype(np.int64)
    return X[finite], Y[finite], flights, rejected


def _every_other(flights: Indices, step: int) -> Flags:
    """Flags (N,) of every step-th sample of each flight."""
    kept = np.zeros(len(flights), dtype=bool)
    for flight in range(int(flights.max()) + 1):
        kept[np.flatnonzero(flights == flight)[::step]] = True
    return kept
