# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Regression of residuals on the effects of a search, as immutable values: columns, noise, and fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.discrepancy.candidates import Candidate
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.evidence import Block, Fit, evidence_at, fit, residual_weights
from quadpi_core.discrepancy.linearisation import NO_COLUMNS, Linearisation, table_starts
from quadpi_core.discrepancy.whitening import Spectrum, band_means, cross_gram, estimate_noise
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.sound_flights import SoundFlights
from quadpi_core.thresholds import CONVENTION, Threshold

# Rounds in which the columns of mass and inertia and the accelerations that all columns explain converge.
_ACCELERATION_ROUNDS = 2
# Steps to the point of linearisation of candidates.
_ROUNDS = 3
# Rounds in which the sizes of a condition converge, and the least of them, in prior deviations.
_CONDITION_ROUNDS, _LEAST_DIFFERENCE = 12, 1e-4
# Precision of what flights share of it, in prior ones.
_FREE = 1e-4
TAILS = Threshold(
    "tails of what flights have of their own",
    1.0,
    "degrees of freedom of Student's t",
    "most flights are alike, and one with a turned IMU differs by ten times as much: it must not hide "
    "what the others share",
    CONVENTION,
)
# Axes of a simulation that states no intervals.
NONE_HELD = np.zeros(len(AXES), dtype=np.bool_)
SMALL_STEP = Threshold(
    "step to another point of linearisation",
    0.05,
    "prior standard deviations",
    "a third of the smallest size that is named: columns hardly change over less",
    CONVENTION,
)


class Reduction(NamedTuple):
    """Squares by which effects reduce the residual, axis by axis.

    Attributes:
        fitted, stated: (6,) with the coefficients of the simulation as fitted, and as stated.
    """

    fitted: Array
    stated: Array

    @property
    def credited(self) -> Array:
        """Squares (6,) that speak for the effects: where coefficients undo what they add, not the whole."""
        smaller: Array = np.minimum(self.fitted, self.stated)
        return smaller


@dataclass(frozen=True)
class NoiseWeighting:
    """Columns weighted by the noise, and their Gram matrices.

    Attributes:
        noise: (6, C) variance in C bands of frequency.
        held: axes (6,) that say nothing, as the simulation's own intervals hold them; their weight is 0.
        per_flight: (F, K, K) Gram matrices of the whitened columns.
        gram: (K, K) their sum.
    """

    noise: Array
    held: npt.NDArray[np.bool_]
    per_flight: Array
    gram: Array
    _whitened: tuple[tuple[Array, ...], ...]

    @classmethod
    def of(cls, columns: Linearisation, noise: Array, held: npt.NDArray[np.bool_]) -> NoiseWeighting:
        """Weighting of all columns by a noise (6, C)."""
        flights = len(columns.flights)
        none = np.zeros((flights, 0, 0))
        return cls(noise, held, none, none.sum(axis=0), ((),) * flights).extended(columns)

    @cached_property
    def precision(self) -> Array:
        """Squared weights (6, C): one over the variance, 0 in axes that say nothing."""
        squared: Array = np.where(self.held[:, None], 0.0, 1.0 / self.noise)
        return squared

    def extended(self, columns: Linearisation) -> NoiseWeighting:
        """The weighting with columns that were appended since."""
        known, width = self.per_flight.shape[1], columns.width
        if width == known:
            return self
        grown = np.zeros((len(columns.flights), width, width))
        grown[:, :known, :known] = self.per_flight
        whitened = []
        for place, (band, done) in enumerate(zip(columns.bands, self._whitened, strict=True)):
            weights = np.sqrt(self.precision[:, band])
            fresh = [rows * weights[:, :, None] for rows in columns.tables[place][len(done) :]]
            if columns.errors[place].shape[2]:
                fresh = _beside(columns.errors[place] * weights[:, :, None], fresh)
            added = np.concatenate(fresh, axis=2)
            for first, rows in zip(table_starts(done), done, strict=True):
                block = cross_gram(rows, added)
                grown[place, first : first + rows.shape[2], known:] = block
                grown[place, known:, first : first + rows.shape[2]] = block.T
            grown[place, known:, known:] = cross_gram(added, added)
            whitened.append((*done, *fresh))
        return replace(self, per_flight=grown, gram=grown.sum(axis=0), _whitened=tuple(whitened))


