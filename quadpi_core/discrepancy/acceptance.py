# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The tests that a candidate of the search has to pass, each with its threshold and the reason for that.

A candidate is accepted if it passes all tests of a :class:`Trial`. The tests of the result as a whole are in
`result_verdicts`.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, wraps
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from quadpi_core.discrepancy.candidates import Candidate
from quadpi_core.discrepancy.effect_regression import ROUNDS, Regression, left_out_squares
from quadpi_core.discrepancy.evidence import Fit
from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, DEVELOPMENT, Threshold

FALSE_ALARMS = Threshold(
    "false alarms",
    0.01,
    "share of searches without any effect",
    "half of the 2 % that the blind benchmark allows: a wrong name costs more than a missed small effect",
    CONVENTION,
)
FURTHER_SHARE = Threshold(
    "share of a further effect",
    0.05,
    "of the evidence of the contribution of the effects before it",
    "others explain the error of a wrong law in proportion to its contribution, however tolerances cover it",
    DEVELOPMENT,
)
FURTHER_LEAST = Threshold(
    "least gain of a further effect",
    20.0,
    "nat",
    "below the 40 to 170 nat that a true change of mass, inertia or thrust gains beside a wrong law",
    DEVELOPMENT,
)
FURTHER_NUMBER = Threshold(
    "gain that suffices a further exact effect",
    100.0,
    "nat",
    "above the gain of an exact effect that explains a wrong parameter of another exact one",
    DEVELOPMENT,
)
FURTHER_KNOWN = Threshold(
    "gain that suffices a further exact effect where sound flights tell the noise",
    40.0,
    "nat",
    "below the 46 to 190 nat of the hook of 1.5 g that a load of 4.7 g hangs from; noise that is known "
    "leaves an effect less to explain than noise that is estimated of the same flights",
    "sets of eight flights of a Crazyflie with a load",
)
FURTHER_LAW = Threshold(
    "gain that suffices a further law",
    200.0,
    "nat",
    "above the gain of an aerodynamic law that explains a wrong parameter of an exact effect",
    DEVELOPMENT,
)
BESIDE_LAW = Threshold(
    "gain that suffices beside a law",
    350.0,
    "nat",
    "above the gain of any effect that explains the error of an aerodynamic law",
    DEVELOPMENT,
)
SMALLEST = Threshold(
    "smallest size",
    0.13,
    "prior standard deviations, 1.5 typical sizes each",
    "a fifth of the typical size: a smaller effect is no finding, however certain it is",
    CONVENTION,
)
LARGEST = Threshold(
    "largest size where another does as well",
    5.0,
    "prior standard deviations, 1.5 typical sizes each",
    "a chance of one in a million by its prior; an effect of ordinary size that explains as much is judged "
    "in its place",
    CONVENTION,
)
LOUDNESS = Threshold(
    "loudness",
    0.1,
    "of the noise, root mean square in the loudest axis",
    "a quieter effect closes no gap; in a hover all motion, and what is simulated from it, is noise",
    DEVELOPMENT,
)
GROWTH = Threshold(
    "growth on flights left out",
    0.5,
    "of the squares left in an axis and of those that the effect takes from all axes",
    "coefficients change beside a true effect, which may enlarge the residual of an axis",
    DEVELOPMENT,
)
FEW_FLIGHTS = Threshold(
    "flights to leave one out",
    4.0,
    "flights",
    "fewer flights each contain different manoeuvres, and do not predict each other",
    DEVELOPMENT,
)
OF_ITSELF = Threshold(
    "share of what an effect closes that it closes with coefficients as stated",
    0.5,
    "of the squares of axes that do not hold",
    "most of it: models of two flights leave so much open that beside any effect coefficients close nine "
    "tenths of a gap, of which a wrong effect closes 30 % and less by itself, a right one 58 % and more",
    "models of two flights of a Crazyflie (experiments/results/discovery-hidden.md)",
)
NAMED_ALONE = Threshold(
    "margin to be named alone",
    4.6,
    "nat",
    "odds of about a hundred against every other effect in its place",
    CONVENTION,
)
ALIKE = Threshold(
    "margin of a law",
    0.1,
    "of the gain of the effect",
    "what an aerodynamic law that is wrong by a third loses: another that does as well may be the true one",
    DEVELOPMENT,
)
DIFFERENT = Threshold(
    "parameters that differ from zero",
    0.95,
    "quantile of chi square",
    "the level of the intervals that the page states: a name whose interval holds zero explains nothing",
    CONVENTION,
)
# Why an effect is barred without which no axis of flights left out is further off, and one that gains its
# evidence in axes that the simulation's own intervals hold: neither is told among rivals.
CLOSES_NOTHING = "closes nothing of the gap: flights left out are as close without it"
ALLOWED = "explains no more than what the intervals of the simulation allow for"
NO_EXPLANATION = (CLOSES_NOTHING, ALLOWED)
# Why what flights have of their own is barred, which explains one axis and worsens another.
HOLDS_MORE = "intervals hold more without what each flight has of it"
# Name of the test of `LARGEST`, and tests whose failure ends a round of the search: the residual is then
# noise, or the error of a law, and an effect that fits less well would be named for the same.
ORDINARY = "ordinary size"
_END_OF_ROUND = (
    *("evidence", "loudness", "bounds, refined", "size, refined", "size by its law"),
    "bounds, reweighted",
)

