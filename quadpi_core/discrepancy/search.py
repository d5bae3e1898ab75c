# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The search for the effects, if any, that explain where simulation and flights disagree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from quadpi_core.discrepancy.acceptance import (
    FEW_FLIGHTS,
    LARGEST,
    NAMED_ALONE,
    ORDINARY,
    SMALLEST,
    Accepted,
    Judgement,
    Trial,
    evidence_needed,
    judge_evidence,
    judge_size,
    least_evidence,
    rival_margin,
    scales_beside_law,
)
from quadpi_core.discrepancy.candidates import Candidate
from quadpi_core.discrepancy.closure import Closing, Gap, left_out_squares
from quadpi_core.discrepancy.effect_regression import Regression, refined, settled
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.evidence import Fit
from quadpi_core.discrepancy.flight_conditions import Condition
from quadpi_core.discrepancy.unexplained import (
    Left,
    generic_spectra,
    predicted,
    slow_state_noise,
    stated_squares,
)
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.thresholds import CONVENTION, Threshold

MOST_EFFECTS = Threshold(
    "most effects",
    3,
    "effects",
    "more than a person would look for at once; the rest counts as unexplained",
    CONVENTION,
)

MORE_THAN_SOUND = Threshold(
    "squares that flights leave beyond those of sound flights",
    2.0,
    "standard deviations of their mean",
    "the level of the intervals that are stated",
    CONVENTION,
)

# Beyond it odds are no number.
_MOST_LOG_ODDS = 700.0


@dataclass(frozen=True)
class Found:
    """Result of a search.

    Attributes:
        regression: regression at the end of the search.
        chosen: indices of the candidates that were named.
        fit: their fit.
        closing: fits by which they close the gap.
        gain: evidence of the set over no effect [nat].
        threshold: evidence that a first effect has to gain [nat].
        rivals: for each chosen candidate others that do about as well in its place, best first, with their
            odds against it.
        left: prediction of the residual after the set by generic functions.
        named: (6,) squares that are credited to the effects, in variances of the noise of `left`; see
            :attr:`Reduction.credited`.
        judgements: one of every candidate in every round, best first.
        disputed: a sentence for each chosen effect in whose place another has much more evidence but fails a
            test.
    """

    regression: Regression
    chosen: tuple[int, ...]
    fit: Fit
    closing: Closing
    gain: float
    threshold: float
    rivals: dict[int, list[tuple[int, float]]]
    left: Left
    named: Array
    judgements: tuple[Judgement, ...]
    disputed: tuple[str, ...] = ()

    @cached_property
    def sensors(self) -> Array:
        """Variance (6, C) of the noise that sensors and the errors of states make, in C bands.

        It is what sound flights leave, where they are known. Else that of sensors is what is left at the
        highest frequencies: white in a force, and in a moment largest there; and no less than what a model
        states by its intervals.
        """
        noise, sound = self.left.noise, self.regression.sound
        if sound is not None:
            return sound.left
        slow = slow_state_noise(self.regression.flights, noise.shape[1])
        return np.maximum(noise[:, -1:] + slow, self.stated[:, np.newaxis])

    def deviation(self, index: int) -> Array:
        """Standard deviation (k,) of the parameters of a chosen candidate, in their units; 0 at a bound.

        The fit's own holds what tolerances and noise leave open, as if flights differed by nothing else;
        where they do, in any parameter of the law, it is as much wider, as is usual for measurements that
        disagree. It is no less than what the laws of the effects leave open, of which each axis may be off by
        a share, even where no flight asks for it.
        """
        of_laws = self.regression.deviation(index, self._with_forms)
        wider: Array = self._deviation(index) * max(1.0, float(self.disagreement(index).max()))
        return np.maximum(wider, of_laws) * self.regression.candidates[index].scale

    @cached_property
    def _with_forms(self) -> Fit:
        """The fit beside the forms of all laws, one for all of the chosen."""
        return self.regression.equations(self.chosen, self.chosen).with_forms(self.fit)

    def disagreement(self, index: int) -> Array:
        """See :meth:`Closing.disagreement`; 0 (k,) of flights so few that they do not predict each other."""
        deviation = self._deviation(index)
        few = len(self.regression.flights) < FEW_FLIGHTS.value
        return np.zeros(len(deviation)) if few else self.closing.disagreement(index, deviation)

    def _deviation(self, index: int) -> Array:
        return self.regression.deviation(index, self.fit)

    @cached_property
    def _as_sound(self) -> Array | None:
        """Variance (6, C) that as many sound flights leave at most; None where none are known."""
        sound = self.regression.sound
        if sound is None:
            return None
        # Both means vary, of these flights and of the sound ones.
        error = sound.differ * np.sqrt(1.0 / len(self.regression.flights) + 1.0 / sound.flights)
        allowed: Array = sound.left * (1.0 + MORE_THAN_SOUND.value * error)[:, np.newaxis]
        return allowed

    def gap(self, *, adjusted: bool = True) -> Gap:
        """The gap of flights left out, see :meth:`Closing.gap`; what sensors do not explain is no floor."""
        if self._as_sound is not None:
            return self.closing.gap(self._as_sound, np.zeros(len(AXES)), adjusted=adjusted)
        noise = np.minimum(self.regression.noise.variance, self.sensors)
        return self.closing.gap(noise, self.stated, adjusted=adjusted)

    @property
    def beyond_sound(self) -> Array:
        """Squares (6,) of the residual after the fit beyond those of sound flights, in variances of these.

        They are infinite where no sound flights are known.
        """
        if self._as_sound is None:
            return np.full(len(AXES), np.inf)
        squares = np.zeros(len(AXES))
        for left, own in zip(self.regression.left(self.fit), self.regression.residual.spectra, strict=True):
            squares += np.sum(np.square(left) / self._as_sound[:, own.band] - 1.0, axis=1)
        return np.maximum(squares, 0.0)

    @cached_property
    def stated(self) -> Array:
        """Mean squares (6,) that the simulation's own intervals state."""
        return stated_squares(self.regression.flights)


