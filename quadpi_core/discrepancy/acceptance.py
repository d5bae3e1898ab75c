# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What decides whether the search accepts one candidate: thresholds, and verdicts with their reasons.

The functions take plain numbers, so that each threshold can be examined without a search; `trial` lists the
tests that a candidate has to pass. Those of the result as a whole are in `result_verdicts`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from quadpi_core.discrepancy.candidates import Candidate
from quadpi_core.discrepancy.verdict import Verdict
from quadpi_core.frames import Array
from quadpi_core.thresholds import CONVENTION, DEVELOPMENT, Threshold

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
    "other effects can explain the error of a wrong law, in proportion to its contribution; not to the "
    "evidence that it gained, which is little where tolerances cover it",
    DEVELOPMENT,
)
FURTHER_LEAST = Threshold(
    "least gain of a further effect",
    20.0,
    "nat",
    "below the 40 to 170 nat that a true change of mass, inertia or thrust gains beside a wrong law, where "
    "tolerances cover the rest",
    DEVELOPMENT,
)
FURTHER_NUMBER = Threshold(
    "gain that suffices a further exact effect",
    100.0,
    "nat",
    "above the gain of an exact effect that explains a wrong parameter of another exact one",
    DEVELOPMENT,
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
# Name of the test of it.
ORDINARY = "ordinary size"
LOUDNESS = Threshold(
    "loudness",
    0.1,
    "of the noise, root mean square in the loudest axis",
    "a quieter effect closes no gap; in a hover all motion is noise of the estimator, and so are the forces "
    "simulated from it",
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
    "an aerodynamic law that is wrong by a third loses this share of its gain, so another effect that does "
    "as well may be the true one",
    DEVELOPMENT,
)
DIFFERENT = Threshold(
    "parameters that differ from zero",
    0.95,
    "quantile of chi square",
    "the level of the intervals that the page states: a name whose interval holds zero explains nothing",
    CONVENTION,
)


@dataclass(frozen=True)
class Judgement:
    """All that was decided about one candidate in one round of the search.

    Attributes:
        effect: name of the effect.
        label: the name with the rotor, where there is one.
        beside: names of the effects accepted before.
        verdicts: verdicts in the order of the tests.
    """

    effect: str
    label: str
    beside: tuple[str, ...]
    verdicts: tuple[Verdict, ...]

    @property
    def accepted(self) -> bool:
        """Whether all tests passed."""
        return all(verdict.passed for verdict in self.verdicts)

    @property
    def reason(self) -> Verdict:
        """The verdict that decided: of a rejected candidate the last, of an accepted one its evidence."""
        wanted = "evidence" if self.accepted else self.verdicts[-1].test
        return next(verdict for verdict in self.verdicts if verdict.test == wanted)


def least_evidence(candidates: int) -> float:
    """Evidence [nat] that a first effect has to gain, given the number of candidates.

    Without any effect, the odds of the data with one candidate over those without are 1 on average, so they
    exceed x in at most one search of x (Markov's inequality), and for any of several candidates the chances
    add up. That holds for coefficients drawn from their tolerances and known noise; it is approximate for
    the form of laws, for curved effects, and as the noise is that of the residual.
    """
    return float(np.log(max(candidates, 1) / FALSE_ALARMS.value))


def evidence_beside(energy: float, *, law: bool, beside_law: bool, scales: bool) -> float:
    """Evidence that an effect has to gain beside others.

    Args:
        energy: evidence of the contribution of those.
        law: whether the effect is a law that may be wrong.
        beside_law: whether one of the others is such a law.
        scales: see :func:`scales_beside_law`.
    """
    if scales:
        return FURTHER_LEAST.value
    enough = BESIDE_LAW if beside_law else FURTHER_LAW if law else FURTHER_NUMBER
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


def judge_evidence(gain: float, needed: float) -> Verdict:
    """Whether an effect gains enough evidence."""
    sentence = f"gains {gain:.1f} nat, {needed:.1f} needed"
    return Verdict("evidence", gain >= needed, gain, needed, "nat", sentence)


def judge_size(sizes: Mapping[str, float], test: str = "size") -> Verdict:
    """Whether every effect of a set, by its name, is large enough, in prior standard deviations."""
    name, smallest = min(sizes.items(), key=lambda item: item[1])
    sentence = f"size of {name} {smallest:.2f}, more than {SMALLEST.value:g} needed"
    return Verdict.of(SMALLEST, test, smallest, smallest > SMALLEST.value, sentence)


def judge_largest(effect: str, size: float, instead: str) -> Verdict:
    """Whether an effect is no larger than is ordinary, or no other, `instead`, does about as well."""
    passed = not instead or size <= LARGEST.value
    sentence = f"size of {effect} {size:.1f}, at most {LARGEST.value:g} where {instead} does about as well"
    if passed:
        sentence = f"size of {effect} {size:.1f}; {LARGEST.value:g} is ordinary, and more where no other does"
    return Verdict.of(LARGEST, ORDINARY, size, passed, sentence)


def judge_loudness(loudness: float) -> Verdict:
    """Whether the contribution of an effect is distinguishable from the noise."""
    sentence = f"adds {loudness:.2f} of the noise in its loudest axis, {LOUDNESS.value:g} needed"
    return Verdict.of(LOUDNESS, "loudness", loudness, loudness >= LOUDNESS.value, sentence)


def judge_difference(value: float, parameters: int) -> Verdict:
    """Whether parameters together differ from zero, by their squares over their covariance."""
    needed = float(chi2.ppf(DIFFERENT.value, parameters))
    sentence = f"squares of its parameters over their variances {value:.1f}, more than {needed:.1f} needed"
    return Verdict("differs from zero", value > needed, value, needed, "", sentence)


def judge_left_out(before: Array, after: Array, flights: int) -> Verdict:
    """Whether no axis of flights left out grows much, given its squares (6,) before and after an effect.

    They need not decrease: coefficients far beyond their tolerances may have closed the same gap.
    """
    room = before + max(0.0, float(before.sum() - after.sum()))
    grown = after - before
    worst = float(np.max(grown / np.where(room > 0.0, room, 1.0)))
    few = flights < FEW_FLIGHTS.value
    sentence = f"worst axis of flights left out grows by {worst:.2f}, {GROWTH.value:g} allowed"
    if few:
        sentence = f"not judged on flights left out, of {flights} flights"
    passed = few or bool(np.all(grown <= GROWTH.value * room))
    return Verdict.of(GROWTH, "flights left out", worst, passed, sentence)


def rival_margin(gain: float) -> float:
    """Evidence by which an effect with this gain has to exceed others in its place to be named alone."""
    return max(NAMED_ALONE.value, ALIKE.value * gain)
