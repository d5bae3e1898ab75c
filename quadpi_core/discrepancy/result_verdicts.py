# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What is made of a search: tests of its result as a whole, each with its threshold, and ranked candidates.

A search can only choose among the effects of its library; where something else is missing, these say so.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from quadpi_core.discrepancy.acceptance import FEW_FLIGHTS, Verdict
from quadpi_core.discrepancy.closure import Gap, SearchResult
from quadpi_core.discrepancy.discrepancy_result import (
    ERROR_NAMES,
    Coverage,
    Discovery,
    FoundEffect,
    RankedCandidate,
    Reflights,
)
from quadpi_core.discrepancy.other_simulations import of_coefficient
from quadpi_core.discrepancy.whitening import Part
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, DEVELOPMENT, Threshold
from quadpi_core.simulation.applied_effects import EFFECTS

PREDICTABLE = Threshold(
    "squares that are predicted",
    0.3,
    "of those of the noise",
    "nothing is predicted without any effect, but up to a quarter of a hover, whose motion is all noise",
    DEVELOPMENT,
)
LOUD_AXIS = Threshold(
    "squares of an axis judged alone",
    0.8,
    "of those of the noise",
    "above the residual of effects that were found, largest for a tilted rotor; other axes may hide this one",
    DEVELOPMENT,
)
PART_OF_AXIS = Threshold(
    "unexplained part of an axis judged alone",
    0.2,
    "of the explained squares of the axis",
    "the error of a law leaves less than that in its own axis",
    DEVELOPMENT,
)
UNEXPLAINED = Threshold(
    "unexplained share",
    0.05,
    "of the predictable discrepancy",
    "less is left after effects of the library that were found, and most of a force that none explains",
    DEVELOPMENT,
)
FAR_COEFFICIENT = Threshold(
    "coefficient far from its stated value",
    5.0,
    "tolerances",
    "a chance of one in a million for each coefficient: something else, which has no name, is there",
    CONVENTION,
)
COLOURED = Threshold(
    "noise of slow over fast frequencies",
    12.0,
    "root mean square per row",
    "errors of smoothed states reach 7 with right names; noise of sensors is white, or grows in a moment",
    "short cases of the blind benchmark (experiments/discovery.py --short)",
)
CLOSED = Threshold(
    "least share of the gap that is closed",
    0.8,
    "of the squares of flights left out above the floor",
    "a model of real flights is not exact; right names close 97 % and more of simulated flights",
    CONVENTION,
)
NEAR_FLOOR = Threshold(
    "squares above the floor of a gap that is as good as closed by half of it",
    0.1,
    "of those of the floor, in every axis",
    "floors are known no better: those of sound flights of one vehicle differ by 11 to 17 %",
    "ten bare flights of a Crazyflie",
)
DISAGREEMENT = Threshold(
    "spread of a parameter between flights",
    3.0,
    "of what one fit to all leaves open, as a standard deviation",
    "a chance of six in a million for a law that holds, on four flights, and less on more",
    CONVENTION,
)
ALL_BUT_CLOSED = Threshold(
    "open share of the gap of a law that flights need not agree on",
    0.05,
    "of the squares of flights left out above the floor",
    "right names whose law is off, as wind that grows with height, spread by up to ten and leave 1 %",
    DEVELOPMENT,
)
WORSE_ROLLOUTS = Threshold(
    "growth of the error of roll-outs",
    0.02,
    "of the error before",
    "errors of roll-outs beside their floor change by less than that with the noise of the parameters",
    CONVENTION,
)
BY_CHANCE = Threshold(
    "growth of the error of roll-outs that may be chance",
    0.1,
    "of the error before",
    "roll-outs of real flights end 60 times their floor away, and flights differ by that",
    "real flights of a Crazyflie",
)
WORSE_COVERAGE = Threshold(
    "growth of the samples that intervals miss",
    3.0,
    "times as many as the intervals state to miss",
    "right names grow it by up to twice that, where a load swings wide; what shifts an axis, by much more",
    "real flights with and without a load (docs/discrepancy.md)",
)
LEAST_COVERAGE = Threshold(
    "samples of an axis that intervals hold with the effects",
    0.5,
    "of the share that they state",
    "an axis that they mostly miss is not explained; with right names they held 75 % and more",
    "changed flights of a Crazyflie (experiments/results/discovery-hidden.md)",
)
# Share of the floor's square by which an axis has to exceed it: less is no gap that an effect could close.
LEAST_ABOVE_FLOOR = 0.05
# Tests that coefficients as stated may pass where fitted ones do not.
OF_GAP = ("closed", "agreement")


