# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bayesian evidence for sets of effects, and sizes of what flights have of their own, from Gram matrices.

For columns X with prior N(0, 1) on every coefficient and white noise of unit variance, the evidence of a
residual r is, up to a constant, ln p = −½ (r·r − bᵀA⁻¹b) − ½ ln det A with A = XᵀX + 1 and b = Xᵀr. The
tolerances of the simulation are part of every set, so that an effect has to explain what no coefficient
within its tolerance can. The law of an effect may be wrong, too: with the effect, a set contains columns for
the error of its form, in proportion to its size.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from quadpi_core.discrepancy.whitening import Columns, Indices, Noise, Part
from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, Threshold

# Prior precision of the form columns of an effect of size zero, whose form cannot differ.
_PRECISE = 1e12
# Rounds in which the sizes converge, and the least of them, in prior deviations.
_ROUNDS, _LEAST_DIFFERENCE = 12, 1e-4
# Precision of what flights share, in prior ones.
_FREE = 1e-4
ERROR_OF_LAW = Threshold(
    "evidence that errors of laws may add where sound flights tell the noise",
    1.0,
    "of the evidence of the laws without",
    "most is by the formula: a vortex ring bent by eight states gains 4 to 6 of longer arms, wind 0.3",
    "models of NeuroBEM and of a Crazyflie (experiments/results/discovery-hidden.md)",
)
LACKED = Threshold(
    "flights that may lack what the others share",
    0.25,
    "of the flights",
    "one of four with a turned IMU hides nothing; what more of them lack acts in some flights only",
    CONVENTION,
)
TAILS = Threshold(
    "tails of what flights have of their own",
    1.0,
    "degrees of freedom of Student's t",
    "most flights are alike, and one with a turned IMU differs by ten times as much: it must not hide "
    "what the others share",
    CONVENTION,
)


@dataclass(frozen=True, eq=False)
class Block:
    """The columns of one candidate about a point.

    Attributes:
        columns: one for each of k parameters; of a curved effect, then one for what its linearisation adds to
            the residual.
        at: (k,) the point, in prior standard deviations from their mean.
        lowest, highest: (k,) bounds of the parameters, in prior standard deviations.
        form: columns for the error of its form, made for an effect of the size `formed_at`; none for one that
            is exact, or of size 0.
        formed_at: length of the coefficients that the form columns are in proportion to.
        cost: evidence [nat] that the candidate loses for what is fitted to each flight beside its columns.
    """

    columns: Columns
    at: Array
    lowest: Array
    highest: Array
    form: Columns | None = None
    formed_at: float = 1.0
    cost: float = 0.0

    @property
    def curved(self) -> bool:
        """Whether its linearisation depends on the point."""
        return self.columns.width > len(self.at)


