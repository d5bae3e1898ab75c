# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The search for the effects, if any, that explain where simulation and flights disagree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.discrepancy.acceptance import (
    FEW_FLIGHTS,
    FURTHER_LEAST,
    FURTHER_NUMBER,
    HOLDS_MORE,
    LARGEST,
    NAMED_ALONE,
    NO_EXPLANATION,
    ORDINARY,
    SMALLEST,
    Accepted,
    Judgement,
    Trial,
    judge_evidence,
    least_evidence,
    once_of_effects,
    rival_margin,
    scales_beside_law,
    stands_behind,
)
from quadpi_core.discrepancy.candidates import Candidate
from quadpi_core.discrepancy.closure import Closing, Rivals, SearchResult
from quadpi_core.discrepancy.effect_regression import Regression
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.evidence import Condition, Fit
from quadpi_core.discrepancy.unexplained import (
    Inside,
    generic_spectra,
    held_axes,
    inside_intervals,
    predicted,
)
from quadpi_core.discrepancy.whitening import Spectrum
from quadpi_core.flight import AXES
from quadpi_core.records import CONVENTION, Threshold

MOST_EFFECTS = Threshold(
    "most effects",
    3,
    "effects",
    "more than a person would look for at once; the rest counts as unexplained",
    CONVENTION,
)

KEPT = Threshold(
    "evidence of what all flights share beside what each has of its own",
    0.5,
    "of the evidence without",
    "what most of the evidence speaks for is shared: of few flights, each for itself may explain as much",
    CONVENTION,
)

# Margins of a law within which coefficients as fitted, or columns about other points, may bring rivals close.
_NEAR = 3.0
# Beyond it odds are no number.
_MOST_LOG_ODDS = 700.0
# Candidates beside a set, each with the fit of all together.
_Fits: TypeAlias = Sequence[tuple[int, Fit | None]]


@dataclass(frozen=True)
class Prepared:
    """Flights beside their simulation with all that searches of them share, whatever these may name.

    Attributes:
        regression: with every candidate linearised where it fits best alone.
        inside: what the intervals of the simulation hold of the flights; None without intervals.
        within: names of the effects that act only on axes that these hold.
    """

    regression: Regression
    inside: Inside | None
    within: frozenset[str]

    @classmethod
    def from_flights(cls, flights: Sequence[Compared], candidates: Sequence[Candidate]) -> Prepared:
        """Prepare searches of flights, at least two, beside their simulation.

        What acts only where the simulation's own intervals hold is nothing that it lacks. Where sound flights
        tell the noise of every axis, flights may show it all the same, and no other effect is named for it.
        """
        inside = inside_intervals(flights)
        held = held_axes(inside)
        within = {c.name for c in candidates if all(held[AXES.index(axis)] for axis in c.effect.axes)}
        told = flights[0].simulation.sound is not None and not held.all()
        sought = [replace(c, within=c.name in within) for c in candidates if told or c.name not in within]
        regression = Regression.from_flights(flights, sought)
        for index in range(len(sought)):
            if (alone := Accepted.fitted(regression, (index,))) and (better := alone.refined()):
                regression = better.regression
        return cls(regression, inside, frozenset(within))

    @cached_property
    def generic(self) -> tuple[list[str], list[Spectrum]]:
        """See :func:`generic_spectra`."""
        return generic_spectra(self.regression.flights)