def search(flights: Sequence[Compared], candidates: Sequence[Candidate]) -> Found:
    """Search flights for candidates.

    Args:
        flights: at least two, beside their simulation.
        candidates: effects to look for.
    """
    regression = Regression.of(flights, candidates)
    threshold = least_evidence(len(candidates))
    none = regression.fit_none()
    accepted = Accepted(settled(regression), (), none)
    idle: frozenset[int] = frozenset()
    gain = 0.0
    judgements: list[Judgement] = []
    disputed: tuple[str, ...] = ()
    for _ in range(MOST_EFFECTS.value):
        accepted, more, idle, judged = _grown(accepted, threshold, idle)
        exchanged, swapped, disputed = _exchanged(accepted, threshold)
        gain += more
        judgements += [*judged, *swapped]
        if exchanged.chosen == accepted.chosen:
            break
        accepted = exchanged
    # First, as only the chosen get columns beside other coefficients, which no rival has.
    rivals = _rivals(accepted)
    accepted = _with_fitted_coefficients(accepted)
    names, spectra = generic_spectra(flights)
    left = predicted(accepted.regression.left(accepted.fit), spectra, names)
    return Found(
        regression=accepted.regression,
        chosen=accepted.chosen,
        fit=accepted.fit,
        closing=Closing.of(accepted.regression, accepted.chosen),
        gain=gain,
        threshold=threshold,
        rivals=rivals,
        left=left,
        named=accepted.regression.reduction(accepted.chosen, accepted.fit, left.noise).credited,
        judgements=tuple(judgements),
        disputed=disputed,
    )


def _grown(
    accepted: Accepted, threshold: float, idle: frozenset[int]
) -> tuple[Accepted, float, frozenset[int], list[Judgement]]:
    """The set with all effects and conditions that one after the other gain the most and pass all tests.

    Returns:
        The set, the evidence that was gained [nat], effects that became idle, which are not tried again, and
        all judgements.
    """
    gain = 0.0
    judgements: list[Judgement] = []
    while True:
        condition, gained = _best_condition(accepted, threshold)
        fits = _fits_with_one_more(accepted) if len(accepted.chosen) < MOST_EFFECTS.value else []
        most = max((fit.log_evidence for _, fit in fits if fit is not None), default=-np.inf)
        larger, more = None, 0.0
        if fits and most - accepted.fit.log_evidence >= gained:
            larger, more, judged = _one_more(accepted, fits, threshold, idle)
            judgements += judged
        if larger is None and condition is not None:
            # It gains more than any effect, or those that gain more were refused.
            larger = _with_condition(accepted, condition)
        if larger is None:
            break
        gain += more
        accepted, dropped = without_idle(larger, threshold)
        judgements += dropped
        # A dropped effect is not tried again: two effects could replace each other forever.
        idle |= set(larger.chosen) - set(accepted.chosen)
    return accepted, gain, idle, judgements