@dataclass(frozen=True, eq=False)
class Condition:
    """Parameters of a candidate that each flight has of its own.

    Attributes:
        index: of the candidate.
        sizes: (F, k) standard deviation of each parameter of each flight about what all share, in prior ones.
    """

    index: int
    sizes: Array


@dataclass(frozen=True)
class Regression:
    """Weighted columns of residual, tolerances and candidates of all flights; changes give new values.

    Attributes:
        columns: columns in frequency.
        weighting: their weights by the noise, and Gram matrices.
        explained: per flight, rows (6, B) of the wrench of the accelerations that the columns of mass and
            inertia are made of.
        conditions: what each flight has of its own.
    """

    columns: Linearisation
    weighting: NoiseWeighting
    explained: tuple[Array, ...]
    conditions: tuple[Condition, ...] = ()

    @classmethod
    def of(
        cls,
        flights: Sequence[Compared],
        candidates: Sequence[Candidate],
        held: npt.NDArray[np.bool_] = NONE_HELD,
    ) -> Regression:
        """Regression with every candidate linearised at zero, and the noise that all of them leave.

        Args:
            flights: beside their simulation.
            candidates: effects to look for.
            held: axes (6,) that the simulation's own intervals hold: what is inside them is known no better,
                so that it speaks neither for nor against an effect or a coefficient.
        """
        columns = Linearisation.of(flights, candidates)
        explained = tuple(_rows(flight, flight.expected_measured) for flight in flights)
        sound = in_bands(columns)
        if sound is not None:
            # Its known errors were found with columns of the accelerations that the simulation expects.
            return cls(columns, NoiseWeighting.of(columns, sound.noise, held), explained)
        noise = _estimated_noise(columns, ())
        regression = cls(columns, NoiseWeighting.of(columns, noise, held), explained)
        for _ in range(_ACCELERATION_ROUNDS):
            accelerated = regression.accelerated(_require(regression.fit(())))
            regression = accelerated.weighted(_estimated_noise(accelerated.columns, ()))
        return regression

    def accelerated(self, found: Fit) -> Regression:
        """The regression with columns of mass and inertia made of the accelerations that a fit explains.

        They are those of the quiet simulation and of what the fit adds to it. Another mass or inertia then
        explains nothing that the fit itself does not. Measured accelerations hold the noise of the residual,
        and so do those that many columns explain together: a vehicle without mass, in no air, would leave
        none of it. The weighting is not changed.
        """
        columns = self.columns
        fitted = residual_weights(columns.width, ()) - found.left
        explained = tuple(
            _rows(flight, flight.quiet_wrench[:: flight.step]) + columns.combined(place, fitted)
            for place, flight in enumerate(self.flights)
        )
        changes = [new - old for new, old in zip(explained, self.explained, strict=True)]
        return replace(self, columns=columns.accelerated(changes), explained=explained)

    @property
    def flights(self) -> tuple[Compared, ...]:
        """The flights, beside their simulation."""
        return self.columns.flights

    @property
    def sound(self) -> SoundFlights | None:
        """What sound flights leave of the simulation, in the bands of the columns; None where unknown."""
        return in_bands(self.columns)

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """The candidates of the search."""
        return self.columns.candidates

    @property
    def noise(self) -> Array:
        """Variance (6, C) of the noise."""
        return self.weighting.noise

    @property
    def gram(self) -> Array:
        """Gram matrix (K, K) of all flights."""
        return self.weighting.gram

    def block(self, index: int) -> Block:
        """The columns of a candidate."""
        return self.columns.blocks[index]

    def moved(self, points: Mapping[int, Array]) -> Regression:
        """The regression with candidates, by index, linearised about other points."""
        columns = self.columns.moved(points)
        return replace(self, columns=columns, weighting=self.weighting.extended(columns))

    def with_fitted_coefficients(self, chosen: Sequence[int], found: Fit) -> Regression:
        """The regression with the chosen made of the simulation with its coefficients as a fit has them.

        A tilted rotor turns its true thrust, not the stated one: the product of an effect and a coefficient
        would bias what is known to less than the tolerance. Mass and inertia are made of other accelerations,
        see :meth:`accelerated`. The noise stays that of the fit, which holds that product: intervals are
        rather too wide for it.
        """
        columns = self.columns
        fitted = zip(columns.tolerance_names, found.of(columns.tolerances).tolist(), strict=True)
        stated = self.flights[0].simulation
        simulation = stated.with_coefficients(dict(fitted))
        if simulation is stated:
            return self
        flights = [flight.compared_with(simulation) for flight in self.flights]
        moving = [index for index in chosen if self.candidates[index].effect.kind != "vehicle"]
        columns = columns.remade(flights, moving)
        return replace(self, columns=columns, weighting=self.weighting.extended(columns))

    def weighted(self, noise: Array) -> Regression:
        """The regression with another noise (6, C)."""
        return replace(self, weighting=NoiseWeighting.of(self.columns, noise, self.weighting.held))

    def beside(self, chosen: Sequence[int], found: Fit) -> Regression:
        """The regression with at least the residual after a set of effects as noise, as far as there was any.

        An error of a law would otherwise be explained by another effect. Columns of mass and inertia are made
        of the accelerations that the set explains. What flights may have of their own is no noise.
        """
        varied = replace(self, columns=self._with_all_conditions)
        left = band_means([np.square(rows) for rows in varied.left(found)], self.columns.bands)
        accelerated = self.accelerated(found)
        if self.sound is not None:
            return accelerated.weighted(np.maximum(self.sound.noise, left))
        # Nothing was fitted to axes that say nothing, so what is left of them is no noise.
        left[self.weighting.held] = 0.0
        noise = np.maximum(_estimated_noise(accelerated.columns, chosen), left)
        return accelerated.weighted(np.minimum(noise, _residual_squares(self.columns)))

    @property
    def _with_all_conditions(self) -> Linearisation:
        columns = self.columns
        for index in self.conditions_to_come:
            sizes = np.ones((len(self.flights), len(self.block(index).parameters)))
            columns = columns.with_flights_own(index, sizes)
        return columns

    @cached_property
    def varied(self) -> Regression:
        """The regression with all that flights may have of their own as noise, however large."""
        columns = self._with_all_conditions
        return self if columns is self.columns else replace(self, columns=columns).weighted(self.noise)

    @property
    def conditions_to_come(self) -> list[int]:
        """Candidates of which flights may have parameters of their own; none without sound flights."""
        if self.sound is None:
            return []
        known = {condition.index for condition in self.conditions}
        return [
            index
            for index, candidate in enumerate(self.candidates)
            if candidate.effect.of_a_flight and index not in known
        ]

    def fit(self, chosen: Sequence[int], gram: Array | None = None, *, form: bool = True) -> Fit | None:
        """Fit a set of candidates, by their indices, with or without the columns of their form.

        See :func:`evidence.fit`.
        """
        blocks = [self.block(i) if form else replace(self.block(i), form=NO_COLUMNS) for i in chosen]
        return fit(self.gram if gram is None else gram, self.columns.tolerances, blocks)

    def evidence_at(self, chosen: Sequence[int]) -> float:
        """See :func:`evidence.evidence_at`, of candidates by their indices."""
        return evidence_at(self.gram, self.columns.tolerances, [self.block(index) for index in chosen])

    def parameters(self, index: int, found: Fit) -> Array:
        """Free parameters (k,) of a candidate in a fit, brought within their bounds."""
        candidate = self.candidates[index]
        values = candidate.centre + found.of(self.block(index).parameters) * candidate.scale
        return candidate.within_bounds(values)

    def size(self, index: int, found: Fit) -> float:
        """Largest parameter of a candidate in a fit, in prior standard deviations."""
        return float(np.abs(found.of(self.block(index).parameters)).max())

    def left(self, found: Fit) -> list[Array]:
        """Rows (6, B) of the residual of each flight after a fit and what that flight has of its own."""
        return [self.left_of(place, found.left) for place in range(len(self.flights))]

    def left_of(self, place: int, weights: Array) -> Array:
        """Rows (6, B) of a flight's columns, each times its weight, together, less what it has of its own."""
        return self.columns.combined(place, weights) - self.own_rows(place, weights)

    def own_rows(self, place: int, weights: Array) -> Array:
        """Rows (6, B) of what a flight has of its own, as far as its columns, each times its weight, tell."""
        rows: Array = self.columns.errors[place] @ self.flights_own(place, weights)[0]
        return rows

    def flights_own(self, place: int, weights: Array) -> tuple[Array, Array]:
        """Deviations of a flight from what all share, by :attr:`Linearisation.errors`, as far as known.

        Returns:
            Their posterior mean (E,) and covariance (E, E).
        """
        errors, band = self.columns.errors[place], self.columns.bands[place]
        weighed = np.einsum("abe,ab->eab", errors, self.weighting.precision[:, band])
        information = np.einsum("eab,abf->ef", weighed, errors) + np.eye(errors.shape[2])
        covariance = np.linalg.inv(information)
        rows = self.columns.combined(place, weights)
        return covariance @ np.einsum("eab,ab->e", weighed, rows), covariance

    def sizes_of_condition(self, index: int, chosen: Sequence[int]) -> Array:
        """Standard deviations (F, k) of the parameters of a candidate that each flight has, in prior ones.

        Those of the largest evidence beside a set and what flights share of the same parameters, by
        expectation and maximisation for a Student's t: an effect that all flights have is no condition of
        one, and a flight that differs by much says nothing of the others.
        """
        own = self.block(index).parameters
        parameters = [self.block(one).parameters for one in chosen if one != index]
        shared = np.concatenate((self.columns.tolerances, *parameters, own))
        residual = residual_weights(len(self.gram), [self.block(one) for one in chosen])
        # However large what flights share is, it is no difference between them.
        prior = np.diag(np.where(np.isin(shared, own), _FREE, 1.0))
        sizes = np.ones((len(self.flights), len(own)))
        typical = np.ones(len(own))
        for _ in range(_CONDITION_ROUNDS):
            information, projection, inner = prior.copy(), np.zeros(len(shared)), []
            for gram, size in zip(self.weighting.per_flight, sizes, strict=True):
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

    def gain_of_condition(self, index: int, sizes: Array, chosen: Sequence[int], found: Fit) -> float:
        """Evidence [nat] that flights of their own parameters of a candidate gain beside a fitted set."""
        own, deflated, cost = self.block(index).parameters, np.zeros_like(self.gram), 0.0
        for gram, size in zip(self.weighting.per_flight, sizes, strict=True):
            columns = gram[:, own] * size
            inner = columns[own] * size[:, np.newaxis] + np.eye(len(own))
            deflated += gram - columns @ np.linalg.solve(inner, columns.T)
            cost += 0.5 * float(np.linalg.slogdet(inner)[1])
        fit = self.fit(chosen, deflated)
        return -np.inf if fit is None else fit.log_evidence - cost - found.log_evidence

    def with_condition(self, condition: Condition) -> Regression:
        """The regression with parameters of a candidate that each flight has of its own, as noise."""
        columns = self.columns.with_flights_own(condition.index, condition.sizes)
        return replace(self, columns=columns, conditions=(*self.conditions, condition)).weighted(self.noise)

    def of_condition(self, condition: Condition, place: int, weights: Array) -> tuple[Array, Array]:
        """Parameters (k,) of a candidate that a flight has of its own, and their standard deviations (k,).

        Args:
            condition: one of `conditions`.
            place: number of the flight.
            weights: (K,) of its columns in the residual after a fit.
        """
        later = self.conditions[self.conditions.index(condition) :]
        mean, covariance = self.flights_own(place, weights)
        first = len(mean) - sum(one.sizes.shape[1] for one in later)
        own = slice(first, first + condition.sizes.shape[1])
        units = condition.sizes[place] * self.candidates[condition.index].scale
        return mean[own] * units, np.sqrt(np.diag(covariance)[own]) * units

    def loudness(self, index: int, found: Fit) -> float:
        """Root mean square of the contribution of a candidate over that of the noise, in its loudest axis."""
        squares, noise = np.zeros(len(AXES)), np.zeros(len(AXES))
        for place, band in enumerate(self.columns.bands):
            squares += np.square(self._added(place, (index,), found)).sum(axis=1)
            noise += self.noise[:, band].sum(axis=1)
        return float(np.sqrt(np.max((squares / noise)[~self.weighting.held], initial=0.0)))

    def energy(self, chosen: Sequence[int], found: Fit) -> float:
        """Evidence of candidates in a fit: half of the squares that they add, in variances of the noise."""
        squares = 0.0
        for place, band in enumerate(self.columns.bands):
            added = np.square(self._added(place, chosen, found))
            squares += float(np.sum(added * self.weighting.precision[:, band]))
        return 0.5 * squares

    def reduction(self, chosen: Sequence[int], found: Fit, noise: Array | None = None) -> Reduction:
        """Squares by which candidates in a fit reduce the residual of all flights.

        Args:
            chosen: indices of the candidates.
            found: fit of them, and of others.
            noise: (6, C) variance to count the squares in; unless given, they are in units of the wrench.
        """
        stated = found.left.copy()
        stated[self.columns.tolerances] = 0.0
        reduced = []
        for left in (found.left, stated):
            without = left.copy()
            for block in map(self.block, chosen):
                without[block.parameters] = without[block.form] = 0.0
                if block.offset is not None:
                    without[block.offset] = 0.0
            reduced.append(self.columns.squares(without, noise) - self.columns.squares(left, noise))
        return Reduction(*reduced)

    def _added(self, place: int, chosen: Sequence[int], found: Fit) -> Array:
        """Rows (6, B) of the contribution of candidates to a flight in a fit."""
        weights = np.zeros(self.columns.width)
        for block in map(self.block, chosen):
            weights[block.parameters] = found.of(block.parameters)
            if block.offset is not None:
                weights[block.offset] = -1.0
        return self.columns.combined(place, weights)