def search(prepared: Prepared, barred: Mapping[str, str] = MappingProxyType({})) -> SearchResult:
    """Search flights for the effects that their simulation lacks, but those barred by name for a reason."""
    regression, inside, own = prepared.regression, prepared.inside, _Search(barred, prepared.inside)
    accepted = Accepted(regression, (), regression.fit_none())
    disputed = tuple[str, ...]()
    for _ in range(MOST_EFFECTS.value):
        accepted = own.grown(accepted)
        exchanged, disputed = own.exchanged(accepted)
        exchanged = own.parted(exchanged)
        if exchanged.chosen == accepted.chosen:
            break
        accepted = exchanged
    # Other columns may clearly prefer another; what fails a test is told among its rivals.
    accepted, _ = own.exchanged(own.with_fitted_coefficients(accepted), float(np.exp(NAMED_ALONE.value)))
    rivals, allowed = own.rivals(accepted), dict[int, float]()
    if inside is not None:
        lenient = _lenient(accepted, inside.held)
        rivals, allowed = _told_among(rivals, own.rivals(lenient)), _allowed(lenient)
        sound = accepted.regression.sound
        if sound is not None and sound.flights < FEW_FLIGHTS.value:
            # So few do not tell by how much a simulation errs in other flights.
            rivals = _told_among(rivals, own.rivals(_lenient(accepted, np.ones_like(inside.held))))
    names, spectra = prepared.generic
    return SearchResult(
        regression=accepted.regression,
        chosen=accepted.chosen,
        fit=accepted.fit,
        closing=Closing.from_regression(accepted.regression, accepted.chosen),
        rivals=rivals,
        left=predicted(accepted.regression.left(accepted.fit), spectra, names),
        judgements=tuple(own.judgements),
        disputed=(*disputed, *_beyond_bounds(accepted)),
        inside=inside,
        allowed=allowed,
    )


def _beyond_bounds(accepted: Accepted) -> list[str]:
    """What is said of effects that flights ask for beyond bounds, by as much as suffices a further effect."""
    regression, limit = accepted.regression, np.inf
    free = [replace(own, lowest=own.lowest - limit, highest=own.highest + limit) for own in regression.blocks]
    fit = replace(regression, blocks=tuple(free)).fit(accepted.chosen)
    beyond = fit is not None and fit.log_evidence - accepted.fit.log_evidence >= FURTHER_NUMBER.value
    return ["flights ask for parameters beyond their bounds"] if beyond else []


