# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The regression behind the search: residual, tolerances, candidates and their forms, among frequencies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quadpi_core.discrepancy.candidates import Candidate, linearise
from quadpi_core.discrepancy.effect_response import Compared, body_tolerances, share_of_wrench
from quadpi_core.discrepancy.evidence import Block, Fit, Indices, fit, fit_forms, residual_weights
from quadpi_core.discrepancy.whitening import Spectrum, band_means, cross_gram, estimate_noise, spectrum
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.simulation.applied_effects import state_modulators
from quadpi_core.simulation.effect_definition import SHAPE
from quadpi_core.simulation.effect_registry import EFFECTS

# Of an effect whose law may be off: share by which its axes may differ, over that by which it may change.
_AXES_OVER_FORM = 1.5
# Of a prior: step of a difference quotient. Rounds in which columns and what they explain settle together.
_SMALL, _ROUNDS = 1e-3, 2
_NONE: Indices = np.empty(0, dtype=np.intp)


class Design:
    """Columns of all flights, one block per candidate.

    Column 0 is the residual, then come the tolerances, then the blocks. A block that is made anew about
    another point stands behind those that are there; its old columns are left where they are.

    Attributes:
        flights: F flights.
        candidates: that blocks belong to.
        points: per candidate, the free parameters that it is linearised at.
        blocks: per candidate, its columns.
        tolerance_names, tolerances: names and indices of the columns of tolerances.
        bands: per flight (B,) the band of each row.
        noise: (6, BANDS) variance of the noise.
        per_flight: (F, K, K) Gram matrices of the columns, whitened.
    """

    def __init__(self, flights: Sequence[Compared], candidates: Sequence[Candidate]) -> None:
        self.flights, self.candidates = flights, candidates
        raw = [state_modulators(flight.states, flight.record) for flight in flights]
        self._mean, self._deviation = _scales(raw)
        # Per flight (M, C): what an effect may depend on other than its law says.
        self._modulators = [(own - self._mean) / self._deviation for own in raw]
        self._tables: list[list[Array]] = [[] for _ in flights]
        self.bands: list[Indices] = []
        self.points: list[Array] = []
        self.blocks: list[Block] = []
        # Per candidate whose form may be off, its columns in time.
        self._in_time: dict[int, list[Array]] = {}
        uncertain = [flight.uncertain() for flight in flights]
        self.tolerance_names = [column.name for column in uncertain[0]]
        self.tolerances: Indices = np.arange(1, 1 + len(self.tolerance_names))
        for place, (flight, columns) in enumerate(zip(flights, uncertain, strict=True)):
            table = np.stack((flight.residual, *(column.wrench for column in columns)), axis=2)
            self.bands.append(self._append(place, table))
        for index, candidate in enumerate(candidates):
            self.points.append(np.zeros(len(candidate.free)))
            self.blocks.append(self._linearised(index))
        self.weigh(self._estimated_noise(()))
        self._accelerate()

    def _accelerate(self) -> None:
        """Columns of another mass or inertia, of the accelerations that all columns together explain.

        As measured, accelerations would explain their own noise; as simulated, they are off by all that is
        looked for, times the change of mass or inertia.
        """
        shares = self._shares()
        columns = np.array(list(shares))
        measured = [_rows(flight, flight.measured) for flight in self.flights]
        accelerated = [_rows(flight, flight.expected_measured) for flight in self.flights]
        for _ in range(_ROUNDS):
            left = self._left_of_everything()
            for place, tables in enumerate(self._tables):
                explained = measured[place] - self.combined(place, left)
                change = explained - accelerated[place]
                accelerated[place] = explained
                for (table, at), share in zip(_places(tables, columns), shares.values(), strict=True):
                    tables[table][:, :, at] += share @ change
            self.weigh(self._estimated_noise(()))

    def _shares(self) -> dict[int, Array]:
        """Share (6, 6) of the wrench in each column of another mass or inertia, by its index."""
        simulation = self.flights[0].simulation
        shares = {}
        for name, deviation in body_tolerances(simulation.tolerances):
            effect = EFFECTS[name]
            for values, p in zip(deviation * np.eye(len(effect.parameters)), effect.parameters, strict=True):
                if effect.kind == "vehicle":
                    column = 1 + self.tolerance_names.index(f"{name}.{p.name}")
                    shares[column] = share_of_wrench(effect, simulation.vehicle, values)
        for candidate, block in zip(self.candidates, self.blocks, strict=True):
            if candidate.effect.kind == "vehicle":
                for column, values in zip(block.parameters, np.diag(candidate.scale), strict=True):
                    small = share_of_wrench(candidate.effect, simulation.vehicle, _SMALL * values)
                    shares[int(column)] = small / _SMALL
        return shares

    def _left_of_everything(self) -> Array:
        """Weights (K,) of what tolerances and every effect that is linear leave together."""
        columns = self._linear_columns()
        matrix = self.gram[np.ix_(columns, columns)] + np.eye(len(columns))
        weights = residual_weights(self._width, ())
        weights[columns] = -np.linalg.solve(matrix, self.gram[columns, 0])
        return weights

    def _estimated_noise(self, chosen: Sequence[int]) -> Array:
        """Noise (6, BANDS) that tolerances, every effect that is linear, and those chosen leave."""
        residual = residual_weights(self._width, [self.blocks[index] for index in chosen])
        parts = [self._linear_columns()]
        for index in chosen:
            parts.append(self.blocks[index].form)
            if self.blocks[index].offset is not None:
                parts.append(self.blocks[index].parameters)
        columns = np.concatenate(parts)
        return estimate_noise(
            [
                Spectrum(np.dstack((self.combined(place, residual), self.rows(place, columns))), band)
                for place, band in enumerate(self.bands)
            ]
        )

    def _linear_columns(self) -> Indices:
        linear = [block.parameters for block in self.blocks if block.offset is None]
        return np.concatenate([self.tolerances, *linear])

    def weigh(self, noise: Array) -> None:
        """Take another noise (6, BANDS)."""
        self.noise = noise
        self.per_flight = np.zeros((len(self.flights), 0, 0))
        self._weighted: list[list[Array]] = [[] for _ in self.flights]
        self.refresh()

    def state(self) -> tuple[Array, list[Array], list[Block]]:
        """What :meth:`restore` takes: noise, points and blocks. Columns are only ever added."""
        return self.noise, list(self.points), list(self.blocks)

    def restore(self, state: tuple[Array, list[Array], list[Block]]) -> None:
        """Go back to an earlier :meth:`state`."""
        noise, self.points, self.blocks = state
        if noise is not self.noise:
            self.weigh(noise)

    def noise_beside(self, chosen: Sequence[int], found: Fit) -> Array:
        """Noise (6, BANDS) where some effects are taken for granted.

        What they leave counts as noise where it is more: a law that is a little off would otherwise call for
        another effect to mend it.
        """
        left = [np.square(rows) for rows in self.left(found)]
        return np.maximum(self._estimated_noise(chosen), band_means(left, self.bands))

    @property
    def gram(self) -> Array:
        """Gram matrix (K, K) of all flights."""
        return self._gram

    def rows(self, place: int, columns: Indices) -> Array:
        """Some columns (6, B, k) of a flight."""
        tables = self._tables[place]
        taken = [tables[t][:, :, at] for t, at in _places(tables, columns)]
        return np.stack(taken, axis=2)

    def combined(self, place: int, weights: Array) -> Array:
        """Sum (6, B) of the columns of a flight, each times its weight (K,); later columns have none."""
        total = np.zeros((len(AXES), len(self.bands[place])))
        for start, table in zip(_starts(self._tables[place]), self._tables[place], strict=True):
            own = weights[start : start + table.shape[2]]
            if own.any():
                total += table[:, :, : len(own)] @ own
        return total

    def refresh(self) -> None:
        """Bring the Gram matrices up to date with columns that were added."""
        known = self.per_flight.shape[1]
        width = self._width
        if width == known:
            return
        grown = np.zeros((len(self.flights), width, width))
        grown[:, :known, :known] = self.per_flight
        for place, band in enumerate(self.bands):
            weights = 1.0 / np.sqrt(self.noise[:, band])
            done = self._weighted[place]
            fresh = [rows * weights[:, :, None] for rows in self._tables[place][len(done) :]]
            added = np.concatenate(fresh, axis=2)
            for first, rows in zip(_starts(done), done, strict=True):
                block = cross_gram(rows, added)
                grown[place, first : first + rows.shape[2], known:] = block
                grown[place, known:, first : first + rows.shape[2]] = block.T
            grown[place, known:, known:] = cross_gram(added, added)
            done.extend(fresh)
        self.per_flight = grown
        self._gram: Array = grown.sum(axis=0)

    @property
    def _width(self) -> int:
        return sum(table.shape[2] for table in self._tables[0])

    def _append(self, place: int, table: Array) -> Indices:
        """Append columns (M, 6, K) of a flight; gives the band of each row."""
        found = spectrum(table, self.flights[place].thinned.rate_hz)
        self._tables[place].append(found.rows)
        return found.band

    def _linearised(self, index: int) -> Block:
        """Append the columns of a candidate about its point."""
        candidate, at, first = self.candidates[index], self.points[index], self._width
        found = linearise(candidate, self.flights, at)
        if candidate.linear and candidate.form > 0.0:
            self._in_time[index] = [columns for _, columns in found]
        for place, (here, columns) in enumerate(found):
            offset = columns @ (at / candidate.scale) - here
            added = [columns] if candidate.linear else [columns, offset[:, :, None]]
            self._append(place, np.concatenate(added, axis=2))
        bounds = [candidate.effect.parameters[free] for free in candidate.free]
        return Block(
            parameters=np.arange(first, first + len(at)),
            form=_NONE,
            formed_at=1.0,
            offset=None if candidate.linear else first + len(at),
            lowest=np.array([p.lowest for p in bounds]) / candidate.scale,
            highest=np.array([p.highest for p in bounds]) / candidate.scale,
        )

    def move(self, index: int, at: Array) -> None:
        """Linearise a candidate about a point and let its form differ in proportion to its size there."""
        self.points[index] = at
        candidate = self.candidates[index]
        if not candidate.linear:
            self.blocks[index] = self._linearised(index)
        size = float(np.linalg.norm(at / candidate.scale))
        if size == 0.0 or candidate.form == 0.0:
            return
        first = self._width
        for place, flight in enumerate(self.flights):
            here = (
                self._in_time[index][place] @ (at / candidate.scale)
                if candidate.linear
                else flight.added(candidate.effect, candidate.values(at))
            )
            self._append(place, self._form(candidate, here, place))
        form = np.arange(first, self._width)
        self.blocks[index] = replace(self.blocks[index], form=form, formed_at=size)

    def _form(self, candidate: Candidate, here: Array, place: int) -> Array:
        """Columns (M, 6, C): how the contribution of an effect may differ from its law."""
        share = candidate.form
        columns = []
        for axis, name in enumerate(AXES):
            if name in candidate.effect.axes:
                single = np.zeros_like(here)
                single[:, axis] = _AXES_OVER_FORM * share * here[:, axis]
                columns.append(single)
        columns += [share * here * modulator[:, None] for modulator in self._modulators[place].T]
        return np.stack(columns, axis=2)

    def shape(self, index: int, law: Fit, found: Fit) -> dict[str, float]:
        """Parameters of `simulation.effects.SHAPE` by which a fit shapes the law of a candidate.

        Args:
            index: of the candidate.
            law: fit that its parameters are of.
            found: see :meth:`fit_shapes`.
        """
        candidate, block = self.candidates[index], self.blocks[index]
        size = float(np.linalg.norm(law.of(block.parameters)))
        weights = candidate.form * found.of(block.form)
        if not weights.any() or size == 0.0:
            return {}
        # The columns are made of an effect of another size.
        weights *= block.formed_at / size
        axes = [AXES.index(name) for name in candidate.effect.axes]
        slopes = weights[len(axes) :] / self._deviation
        shares = np.zeros(len(AXES))
        shares[axes] = _AXES_OVER_FORM * weights[: len(axes)] - slopes @ self._mean
        shape = zip(SHAPE, np.concatenate((shares, slopes)), strict=True)
        return {p.name: float(np.clip(value, p.lowest, p.highest)) for p, value in shape if value}

    def fit(self, chosen: Sequence[int], gram: Array | None = None, *, form: bool = True) -> Fit | None:
        """Fit a set of candidates, by their indices, with or without the columns of their form.

        See :func:`evidence.fit`.
        """
        blocks = [self.blocks[i] if form else replace(self.blocks[i], form=_NONE) for i in chosen]
        return fit(self.gram if gram is None else gram, self.tolerances, blocks)

    def fit_shapes(self, chosen: Sequence[int], shaped: Sequence[int], law: Fit, gram: Array) -> Fit:
        """Fit tolerances and the forms of some of those chosen, whose parameters stay those of `law`.

        See :func:`evidence.fit_forms`.
        """
        blocks = {index: self.blocks[index] for index in chosen}
        return fit_forms(gram, self.tolerances, list(blocks.values()), law, [blocks[i] for i in shaped])

    def even_grams(self, chosen: Sequence[int]) -> Array:
        """Gram matrices (F, K, K) in which all frequencies count alike, in units of the fastest noise.

        Only of the residual, the tolerances and the candidates chosen; 0 for all other columns.
        """
        parts = [np.zeros(1, dtype=np.intp), self.tolerances]
        for block in (self.blocks[index] for index in chosen):
            offset = [] if block.offset is None else [block.offset]
            parts += [block.parameters, block.form, np.array(offset, dtype=np.intp)]
        columns = np.concatenate(parts)
        grams = np.zeros((len(self.flights), self._width, self._width))
        for place in range(len(self.flights)):
            rows = self.rows(place, columns) / np.sqrt(self.noise[:, -1])[:, None, None]
            grams[place][np.ix_(columns, columns)] = cross_gram(rows, rows)
        return grams

    def left(self, found: Fit) -> list[Array]:
        """Rows (6, B) of each flight that a fit leaves of the residual."""
        return [self.combined(place, found.left) for place in range(len(self.flights))]

    def loudness(self, index: int, found: Fit) -> float:
        """Root mean square of what a candidate adds in a fit over that of the noise, in its loudest axis."""
        squares, noise = np.zeros(len(AXES)), np.zeros(len(AXES))
        for place, band in enumerate(self.bands):
            squares += np.square(self._adds(place, (index,), found)).sum(axis=1)
            noise += self.noise[:, band].sum(axis=1)
        return float(np.sqrt(np.max(squares / noise)))

    def energy(self, chosen: Sequence[int], found: Fit) -> float:
        """Half of the squares of what candidates add in a fit, in variances of the noise."""
        squares = 0.0
        for place, band in enumerate(self.bands):
            squares += float(np.sum(np.square(self._adds(place, chosen, found)) / self.noise[:, band]))
        return 0.5 * squares

    def _adds(self, place: int, chosen: Sequence[int], found: Fit) -> Array:
        """Rows (6, B) that candidates add to a flight in a fit."""
        weights = np.zeros(self._width)
        for index in chosen:
            block = self.blocks[index]
            weights[block.parameters] = found.of(block.parameters)
            if block.offset is not None:
                weights[block.offset] = -1.0
        return self.combined(place, weights)

    def parameters(self, index: int, found: Fit) -> Array:
        """Free parameters (k,) of a candidate in a fit, brought within their bounds."""
        candidate = self.candidates[index]
        return candidate.within_bounds(found.of(self.blocks[index].parameters) * candidate.scale)


def _rows(flight: Compared, wrench: Array) -> Array:
    """Rows (6, B) of a wrench (M, 6)."""
    return spectrum(wrench[:, :, None], flight.thinned.rate_hz).rows[:, :, 0]


def _starts(tables: Sequence[Array]) -> list[int]:
    """Index of the first column of each of the tables (6, B, ·)."""
    return [0, *np.cumsum([table.shape[2] for table in tables])[:-1].tolist()] if tables else []


def _places(tables: Sequence[Array], columns: Indices) -> list[tuple[int, int]]:
    """Which of the tables (6, B, ·) each column is in, and where in it."""
    starts = _starts(tables)
    within = np.searchsorted(starts, columns, side="right") - 1
    return [(int(table), int(column - starts[table])) for table, column in zip(within, columns, strict=True)]


def _scales(modulators: Sequence[Array]) -> tuple[Array, Array]:
    """Mean and deviation (C,) over all flights (M, C)."""
    everything = np.concatenate(modulators)
    return everything.mean(axis=0), np.maximum(everything.std(axis=0), 1e-9)