_Made = TypeVar("_Made")


@dataclass(frozen=True)
class Verdict:
    """Outcome of one test of a candidate, or of the whole result, with a sentence for people.

    `value` was compared with `threshold`, both in `unit`.
    """

    test: str
    passed: bool
    value: float
    threshold: float
    unit: str
    sentence: str

    @classmethod
    def by_limit(
        cls, limit: Threshold[float], test: str, value: float, passed: bool, sentence: str
    ) -> Verdict:
        """The verdict of a test that compares a value with a threshold."""
        return cls(test, passed, value, limit.value, limit.unit, sentence)

    @classmethod
    def fact(cls, test: str, passed: bool, if_so: str, if_not: str) -> Verdict:
        """The verdict of a test of what is so or not, in one sentence for each."""
        return cls(test, passed, float(passed), 1.0, "", if_so if passed else if_not)


@dataclass(frozen=True)
class Judgement:
    """All that was decided about one candidate in one round of the search.

    Attributes:
        effect: name of the effect.
        label: the name with the rotor, where there is one.
        beside: names of the effects accepted before.
        verdicts: verdicts in the order of the tests, up to the first that failed.
    """

    effect: str
    label: str
    beside: tuple[str, ...]
    verdicts: tuple[Verdict, ...]

    @classmethod
    def from_verdicts(cls, before: Accepted, index: int, verdicts: tuple[Verdict, ...]) -> Judgement:
        """The judgement of a candidate, by its index, beside the effects accepted before it."""
        own, beside = before.regression.candidates[index], (other.name for other in before.candidates)
        return cls(own.name, own.label, tuple(beside), verdicts)

    @property
    def accepted(self) -> bool:
        """Whether all tests passed."""
        return all(verdict.passed for verdict in self.verdicts)

    @property
    def reason(self) -> Verdict:
        """The verdict that decided: of a rejected candidate the last, of an accepted one its evidence."""
        wanted = "evidence" if self.accepted else self.verdicts[-1].test
        return next(verdict for verdict in self.verdicts if verdict.test == wanted)

    @property
    def ends_round(self) -> bool:
        """Whether no candidate after a rejected one may be named in the same round."""
        return self.reason.test in _END_OF_ROUND


def least_evidence(candidates: int) -> float:
    """Evidence [nat] that a first effect has to gain, given the number of candidates.

    Without any effect, the odds of the data with one candidate over those without are 1 on average, so they
    exceed x in at most one search of x (Markov's inequality), and chances of several candidates add up. It is
    approximate for the form of laws, for curved effects, and as the noise is that of the residual.
    """
    return float(np.log(max(candidates, 1) / FALSE_ALARMS.value))


def evidence_needed(
    candidate: Candidate, beside: Sequence[Candidate], energy: float, first: float, *, known: bool
) -> float:
    """Evidence that a candidate has to gain beside others, whose contribution has that energy [nat].

    A first effect needs so much; of others less where sound flights tell the noise.
    """
    if not beside:
        return first
    if scales_beside_law(candidate, beside):
        return FURTHER_LEAST.value
    beside_law = any(other.form > 0.0 for other in beside)
    exact = FURTHER_KNOWN if known else FURTHER_NUMBER
    enough = BESIDE_LAW if beside_law else FURTHER_LAW if candidate.form > 0.0 else exact
    return float(np.clip(FURTHER_SHARE.value * energy, FURTHER_LEAST.value, enough.value))