class _Search:
    """What one search may not name, by its name, and what it judged so far.

    Attributes:
        judgements: those of all rounds, in their order.
    """

    def __init__(self, barred: Mapping[str, str], inside: Inside | None) -> None:
        self._barred, self.judgements = barred, list[Judgement]()
        self._broken = None if inside is None else ~inside.held
        # Effects that became idle, which are not tried again.
        self._idle = set[int]()

    def grown(self, accepted: Accepted) -> Accepted:
        """The set with effects and conditions that one after the other gain the most and pass all tests."""
        while True:
            own, known = conditions_gaining(accepted), accepted.regression.candidates
            beside = next((one for k, one in own if self._barred.get(known[k].name) != HOLDS_MORE), None)
            gained = beside.fit.log_evidence - accepted.fit.log_evidence if beside else -np.inf
            fits = _fits_with_one_more(accepted) if len(accepted.chosen) < MOST_EFFECTS.value else []
            gains = {k: fit.log_evidence - accepted.fit.log_evidence for k, fit in fits if fit is not None}
            as_shared = gains.get(beside.regression.conditions[-1].index, -np.inf) if beside else -np.inf
            larger = None
            if fits and (keeps(as_shared, gained) or max(gains.values(), default=-np.inf) >= gained):
                larger = self._one_more(accepted, fits)
            # A condition gains more than any effect, or those that gain more were refused.
            larger = larger or beside
            if larger is None:
                return accepted
            accepted, dropped = without_idle(larger)
            self.judgements += dropped
            # A dropped effect is not tried again: two effects could replace each other forever.
            self._idle |= set(larger.chosen) - set(accepted.chosen)

    def _one_more(self, before: Accepted, fits: _Fits) -> Accepted | None:
        """One round: the set with the best candidate that passes all tests; None if none does."""
        behind, least = None, np.inf
        for index, fit in fits:
            own = before.regression.candidates[index]
            worse = fit is None or fit.log_evidence < least
            trial = Trial(
                before=before,
                added=index,
                fit=fit,
                dropped=index in self._idle,
                barred=self._barred.get(own.name, ""),
                behind=behind.label if behind and worse and stands_behind(own, behind) else "",
                instead=self._about_as_well(before, index, fit, fits),
                broken=self._broken,
            )
            judgement, larger = trial.outcome()
            self.judgements.append(judgement)
            if larger is not None:
                return larger
            if judgement.ends_round and behind is None:
                behind = own
                # Another kind may need less evidence than one that does about as well.
                if fit is not None and judgement.reason.test == "evidence":
                    least = fit.log_evidence - rival_margin(trial.gain)
        return None

    def _about_as_well(self, before: Accepted, index: int, fit: Fit | None, fits: _Fits) -> str:
        """Name of the best candidate of ordinary size that does about as well as one; empty without one."""
        if fit is None:
            return ""
        regression = before.regression
        least = fit.log_evidence - rival_margin(fit.log_evidence - before.fit.log_evidence)
        for other, found in fits:
            if found is None or found.log_evidence < least:
                break
            candidate = regression.candidates[other]
            is_ordinary = SMALLEST.value < regression.size(other, found) <= LARGEST.value
            if other != index and not self._barred.get(candidate.name) and is_ordinary:
                return candidate.label
        return ""

    def exchanged(self, accepted: Accepted, least_odds: float = 1.0) -> tuple[Accepted, tuple[str, ...]]:
        """The set with effects replaced by those that have better odds in their place and pass all tests.

        Disputed is an effect against which one that fails a test has odds of more than a hundred.
        """
        for _ in range(MOST_EFFECTS.value):
            rivals = self.rivals(accepted, of_its_name=True)
            disputed, better = [], None
            close = [(own, rival, odds) for own in rivals for rival, odds in rivals[own] if odds > least_odds]
            for index, rival, odds in close:
                judgement, better = self._in_place_of(accepted, index, rival).outcome()
                self.judgements.append(judgement)
                if better is not None:
                    break
                # One whose size is out of the ordinary is told among the rivals.
                before = odds_before(accepted.regression.candidates[rival], accepted.without(index))
                if odds > np.exp(NAMED_ALONE.value) * before and judgement.reason.test != ORDINARY:
                    own, reason = accepted.regression.candidates[index].label, judgement.reason.sentence
                    disputed.append(
                        f"{judgement.label} has more evidence than {own} in its place, but {reason}"
                    )
            if better is None:
                return accepted, tuple(disputed)
            accepted = better
        return accepted, ()

    def parted(self, accepted: Accepted) -> Accepted:
        """The set with those two in the place of one effect that gain the most, of whom both pass all tests.

        What acts as two do together, as a constant force for wind and a mass, gains more than either alone.
        In its place they need as much more as one of them would need beside it.
        """
        known, found = accepted.regression.candidates, list[tuple[float, float, Accepted, tuple[int, int]]]()
        for index in accepted.chosen if len(accepted.chosen) < MOST_EFFECTS.value else ():
            others = accepted.without(index)
            joining = [k for k, _ in _fits_with_one_more(others) if known[k].name not in self._barred]
            for pair in combinations([k for k in joining if k not in accepted.chosen], 2):
                fit = None if known[pair[0]].excludes(known[pair[1]]) else others.fit_with(*pair)
                least = min(map(accepted.needed, pair))
                if fit and fit.log_evidence >= accepted.fit.log_evidence + least:
                    found.append((fit.log_evidence, least, others, pair))
        for _, least, others, pair in sorted(found, key=lambda own: -own[0]):
            larger: Accepted | None = others
            before = len(self.judgements)
            for _ in pair:
                fits = [own for own in _fits_with_one_more(larger) if own[0] in pair] if larger else []
                larger = self._one_more(larger, fits) if larger else None
            # Once more, as both are refined and beside the noise that they leave.
            one = larger.regression.fit(accepted.chosen) if larger else None
            if larger and (one is None or larger.fit.log_evidence >= one.log_evidence + least):
                return larger
            # What was said of half a pair is not said of the set.
            del self.judgements[before:]
        return accepted

    def _in_place_of(self, accepted: Accepted, index: int, rival: int) -> Trial:
        """The trial of a rival in the place of one effect."""
        regression, others = accepted.regression, accepted.without(index)
        ordinary = regression.size(index, accepted.fit) <= LARGEST.value
        return Trial(
            before=others,
            added=rival,
            fit=others.fit_with(rival),
            barred=self._barred.get(regression.candidates[rival].name, ""),
            instead=regression.candidates[index].label if ordinary else "",
            broken=self._broken,
        )

    def with_fitted_coefficients(self, accepted: Accepted) -> Accepted:
        """The set fitted with columns of the simulation with its coefficients as fitted, where bounds allow.

        Rivals that do nearly as well get such columns too, so that they are compared alike.
        """
        near = {rival for close in self.rivals(accepted, near=True).values() for rival, _ in close}
        made = sorted({*accepted.chosen, *near})
        regression = accepted.regression.with_fitted_coefficients(made, accepted.fit)
        return accepted.within(regression)

    def rivals(self, accepted: Accepted, *, of_its_name: bool = False, near: bool = False) -> Rivals:
        """For each chosen candidate others that do about as well in its place, with their odds.

        What no search may name is told among them, unless it closes no gap or intervals hold it. Others
        `of_its_name`, as of another rotor, count where asked for, and those that are only `near`.
        """
        regression, found = accepted.regression, accepted.fit
        rivals: Rivals = {}
        for index in accepted.chosen:
            own, others = regression.candidates[index], accepted.without(index)
            margin = rival_margin(found.log_evidence - others.fit.log_evidence)
            scales = scales_beside_law(own, others.candidates)
            close = []
            for rival, candidate in enumerate(regression.candidates):
                same = rival == index or (candidate.name == own.name and not of_its_name)
                is_none = candidate.within or self._barred.get(candidate.name) in NO_EXPLANATION
                if same or is_none or any(map(candidate.excludes, others.candidates)):
                    continue
                # An effect that explains the error of a law is no rival of one that scales existing forces.
                if scales and not (candidate.effect.scales_existing or candidate.effect.scales_thrust):
                    continue
                swapped = others.fit_with(rival)
                if swapped is None or not Accepted(regression, (rival,), swapped).sizeable:
                    continue
                behind = found.log_evidence - swapped.log_evidence
                if not near and 0.0 < behind < _NEAR * margin:
                    chosen = tuple(sorted((*others.chosen, rival)))
                    behind -= _gained_together(Accepted(regression, chosen, swapped))
                if behind < (_NEAR if near else 1.0) * margin:
                    odds = np.exp(min(-behind * NAMED_ALONE.value / margin, _MOST_LOG_ODDS))
                    odds *= odds_before(candidate, others) / odds_before(own, others)
                    close.append((rival, float(odds)))
            rivals[index] = sorted(close, key=lambda item: -item[1])
        return rivals


