# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of several axes, made ready for the networks of all of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import named_in
from quadpi_core.frames import Array
from quadpi_core.models.fitted_ensemble import Scaling
from quadpi_core.models.interval_rules import FEWEST_INSIDE
from quadpi_core.models.model_kind import Pools, TrainingSamples
from quadpi_core.models.regressors import RegressorProgram


@dataclass(frozen=True)
class Table:
    """Samples of A axes.

    Attributes:
        X: (N, 19) input vectors.
        features: (N, A, D) standardised inputs of the networks, zero beyond the last of an axis.
        targets: (A, N) standardised.
        flights: (N,) numbered from 0.
        scalings: of each axis.
    """

    X: Array
    features: npt.NDArray[np.float32]
    targets: npt.NDArray[np.float32]
    flights: Indices
    scalings: tuple[Scaling, ...]

    @classmethod
    def make(cls, samples: TrainingSamples, pools: Pools, most_samples: int | None) -> Table:
        """Prepare samples for the axes of pools.

        Inputs and targets are standardised over all flights, those that will be left out included: a choice
        of units, from which no network learns anything of a flight.

        Raises:
            ModelError: for a constant target, naming the axis.
        """
        rows = _every_other(
            samples.flight, 1 if most_samples is None else -(-len(samples.time) // most_samples)
        )
        X, scaled, scalings, targets = samples.inputs[rows], [], [], []
        for axis, pool in pools.items():
            features, target = RegressorProgram.compile(pool.inputs).evaluate(X), samples.target(axis)[rows]
            with named_in(axis):
                scaling = Scaling.from_samples(features, target)
            scaled.append(scaling.standardised(features))
            scalings.append(scaling)
            targets.append((target - scaling.target_mean) / scaling.target_scale)
        filled = np.zeros((len(X), len(scaled), max(part.shape[1] for part in scaled)), dtype=np.float32)
        for k, part in enumerate(scaled):
            filled[:, k, : part.shape[1]] = part
        return cls(X, filled, np.array(targets, dtype=np.float32), samples.flight[rows], tuple(scalings))

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
        """Whether the errors on a flight count for intervals (see :class:`.interval_rules.HeldOutRule`)."""
        return float(np.mean(self.inside(flight, others))) >= FEWEST_INSIDE


def _every_other(flights: Indices, step: int) -> Flags:
    """Flags (N,) of every step-th sample of each flight."""
    rows = np.zeros(len(flights), dtype=bool)
    for flight in range(int(flights.max()) + 1):
        rows[np.flatnonzero(flights == flight)[::step]] = True
    return rows


Split: TypeAlias = Literal["flight", "sample"]
Flags: TypeAlias = npt.NDArray[np.bool_]
Indices: TypeAlias = npt.NDArray[np.int64]

# Units that samples are dealt to where single samples are in or out.
_SAMPLE_UNITS = 1000
# Contiguous parts of a flight, which members leave out where there are too few flights to leave out.
_PARTS = 5
_FEWEST_FLIGHTS = 3


@dataclass(frozen=True)
class Plan:
    """Ensembles of B members: the first sees all flights, each other one all but those left out in its turn.

    Networks are numbered ensemble by ensemble, M of them. Of what its ensemble sees, each member leaves some
    out; that judges it, and errors there are those of a network that was not trained on them.

    Attributes:
        members: B.
        unit: (N,) unit of each sample; units are in or out as a whole.
        trained: (M, U) units that a network is trained on.
        omitted: (M, U) units that its ensemble sees, and the network does not.
        left_out: flights that each ensemble does not see.
        seen: flights that each ensemble sees.
    """

    members: int
    unit: npt.NDArray[np.int32]
    trained: Flags
    omitted: Flags
    left_out: tuple[Indices, ...]
    seen: tuple[Indices, ...]

    @classmethod
    def make(cls, flights: Indices, members: int, subset: float, split: Split, folds: int, seed: int) -> Plan:
        """Plan for samples (N,) of flights numbered from 0, which are left out in `folds` turns."""
        random = np.random.default_rng(seed)
        every = np.arange(int(flights.max()) + 1)
        unit, flight_of = _units(flights, split, random)
        left_out = (every[:0], *(np.array_split(every, folds) if folds else ()))
        seen = tuple(np.setdiff1d(every, flights_out) for flights_out in left_out)
        share = 1.0 - subset
        omitted = [_omitted(flight_of, flights_in, members, share, split, random) for flights_in in seen]
        visible = [np.tile(np.isin(flight_of, flights_in), (members, 1)) for flights_in in seen]
        trained = np.concatenate(visible) & ~np.concatenate(omitted)
        return cls(members, unit, trained, np.concatenate(omitted), left_out, seen)

    def __len__(self) -> int:
        """Number of ensembles."""
        return len(self.seen)

    def networks(self, ensemble: int) -> slice:
        """The networks of an ensemble."""
        return slice(ensemble * self.members, (ensemble + 1) * self.members)

    def unseen(self, ensemble: int) -> Flags:
        """Which samples (B, N) the members of an ensemble leave out."""
        return self.omitted[self.networks(ensemble)][:, self.unit]


def _units(
    flights: Indices, split: Split, random: np.random.Generator
) -> tuple[npt.NDArray[np.int32], Indices]:
    """Unit of each sample (N,) and flight of each unit (U,)."""
    count = int(flights.max()) + 1
    parts = _PARTS if split == "flight" else -(-_SAMPLE_UNITS // count)
    part = np.empty(len(flights), dtype=np.int64)
    for flight in range(count):
        mine = np.flatnonzero(flights == flight)
        in_order = np.arange(len(mine)) * parts // len(mine)
        part[mine] = in_order if split == "flight" else random.permutation(in_order)
    return (flights * parts + part).astype(np.int32), np.repeat(np.arange(count), parts)


def _omitted(
    flight_of: Indices, seen: Indices, members: int, share: float, split: Split, random: np.random.Generator
) -> Flags:
    """Units (B, U) that each member of an ensemble leaves out.

    Members take turns through an order that chance gives, so that all are left out about equally often.
    """
    if split == "flight" and len(seen) >= _FEWEST_FLIGHTS:
        pieces = flight_of == seen[:, None]
    else:
        pieces = np.eye(len(flight_of), dtype=bool)[np.isin(flight_of, seen)]
    size = max(1, round(share * len(pieces)))
    rounds = -(-members * size // len(pieces))
    order = np.concatenate([random.permutation(len(pieces)) for _ in range(rounds)])[: members * size]
    omitted: Flags = pieces[order].reshape(members, size, -1).any(axis=1)
    return omitted