def scales_beside_law(candidate: Candidate, beside: Sequence[Candidate]) -> bool:
    """Whether a candidate alone of a set scales existing forces, beside a law that may be wrong.

    A wrong law lacks a force or a moment in some conditions. An effect that scales all existing forces does
    not gain by that (in none of 20 development cases), so it needs less evidence than other effects.
    """
    alone = candidate.effect.scales_existing and not any(
        other.effect.scales_existing and other.name != candidate.name for other in beside
    )
    return alone and any(other.form > 0.0 for other in beside)


def stands_behind(candidate: Candidate, rejected: Candidate) -> bool:
    """Whether a candidate that fits less well than one rejected for good would be named for the same.

    The strength of the same rotor by another law is no other explanation, and may need less evidence.
    """
    return candidate.name == rejected.name or not candidate.excludes(rejected)


def rival_margin(gain: float) -> float:
    """Evidence by which an effect with this gain has to exceed others in its place to be named alone."""
    return max(NAMED_ALONE.value, ALIKE.value * gain)


@dataclass(frozen=True)
class Accepted:
    """Effects that were accepted, their fit, and the regression that it was made in."""

    regression: Regression
    chosen: tuple[int, ...]
    fit: Fit

    @classmethod
    def fitted(cls, regression: Regression, chosen: Sequence[int]) -> Accepted | None:
        """Effects fitted in a regression; None where bounds exclude one of them."""
        fit = regression.fit(chosen)
        return None if fit is None else cls(regression, tuple(chosen), fit)

    @property
    def candidates(self) -> list[Candidate]:
        """The effects."""
        return [self.regression.candidates[index] for index in self.chosen]

    @cached_property
    def energy(self) -> float:
        """Evidence [nat] of the contribution of the effects."""
        return self.regression.energy(self.chosen, self.fit)

    def once(self, key: Hashable, make: Callable[[], _Made]) -> _Made:
        """See :meth:`Memoised.once`, of these effects."""
        return self.regression.once((key, self.chosen, self.fit), make)

    def without(self, index: int) -> Accepted:
        """The other effects; by their laws alone where errors outdo these, none where bounds exclude one."""
        own, others = self.regression, tuple(other for other in self.chosen if other != index)
        return Accepted(own, others, own.fit(others) or own.fit(others, form=False) or own.fit_none())

    def fit_with(self, *more: int) -> Fit | None:
        """Fit of all effects and more; None where bounds exclude one of them."""
        return self.regression.fit(tuple(sorted((*self.chosen, *more))))

    @property
    def sizeable(self) -> bool:
        """Whether every effect is large enough."""
        sizes = {self.regression.candidates[k].label: self.regression.size(k, self.fit) for k in self.chosen}
        return judge_size(sizes).passed

    def gains(self) -> dict[int, float]:
        """Evidence [nat] that each effect gains beside the others."""
        return {k: self.fit.log_evidence - self.without(k).fit.log_evidence for k in self.chosen}

    def refined(self) -> Accepted | None:
        """The effects linearised where they fit together; None where bounds exclude one of them.

        A step that lowers the evidence, as long ones of a tether do, is halved.
        """
        best, to = self, self._parameters
        curved = any(not candidate.linear for candidate in self.candidates)
        value, at = self.regression.at_points(self.chosen), {k: self.regression.points[k] for k in to}
        for _ in range(ROUNDS):
            steps = {k: own for k, own in to.items() if best.regression.moves(k, best.fit, own)}
            if not steps:
                break
            moved = best.regression.moved(steps)
            improved, there = Accepted.fitted(moved, self.chosen), moved.at_points(self.chosen)
            if improved is not None and (not curved or there >= value):
                best, value, at, to = improved, there, to, improved._parameters
            elif not curved:
                return None
            else:
                to = {k: 0.5 * (old + to[k]) for k, old in at.items()}
        return best

    def within(self, regression: Regression) -> Accepted:
        """The effects refined in another regression; as they are where bounds exclude one of them there.

        Others in their place then find their columns about where these fit.
        """
        fitted = Accepted.fitted(regression, self.chosen)
        return (fitted and fitted.refined()) or self

    @property
    def _parameters(self) -> dict[int, Array]:
        return {index: self.regression.parameters(index, self.fit) for index in self.chosen}

    def needed(self, index: int) -> float:
        """Evidence [nat] that one more effect has to gain."""
        regression = self.regression
        return evidence_needed(
            regression.candidates[index],
            self.candidates,
            self.energy,
            least_evidence(len(regression.candidates)),
            known=regression.sound is not None,
        )