def checks(
    found: SearchResult, effects: Sequence[FoundEffect], left: Unexplained, gap: Gap
) -> tuple[Verdict, ...]:
    """Tests of what a search named, of what that leaves, and of its gap on flights left out, passed or not.

    No coefficient and no noise is doubted in axes of which the simulation's own intervals hold what they say.
    """
    sensors = np.where(found.held[:, None], np.inf, found.sensors)
    # Squares that are credited to the effects, in variances of the sensors.
    reduction = found.regression.reduction(found.chosen, found.fit, sensors)
    named = max(0.0, float(np.sum(reduction.credited)))
    doubtful = found.inside is not None and not effects
    broken = [name for name, held in zip(AXES, found.held, strict=True) if doubtful and not held]
    sentence = "no axis has broken intervals that no effect explains"
    if broken:
        sentence = f"the intervals of {', '.join(broken)} hold less of these flights than they state"
    return (
        judge_unexplained(left.share, left.axis),
        *_coefficients(found, sensors, named),
        _noise(found, np.maximum(sensors, found.regression.least), named),
        Verdict("intervals", not broken, float(len(broken)), 0.0, "axes", sentence),
        *map(judge_not_zero, effects),
        *(Verdict.fact("disputed", False, "", own) for own in found.disputed),
        *(_of_gap(found, gap) if effects else ()),
    )


def with_stated_coefficients(discovery: Discovery) -> Discovery:
    """The discovery with coefficients as they are stated, its gap, and the tests on that."""
    gap = discovery.found.gap(adjusted=False)
    others = (check for check in discovery.checks if check.test not in OF_GAP)
    return replace(discovery, gap=gap, checks=(*others, *_of_gap(discovery.found, gap)), adjusted=False)


def judged_by_rollouts(discovery: Discovery, flown: Reflights) -> Discovery:
    """The discovery, "unknown" where flights left out are simulated worse with its effects.

    Their roll-outs must get no worse than chance may make them, one by one or by those that diverge; nor may
    the intervals of a model, by axis, hold much less of them.
    """
    rollouts, coverage = flown.rollout, flown.coverage
    errors = {ERROR_NAMES[name]: (error.before, error.after) for name, error in rollouts.errors.items()}
    before, after = (rollouts.lost.get(when, 0) for when in ("before", "after"))
    sentence = f"{after} roll-outs of flights left out diverge with it, {before} before"
    inside = discovery.found.inside
    judged = (
        judge_rollouts(errors, {ERROR_NAMES[name] for name in rollouts.by_chance}),
        Verdict("diverged roll-outs", after <= before, float(after), float(before), "roll-outs", sentence),
        *([judge_coverage(coverage, inside.confidence)] if coverage and inside else ()),
    )
    return replace(discovery, checks=(*discovery.checks, *judged), flown=flown)


def is_rejected(discovery: Discovery) -> bool:
    """Whether flights left out are simulated worse with the effects, by their gap or by what was judged."""
    failed = {check.test for check in discovery.checks if not check.passed}
    return discovery.gap.reduction < 0.0 or not failed.isdisjoint(
        ("roll-outs", "diverged roll-outs", "coverage")
    )


def predictable(left: Array, rows: int) -> Array:
    """Predicted squares that no effect explains, 0 where they may be noise of that many rows."""
    return np.where(left > PREDICTABLE.value * rows, left, 0.0)


class Unexplained(NamedTuple):
    """What generic functions predict beside the named effects.

    Attributes:
        squares: (6,) see :func:`predictable`; 0 in axes that the simulation's own intervals hold.
        share, axis: see :func:`unexplained_share`.
    """

    squares: Array
    share: float
    axis: str

    @classmethod
    def from_search(cls, found: SearchResult) -> Unexplained:
        """Of the result of a search."""
        rows = int(found.regression.residual.counts.sum())
        left = predictable(np.minimum(found.left.gain, found.beyond_sound), rows)
        named = found.regression.reduction(found.chosen, found.fit, found.left.noise).credited
        left, named = (np.where(found.held, 0.0, own) for own in (left, np.maximum(named, 0.0)))
        return cls(left, *unexplained_share(left, named, rows))


