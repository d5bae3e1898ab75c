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

from quadpi_core.discrepancy.effect_columns import AXES_OVER_FORM
from quadpi_core.discrepancy.effect_regression import Regression
from quadpi_core.discrepancy.evidence import Equations, Fit
from quadpi_core.discrepancy.whitening import Noise, rows_of
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.simulation.effect_definition import SHAPE


class Gap(NamedTuple):
    """Root-mean-square differences up to the highest compared frequency, order as `AXES`, N and Nm.

    Attributes:
        before, after: (6,) difference of measured and simulated wrench, after with the effects fitted on all
            other flights.
        floor: (6,) noise of sensors and states, or what the simulation states that it may err by.
        reduction: closed share of the squares above the floor, in those of the floor, of all axes.
    """

    before: Array
    after: Array
    floor: Array
    reduction: float


def law_fit(regression: Regression, chosen: Sequence[int], without: int | None = None) -> Fit:
    """Fit of some candidates by their laws alone, and of all coefficients; without one of the flights."""
    return regression.equations(chosen).fit(without) or regression.equations(()).fit_none(without)


def left_out_squares(regression: Regression, chosen: Sequence[int]) -> Array:
    """Squares (6,) of the flights, each after the fit of all others by the laws, in variances of the noise.

    What a flight may have of its own is left out, however large.
    """
    regression, squares = regression.varied, np.zeros(len(AXES))
    for place, (_, band) in enumerate(regression.residual.spectra):
        left = regression.left_of(place, law_fit(regression, chosen, place))
        squares += np.sum(np.square(left) * regression.noise.precision[place][:, band], axis=1)
    return squares