def odds_before(candidate: Candidate, beside: Accepted) -> float:
    """Odds of an effect beside others before any flight, to one that comes with none of them.

    What others bring is named wherever it does about as well: a load hangs from a hook, and that thrust
    changed by chance meanwhile is less likely by the odds for which an effect is named alone.
    """
    brought = any(candidate.name in own.effect.brings for own in beside.candidates)
    return float(np.exp(NAMED_ALONE.value)) if brought else 1.0


@once_of_effects
def _gained_together(accepted: Accepted) -> float:
    """Evidence [nat] that a set with curved effects gains by columns about where it fits together.

    They have columns about where they fit alone, or beside what another effect of the set would replace.
    """
    refined = None if all(own.linear for own in accepted.candidates) else accepted.refined()
    return max(0.0, refined.fit.log_evidence - accepted.fit.log_evidence) if refined else 0.0


@once_of_effects
def conditions_gaining(accepted: Accepted) -> list[tuple[int, Accepted]]:
    """The set beside what each flight may have of a candidate of its own, by index; the most evidence first.

    Those that gain as much as a first effect has to and leave every effect most of its evidence or more than
    enough, as of a load, whose swing is no constant of each flight; none without sound flights.
    """
    regression, chosen = accepted.regression, accepted.chosen
    found, before = list[tuple[int, Accepted]](), accepted.gains()
    least = least_evidence(len(regression.candidates))
    for index in regression.conditions_to_come:
        condition = Condition(index, regression.sizes_of_condition(index, chosen))
        beside = Accepted.fitted(regression.with_condition(condition), chosen)
        if beside is None:
            continue
        gain = beside.fit.log_evidence - accepted.fit.log_evidence
        kept = beside.gains().items()
        if gain >= least and all(own >= FURTHER_NUMBER.value or keeps(own, before[k]) for k, own in kept):
            found.append((index, beside))
    return sorted(found, key=lambda one: -one[1].fit.log_evidence)


