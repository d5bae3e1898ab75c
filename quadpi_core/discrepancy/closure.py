# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a search found, and how far that closes the gap between simulation and flights left out of the fit.

The search counts the error of a law as noise, most of which is slow, so a fit weighted by that noise hardly
sees the error of a law in steady flight. So the shape of a law is fitted by least squares with the same
weight at all frequencies, and the parameters of the effects stay as the search found them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.discrepancy.acceptance import FEW_FLIGHTS, Judgement, least_evidence
from quadpi_core.discrepancy.candidates import AXES_OVER_FORM
from quadpi_core.discrepancy.effect_regression import Regression, law_fit
from quadpi_core.discrepancy.evidence import Equations, Fit
from quadpi_core.discrepancy.unexplained import Inside, Unpredicted, held_axes, slow_state_noise
from quadpi_core.discrepancy.whitening import Noise, rows_of
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.simulation.effect_definition import SHAPE

MORE_THAN_SOUND = Threshold(
    "squares that flights leave beyond those of sound flights",
    2.0,
    "standard deviations of their mean",
    "the level of the intervals that are stated",
    CONVENTION,
)
_NONE_HELD = np.zeros(len(AXES), dtype=np.bool_)
# By candidate, those that do about as well in its place, best first, with their odds against it.
Rivals: TypeAlias = dict[int, list[tuple[int, float]]]


class Gap(NamedTuple):
    """Root-mean-square differences up to the highest compared frequency, order as `AXES`, N and Nm.

    Attributes:
        before, after: (6,) difference of measured and simulated wrench, after with the effects fitted on all
            other flights.
        floor: (6,) noise of sensors and states, or what the simulation states that it may err by.
        reduction: closed share of the squares above the floor, in those of the floor, of all axes that the
            simulation's own intervals do not hold.
    """

    before: Array
    after: Array
    floor: Array
    reduction: float


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
    def from_regression(cls, regression: Regression, chosen: Sequence[int]) -> Closing:
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
        return Equations.from_columns(self.regression.base, chosen, self.noise, shaped)

    @cached_property
    def left_out(self) -> list[Fit]:
        """For each flight the second of :meth:`fits` on all other flights."""
        return [self.fits(place)[1] for place in range(len(self.regression.flights))]

    def _leaves(self, noise: Noise) -> float:
        """Squares of flights left out after the fit of all others, in variances of a noise."""
        return sum(noise.squares(fit.residual(), place) for place, fit in enumerate(self.left_out))

    def gap(
        self, noise: Array, stated: Array, *, adjusted: bool = True, held: npt.NDArray[np.bool_] = _NONE_HELD
    ) -> Gap:
        """The gap of each flight after the fit of all others; unchanged where no effect was chosen.

        Coefficients alone are not fitted: without the missing effect they would exceed their tolerances. Of
        effects made of fitted coefficients, what the stated ones would change is left out. So is, before and
        after alike, what a flight has of its own beside them, which no effect closes.

        Args:
            noise: (6, C) variance in C bands, or (F, 6, C) of each flight, which no simulation can close.
            stated: (6,) mean squares that are no gap either, as the simulation states that it errs by them.
            adjusted: whether coefficients are moved as fitted, or stay as they are stated.
            held: axes (6,) that are no gap however large the difference is; none unless given.
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
        above = np.maximum(np.stack((before, after)) / floor - 1.0, 0.0)
        removable, kept = above.sum(axis=1, where=~held).tolist()
        reduction = 1.0 - kept / removable if removable > 0.0 else 0.0
        before, after, floor = np.sqrt(np.stack((before, after, floor)) / samples)
        return Gap(before, after, floor, reduction)

    def disagreement(self, index: int, deviation: Array) -> Array:
        """Spread (k,) between flights of the parameters of a candidate, over what one fit to all leaves open.

        The spread is the jackknife's, without bounds, which would call known what is not. Where one flight
        alone shows an effect, the fit without it knows less, and the spread is compared with that. Where the
        law holds, 1 is the most to expect: Birge, The calculation of errors by least squares (1932).

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
        return np.sqrt(np.divide(spread, expected, out=np.zeros(len(deviation)), where=estimated))

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


