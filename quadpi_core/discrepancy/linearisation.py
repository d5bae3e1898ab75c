# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of the regression in frequency: residual, tolerances and candidates of all flights."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from quadpi_core.discrepancy.candidates import Candidate, candidates, first_point, linearise, start_cost
from quadpi_core.discrepancy.effect_response import Compared, body_tolerances, share_of_wrench
from quadpi_core.discrepancy.evidence import Block, Indices
from quadpi_core.discrepancy.simulations import Column, Tolerances
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.simulation.applied_effects import state_modulators
from quadpi_core.thresholds import DEVELOPMENT, Threshold

AXES_OVER_FORM = Threshold(
    "share of a single axis by which a law may be off",
    1.5,
    "shares by which the whole law may be off",
    "two laws of the literature for one effect differ more from axis to axis than in their mean",
    DEVELOPMENT,
)
# Step of the difference quotient in a vehicle parameter, in prior standard deviations.
_VEHICLE_STEP = 1e-3
# Smallest standard deviation of a modulator that is divided by: one that is constant has none.
_LEAST_DEVIATION = 1e-9
NO_COLUMNS: Indices = np.empty(0, dtype=np.intp)


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


@dataclass(frozen=True)
class Linearisation:
    """Columns of all flights about one point per candidate; immutable, a move gives another value.

    Column 0 is the residual; the tolerances follow, then the blocks of the candidates. The columns are held
    in tables, and columns are only appended: a candidate that has moved gets a new block at the end, and no
    other index changes.

    Attributes:
        flights: F flights.
        candidates: the candidates of the blocks.
        points: free parameters at which each candidate is linearised.
        blocks: columns of each candidate.
        tolerance_names, tolerances: names and indices of the columns of the tolerances.
        tolerance_laws: for each the name of the one of what it shares with others; empty without.
        bands: per flight (B,) the frequency band of each row.
        tables: per flight, tables (6, B, ·) of columns.
        errors: per flight (6, B, E) independent deviations of the known errors of the simulation, and of what
            flights have of their own, each by its standard deviation. They are noise, in no table.
    """

    flights: tuple[Compared, ...]
    candidates: tuple[Candidate, ...]
    points: tuple[Array, ...]
    blocks: tuple[Block, ...]
    tolerance_names: tuple[str, ...]
    tolerance_laws: tuple[str, ...]
    tolerances: Indices
    bands: tuple[Indices, ...]
    tables: tuple[tuple[Array, ...], ...]
    modulators: Modulators
    errors: tuple[Array, ...]
    # Columns in time per flight, by the index of a linear candidate whose law may be off.
    _in_time: Mapping[int, list[Array]] = field(repr=False)

    @classmethod
    def of(cls, flights: Sequence[Compared], sought: Sequence[Candidate]) -> Linearisation:
        """Every candidate linearised at no effect."""
        uncertain = _felt([flight.uncertain() for flight in flights], flights[0].simulation.tolerances)
        names = tuple(column.name for column in uncertain[0])
        first = [
            flight.spectrum(np.stack((flight.residual, *(column.wrench for column in columns)), axis=2))
            for flight, columns in zip(flights, uncertain, strict=True)
        ]
        value = cls(
            flights=tuple(flights),
            candidates=tuple(sought),
            points=tuple(first_point(candidate, flights) for candidate in sought),
            blocks=(),
            tolerance_names=names,
            tolerance_laws=tuple(column.law for column in uncertain[0]),
            tolerances=np.arange(1, 1 + len(names)),
            bands=tuple(found.band for found in first),
            tables=tuple((found.rows,) for found in first),
            modulators=Modulators.of(flights),
            errors=tuple(found.rows[:, :, :0] for found in first),
            _in_time={},
        )
        for index in range(len(sought)):
            value = value._with_block(index)
        return value._beside_known_errors()

    @property
    def width(self) -> int:
        """Number of columns."""
        return sum(table.shape[2] for table in self.tables[0])

    @property
    def linear_columns(self) -> Indices:
        """Indices of the columns of the tolerances and of the parameters of every linear candidate."""
        linear = [block.parameters for block in self.blocks if block.offset is None]
        return np.concatenate([self.tolerances, *linear])

    def rows(self, place: int, columns: Indices) -> Array:
        """Some columns (6, B, k) of a flight."""
        tables = self.tables[place]
        return np.stack([tables[t][:, :, at] for t, at in _located(tables, columns)], axis=2)

    def combined(self, place: int, weights: Array) -> Array:
        """Sum (6, B) of the columns of a flight, each times its weight (K,); further columns have none."""
        total = np.zeros((len(AXES), len(self.bands[place])))
        for start, table in zip(table_starts(self.tables[place]), self.tables[place], strict=True):
            own = weights[start : start + table.shape[2]]
            if own.any():
                total += table[:, :, : len(own)] @ own
        return total

    def squares(self, weights: Array, noise: Array | None = None) -> Array:
        """Squares (6,) of the sum of the columns, each times its weight (K,), over all flights.

        They are in variances of a noise (6, C) of C bands where it is given.
        """
        squares = np.zeros(len(AXES))
        for place, band in enumerate(self.bands):
            rows = np.square(self.combined(place, weights))
            squares += np.sum(rows if noise is None else rows / noise[:, band], axis=1)
        return squares

    def squares_of_each(self, wanted: Indices, noise: Array) -> Array:
        """Squares (6, k) of k columns by themselves over all flights, in variances of a noise (6, C)."""
        squares = np.zeros((len(AXES), len(wanted)))
        for place, band in enumerate(self.bands):
            squares += np.sum(np.square(self.rows(place, wanted)) / noise[:, band, None], axis=1)
        return squares

    def moved(self, points: Mapping[int, Array]) -> Linearisation:
        """The linearisation about other points of candidates, by index, with form columns for their sizes."""
        value = self
        for index, at in points.items():
            moved = replace(value, points=_with(value.points, index, at))
            if not self.candidates[index].linear:
                moved = moved._with_block(index)
            value = moved._with_form(index)
        return value

    def remade(self, flights: Sequence[Compared], chosen: Sequence[int]) -> Linearisation:
        """The linearisation with some candidates, by index, made of the flights beside another simulation.

        Residual, tolerances, and all other candidates stay those of the first.
        """
        value = replace(self, flights=tuple(flights))
        for index in chosen:
            value = value._with_block(index)._with_form(index)
        return replace(value, flights=self.flights)

    def accelerated(self, changes: Sequence[Array]) -> Linearisation:
        """The linearisation with the columns of mass and inertia made of other accelerations.

        Args:
            changes: per flight, rows (6, B) by which the wrench of the vehicle's accelerations changed.
        """
        shares = self._vehicle_shares()
        columns = np.array(list(shares), dtype=np.intp)
        tables = []
        for own, change in zip(self.tables, changes, strict=True):
            copies = list(own)
            located = _located(own, columns)
            for table in {table for table, _ in located}:
                copies[table] = own[table].copy()
            for (table, at), share in zip(located, shares.values(), strict=True):
                copies[table][:, :, at] += share @ change
            tables.append(tuple(copies))
        return replace(self, tables=tuple(tables))

    def _vehicle_shares(self) -> dict[int, Array]:
        """Share (6, 6) of the wrench in each column of another mass or inertia, by the column's index."""
        simulation = self.flights[0].simulation
        shares = {}
        for effect, deviation in body_tolerances(simulation.tolerances):
            for values, p in zip(deviation * np.eye(len(effect.parameters)), effect.parameters, strict=True):
                if effect.kind == "vehicle":
                    column = 1 + self.tolerance_names.index(f"{effect.name}.{p.name}")
                    shares[column] = share_of_wrench(effect, simulation.vehicle, values)
        for candidate, block in zip(self.candidates, self.blocks, strict=True):
            if candidate.effect.kind == "vehicle":
                for column, values in zip(block.parameters, np.diag(candidate.scale), strict=True):
                    small = share_of_wrench(candidate.effect, simulation.vehicle, _VEHICLE_STEP * values)
                    shares[int(column)] = small / _VEHICLE_STEP
        return shares

    def _beside_known_errors(self) -> Linearisation:
        """The linearisation of the residual less what sound flights leave, with columns of its deviations."""
        sound = self.flights[0].simulation.sound
        if sound is None:
            return self
        rows = self._rows_of_parameters({label for label, _ in sound.names})
        if unknown := [label for label, parameter in sound.names if (label, parameter) not in rows]:
            raise DiscrepancyError(
                f"{self.flights[0].simulation.name}: knows an error of {unknown[0]}, which is no effect "
                "here: install what it came from, or identify the model again"
            )
        deviations = sound.deviations(len(self.flights))
        tables, errors = [], []
        for place, (first, *others) in enumerate(self.tables):
            known = np.zeros((*first.shape[:2], len(sound.names)))
            for k, name in enumerate(sound.names):
                known[:, :, k] = rows[name][place]
            changed = first.copy()
            changed[:, :, 0] -= known @ sound.mean
            tables.append((changed, *others))
            errors.append(known @ deviations)
        return replace(self, tables=tuple(tables), errors=tuple(errors))

    def with_flights_own(self, index: int, sizes: Array) -> Linearisation:
        """The linearisation with the parameters of a candidate as a part of the noise that each flight has.

        Args:
            index: of the candidate.
            sizes: (F, k) standard deviation of each parameter of each flight, in prior ones.
        """
        columns = self.blocks[index].parameters
        errors = [
            np.concatenate((own, self.rows(place, columns) * sizes[place]), axis=2)
            for place, own in enumerate(self.errors)
        ]
        return replace(self, errors=tuple(errors))

    def _rows_of_parameters(self, labels: Collection[str]) -> dict[tuple[str, str], list[Array]]:
        """Rows (6, B) of each flight by candidate and parameter, per unit of it about no effect."""
        blocks = {own.label: block for own, block in zip(self.candidates, self.blocks, strict=True)}
        rows: dict[tuple[str, str], list[Array]] = {}
        for candidate in candidates(self.flights[0].simulation.vehicle):
            if candidate.label not in labels:
                continue
            block = blocks.get(candidate.label)
            if block is not None:
                each = [self.rows(place, block.parameters) for place in range(len(self.flights))]
            else:
                found = linearise(candidate, self.flights, np.zeros(len(candidate.free)))
                pairs = zip(self.flights, found, strict=True)
                each = [flight.spectrum(columns).rows for flight, (_, columns) in pairs]
            for k, free in enumerate(candidate.free):
                name = candidate.label, candidate.effect.parameters[free].name
                rows[name] = [own[:, :, k] / candidate.scale[k] for own in each]
        return rows

    def _with_block(self, index: int) -> Linearisation:
        """The linearisation with a new block of columns of a candidate about its point."""
        candidate, at, first = self.candidates[index], self.points[index], self.width
        # One that is all but linear is so about no effect.
        found = linearise(candidate, self.flights, np.zeros_like(at) if candidate.linear else at)
        in_time = self._in_time
        if candidate.linear and candidate.form > 0.0:
            in_time = {**in_time, index: [columns for _, columns in found]}
        added = []
        for here, columns in found:
            offset = columns @ ((at - candidate.centre) / candidate.scale) - here
            added.append(
                columns if candidate.linear else np.concatenate((columns, offset[:, :, None]), axis=2)
            )
        bounds = [candidate.effect.parameters[free] for free in candidate.free]
        block = Block(
            parameters=np.arange(first, first + len(at)),
            form=NO_COLUMNS,
            formed_at=1.0,
            offset=None if candidate.linear else first + len(at),
            at=(at - candidate.centre) / candidate.scale,
            lowest=(np.array([p.lowest for p in bounds]) - candidate.centre) / candidate.scale,
            highest=(np.array([p.highest for p in bounds]) - candidate.centre) / candidate.scale,
            cost=start_cost(candidate, self.flights, at),
        )
        appended = self._appended(added)
        return replace(appended, blocks=_with(self.blocks, index, block), _in_time=in_time)

    def _with_form(self, index: int) -> Linearisation:
        """The linearisation with columns for the error of a candidate's law, in proportion to its size."""
        candidate, at = self.candidates[index], self.points[index]
        size = float(np.linalg.norm(at / candidate.scale))
        if size == 0.0 or candidate.form == 0.0:
            return self
        added = []
        for place, flight in enumerate(self.flights):
            here = (
                self._in_time[index][place] @ (at / candidate.scale)
                if candidate.linear
                else flight.added(candidate.effect, candidate.values(at))
            )
            added.append(self._form(candidate, here, place))
        appended = self._appended(added)
        form = np.arange(self.width, appended.width)
        block = replace(self.blocks[index], form=form, formed_at=size)
        return replace(appended, blocks=_with(self.blocks, index, block))

    def _form(self, candidate: Candidate, here: Array, place: int) -> Array:
        """Columns (M, 6, C): shares of the contribution, axis by axis, then times each modulator."""
        share = candidate.form
        columns = []
        for axis, name in enumerate(AXES):
            if name in candidate.effect.axes:
                single = np.zeros_like(here)
                single[:, axis] = AXES_OVER_FORM.value * share * here[:, axis]
                columns.append(single)
        columns += [share * here * modulator[:, None] for modulator in self.modulators.values[place].T]
        return np.stack(columns, axis=2)

    def _appended(self, columns: Iterable[Array]) -> Linearisation:
        """The linearisation with further columns, (M, 6, K) in time of each flight."""
        tables = tuple(
            (*own, flight.spectrum(added).rows)
            for own, added, flight in zip(self.tables, columns, self.flights, strict=True)
        )
        return replace(self, tables=tables)