def keeps(evidence: float, of: float) -> bool:
    """Whether evidence [nat] is most of another."""
    return evidence >= KEPT.value * of


def _fits_with_one_more(before: Accepted) -> _Fits:
    """Candidates that can be added to the set, with the fit of all together; most evidence first."""
    fits = [
        (index, before.fit_with(index))
        for index, candidate in enumerate(before.regression.candidates)
        if not candidate.within and not any(map(candidate.excludes, before.candidates))
    ]
    return sorted(fits, key=lambda item: np.inf if item[1] is None else -item[1].log_evidence)


@once_of_effects
def without_idle(accepted: Accepted) -> tuple[Accepted, list[Judgement]]:
    """The set without an effect that is idle beside a better one or a condition, and the judgement of it."""
    regression = accepted.regression
    for index in accepted.chosen:
        fewer = tuple(other for other in accepted.chosen if other != index)
        rest = Accepted.fitted(regression, fewer) if fewer or regression.conditions else None
        if rest is None or (fewer and not rest.sizeable):
            continue
        gain = accepted.fit.log_evidence - rest.fit.log_evidence
        still_needed = judge_evidence(gain, rest.needed(index))
        better = None if still_needed.passed else rest.refined()
        smaller = better and Accepted.fitted(better.regression.beside(fewer, better.fit), fewer)
        if smaller is not None:
            return smaller, [Judgement.from_verdicts(smaller, index, (still_needed,))]
    return accepted, []


def _lenient(accepted: Accepted, held: npt.NDArray[np.bool_]) -> Accepted:
    """The set with as much noise as intervals state in axes (6,) that these hold.

    By what they hold a simulation may err: it does not tell which of two effects is missing.
    """
    regression = accepted.regression
    noise = regression.noise.variance
    lenient = regression.weighted(np.where(held[:, np.newaxis], np.maximum(noise, regression.stated), noise))
    return accepted.within(lenient)


def _allowed(lenient: Accepted) -> dict[int, float]:
    """Evidence [nat] of each effect that gains less than the least beside the others."""
    alone = len(lenient.chosen) == 1
    least = least_evidence(len(lenient.regression.candidates)) if alone else FURTHER_LEAST.value
    return {index: gain for index, gain in lenient.gains().items() if gain < least}


def _told_among(rivals: Rivals, lenient: Rivals) -> Rivals:
    """The rivals, and those that more noise adds: it hides what speaks for an effect, and prefers none."""
    told = {}
    for index, close in lenient.items():
        odds = {rival: min(own, 1.0) for rival, own in close} | dict(rivals[index])
        told[index] = sorted(odds.items(), key=lambda item: -item[1])
    return told