@dataclass(frozen=True)
class SearchResult:
    """Result of a search.

    Attributes:
        regression: regression at the end of the search.
        chosen: indices of the candidates that were named.
        fit: their fit.
        closing: fits by which they close the gap.
        rivals: for each chosen candidate others that do about as well in its place, best first, with their
            odds against it.
        left: prediction of the residual after the set by generic functions.
        judgements: one of every candidate in every round, best first.
        disputed: a sentence for each chosen effect in whose place another, or itself beyond its bounds, has
            much more evidence but fails a test.
        inside: what the intervals of the simulation hold of the flights; None without intervals.
        allowed: evidence of each chosen candidate that gains too little with as much noise as intervals state
            in axes that these hold [nat].
    """

    regression: Regression
    chosen: tuple[int, ...]
    fit: Fit
    closing: Closing
    rivals: Rivals
    left: Unpredicted
    judgements: tuple[Judgement, ...]
    disputed: tuple[str, ...] = ()
    inside: Inside | None = None
    allowed: Mapping[int, float] = field(default_factory=dict)

    @property
    def threshold(self) -> float:
        """Evidence that a first effect had to gain [nat]."""
        return least_evidence(len(self.regression.candidates))

    @property
    def held(self) -> npt.NDArray[np.bool_]:
        """Axes (6,) of which the simulation's own intervals hold what they say; none without intervals."""
        return held_axes(self.inside)

    @cached_property
    def sensors(self) -> Array:
        """Variance (6, C) of the noise that sensors and the errors of states make, in C bands.

        It is what sound flights leave, where they are known. Else that of sensors is what is left at the
        highest frequencies: white in a force, and in a moment largest there. It is no less than what a model
        states by its intervals, unless sound flights are enough to tell how much they differ.
        """
        noise, sound = self.left.noise, self.regression.sound
        if sound is not None:
            return np.maximum(sound.left, self._stated[:, np.newaxis])
        slow = slow_state_noise(self.regression.flights, noise.shape[1])
        return np.maximum(noise[:, -1:] + slow, self._stated[:, np.newaxis])

    @property
    def _stated(self) -> Array:
        """Mean squares (6,) of intervals, which are no gap; 0 where enough sound flights tell more."""
        sound = self.regression.sound
        return self.regression.stated_squares * (sound is None or sound.flights < FEW_FLIGHTS.value)

    def deviation(self, index: int) -> Array:
        """Standard deviation (k,) of the parameters of a chosen candidate, in their units; 0 at a bound.

        The fit's own holds what tolerances and noise leave open. Where flights differ by more, in any
        parameter of the law, it is as much wider; and it is no less than an error of the laws leaves open.
        """
        regression = self.regression
        with_forms = regression.equations(self.chosen, self.chosen).with_forms(self.fit)
        differ = max(1.0, float(self.disagreement(index).max()))
        wider: Array = regression.deviation(index, self.fit) * differ
        of_laws = regression.deviation(index, with_forms)
        return np.maximum(wider, of_laws) * regression.candidates[index].scale

    def disagreement(self, index: int) -> Array:
        """See :meth:`Closing.disagreement`; 0 (k,) of flights so few that they do not predict each other."""
        deviation = self.regression.deviation(index, self.fit)
        few = len(self.regression.flights) < FEW_FLIGHTS.value
        return np.zeros(len(deviation)) if few else self.closing.disagreement(index, deviation)

    @cached_property
    def _as_sound(self) -> Array | None:
        """Variance (6, C) that as many sound flights leave at most; None where none are known."""
        sound = self.regression.sound
        if sound is None:
            return None
        # Both means vary, of these flights and of the sound ones.
        error = sound.differ * np.sqrt(1.0 / len(self.regression.flights) + 1.0 / sound.flights)
        return np.asarray(sound.left * (1.0 + MORE_THAN_SOUND.value * error)[:, np.newaxis])

    def gap(self, *, adjusted: bool = True) -> Gap:
        """The gap of flights left out, see :meth:`Closing.gap`; what sensors do not explain is no floor.

        That is the most that as many sound flights leave; their mean, where only intervals are broken.
        """
        sound, measured = self.regression.sound, partial(self.closing.gap, adjusted=adjusted, held=self.held)
        if sound is None or self._as_sound is None:
            return measured(np.minimum(self.regression.noise.variance, self.sensors), self._stated)
        gap = measured(self._as_sound, self._stated)
        broken = self.inside is not None and not self.inside.held.all()
        further = np.any(gap.before > gap.floor, where=~self.held)
        return measured(sound.left, self._stated) if broken and not further else gap

    @property
    def beyond_sound(self) -> Array:
        """Squares (6,) of the residual after the fit beyond those of sound flights, in variances of these.

        Without sound flights they are those beyond what the simulation's own intervals state, infinite where
        there are none.
        """
        stated = np.repeat(self._stated[:, np.newaxis], self.regression.residual.bands, axis=1)
        allowed = stated if self._as_sound is None else np.maximum(self._as_sound, stated)
        if not allowed.any():
            return np.full(len(AXES), np.inf)
        squares = np.zeros(len(AXES))
        for left, own in zip(self.regression.left(self.fit), self.regression.residual.spectra, strict=True):
            squares += np.sum(np.square(left) / allowed[:, own.band] - 1.0, axis=1)
        return np.maximum(squares, 0.0)