def student_weights(squares: Array) -> Array:
    """Weights of deviations with these squares, in typical ones, by the tails of Student's t."""
    weights: Array = (TAILS.value + 1.0) / (TAILS.value + squares)
    return weights


def in_bands(columns: Linearisation) -> SoundFlights | None:
    """What sound flights leave of the simulation, in the bands that are compared."""
    sound = columns.flights[0].simulation.sound
    bands = 1 + max(int(band.max()) for band in columns.bands)
    if sound is None or bands == sound.noise.shape[1]:
        return sound
    edges, noise, left = sound.edges_hz[: bands + 1], sound.noise[:, :bands], sound.left[:, :bands]
    return replace(sound, edges_hz=edges, noise=noise, left=left)


def _beside(errors: Array, tables: Sequence[Array]) -> list[Array]:
    """Whitened tables (6, B, ·) beside further noise, the sum of whitened columns (6, B, E) times N(0, 1).

    With errors Q = U S Vᵀ the noise has the covariance 1 + Q Qᵀ, whose inverse root is
    1 − U (1 − 1/√(1 + S²)) Uᵀ.
    """
    basis, sizes, _ = np.linalg.svd(errors.reshape(-1, errors.shape[2]), full_matrices=False)
    lost = (1.0 - 1.0 / np.sqrt(1.0 + np.square(sizes)))[:, np.newaxis]
    result = []
    for table in tables:
        flat = table.reshape(len(basis), -1)
        result.append((flat - basis @ (lost * (basis.T @ flat))).reshape(table.shape))
    return result