@dataclass(frozen=True)
class Closing:
    """Fits that close the gap: effects, shapes of their laws, and coefficients; see :meth:`fits`.

    Attributes:
        regression: regression of the search.
        chosen: indices of the candidates that were named.
        shaped: those whose laws are shaped, because that reduces the residual of flights left out.
        noise: weighs the residual: the same at all frequencies with shapes.
        adjusted: whether coefficients are adjusted beside the effects.
    """

    regression: Regression
    chosen: tuple[int, ...]
    shaped: tuple[int, ...]
    noise: Noise
    adjusted: bool

    @classmethod
    def of(cls, regression: Regression, chosen: Sequence[int]) -> Closing:
        """Fits with laws shaped, and coefficients adjusted, where that helps on flights left out."""
        best = cls(regression, tuple(chosen), (), regression.noise, adjusted=True)
        laws = [(index, regression.candidates[index]) for index in chosen]
        # A law that is not linear in its parameters is shaped by them.
        if shaped := tuple(index for index, law in laws if law.effect.shape and law.linear):
            variance = best.noise.variance
            flat = np.repeat(variance[..., -1:], variance.shape[-1], axis=-1)
            whole = replace(best, shaped=shaped, noise=replace(best.noise, variance=flat, own=()))
            best = whole if whole._leaves(whole.noise) < best._leaves(whole.noise) else best
        stated = replace(best, adjusted=False)
        return best if not chosen or best._leaves(best.noise) < stated._leaves(best.noise) else stated

    def fits(self, without: int | None = None) -> tuple[Fit, Fit]:
        """Fit of the parameters by the laws alone, and fit of coefficients and shapes beside these.

        Args:
            without: index of a flight to leave out of both, so that they can be judged on it.
        """
        law = law_fit(self.regression, self.chosen, without)
        return law, self._equations.fit_forms(law, adjusted=self.adjusted, without=without)

    @cached_property
    def _equations(self) -> Equations:
        chosen, shaped = ([self.regression.blocks[k] for k in some] for some in (self.chosen, self.shaped))
        return Equations.of(self.regression.base, chosen, self.noise, shaped)

    @cached_property
    def left_out(self) -> list[Fit]:
        """For each flight the second of :meth:`fits` on all other flights."""
        return [self.fits(place)[1] for place in range(len(self.regression.flights))]

    def _leaves(self, noise: Noise) -> float:
        """Squares of flights left out after the fit of all others, in variances of a noise."""
        return sum(noise.squares(fit.residual(), place) for place, fit in enumerate(self.left_out))

    def gap(self, noise: Array, stated: Array, *, adjusted: bool = True) -> Gap:
        """The gap of each flight after the fit of all others; unchanged where no effect was chosen.

        Coefficients alone are not fitted: without the missing effect they would exceed their tolerances. Of
        effects made of fitted coefficients, what the stated ones would change is left out. So is, before and
        after alike, what a flight has of its own beside them, which no effect closes.

        Args:
            noise: (6, C) variance in C bands, or (F, 6, C) of each flight, which no simulation can close.
            stated: (6,) mean squares that are no gap either, as the simulation states that it errs by them.
            adjusted: whether coefficients are moved as fitted, or stay as they are stated.
        """
        regression, (before, after, floor) = self.regression, np.zeros((3, len(AXES)))
        noises = np.broadcast_to(noise, regression.noise.variance.shape)
        stays = () if self.chosen and adjusted else regression.base[1:]
        for place, (found, own) in enumerate(zip(self.left_out, regression.residual.spectra, strict=True)):
            left = found.residual(without=stays)
            apart = regression.noise.own_rows(left, place)
            before += np.square(own.rows[:, :, 0] - apart).sum(axis=1)
            after += np.square(rows_of(left, place) - apart).sum(axis=1)
            floor += noises[place][:, own.band].sum(axis=1)
        samples = sum(len(flight.thinned) for flight in regression.flights)
        # Of numbers that were made up, without any noise, too.
        floor = np.maximum(floor, stated * samples + np.finfo(float).eps * before + np.finfo(float).tiny)
        removable, kept = np.maximum(np.stack((before, after)) / floor - 1.0, 0.0).sum(axis=1).tolist()
        reduction = 1.0 - kept / removable if removable > 0.0 else 0.0
        before, after, floor = np.sqrt(np.stack((before, after, floor)) / samples)
        return Gap(before, after, floor, reduction)

    def disagreement(self, index: int, deviation: Array) -> Array:
        """Spread (k,) between flights of the parameters of a candidate, over what one fit to all leaves open.

        The spread is the jackknife's, of fits without each flight in turn, without bounds: these would hold
        what a fit without a flight knows least, and call it known. A flight that alone shows an effect
        spreads it, too, but then the fit without it says that it knows less: the spread is compared with
        that, where it is more. Where the law holds, 1 is the most to expect; see Birge, The calculation of
        errors by the method of least squares (1932).

        Args:
            index: index of the candidate.
            deviation: (k,) of its parameters in the fit to all, in prior ones; 0 for those at a bound.
        """
        regression, law = self.regression, law_fit(self.regression, self.chosen)
        equations, flights = regression.equations(self.chosen), range(len(regression.flights))
        without = [equations.refit(law, place) for place in flights]
        share = (len(without) - 1) / len(without)
        spread = len(without) * share * np.var([regression.found(index, fit) for fit in without], axis=0)
        known = np.square(regression.deviation(index, law))
        lost = [np.square(regression.deviation(index, fit)) - known for fit in without]
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
        candidate, block = self.regression.candidates[index], self.regression.blocks[index]
        modulators = self.regression.modulators
        if block.form is None:
            return {}
        size = float(np.linalg.norm(self.regression.found(index, law)))
        # The columns were made for an effect of another size.
        weights = candidate.form * found.of(block.form) * block.formed_at / (size or np.inf)
        if not weights.any():
            return {}
        axes = [AXES.index(name) for name in candidate.effect.axes]
        slopes = weights[len(axes) :] / modulators.deviation
        shares = np.zeros(len(AXES))
        shares[axes] = AXES_OVER_FORM.value * weights[: len(axes)] - slopes @ modulators.mean
        shape = zip(SHAPE, np.concatenate((shares, slopes)), strict=True)
        return {p.name: float(np.clip(value, p.lowest, p.highest)) for p, value in shape if value}
