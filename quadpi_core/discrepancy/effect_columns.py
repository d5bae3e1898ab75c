# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of what a simulation may be wrong by, in frequency: tolerances, effects, and the form of laws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quadpi_core.discrepancy.candidates import Candidate, linearise, start_cost
from quadpi_core.discrepancy.effect_response import Compared, body_tolerances, share_of_wrench
from quadpi_core.discrepancy.evidence import Block
from quadpi_core.discrepancy.whitening import Columns
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.simulation.applied_effects import state_modulators
from quadpi_core.thresholds import DEVELOPMENT, Threshold

# Smallest standard deviation of a modulator that is divided by: one that is constant has none.
_LEAST_DEVIATION = 1e-9
AXES_OVER_FORM = Threshold(
    "share of a single axis by which a law may be off",
    1.5,
    "shares by which the whole law may be off",
    "two laws of the literature for one effect differ more from axis to axis than in their mean",
    DEVELOPMENT,
)


@dataclass(frozen=True)
class Modulators:
    """Quantities that a law may depend on beyond its formula, standardised over all flights.

    Attributes:
        mean, deviation: (C,) over all flights.
        values: (M, C) of each flight, standardised.
    """

    mean: Array
    deviation: Array
    values: tuple[Array, ...]

    @classmethod
    def of(cls, flights: Sequence[Compared]) -> Modulators:
        """Modulators of the states of the flights."""
        raw = [state_modulators(flight.states, flight.record) for flight in flights]
        everything = np.concatenate(raw)
        mean, deviation = everything.mean(axis=0), np.maximum(everything.std(axis=0), _LEAST_DEVIATION)
        return cls(mean, deviation, tuple((own - mean) / deviation for own in raw))

    def form(self, candidate: Candidate, flights: Sequence[Compared], at: Array) -> Columns:
        """Columns for the error of a law: shares of its contribution by axis, then times each modulator.

        Args:
            candidate: with that law.
            flights: beside the simulation that it contributes to.
            at: (k,) its free parameters.
        """
        axes = [AXES.index(name) for name in candidate.effect.axes]
        columns = []
        for flight, values in zip(flights, self.values, strict=True):
            here = flight.added(candidate.effect, candidate.values(at))
            single = AXES_OVER_FORM.value * here[:, :, np.newaxis] * np.eye(len(AXES))[:, axes]
            modulated = here[:, :, np.newaxis] * values[:, np.newaxis]
            columns.append(candidate.form * np.concatenate((single, modulated), axis=2))
        return in_frequency(flights, columns)


class Tolerances(NamedTuple):
    """Columns of what is uncertain in a simulation.

    Attributes:
        coefficients, body: of its own coefficients, and of the body.
        names: of all of them.
        laws: for each the name of the one of what it shares with others; empty without.
        shares: (6, 6, k) share of the wrench of the vehicle's accelerations in each of the body.
    """

    coefficients: Columns
    body: Columns
    names: tuple[str, ...]
    laws: tuple[str, ...]
    shares: Array

    @classmethod
    def of(cls, flights: Sequence[Compared]) -> Tolerances:
        """Those of a simulation, without coefficients that no flight feels."""
        simulation = flights[0].simulation
        each = [flight.uncertain() for flight in flights]
        shares = []
        for effect, deviation in body_tolerances(simulation.tolerances):
            for values in deviation * np.eye(len(effect.parameters)):
                moved = effect.kind == "vehicle"
                shares.append(
                    share_of_wrench(effect, simulation.vehicle, values) if moved else np.zeros((6, 6))
                )
        first = len(each[0]) - len(shares)
        felt = [k for k in range(first) if any(np.any(own[k].wrench) for own in each)]
        kept = [*felt, *range(first, len(each[0]))]

        def columns(chosen: Sequence[int]) -> Columns:
            none = [np.zeros((*flight.residual.shape, 0)) for flight in flights]
            of_flights = zip(none, each, strict=True)
            return in_frequency(
                flights, [np.dstack([empty, *(own[k].wrench for k in chosen)]) for empty, own in of_flights]
            )

        return cls(
            coefficients=columns(felt),
            body=columns(range(first, len(each[0]))),
            names=tuple(each[0][k].name for k in kept),
            laws=tuple(each[0][k].law for k in kept),
            shares=np.stack(shares, axis=2) if shares else np.zeros((6, 6, 0)),
        )


def block_of(candidate: Candidate, at: Array, flights: Sequence[Compared]) -> Block:
    """Columns of a candidate about free parameters (k,), without its form."""
    # One that is all but linear is so about no effect.
    found = linearise(candidate, flights, np.zeros_like(at) if candidate.linear else at)
    point = (at - candidate.centre) / candidate.scale
    columns = [
        own if candidate.linear else np.dstack((own, (own @ point - here)[:, :, np.newaxis]))
        for here, own in found
    ]
    bounds = [candidate.effect.parameters[free] for free in candidate.free]
    return Block(
        columns=in_frequency(flights, columns),
        at=point,
        lowest=(np.array([p.lowest for p in bounds]) - candidate.centre) / candidate.scale,
        highest=(np.array([p.highest for p in bounds]) - candidate.centre) / candidate.scale,
        cost=start_cost(candidate, flights, at),
    )


def in_frequency(flights: Sequence[Compared], columns: Sequence[Array]) -> Columns:
    """Columns (M, 6, k) in time of each flight, in frequency."""
    return Columns(tuple(flight.spectrum(own) for flight, own in zip(flights, columns, strict=True)))
