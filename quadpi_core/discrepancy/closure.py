# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How far a set of effects closes the gap between simulation and flights, on flights left out of the fit.

The search counts the error of a law as noise, most of which is slow, so a fit weighted by that noise hardly
sees the error of a law in steady flight. So the shape of a law is fitted by least squares with the same
weight at all frequencies, and the parameters of the effects stay as the search found them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from quadpi_core.discrepancy.adjustment import Adjustment, LeftOut
from quadpi_core.discrepancy.effect_regression import Regression
from quadpi_core.discrepancy.evidence import (
    Block,
    Fit,
    Indices,
    fit_forms,
    form_precisions,
    refit,
    residual_weights,
)
from quadpi_core.discrepancy.linearisation import AXES_OVER_FORM
from quadpi_core.discrepancy.whitening import cross_gram
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.simulation.effect_definition import SHAPE


class Gap(NamedTuple):
    """Root-mean-square differences up to the highest compared frequency, order as `AXES`, N and Nm.

    Attributes:
        before, after: (6,) difference of measured and simulated wrench, after with the effects fitted on all
            other flights.
        floor: (6,) noise of sensors and states, or what the simulation states that it may err by.
        reduction: closed share of the removable gap, in units of the noise of each axis, of all axes but
            those that the simulation's own intervals hold.
    """

    before: Array
    after: Array
    floor: Array
    reduction: float

    @property
    def removable(self) -> Array:
        """Squares (6,) before, in those of the floor beyond it."""
        return _beyond(self.before, self.floor)

    @property
    def kept(self) -> Array:
        """Squares (6,) after, in those of the floor beyond it."""
        return _beyond(self.after, self.floor)


def _beyond(error: Array, floor: Array) -> Array:
    beyond: Array = np.maximum(np.square(error / floor) - 1.0, 0.0)
    return beyond