def once_of_effects(make: Callable[[Accepted], _Made]) -> Callable[[Accepted], _Made]:
    """A function of accepted effects, computed once for the same ones."""

    @wraps(make)
    def kept(accepted: Accepted) -> _Made:
        return accepted.once(make.__name__, lambda: make(accepted))

    return kept


@dataclass(frozen=True)
class Trial:
    """A candidate beside the effects accepted before it.

    Attributes:
        before: effects accepted before.
        added: index of the candidate.
        fit: fit of all together; None where bounds exclude one.
        dropped: whether it was accepted earlier and dropped beside a better one.
        barred: why it may not be named; empty if it may.
        behind: name of a better candidate that ended the round; empty without one.
        instead: name of a candidate of ordinary size that does about as well; empty without one.
        broken: (6,) axes that the simulation's own intervals do not hold; None without intervals.
    """

    before: Accepted
    added: int
    fit: Fit | None
    dropped: bool = False
    barred: str = ""
    behind: str = ""
    instead: str = ""
    broken: npt.NDArray[np.bool_] | None = None

    @property
    def larger(self) -> tuple[int, ...]:
        """Indices of all effects together."""
        return tuple(sorted((*self.before.chosen, self.added)))

    @property
    def gain(self) -> float:
        """Evidence that the candidate gains, of a trial that passed the test of bounds."""
        assert self.fit is not None
        return self.fit.log_evidence - self.before.fit.log_evidence

    @cached_property
    def refined(self) -> Accepted | None:
        """All effects linearised where they fit together."""
        assert self.fit is not None
        return Accepted(self.before.regression, self.larger, self.fit).refined()

    @cached_property
    def reweighted(self) -> Regression:
        """The refined regression with at least the residual after all effects as noise."""
        assert self.refined is not None
        return self.refined.regression.beside(self.refined.chosen, self.refined.fit)

    @cached_property
    def together(self) -> Accepted | None:
        """All effects fitted in :attr:`reweighted`."""
        return Accepted.fitted(self.reweighted, self.larger)

    def outcome(self) -> tuple[Judgement, Accepted | None]:
        """The judgement, and the effects together; None where a test fails."""

        def judged() -> tuple[Judgement, Accepted | None]:
            return self.judgement, self.together if self.judgement.accepted else None

        told = (self.added, self.dropped, self.barred, self.behind, self.instead)
        return self.before.once(told, judged)

    @cached_property
    def judgement(self) -> Judgement:
        """Verdicts up to the first that fails."""
        verdicts = []
        for verdict in self._tests():
            verdicts.append(verdict)
            if not verdict.passed:
                break
        return Judgement.from_verdicts(self.before, self.added, tuple(verdicts))

    def _tests(self) -> Iterator[Verdict]:
        """Every test in its order; each relies on those before it."""
        regression, added, larger = self.before.regression, self.added, self.larger
        own = regression.candidates[added]
        yield _possible("bounds", self.fit)
        assert self.fit is not None
        yield judge_size(self._sizes(regression, self.fit))
        size = regression.size(added, self.fit)
        passed = not self.instead or size <= LARGEST.value
        so = f"; {LARGEST.value:g} is ordinary, and more where no other does"
        not_so = f", at most {LARGEST.value:g} where {self.instead} does about as well"
        sentence = f"size of {own.label} {size:.1f}{so if passed else not_so}"
        yield Verdict.by_limit(LARGEST, ORDINARY, size, passed, sentence)
        # Two effects could replace each other forever.
        dropped = "became idle beside a better one"
        yield Verdict.fact("not dropped", not self.dropped, "was not dropped before", dropped)
        yield judge_evidence(self.gain, self.before.needed(added))
        yield Verdict.fact("barred", not self.barred, "no other search has barred it", self.barred)
        first = not self.behind or scales_beside_law(own, self.before.candidates)
        behind = f"gains less than {self.behind}, which was rejected"
        yield Verdict.fact("precedence", first, "no better candidate was rejected for good", behind)
        loudness = regression.loudness(added, self.fit)
        sentence = f"adds {loudness:.2f} of the noise in its loudest axis, {LOUDNESS.value:g} needed"
        yield Verdict.by_limit(LOUDNESS, "loudness", loudness, loudness >= LOUDNESS.value, sentence)
        # From here on with all linearised where they fit together.
        yield _possible("bounds, refined", self.refined)
        assert self.refined is not None
        regression = self.refined.regression
        before = left_out_squares(self.before.regression, self.before.chosen)
        after = left_out_squares(regression, larger)
        yield judge_left_out(before, after, len(regression.flights))
        if self.broken is not None and regression.sound is not None:
            reduction, noise = regression.reduction((added,), self.refined.fit), regression.noise_squares
            yield judge_of_itself(*(float(np.sum((own / noise)[self.broken])) for own in reduction))
        yield judge_size(self._sizes(regression, self.refined.fit), "size, refined")
        # With at least the residual after the set as noise; by the laws alone, without columns for the errors
        # of their forms.
        regression = self.reweighted
        plain = regression.fit(larger, form=False)
        yield judge_size(self._sizes(regression, plain) if plain else {own.name: 0.0}, "size by its law")
        assert plain is not None
        equations = regression.equations(larger)
        kept = np.isin(plain.fitted, equations.parameters(larger.index(added)))
        values = plain.coefficients[kept]
        squares = float(values @ np.linalg.solve(plain.covariance[np.ix_(kept, kept)], values))
        least = float(chi2.ppf(DIFFERENT.value, len(own.free)))
        sentence = (
            f"squares of its parameters over their variances {squares:.1f}, more than {least:.1f} needed"
        )
        yield Verdict("differs from zero", squares > least, squares, least, "", sentence)
        yield _possible("bounds, reweighted", self.together)

    def _sizes(self, regression: Regression, found: Fit) -> dict[str, float]:
        return {regression.candidates[i].name: regression.size(i, found) for i in self.larger}


