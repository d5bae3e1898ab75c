# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The regression behind the search: residual, tolerances, candidates and their forms, among frequencies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from quadpi_core.discrepancy.candidates import Candidate, linearise
from quadpi_core.discrepancy.contributions import Compared
from quadpi_core.discrepancy.evidence import Block, Fit, Indices, fit
from quadpi_core.discrepancy.whitening import Spectrum, estimate_noise, grams, spectrum
from quadpi_core.flight import AXES
from quadpi_core.frames import Array

# Of an effect whose law may be off: share by which its axes may differ, over that by which it may change.
_AXES_OVER_FORM = 1.5
_NONE: Indices = np.empty(0, dtype=np.intp)


@dataclass
class Design:
    """Columns of all flights, one block per candidate.

    Column 0 is the residual, then come the tolerances, then the blocks.

    Attributes:
        flights: F flights.
        candidates: that blocks belong to.
        points: per candidate, the free parameters that it is linearised at.
    """

    flights: Sequence[Compared]
    candidates: Sequence[Candidate]
    points: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._modulators = _modulators(self.flights)
        uncertain = [flight.uncertain() for flight in self.flights]
        self.tolerance_names = [column.name for column in uncertain[0]]
        self._spectra: list[list[Array]] = []
        self._bands = []
        for flight, columns in zip(self.flights, uncertain, strict=True):
            table = np.stack((flight.residual, *(column.wrench for column in columns)), axis=2)
            found = spectrum(table, flight.thinned.rate_hz)
            self._spectra.append([found.rows])
            self._bands.append(found.band)
        self.tolerances: Indices = np.arange(1, 1 + len(self.tolerance_names))
        self.blocks: list[Block] = []
        for candidate in self.candidates:
            start = (
                np.zeros(len(candidate.free)) if candidate.linear else candidate.start[list(candidate.free)]
            )
            self.blocks.append(self._add(candidate, start, form=False))
            self.points.append(start)
        linear = [block.parameters for block in self.blocks if block.offset is None]
        self.noise = estimate_noise(self.spectra(), np.concatenate([self.tolerances, *linear]))
        self._weigh()

    def spectra(self) -> list[Spectrum]:
        """All columns of each flight."""
        return [
            Spectrum(np.concatenate(rows, axis=2), band)
            for rows, band in zip(self._spectra, self._bands, strict=True)
        ]

    def _weigh(self) -> None:
        self.per_flight = grams(self.spectra(), self.noise)
        self.gram = self.per_flight.sum(axis=0)

    @property
    def _width(self) -> int:
        return sum(rows.shape[2] for rows in self._spectra[0])

    def _add(self, candidate: Candidate, at: Array, *, form: bool) -> Block:
        """Append the columns of a candidate, linearised at a point."""
        first, count = self._width, len(at)
        linear = candidate.linear
        formed = form and candidate.effect.form > 0.0
        for place, (here, columns) in enumerate(linearise(candidate, self.flights, at)):
            added = [columns]
            if not linear:
                added.append((columns @ (at / candidate.scale) - here)[:, :, None])
            if formed:
                added.append(self._form(candidate, here, place))
            table = np.concatenate(added, axis=2)
            self._spectra[place].append(spectrum(table, self.flights[place].thinned.rate_hz).rows)
        after = first + count + (not linear)
        bounds = [candidate.effect.parameters[index] for index in candidate.free]
        return Block(
            parameters=np.arange(first, first + count),
            form=np.arange(after, self._width),
            offset=None if linear else first + count,
            lowest=np.array([p.lowest for p in bounds]) / candidate.scale,
            highest=np.array([p.highest for p in bounds]) / candidate.scale,
        )

    def _form(self, candidate: Candidate, here: Array, place: int) -> Array:
        """Columns (M, 6, C): how the contribution of an effect may differ from its law."""
        share = candidate.effect.form
        columns = []
        for axis, name in enumerate(AXES):
            if name in candidate.effect.axes:
                single = np.zeros_like(here)
                single[:, axis] = _AXES_OVER_FORM * share * here[:, axis]
                columns.append(single)
        columns += [share * here * modulator[:, None] for modulator in self._modulators[place]]
        return np.stack(columns, axis=2)

    def relinearise(self, index: int, at: Array) -> None:
        """Give a candidate other columns: about a point, and those of its form."""
        self.points[index] = at
        self.blocks[index] = self._add(self.candidates[index], at, form=True)

    def refresh(self) -> None:
        """Bring the Gram matrices up to date after :meth:`relinearise`."""
        self._weigh()

    def fit(self, chosen: Sequence[int], gram: Array | None = None, *, form: bool = True) -> Fit | None:
        """Fit a set of candidates, by their indices, with or without the columns of their form.

        See :func:`evidence.fit`.
        """
        blocks = [self.blocks[i] if form else replace(self.blocks[i], form=_NONE) for i in chosen]
        return fit(self.gram if gram is None else gram, self.tolerances, blocks)

    def weights(self, found: Fit) -> Array:
        """Weight (K,) of each column in what a fit leaves of the residual."""
        weights = np.zeros(self.gram.shape[0])
        weights[0] = 1.0
        weights[found.columns] -= found.coefficients
        for block in self.blocks:
            if block.offset is not None and np.isin(block.parameters, found.columns).any():
                weights[block.offset] += 1.0
        return weights

    def left(self, found: Fit) -> list[Array]:
        """Rows (6, B) of each flight that a fit leaves of the residual."""
        weights = self.weights(found)
        return [flight.rows @ weights for flight in self.spectra()]

    def parameters(self, index: int, found: Fit) -> Array:
        """Free parameters (k,) of a candidate in a fit."""
        return found.of(self.blocks[index].parameters) * self.candidates[index].scale


def _modulators(flights: Sequence[Compared]) -> list[Array]:
    """Per flight (C, M): what an effect may depend on other than its law says, of mean 0 and deviation 1."""
    raw = []
    for flight in flights:
        states = flight.states
        velocity = states["velocity_air"]
        load = np.square(states["rotor_speeds"]).mean(axis=1)
        height = np.maximum(-states["position"][:, 2], flight.simulation.vehicle.rotor_radius_m)
        raw.append(
            np.stack(
                (
                    np.linalg.norm(velocity, axis=1),
                    *velocity.T,
                    load,
                    np.linalg.norm(states["rates"], axis=1),
                    1.0 / height,
                )
            )
        )
    everything = np.concatenate(raw, axis=1)
    mean, deviation = everything.mean(axis=1), everything.std(axis=1)
    return [(own - mean[:, None]) / np.maximum(deviation, 1e-9)[:, None] for own in raw]