@dataclass(frozen=True, eq=False)
class Fit:
    """Fit of a set of effects.

    Attributes:
        log_evidence: log evidence [nat] relative to other fits of the same flights.
        parts: columns of the set, the residual first.
        fitted: (c,) indices in these of the columns that were fitted.
        coefficients: (c,) their posterior mean.
        covariance: (c, c) their posterior covariance.
        left: (K,) weight of each column in the residual after the fit.
    """

    log_evidence: float
    parts: tuple[Columns, ...]
    fitted: Indices
    coefficients: Array
    covariance: Array
    left: Array

    def of(self, columns: Columns) -> Array:
        """Coefficients of some columns; 0 for those that were not fitted, as a bound excluded them."""
        return self._at(columns, self.coefficients)

    def deviation(self, columns: Columns) -> Array:
        """Posterior standard deviation of some columns; 0 for those that were not fitted."""
        return self._at(columns, np.sqrt(np.diag(self.covariance)))

    def residual(self, *, without: Iterable[Columns] = ()) -> list[Part]:
        """The residual after the fit as a sum of columns, of which some are left out."""
        ends = np.cumsum([part.width for part in self.parts])[:-1]
        weights = zip(self.parts, np.split(self.left, ends), strict=True)
        return [Part(*own) for own in weights if own[0] not in without]

    def _at(self, columns: Columns, values: Array) -> Array:
        if columns not in self.parts:
            return np.zeros(columns.width)
        first = sum(part.width for part in self.parts[: self.parts.index(columns)])
        return (self.fitted == first + np.arange(columns.width)[:, None]) @ values


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of the tolerances of a simulation and a set of effects.

    Attributes:
        parts: the residual, tolerances, columns of each block, and those of forms that are fitted too.
        tolerances: number of columns of tolerances.
        blocks: those of the effects.
        formed: blocks whose forms are fitted.
        per_flight: (F, K, K) Gram matrices of all columns.
    """

    parts: tuple[Columns, ...]
    tolerances: int
    blocks: tuple[Block, ...]
    formed: tuple[Block, ...]
    per_flight: Array

    @classmethod
    def from_columns(
        cls, base: Sequence[Columns], blocks: Sequence[Block], noise: Noise, formed: Sequence[Block]
    ) -> Equations:
        """Equations of blocks beside columns of the residual and tolerances, with the forms of some."""
        formed = tuple(block for block in formed if block.form is not None)
        parts = (*base, *(block.columns for block in blocks), *(own.form for own in formed if own.form))
        tolerances = sum(part.width for part in base) - 1
        return cls(parts, tolerances, tuple(blocks), formed, noise.grams(parts, parts))

    def fit(self, without: int | None = None, *, known: bool = False) -> Fit | None:
        """Fit tolerances and effects; None where bounds exclude all of an effect, or errors refute laws.

        A parameter whose posterior mean violates its bound is set to zero, its nearest bound, and the rest
        are fitted again; all of an effect are where a flight is left out, whose others stay.

        Args:
            without: index of a flight to leave out.
            known: whether sound flights tell the noise, so that :func:`is_error_of_law` is asked.
        """
        gram = self._gram(without)
        inside = [np.ones(len(block.at), dtype=np.bool_) for block in self.blocks]
        exact: Fit | None = None
        while without is not None or all(own.any() for own in inside):
            found = self._solved(gram, inside, exact)
            kept = [
                own & self._possible(found, block) for own, block in zip(inside, self.blocks, strict=True)
            ]
            if any(np.any(was & ~own) for was, own in zip(inside, kept, strict=True)):
                inside = kept
                continue
            if not self.formed:
                return found
            if exact is not None:
                # A law may be exact: form columns that are not needed must not cost it evidence.
                if (added := found.log_evidence - exact.log_evidence) <= 0.0:
                    return exact
                is_error = not known or is_error_of_law(added, self._of_laws(gram, inside, exact))
                return found if is_error else None
            # The sizes of the effects, now known, scale by how much their forms may differ.
            exact = found
        # If the form columns would flip the sign of the effect, fall back to the fit without them.
        return exact

    def _of_laws(self, gram: Array, inside: Sequence[npt.NDArray[np.bool_]], exact: Fit) -> float:
        """Evidence [nat] that those blocks gain whose forms are fitted, without these."""
        residual, others = self.residual, list(inside)
        for place, (block, first) in enumerate(zip(self.blocks, self._firsts, strict=True)):
            if block in self.formed:
                residual[first : first + block.columns.width] = 0.0
                others[place] = np.zeros_like(inside[place])
        return exact.log_evidence - self._solved(gram, others, None, residual).log_evidence

    def fit_none(self) -> Fit:
        """The fit of equations without effects, which there always is."""
        return self._solved(self._gram(None), (), None)

    def at_points(self) -> float:
        """Log evidence [nat] of the set with curved effects at their points, where it is exact.

        Far from its point a linearisation may promise what it cannot keep. Values at different points of the
        same set can be compared with each other, not with those of :meth:`fit`.
        """
        inside = [np.full(len(block.at), not block.curved) for block in self.blocks]
        residual = self.residual
        cost = 0.0
        for block, first in zip(self.blocks, self._firsts, strict=True):
            if block.curved:
                residual[first : first + len(block.at)] = -block.at
                cost += 0.5 * float(block.at @ block.at)
        return self._solved(self._gram(None), inside, None, residual).log_evidence - cost

    def refit(self, found: Fit, without: int) -> Fit:
        """Fit the same columns as another fit, without bounds, and without one of the flights."""
        precisions = np.ones(len(found.fitted))
        return self._evidence(self._gram(without), found.fitted, self.residual, precisions)

    def with_forms(self, found: Fit) -> Fit:
        """The fit of the same columns beside those of all forms, whether they are needed or not."""
        known = found.fitted[found.fitted < self._forms]
        columns, precisions = self._with_forms(known, found)
        return self._evidence(self._gram(None), columns, self.residual, precisions)

    def fit_forms(self, fixed: Fit, *, adjusted: bool, without: int | None = None) -> Fit:
        """Fit the forms, and tolerances unless they are not adjusted, with the parameters of effects fixed.

        Args:
            fixed: fit that the parameters are taken from.
            adjusted: whether tolerances are fitted.
            without: index of a flight to leave out.
        """
        residual = self.residual
        for block, first in zip(self.blocks, self._firsts, strict=True):
            residual[first : first + len(block.at)] -= fixed.of(block.columns)[: len(block.at)]
        columns, precisions = self._with_forms(np.arange(1, 1 + self.tolerances * adjusted), fixed)
        return self._evidence(self._gram(without), columns, residual, precisions)

    def _gram(self, without: int | None) -> Array:
        gram: Array = self.per_flight.sum(axis=0)
        return gram if without is None else gram - self.per_flight[without]

    @cached_property
    def _firsts(self) -> list[int]:
        """First column of each block."""
        widths = [block.columns.width for block in self.blocks]
        return [1 + self.tolerances + sum(widths[:place]) for place in range(len(widths))]

    def parameters(self, place: int) -> Indices:
        """Columns of the parameters of a block."""
        return self._firsts[place] + np.arange(len(self.blocks[place].at))

    @property
    def _forms(self) -> int:
        return 1 + self.tolerances + sum(block.columns.width for block in self.blocks)

    @property
    def residual(self) -> Array:
        """Weight (K,) of each column in the residual beside the points that effects are linearised at."""
        weights = np.zeros(self.per_flight.shape[1])
        weights[0] = 1.0
        for block, first in zip(self.blocks, self._firsts, strict=True):
            if block.curved:
                weights[first + len(block.at)] = 1.0
        return weights

    def _solved(
        self,
        gram: Array,
        inside: Sequence[npt.NDArray[np.bool_]],
        sizes: Fit | None,
        residual: Array | None = None,
    ) -> Fit:
        """Fit of tolerances, parameters inside bounds, and, given the sizes of effects, forms."""
        own = [first + np.flatnonzero(kept) for first, kept in zip(self._firsts, inside, strict=True)]
        columns = np.concatenate([np.arange(1, 1 + self.tolerances), *own])
        precisions = np.ones(len(columns))
        if sizes is not None:
            columns, precisions = self._with_forms(columns, sizes)
        residual = self.residual if residual is None else residual
        found = self._evidence(gram, columns, residual, precisions)
        return replace(found, log_evidence=found.log_evidence - sum(block.cost for block in self.blocks))

    def _with_forms(self, columns: Indices, sizes: Fit) -> tuple[Indices, Array]:
        """Columns and then those of the forms, and the precision of the prior of each."""
        parts = [np.ones(len(columns))]
        for block in self.formed:
            assert block.form is not None
            size = float(np.linalg.norm(sizes.of(block.columns)[: len(block.at)]))
            precision = min((block.formed_at / max(size, 1e-9)) ** 2, _PRECISE)
            parts.append(np.full(block.form.width, precision))
        precisions = np.concatenate(parts)
        forms = self._forms + np.arange(len(precisions) - len(columns))
        return np.concatenate((columns, forms)), precisions

    def _evidence(self, gram: Array, columns: Indices, residual: Array, precisions: Array) -> Fit:
        matrix = gram[np.ix_(columns, columns)] + np.diag(precisions)
        lower = np.linalg.cholesky(matrix)
        half = np.linalg.solve(lower, gram[columns] @ residual)
        coefficients = np.linalg.solve(lower.T, half)
        inverse = np.linalg.solve(lower, np.eye(len(columns)))
        log_evidence = -0.5 * float(residual @ gram @ residual - half @ half)
        log_evidence -= float(np.log(np.diag(lower)).sum() - 0.5 * np.log(precisions).sum())
        left = residual.copy()
        left[columns] -= coefficients
        return Fit(log_evidence, self.parts, columns, coefficients, inverse.T @ inverse, left)

    @staticmethod
    def _possible(found: Fit, block: Block) -> npt.NDArray[np.bool_]:
        values = found.of(block.columns)[: len(block.at)]
        return (values >= block.lowest) & (values <= block.highest)


def is_error_of_law(added: float, of_laws: float) -> bool:
    """Whether what the errors of laws add may be such, beside the evidence [nat] of these laws."""
    return added <= ERROR_OF_LAW.value * of_laws


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
    flights have is no condition of one, and a flight that differs by much says nothing of the others. What
    more than a few flights lack is not shared, and theirs are about zero.

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
        apart = np.array([solved @ seen - gain.T @ mean for solved, gain, seen in inner])
        squares = np.square(apart) + np.array(
            [np.diag(solved + gain.T @ covariance @ gain) for solved, gain, _ in inner]
        )
        weights = student_weights(squares / np.square(typical))
        typical = np.maximum(np.sqrt(np.mean(weights * squares, axis=0)), _LEAST_DIFFERENCE)
        sizes = np.clip(typical / np.sqrt(weights), _LEAST_DIFFERENCE, 1.0)
    of_all = np.array([float(mean[shared == column].sum()) for column in own])
    # A flight lacks what is nearer to zero in it than to what all are said to have.
    lack = np.mean(np.sign(of_all) * apart < -0.5 * np.abs(of_all), axis=0) > LACKED.value
    return own_sizes(per_flight, residual, np.setdiff1d(shared, own[lack]), own) if lack.any() else sizes


def student_weights(squares: Array) -> Array:
    """Weights of deviations with these squares, in typical ones, by the tails of Student's t."""
    return (TAILS.value + 1.0) / (TAILS.value + squares)