@dataclass(frozen=True)
class Closing:
    """Fits that close the gap: effects, shapes of their laws, and tolerances; see :meth:`fits`.

    Attributes:
        regression: regression of the search.
        chosen: indices of the candidates that were named.
        shaped: those whose laws are shaped, because that reduces the residual of flights left out.
        grams: (F, K, K) Gram matrices that weigh the residual: equally at all frequencies with shapes, by the
            noise without.
        adjusted: columns of the coefficients that are adjusted beside the effects; see :mod:`.adjustment`.
    """

    regression: Regression
    chosen: tuple[int, ...]
    shaped: tuple[int, ...]
    grams: Array
    adjusted: Indices

    @classmethod
    def by_laws(cls, regression: Regression, chosen: Sequence[int]) -> Closing:
        """Fits of the laws alone, and of all coefficients."""
        grams = regression.weighting.per_flight
        return cls(regression, tuple(chosen), (), grams, regression.columns.tolerances)

    @classmethod
    def of(cls, regression: Regression, chosen: Sequence[int]) -> Closing:
        """Fits with laws shaped, and coefficients adjusted, where that helps on flights left out."""
        bare = cls.by_laws(regression, chosen)
        laws = [regression.candidates[index] for index in chosen]
        # A law that is not linear in its parameters is shaped by them.
        shaped = tuple(i for i, law in zip(chosen, laws, strict=True) if law.effect.shape and law.linear)
        best = bare
        if shaped:
            whole = replace(bare, shaped=shaped, grams=_even_grams(regression, chosen))
            best = whole if whole._leaves(whole.grams) < bare._leaves(whole.grams) else bare
        return best._adjusting_what_helps() if chosen else best

    def fits(self, without: int | None = None) -> tuple[Fit, Fit]:
        """Fit of the parameters by the laws alone, and fit of parameters, tolerances and shapes.

        Args:
            without: index of a flight to leave out of both, so that they can be judged on it.
        """
        law = self._law(without)
        if not self.chosen or (not self.shaped and self._adjusts_all):
            return law, law
        gram = self.grams.sum(axis=0)
        if without is not None:
            gram -= self.grams[without]
        return law, fit_forms(gram, self.adjusted, self._blocks, law, self._formed)

    def _law(self, without: int | None) -> Fit:
        """Fit of the parameters and all coefficients by the laws alone."""
        regression = self.regression
        gram = regression.gram if without is None else regression.gram - self._per_flight[without]
        law = regression.fit(self.chosen, gram, form=False) or regression.fit((), gram)
        assert law is not None  # without effects there is always a fit
        return law

    @property
    def _adjusts_all(self) -> bool:
        return len(self.adjusted) == len(self.regression.columns.tolerances)

    @property
    def _blocks(self) -> list[Block]:
        return [self.regression.block(index) for index in self.chosen]

    @property
    def _formed(self) -> list[Block]:
        return [self.regression.block(index) for index in self.shaped]

    def _adjusting_what_helps(self) -> Closing:
        """The same with those coefficients adjusted that help on flights left out."""
        columns, grams = self.regression.columns, self.grams
        parts = [columns.tolerances, *(block.form for block in self._formed)]
        free = np.concatenate(parts).astype(np.intp)
        total, flights = grams.sum(axis=0), []
        for place, band in enumerate(columns.bands):
            law = self._law(place)
            residual = residual_weights(columns.width, self._blocks)
            for block in self._blocks:
                residual[block.parameters] -= law.of(block.parameters)
            into = np.column_stack((residual, np.eye(columns.width)[:, free]))
            rows = np.dstack((columns.combined(place, residual), columns.rows(place, free)))
            noisy = rows * np.sqrt(self.regression.noise[:, band])[:, :, None]
            flights.append(
                LeftOut(
                    others=into.T @ (total - grams[place]) @ into,
                    own=into.T @ grams[place] @ into,
                    squares=np.swapaxes(rows, 1, 2) @ rows,
                    noisy=np.swapaxes(noisy, 1, 2) @ noisy,
                )
            )
        law = self._law(None)
        precisions = np.concatenate((np.ones(len(columns.tolerances)), form_precisions(law, self._formed)))
        adjustment = Adjustment(flights, precisions, len(columns.tolerances))
        return replace(self, adjusted=columns.tolerances[adjustment.chosen()])

    @cached_property
    def left_out(self) -> list[Fit]:
        """For each flight the second of :meth:`fits` on all other flights."""
        return [self.fits(place)[1] for place in range(len(self.regression.flights))]

    def left_out_squares(self) -> Array:
        """Squares (6,) of the flights, each after the fit of all others, in variances of the noise.

        They are 0 in axes that say nothing about effects, see :meth:`Regression.of`.
        """
        regression, squares = self.regression, np.zeros(len(AXES))
        for place, (found, band) in enumerate(zip(self.left_out, regression.columns.bands, strict=True)):
            left = np.square(regression.left_of(place, found.left))
            squares += np.sum(left * regression.weighting.precision[:, band], axis=1)
        return squares

    def gap(self, noise: Array, stated: Array, *, adjusted: bool = True) -> Gap:
        """The gap of each flight after the fit of all others; unchanged where no effect was chosen.

        Coefficients alone are not fitted: without the missing effect they would exceed their tolerances. Of
        effects made of fitted coefficients, what the stated ones would change is left out. So is, before and
        after alike, what a flight has of its own beside them, which no effect closes.

        Args:
            noise: (6, C) variance in C bands, which no simulation can close.
            stated: (6,) mean squares that are no gap either, as the simulation states that it errs by them.
            adjusted: whether coefficients are moved as fitted, or stay as they are stated.
        """
        columns = self.regression.columns
        before, after, floor = np.zeros(len(AXES)), np.zeros(len(AXES)), np.zeros(len(AXES))
        samples = 0
        unchanged = residual_weights(1, ())
        for place, found in enumerate(self.left_out):
            left = found.left.copy() if self.chosen else unchanged
            if self.chosen and not adjusted:
                left[columns.tolerances] = 0.0
            own = self.regression.own_rows(place, left)
            before += np.square(columns.combined(place, unchanged) - own).sum(axis=1)
            after += np.square(columns.combined(place, left) - own).sum(axis=1)
            floor += noise[:, columns.bands[place]].sum(axis=1)
            samples += len(columns.flights[place].thinned)
        # Of numbers that were made up, without any noise, too.
        floor = np.maximum(floor, stated * samples + np.finfo(float).eps * before + np.finfo(float).tiny)
        before, after, floor = (np.sqrt(squares / samples) for squares in (before, after, floor))
        gap = Gap(before, after, floor, reduction=0.0)
        counted = ~self.regression.weighting.held
        removable, kept = float(gap.removable[counted].sum()), float(gap.kept[counted].sum())
        return gap._replace(reduction=1.0 - kept / removable if removable > 0.0 else 0.0)

    def disagreement(self, index: int, deviation: Array) -> Array:
        """Spread (k,) between flights of the parameters of a candidate, over what one fit to all leaves open.

        The spread is the jackknife's, of fits without each flight in turn. A flight that alone shows an
        effect spreads it, too, but then the fit without it says that it knows less: the spread is compared
        with that, where it is more. Where the law holds, 1 is the most to expect; see Birge, The
        calculation of errors by the method of least squares (1932).

        Args:
            index: index of the candidate.
            deviation: (k,) of its parameters in the fit to all, in prior ones; 0 for those at a bound.
        """
        columns, law = self.regression.block(index).parameters, self._law(None)
        without = self._unbounded
        values = np.array([fit.of(columns) for fit in without])
        lost = [np.square(fit.deviation(columns)) - np.square(law.deviation(columns)) for fit in without]
        share = (len(without) - 1) / len(without)
        spread = share * np.sum(np.square(values - values.mean(axis=0)), axis=0)
        expected = np.maximum(np.square(deviation), share * np.sum(np.maximum(lost, 0.0), axis=0))
        estimated = deviation > 0.0
        ratio: Array = np.sqrt(np.divide(spread, expected, out=np.zeros(len(deviation)), where=estimated))
        return ratio

    def shape(self, index: int, law: Fit, found: Fit) -> dict[str, float]:
        """Parameters of `effect_definition.SHAPE` by which the flights shape the law of a candidate.

        Args:
            index: index of the candidate.
            law: fit of its parameters, see :meth:`fits`.
            found: fit of the shapes.
        """
        candidate, block = self.regression.candidates[index], self.regression.block(index)
        modulators = self.regression.columns.modulators
        size = float(np.linalg.norm(law.of(block.parameters)))
        weights = candidate.form * found.of(block.form)
        if not weights.any() or size == 0.0:
            return {}
        # The columns were made for an effect of another size.
        weights *= block.formed_at / size
        axes = [AXES.index(name) for name in candidate.effect.axes]
        slopes = weights[len(axes) :] / modulators.deviation
        shares = np.zeros(len(AXES))
        shares[axes] = AXES_OVER_FORM.value * weights[: len(axes)] - slopes @ modulators.mean
        shape = zip(SHAPE, np.concatenate((shares, slopes)), strict=True)
        return {p.name: float(np.clip(value, p.lowest, p.highest)) for p, value in shape if value}

    @cached_property
    def _unbounded(self) -> list[Fit]:
        """For each flight the fit by the laws alone on all other flights, without bounds.

        Bounds would hold what a fit without a flight knows least, and call it known.
        """
        law = self._law(None)
        return [refit(self.regression.gram - own, law, self._blocks) for own in self._per_flight]

    @property
    def _per_flight(self) -> Array:
        return self.regression.weighting.per_flight

    def _leaves(self, grams: Array) -> float:
        """Squares of flights left out after the fit of all others, by Gram matrices (F, K, K)."""
        return sum(float(fit.left @ own @ fit.left) for own, fit in zip(grams, self.left_out, strict=True))


def _even_grams(regression: Regression, chosen: Sequence[int]) -> Array:
    """Gram matrices (F, K, K) with the same weight at all frequencies, in units of the fastest noise.

    They hold the residual, the tolerances and the chosen candidates; all other columns are 0.
    """
    parts = [np.zeros(1, dtype=np.intp), regression.columns.tolerances]
    for block in (regression.block(index) for index in chosen):
        offset = [] if block.offset is None else [block.offset]
        parts += [block.parameters, block.form, np.array(offset, dtype=np.intp)]
    columns = np.concatenate(parts)
    grams = np.zeros_like(regression.weighting.per_flight)
    for place in range(len(regression.flights)):
        rows = regression.columns.rows(place, columns)
        rows *= np.sqrt(regression.weighting.precision[:, -1])[:, None, None]
        grams[place][np.ix_(columns, columns)] = cross_gram(rows, rows)
    return grams