def _best_condition(accepted: Accepted, threshold: float) -> tuple[Condition | None, float]:
    """What each flight may have of its own that gains the most evidence, and how much [nat].

    None, and negative infinity, where nothing gains as much as the threshold, and without sound flights that
    tell how much flights differ.
    """
    regression, chosen = accepted.regression, accepted.chosen
    best, most = None, -np.inf
    for index in regression.conditions_to_come:
        sizes = regression.sizes_of_condition(index, chosen)
        condition = Condition(index, sizes)
        fit = regression.with_condition(condition).fit(chosen)
        gain = -np.inf if fit is None else fit.log_evidence - accepted.fit.log_evidence
        if gain >= max(threshold, most):
            best, most = condition, gain
    return best, most


def _with_condition(accepted: Accepted, condition: Condition) -> Accepted | None:
    """The set beside what each flight has of its own; None where bounds leave nothing of it."""
    regression = accepted.regression.with_condition(condition)
    fit = regression.fit(accepted.chosen)
    return None if fit is None else Accepted(regression, accepted.chosen, fit)


def _with_fitted_coefficients(accepted: Accepted) -> Accepted:
    """The set fitted with columns of the simulation with its coefficients as fitted, where bounds allow."""
    regression = accepted.regression.with_fitted_coefficients(accepted.chosen, accepted.fit)
    fit = regression.fit(accepted.chosen)
    return accepted if fit is None else Accepted(regression, accepted.chosen, fit)


def _exchanged(accepted: Accepted, threshold: float) -> tuple[Accepted, list[Judgement], tuple[str, ...]]:
    """The set with effects replaced by those that have more evidence in their place and pass all tests.

    The search adds one effect at a time, and takes the next best where the best fails a test. Where that one
    has odds of more than a hundred against an effect that was taken instead, neither is certain: that is
    disputed.
    """
    judgements: list[Judgement] = []
    for _ in range(MOST_EFFECTS.value):
        rivals = _rivals(accepted, of_its_name=True)
        disputed, better = [], None
        more = [(own, rival, odds) for own, close in rivals.items() for rival, odds in close if odds > 1.0]
        for index, rival, odds in more:
            better, judgement = _replaced(accepted, index, rival, threshold)
            judgements.append(judgement)
            if better is not None:
                break
            # One whose size is out of the ordinary is told among the rivals.
            if odds > np.exp(NAMED_ALONE.value) and judgement.reason.test != ORDINARY:
                own = accepted.regression.candidates[index].label
                reason = judgement.reason.sentence
                disputed.append(f"{judgement.label} has more evidence than {own} in its place, but {reason}")
        if better is None:
            return accepted, judgements, tuple(disputed)
        accepted = better
    return accepted, judgements, ()


def _replaced(
    accepted: Accepted, index: int, rival: int, threshold: float
) -> tuple[Accepted | None, Judgement]:
    """The set with one effect replaced by another, None where that fails a test; and its judgement."""
    regression = accepted.regression
    others = tuple(other for other in accepted.chosen if other != index)
    rest = regression.fit(others) or regression.fit_none()
    trial = Trial(
        regression=regression,
        chosen=others,
        found=rest,
        added=rival,
        fit=regression.fit(tuple(sorted((*others, rival)))),
        needed=_needed(regression, rival, others, regression.energy(others, rest), threshold),
        instead=_ordinary(accepted, index),
        squares_before=lambda: left_out_squares(regression, others),
    )
    return trial.result, trial.judgement


def _one_more(
    before: Accepted, fits: Sequence[tuple[int, Fit | None]], threshold: float, idle: frozenset[int]
) -> tuple[Accepted | None, float, list[Judgement]]:
    """One round: the set with the best candidate that passes all tests, its gain, and all judgements.

    The set is None where no candidate passes.
    """
    regression, chosen = before.regression, before.chosen
    energy = regression.energy(chosen, before.fit)

    @cache
    def squares() -> Array:
        return left_out_squares(regression, chosen)

    judgements, behind = [], ""
    for index, fit in fits:
        trial = Trial(
            regression=regression,
            chosen=chosen,
            found=before.fit,
            added=index,
            fit=fit,
            needed=_needed(regression, index, chosen, energy, threshold),
            dropped=index in idle,
            behind=behind,
            instead=_about_as_well(before, index, fit, fits),
            squares_before=squares,
        )
        judgements.append(trial.judgement)
        if trial.result is not None:
            return trial.result, trial.gain, judgements
        if trial.judgement.ends_round:
            behind = behind or regression.candidates[index].label
    return None, 0.0, judgements