def unexplained_share(left: Array, named: Array, rows: int) -> tuple[float, str]:
    """Unexplained share of all axes together, or of the loud axis that more is left of, and that axis.

    Args:
        left: (6,) unexplained squares, see :func:`predictable`.
        named: (6,) squares that the effects explain.
        rows: number of rows of the noise.
    """
    loud = (left > LOUD_AXIS.value * rows) & (left > PART_OF_AXIS.value * named)
    alone = np.divide(left, left + named, out=np.zeros(len(left)), where=loud)
    together = float(left.sum() / (left.sum() + named.sum())) if left.any() else 0.0
    worst = int(np.argmax(alone))
    return (float(alone[worst]), AXES[worst]) if alone[worst] > together else (together, "")


def judge_unexplained(share: float, axis: str = "") -> Verdict:
    """Whether the unexplained share, of an axis or of all, is small enough to call them explained."""
    sentence = f"{_percent(share)} of what can be predicted{' of ' * bool(axis)}{axis} has no name"
    sentence += f", {_percent(UNEXPLAINED.value)} allowed"
    return Verdict.by_limit(UNEXPLAINED, "unexplained", share, share <= UNEXPLAINED.value, sentence)


def _coefficients(found: SearchResult, sensors: Array, named: float) -> Iterator[Verdict]:
    """Whether coefficients, each and together, explain little beyond what they may beside the effects."""
    regression, names = found.regression, found.regression.tolerances.names
    tolerances = {f"{own.name}.{p.name}": own.tolerance for own in EFFECTS.values() for p in own.parameters}
    # A centre of gravity elsewhere, for one, is elsewhere from the accelerometer too.
    moved = {regression.candidates[index].effect.tolerance for index in found.chosen} - {""}
    judged = np.array([tolerances.get(name) not in moved for name in names])
    values = regression.moved_by(found.fit)
    # In a hover whose motion is noise of the estimator, coefficients of motion move far and explain nothing.
    each = [regression.squares(regression.of_tolerances(own), sensors) for own in np.diag(values)]
    rows = int(regression.residual.counts.sum())
    felt = predictable(np.array(each).reshape(-1, len(AXES)), rows).any(axis=1)
    values = np.where(judged & felt, values, 0.0)

    def share(beyond: Array) -> float:
        """Squares that parts of coefficients explain, of those and the squares of the named effects."""
        explained = float(np.sum(regression.squares(regression.of_tolerances(beyond), sensors)))
        return explained / max(named + explained, 1.0)

    off, own = values.copy(), np.ones(len(values))
    for index, law in enumerate(regression.tolerances.laws):
        if law:
            shared = names.index(law)
            off[index], own[index] = of_coefficient(values[index], values[shared]), of_coefficient(1.0, 0.0)
            off[shared] = 0.0
    excess = np.maximum(np.abs(off) - FAR_COEFFICIENT.value, 0.0) / own
    far = [(share(np.diag(excess)[k]), abs(float(off[k])), names[k]) for k in np.flatnonzero(excess)]
    yield judge_coefficients(*max(far, default=(0.0, 0.0, "")))
    squares, allowed = float(values @ values), allowed_squares(sum(judged))
    beyond = 1.0 - np.sqrt(min(1.0, allowed / squares)) if squares > 0.0 else 0.0
    yield judge_coefficients_together(share(beyond * values), squares, sum(judged))


def judge_coefficients(share: float, off: float, name: str) -> Verdict:
    """Whether the worst coefficient, wrong by `off` tolerances, explains but a small `share` by that."""
    far, most = off > FAR_COEFFICIENT.value, f"{FAR_COEFFICIENT.value:g}"
    passed = not far or share <= UNEXPLAINED.value
    sentence = f"no coefficient is wrong by more than {most} of its tolerances"
    if far:
        sentence = f"{name} would be wrong by {off:.1f} of its tolerances, {most} allowed"
        sentence += f", but explains no more than {_percent(share)} by that" if passed else ""
    return Verdict.by_limit(FAR_COEFFICIENT, "coefficients", off, passed, sentence)


def allowed_squares(count: int) -> float:
    """Sum of squares of coefficients, in tolerances, as unlikely as one at `FAR_COEFFICIENT`."""
    return float(chi2.isf(chi2.sf(FAR_COEFFICIENT.value**2, 1), count)) if count else 0.0


def judge_coefficients_together(share: float, squares: float, count: int) -> Verdict:
    """Whether coefficients, by their `squares` in tolerances, are as likely as a single one has to be.

    Many that are each wrong by three or four tolerances are as unlikely as one beyond `FAR_COEFFICIENT`.
    """
    allowed = allowed_squares(count)
    off, most = (float(np.sqrt(value / max(count, 1))) for value in (squares, allowed))
    passed = squares <= allowed or share <= UNEXPLAINED.value
    sentence = f"{count} coefficients would be wrong by {off:.1f} of their tolerances, root mean square"
    sentence += f", {most:.1f} allowed"
    if squares > allowed and passed:
        sentence += f", but explain no more than {_percent(share)} by that"
    if squares == 0.0:
        sentence = "no coefficient has to be wrong"
    return Verdict("coefficients together", passed, off, most, "tolerances", sentence)