def _felt(uncertain: Sequence[list[Column]], tolerances: Tolerances) -> list[list[Column]]:
    """The columns of each flight without those of coefficients that are zero in every flight.

    Those of the body, which come last, stay: moves make them of other accelerations.
    """
    body = sum(len(effect.parameters) for effect, _ in body_tolerances(tolerances))
    everything = range(len(uncertain[0]))
    kept = [
        index
        for index in everything
        if index >= len(everything) - body or any(np.any(own[index].wrench) for own in uncertain)
    ]
    return [[own[index] for index in kept] for own in uncertain]


def table_starts(tables: Sequence[Array]) -> list[int]:
    """Index of the first column of each of the tables (6, B, ·)."""
    return [0, *np.cumsum([table.shape[2] for table in tables])[:-1].tolist()] if tables else []


def _located(tables: Sequence[Array], columns: Indices) -> list[tuple[int, int]]:
    """Table (6, B, ·) and index in that table of each column."""
    starts = table_starts(tables)
    within = np.searchsorted(starts, columns, side="right") - 1
    return [(int(table), int(column - starts[table])) for table, column in zip(within, columns, strict=True)]


def _with(values: tuple, index: int, value: object) -> tuple:  # type: ignore[type-arg]
    """The values with one of them replaced, or appended at the end."""
    return (*values[:index], value, *values[index + 1 :])