def _fits_with_one_more(before: Accepted) -> list[tuple[int, Fit | None]]:
    """Candidates that can be added to the set, with the fit of all together; most evidence first."""
    regression, fits = before.regression, []
    beside = [regression.candidates[index] for index in before.chosen]
    for index, candidate in enumerate(regression.candidates):
        if not any(map(candidate.excludes, beside)):
            fits.append((index, regression.fit(tuple(sorted((*before.chosen, index))))))
    return sorted(fits, key=lambda item: np.inf if item[1] is None else -item[1].log_evidence)


def _about_as_well(
    before: Accepted, index: int, fit: Fit | None, fits: Sequence[tuple[int, Fit | None]]
) -> str:
    """Name of the best candidate of ordinary size that does about as well as one; empty without one."""
    if fit is None:
        return ""
    least = fit.log_evidence - rival_margin(fit.log_evidence - before.fit.log_evidence)
    for other, found in fits:
        if found is None or found.log_evidence < least:
            break
        smallest, largest = SMALLEST.value, LARGEST.value
        if other != index and smallest < before.regression.size(other, found) <= largest:
            return before.regression.candidates[other].label
    return ""


def _ordinary(accepted: Accepted, index: int) -> str:
    """Name of an accepted effect whose size is ordinary; empty where it is not."""
    ordinary = accepted.regression.size(index, accepted.fit) <= LARGEST.value
    return accepted.regression.candidates[index].label if ordinary else ""


def _needed(
    regression: Regression, index: int, beside: Sequence[int], energy: float, threshold: float
) -> float:
    """Evidence that an effect has to gain beside others, given the energy of their contribution."""
    others = [regression.candidates[other] for other in beside]
    known = regression.sound is not None
    return evidence_needed(regression.candidates[index], others, energy, threshold, known=known)


def without_idle(accepted: Accepted, threshold: float) -> tuple[Accepted, list[Judgement]]:
    """The set without an effect that is idle beside a better one or a condition, and its judgement."""
    regression, chosen, found = accepted.regression, accepted.chosen, accepted.fit
    for index in chosen:
        fewer = tuple(other for other in chosen if other != index)
        rest = regression.fit(fewer) if fewer or regression.conditions else None
        if rest is None or (fewer and not _sizeable(regression, fewer, rest)):
            continue
        needed = _needed(regression, index, fewer, regression.energy(fewer, rest), threshold)
        still_needed = judge_evidence(found.log_evidence - rest.log_evidence, needed)
        better = None if still_needed.passed else refined(regression, fewer, rest)
        if better is not None:
            weighted = better[0].beside(fewer, better[1])
            fit = weighted.fit(fewer)
            if fit is not None:
                smaller = Accepted(weighted, fewer, fit)
                candidate = regression.candidates[index]
                return smaller, [Judgement(candidate.name, candidate.label, smaller.names, (still_needed,))]
    return accepted, []


def _rivals(accepted: Accepted, *, of_its_name: bool = False) -> dict[int, list[tuple[int, float]]]:
    """For each chosen candidate others that do about as well in its place, with their odds.

    Args:
        accepted: effects that were accepted.
        of_its_name: whether those of the same effect count too, such as the same of another rotor.
    """
    regression, found = accepted.regression, accepted.fit
    rivals: dict[int, list[tuple[int, float]]] = {}
    for index in accepted.chosen:
        own = regression.candidates[index]
        others = tuple(other for other in accepted.chosen if other != index)
        beside = [regression.candidates[other] for other in others]
        without = regression.fit(others) or regression.fit_none()
        margin = rival_margin(found.log_evidence - without.log_evidence)
        scales = scales_beside_law(own, beside)
        close = []
        for rival, candidate in enumerate(regression.candidates):
            same = rival == index or (candidate.name == own.name and not of_its_name)
            if same or any(map(candidate.excludes, beside)):
                continue
            # An effect that explains the error of a law is no rival of one that scales existing forces.
            if scales and not candidate.effect.scales_existing:
                continue
            swapped = regression.fit(tuple(sorted((*others, rival))))
            if swapped is None or not _sizeable(regression, (rival,), swapped):
                continue
            behind = found.log_evidence - swapped.log_evidence
            if behind < margin:
                odds = np.exp(min(-behind * NAMED_ALONE.value / margin, _MOST_LOG_ODDS))
                close.append((rival, float(odds)))
        rivals[index] = sorted(close, key=lambda item: -item[1])
    return rivals


def _sizeable(regression: Regression, chosen: Sequence[int], found: Fit) -> bool:
    sizes = {regression.candidates[index].label: regression.size(index, found) for index in chosen}
    return judge_size(sizes).passed