def _noise(found: SearchResult, sensors: Array, named: float) -> Verdict:
    """Whether the noise of each axis can be that of sensors, or is little beside the named effects.

    The noise (6, C) of sensors is infinite in an axis that is not judged.
    """
    ratio = found.left.noise / sensors
    more = np.maximum(ratio - 1.0, 0.0) @ found.regression.residual.counts
    return judge_colour(np.sqrt(ratio.max(axis=1)), more / max(named + float(np.sum(more)), 1.0))


def judge_colour(colour: Array, shares: Array) -> Verdict:
    """Whether no axis with a large share (6,) of the squares has much slow over fast noise, `colour` (6,)."""
    slow = np.where(shares > UNEXPLAINED.value, colour, 0.0)
    worst, most = AXES[int(np.argmax(slow))], float(slow.max())
    sentence = (
        f"the noise of {worst} is {most:.1f} times as large at slow frequencies as that of sensors and "
    )
    sentence += f"states, {COLOURED.value:g} allowed"
    if not most:
        sentence = "no axis has more slow noise than sensors and states explain"
    return Verdict.by_limit(COLOURED, "colour", most, most <= COLOURED.value, sentence)


def judge_not_zero(effect: FoundEffect) -> Verdict:
    """Whether the interval of any parameter that was estimated excludes zero."""
    estimated = [parameter for parameter in effect.parameters if parameter.upper > parameter.lower]
    zero = all(parameter.lower < 0.0 < parameter.upper for parameter in estimated) and bool(estimated)
    sentence = f"every parameter of {effect.name} may be zero"
    return Verdict.fact("not zero", not zero, f"not {sentence}", sentence)


def _of_gap(found: SearchResult, gap: Gap) -> Iterator[Verdict]:
    """Whether the named effects close the gap, and flights agree on them or close it all the same.

    Flights so few that they do not predict each other do not disagree either.
    """
    squares = np.square(np.stack((gap.before, gap.after)) / gap.floor)
    above = np.max(squares, axis=1, where=~found.held, initial=0.0) - 1.0
    yield judge_closed(gap.reduction, *above.tolist())
    for index in found.chosen if len(found.regression.flights) >= FEW_FLIGHTS.value else ():
        candidate, ratios = found.regression.candidates[index], found.disagreement(index)
        worst = int(np.argmax(ratios))
        name = f"{candidate.effect.parameters[candidate.free[worst]].name} of {candidate.label}"
        yield judge_agreement(name, float(ratios[worst]), gap.reduction)


def judge_closed(reduction: float, before: float = np.inf, after: float = np.inf) -> Verdict:
    """Whether the named effects close that share of the gap of flights left out, or all but near its floor.

    By the squares of the worst axis above it, before and after, in those of the floor.
    """
    sentence = f"{_percent(reduction)} of the gap is closed, {_percent(CLOSED.value)} needed"
    if reduction < 0.0:
        sentence = f"the gap of flights left out grows by {_percent(-reduction)}"
    near = reduction >= 0.5 and after <= NEAR_FLOOR.value < before
    if near and reduction < CLOSED.value:
        sentence = (
            f"{_percent(reduction)} of the gap is closed, and no axis is left {_percent(NEAR_FLOOR.value)}"
        )
        sentence += " above its floor"
    return Verdict.by_limit(CLOSED, "closed", reduction, near or reduction >= CLOSED.value, sentence)


def judge_agreement(name: str, most: float, closed: float) -> Verdict:
    """Whether flights agree on a parameter, or its effect all but closes the gap with one for all."""
    far, left = most > DISAGREEMENT.value, min(max(1.0 - closed, 0.0), 1.0)
    passed = not far or left <= ALL_BUT_CLOSED.value
    sentence = f"flights differ in {name} by {most:.1f} times what one fit to all leaves open, "
    sentence += f"{DISAGREEMENT.value:g} allowed"
    if far:
        sentence += f", {'but no more than' if passed else 'and'} {_percent(left)} of the gap stays"
    return Verdict.by_limit(DISAGREEMENT, "agreement", most, passed, sentence)