def settled(regression: Regression) -> Regression:
    """The regression with every candidate linearised where it fits best alone."""
    best: dict[int, tuple[float, Array]] = {}
    for turn in range(_ROUNDS + 1):
        last = turn == _ROUNDS
        points = {}
        for index, candidate in enumerate(regression.candidates):
            here = regression.columns.points[index]
            if candidate.linear:
                found = regression.fit((index,), form=False) if turn == 0 else None
                if found is not None:
                    points[index] = regression.parameters(index, found)
                continue
            value = regression.evidence_at((index,))
            if index in best and value < best[index][0]:
                # The step overshot: take half of it, and none in the last round.
                points[index] = best[index][1] if last else 0.5 * (best[index][1] + here)
                continue
            best[index] = (value, here)
            found = None if last else regression.fit((index,), form=False)
            if found is not None:
                to = regression.parameters(index, found)
                # However small the first step: what else a law depends on acts only where it is there.
                if turn == 0 or np.max(np.abs(to - here) / candidate.scale) > SMALL_STEP.value:
                    points[index] = to
        regression = regression.moved(points)
    return regression


def refined(regression: Regression, chosen: Sequence[int], found: Fit) -> tuple[Regression, Fit] | None:
    """The regression with the chosen linearised where they fit together, and that fit.

    A step that lowers the evidence, as long ones of a tether do, is halved. None where bounds exclude one of
    the effects.
    """
    curved = any(not regression.candidates[index].linear for index in chosen)
    best, value = (regression, found), regression.evidence_at(chosen)
    at = [regression.columns.points[index] for index in chosen]
    to = [regression.parameters(index, found) for index in chosen]
    for _ in range(_ROUNDS):
        moved = regression.moved(dict(zip(chosen, to, strict=True)))
        improved, there = moved.fit(chosen), moved.evidence_at(chosen)
        if improved is not None and (not curved or there >= value):
            regression, best, value, at = moved, (moved, improved), there, to
            to = [moved.parameters(index, improved) for index in chosen]
        elif not curved:
            return None
        else:
            to = [0.5 * (old + new) for old, new in zip(at, to, strict=True)]
    return best