def _possible(test: str, fit: object) -> Verdict:
    likeness = "with possible parameters and the form of its law"
    return Verdict.fact(test, bool(fit), f"fits {likeness}", f"does not fit {likeness}")


def judge_evidence(gain: float, needed: float) -> Verdict:
    """Whether an effect gains enough evidence."""
    sentence = f"gains {gain:.1f} nat, {needed:.1f} needed"
    return Verdict("evidence", gain >= needed, gain, needed, "nat", sentence)


def judge_size(sizes: Mapping[str, float], test: str = "size") -> Verdict:
    """Whether every effect of a set, by its name, is large enough, in prior standard deviations."""
    name, smallest = min(sizes.items(), key=lambda item: item[1])
    sentence = f"size of {name} {smallest:.2f}, more than {SMALLEST.value:g} needed"
    return Verdict.by_limit(SMALLEST, test, smallest, smallest > SMALLEST.value, sentence)


def judge_of_itself(fitted: float, stated: float) -> Verdict:
    """Whether an effect reduces most squares that it does with fitted coefficients with stated ones too."""
    # What closes none of these squares explains other axes, which `ALLOWED` judges.
    share = 1.0 if fitted <= 0.0 else stated / fitted
    sentence = f"closes {100.0 * share:.0f} % of what it does without coefficients that move beside it"
    sentence += f", {100.0 * OF_ITSELF.value:.0f} % needed"
    return Verdict.by_limit(OF_ITSELF, "of itself", share, share >= OF_ITSELF.value, sentence)


def judge_left_out(before: Array, after: Array, flights: int) -> Verdict:
    """Whether no axis of flights left out grows much, given its squares (6,) before and after an effect.

    They need not decrease: coefficients far beyond their tolerances may have closed the same gap.
    """
    room = before + max(0.0, float(before.sum() - after.sum()))
    grown = after - before
    worst = float(np.max(grown / np.where(room > 0.0, room, 1.0)))
    few, sentence = flights < FEW_FLIGHTS.value, f"not judged on flights left out, of {flights} flights"
    if not few:
        sentence = f"worst axis of flights left out grows by {worst:.2f}, {GROWTH.value:g} allowed"
    passed = few or bool(np.all(grown <= GROWTH.value * room))
    return Verdict.by_limit(GROWTH, "flights left out", worst, passed, sentence)