def judge_rollouts(
    errors: Mapping[str, tuple[float, float]], by_chance: Collection[str] = frozenset()
) -> Verdict:
    """Whether no error of roll-outs of flights left out, by its quantity before and after, grows.

    Those whose growth may be chance, see :class:`Rollouts`, may grow by more.
    """
    growth = {name: after / before - 1.0 for name, (before, after) in errors.items() if before > 0.0}
    allowed = {name: (BY_CHANCE if name in by_chance else WORSE_ROLLOUTS).value for name in growth}
    name = max(growth, key=lambda own: growth[own] - allowed[own], default="")
    most, limit = growth.get(name, 0.0), allowed.get(name, WORSE_ROLLOUTS.value)
    passed = most <= limit
    sentence = f"roll-outs of flights left out {'do not ' * passed}get worse with it"
    if name:
        sentence += ": {} {:.3g} to {:.3g}".format(name, *errors[name])
        sentence += ", no more than flights differ" * (WORSE_ROLLOUTS.value < most <= limit)
    if not errors:
        sentence = "no roll-out of flights left out can be compared"
    return Verdict("roll-outs", passed, most, limit, WORSE_ROLLOUTS.unit, sentence)


def judge_coverage(coverage: Mapping[str, Coverage], confidence: float) -> Verdict:
    """Whether the intervals, which state a confidence, hold most of each axis, and of none much less."""
    lost, axis = max((own.before - own.after, axis) for axis, own in coverage.items())
    least, worst = min((own.after, axis) for axis, own in coverage.items())
    share, of_stated = lost / (1.0 - confidence), least / confidence
    mostly = of_stated >= LEAST_COVERAGE.value
    axis = axis if mostly else worst
    before, after, half = map(_percent, (*coverage[axis], LEAST_COVERAGE.value * confidence))
    sentence = f"intervals hold {after} of {axis} with it, {before} before"
    if not mostly:
        return Verdict.by_limit(LEAST_COVERAGE, "coverage", of_stated, mostly, f"{sentence}, {half} needed")
    return Verdict.by_limit(WORSE_COVERAGE, "coverage", share, share <= WORSE_COVERAGE.value, sentence)


def ranked_candidates(found: SearchResult) -> tuple[RankedCandidate, ...]:
    """The candidates of a search, each by its last judgement: named first, then by evidence over need."""
    regression, gap = found.regression, found.gap()
    places = {candidate.label: index for index, candidate in enumerate(regression.candidates)}
    judged = {judgement.label: judgement for judgement in found.judgements}
    # An effect that was named may have been judged again, and rejected, in the place of another.
    judged |= {
        own.label: own for own in found.judgements if own.accepted and places[own.label] in found.chosen
    }
    # Squares of the residual above the floor; 0 for an axis without a gap.
    before, floor = np.square(gap.before), np.square(gap.floor)
    is_gap = before - floor > LEAST_ABOVE_FLOOR * floor
    removable = regression.squares([Part(regression.residual, np.ones(1))])
    removable *= np.divide(before - floor, before, out=np.zeros(len(AXES)), where=is_gap)
    ranked = []
    for label, own in judged.items():
        index = places[label]
        evidence = next((verdict for verdict in own.verdicts if verdict.test == "evidence"), None)
        closes, cancels = _closed(found, index, removable) if evidence else ({}, ())
        ranked.append(
            RankedCandidate(
                name=own.effect,
                label=label,
                named=index in found.chosen,
                beside=own.beside,
                gain=evidence.value if evidence else None,
                needed=evidence.threshold if evidence else None,
                test=own.reason.test,
                reason=own.reason.sentence,
                closes=closes,
                cancels=cancels,
                rivals={regression.candidates[k].label: odds for k, odds in found.rivals.get(index, ())},
            )
        )
    return tuple(sorted(ranked, key=lambda own: (not own.named, -own.over_need)))


def _closed(found: SearchResult, index: int, removable: Array) -> tuple[dict[str, float], tuple[str, ...]]:
    """Share of the gap of each axis that a candidate closes, and axes that it cancels coefficients in."""
    chosen, regression = found.chosen, found.regression
    fit = found.fit if index in chosen else regression.fit(tuple(sorted((*chosen, index))))
    if fit is None:
        return {}, ()
    reduction = regression.reduction((index,), fit)
    gaps = np.flatnonzero(removable > 0.0)
    closes = {AXES[axis]: float(reduction.credited[axis] / removable[axis]) for axis in gaps}
    return closes, tuple(AXES[k] for k in gaps if reduction.stated[k] < 0.0 < reduction.fitted[k])


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"