def _estimated_noise(columns: Linearisation, chosen: Sequence[int]) -> Array:
    """Noise (6, C) of the residual after tolerances, every linear candidate, and those chosen."""
    blocks = [columns.blocks[index] for index in chosen]
    residual = residual_weights(columns.width, blocks)
    parts = [columns.linear_columns]
    for block in blocks:
        parts.append(block.form)
        if block.offset is not None:
            parts.append(block.parameters)
    explaining = np.concatenate(parts)
    return estimate_noise(
        [
            Spectrum(np.dstack((columns.combined(place, residual), columns.rows(place, explaining))), band)
            for place, band in enumerate(columns.bands)
        ],
        _residual_squares(columns),
    )


def _residual_squares(columns: Linearisation) -> Array:
    """Mean squares (6, C) of the residual as it is; infinite in a band that no flight is long enough for."""
    alone = residual_weights(columns.width, ())
    rows = [np.square(columns.combined(place, alone)) for place in range(len(columns.flights))]
    squares = band_means(rows, columns.bands)
    return np.where(squares > 0.0, squares, np.inf)


def _require(found: Fit | None) -> Fit:
    assert found is not None  # without effects there is always a fit
    return found


def _rows(flight: Compared, wrench: Array) -> Array:
    """Rows (6, B) of a wrench (M, 6)."""
    return flight.spectrum(wrench[:, :, None]).rows[:, :, 0]
