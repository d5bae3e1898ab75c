# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What decides whether the search accepts an effect: thresholds, and verdicts with their reasons.

The functions take plain numbers, so that each threshold can be examined without a search; `trial` lists the
tests that a candidate has to pass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from quadpi_core.discrepancy.candidates import Candidate
from quadpi_core.frames import Array
from quadpi_core.thresholds import CONVENTION, DEVELOPMENT, Threshold


@dataclass(frozen=True)
class Verdict:
    """Outcome of one test of one candidate.

    Attributes:
        test: name of the test.
        passed: whether the candidate passed.
        value: compared value.
        threshold: threshold it was compared with.
        unit: unit of both.
        sentence: the reason, for people.
    """

    test: str
    passed: bool
    value: float
    threshold: float
    unit: str
    sentence: str


FALSE_ALARMS = Threshold(
    "false alarms",
    0.01,
    "share of searches without any effect",
    "half of the 2 % that the blind benchmark allows: a wrong name costs more than a missed small effect",
    "drawn for each search: 1000 residuals within tolerances and noise, on the flights at hand",
)
LEAST_EVIDENCE = Threshold(
    "least evidence",
    5.0,
    "nat",
    "odds of about 150, even where the calibration by draws requires less",
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
PREDICTABLE = Threshold(
    "squares that are predicted",
    0.3,
    "of those of the noise",
    "nothing is predicted of flights without any effect, and up to a quarter of a hover, whose motion is all "
    "noise of the estimator",
    DEVELOPMENT,
)
LOUD_AXIS = Threshold(
    "squares of an axis judged alone",
    0.8,
    "of those of the noise",
    "an effect may explain another axis so well that it hides this one; above the residual of effects of the "
    "library that were found, largest for a tilted rotor",
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
DIFFERENT = Threshold(
    "parameters that differ from zero",
    0.95,
    "quantile of chi square",
    "the level of the intervals that the page states: a name whose interval holds zero explains nothing",
    CONVENTION,
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
    "noise of accelerometer, gyro and rotor speeds is white in a force and grows with the frequency in a "
    "moment; errors of smoothed states add up to 7 times as much where every effect has its right name",
    "short cases of the blind benchmark (tools/discovery.py --short)",
)
CLOSED = Threshold(
    "least share of the gap that is closed",
    0.5,
    "of the removable squares of flights left out",
    "named effects must explain most of the discrepancy; right names close 95 % and more",
    CONVENTION,
)
WORSE_ROLLOUTS = Threshold(
    "growth of the error of roll-outs",
    0.02,
    "of the error before",
    "errors of roll-outs beside their floor change by less than that with the noise of the parameters",
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


def _verdict(threshold: Threshold[float], test: str, value: float, passed: bool, sentence: str) -> Verdict:
    """The verdict of a test that compares a value with a threshold."""
    return Verdict(test, passed, value, threshold.value, threshold.unit, sentence)


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def evidence_threshold(gains: Array) -> float:
    """Evidence that a first effect has to gain, from the largest gains (D,) of draws without any effect.

    They are minus infinity where no candidate is linear, for which alone there are draws.
    """
    if not np.isfinite(gains).any():
        return LEAST_EVIDENCE.value
    return max(float(np.quantile(gains, 1.0 - FALSE_ALARMS.value)), LEAST_EVIDENCE.value)


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
    return _verdict(SMALLEST, test, smallest, smallest > SMALLEST.value, sentence)


def judge_loudness(loudness: float) -> Verdict:
    """Whether the contribution of an effect is distinguishable from the noise."""
    sentence = f"adds {loudness:.2f} of the noise in its loudest axis, {LOUDNESS.value:g} needed"
    return _verdict(LOUDNESS, "loudness", loudness, loudness >= LOUDNESS.value, sentence)


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
    return _verdict(GROWTH, "flights left out", worst, passed, sentence)


def rival_margin(gain: float) -> float:
    """Evidence by which an effect with this gain has to exceed others in its place to be named alone."""
    return max(NAMED_ALONE.value, ALIKE.value * gain)


def predictable(left: Array, rows: int) -> Array:
    """Predicted squares (6,) that no effect explains, 0 where they may be noise of that many rows."""
    return np.where(left > PREDICTABLE.value * rows, left, 0.0)


def unexplained_share(left: Array, named: Array, rows: int) -> float:
    """Unexplained share of all axes, or of the worst loud axis.

    Args:
        left: (6,) unexplained squares, see :func:`predictable`.
        named: (6,) squares that the effects explain.
        rows: number of rows of the noise.
    """
    return max(_unexplained(left, named, rows))


def unexplained_axis(left: Array, named: Array, rows: int) -> int | None:
    """Index of the axis that :func:`unexplained_share` is of; None where it is of all axes together."""
    together, *alone = _unexplained(left, named, rows)
    return int(np.argmax(alone)) if max(alone) > together else None


def _unexplained(left: Array, named: Array, rows: int) -> list[float]:
    """Unexplained share of all axes together, then of each, 0 for one that is not loud."""
    loud = (left > LOUD_AXIS.value * rows) & (left > PART_OF_AXIS.value * named)
    alone = np.divide(left, left + named, out=np.zeros(len(left)), where=loud)
    together = left.sum() / (left.sum() + named.sum()) if left.any() else 0.0
    return [float(together), *alone.tolist()]


def judge_unexplained(share: float, axis: str = "") -> Verdict:
    """Whether the unexplained share, of an axis or of all, is small enough to call them explained."""
    of_axis = f" of {axis}" if axis else ""
    sentence = f"{_percent(share)} of what can be predicted{of_axis} has no name"
    sentence += f", {_percent(UNEXPLAINED.value)} allowed"
    return _verdict(UNEXPLAINED, "unexplained", share, share <= UNEXPLAINED.value, sentence)


def judge_coefficients(multiples: Mapping[str, float], shares: Mapping[str, float]) -> Verdict:
    """Whether no coefficient explains much by being far from its stated value.

    Args:
        multiples: by name, what a coefficient is wrong by, in its tolerances.
        shares: by name, squares that its part beyond `FAR_COEFFICIENT` explains, of those and the squares
            that the named effects explain.
    """
    far = [name for name, off in multiples.items() if abs(off) > FAR_COEFFICIENT.value]
    name = max(far, key=lambda own: shares[own], default="")
    off, share = abs(multiples.get(name, 0.0)), shares.get(name, 0.0)
    sentence = f"{name} would be wrong by {off:.1f} of its tolerances, {FAR_COEFFICIENT.value:g} allowed"
    if not name:
        sentence = f"no coefficient is wrong by more than {FAR_COEFFICIENT.value:g} of its tolerances"
    passed = not far or share <= UNEXPLAINED.value
    if far and passed:
        sentence += f", but explains no more than {_percent(share)} by that"
    return _verdict(FAR_COEFFICIENT, "coefficients", off, passed, sentence)


def allowed_squares(count: int) -> float:
    """Sum of squares of coefficients, in tolerances, as unlikely as one at `FAR_COEFFICIENT`."""
    return float(chi2.isf(chi2.sf(FAR_COEFFICIENT.value**2, 1), count)) if count else 0.0


def judge_coefficients_together(squares: float, count: int, share: float) -> Verdict:
    """Whether coefficients are together as near their stated values as a single one has to be.

    Many that are each wrong by three or four tolerances are as unlikely as one that is wrong by more than
    `FAR_COEFFICIENT`.

    Args:
        squares: sum of the squares of what they are wrong by, in their tolerances.
        count: number of coefficients.
        share: squares that their part beyond what is allowed explains, of those and the squares that the
            named effects explain.
    """
    allowed = allowed_squares(count)
    off, most = (float(np.sqrt(value / max(count, 1))) for value in (squares, allowed))
    far = squares > allowed
    sentence = (
        f"{count} coefficients would be wrong by {off:.1f} of their tolerances, root mean square, "
        f"{most:.1f} allowed"
    )
    if far and share <= UNEXPLAINED.value:
        sentence += f", but explain no more than {_percent(share)} by that"
    passed = not far or share <= UNEXPLAINED.value
    return Verdict("coefficients together", passed, off, most, "tolerances", sentence)


def judge_colour(colour: Array, shares: Array, axes: Sequence[str]) -> Verdict:
    """Whether no axis has much noise that is slower than that of sensors.

    Args:
        colour: (6,) slow over fast noise.
        shares: (6,) squares of the noise beyond that of sensors, of those of all axes and those that the
            named effects explain.
        axes: names of the axes.
    """
    slow = np.where(shares > UNEXPLAINED.value, colour, 0.0)
    worst = int(np.argmax(slow))
    sentence = (
        f"the noise of {axes[worst]} is {slow[worst]:.1f} times as large at slow frequencies as that of "
        f"sensors and states, {COLOURED.value:g} allowed"
    )
    if not slow[worst]:
        sentence = "no axis has more slow noise than sensors and states explain"
    return _verdict(COLOURED, "colour", float(slow[worst]), bool(slow[worst] <= COLOURED.value), sentence)


def judge_closed(reduction: float) -> Verdict:
    """Whether the named effects close the gap of flights left out."""
    sentence = f"{_percent(reduction)} of the gap is closed, {_percent(CLOSED.value)} needed"
    if reduction < 0.0:
        sentence = f"the gap of flights left out grows by {_percent(-reduction)}"
    return _verdict(CLOSED, "closed", reduction, reduction >= CLOSED.value, sentence)


def judge_not_zero(effect: str, may_be_zero: bool) -> Verdict:
    """Whether an interval of a named effect's parameters excludes zero."""
    told = "every parameter" if may_be_zero else "not every parameter"
    return Verdict(
        "not zero", not may_be_zero, float(not may_be_zero), 1.0, "", f"{told} of {effect} may be zero"
    )


def judge_disputed(sentence: str) -> Verdict:
    """The failed verdict on an effect in whose place another has much more evidence but fails a test."""
    return Verdict("disputed", False, 0.0, 1.0, "", sentence)


def judge_rollouts(before: Mapping[str, float], after: Mapping[str, float]) -> Verdict:
    """Whether no error of roll-outs of flights left out, by its quantity, grows with what is added."""
    growth = {name: after[name] / before[name] - 1.0 for name in before if before[name] > 0.0}
    name, most = max(growth.items(), key=lambda item: item[1], default=("", 0.0))
    change = f"{before.get(name, 0.0):.3g} to {after.get(name, 0.0):.3g}"
    worse = most > WORSE_ROLLOUTS.value
    told = "get worse with it" if worse else "do not get worse with it"
    sentence = f"roll-outs of flights left out {told}" + (f": {name} {change}" if name else "")
    if not before:
        sentence = "no roll-out of flights left out can be compared"
    return _verdict(WORSE_ROLLOUTS, "roll-outs", most, most <= WORSE_ROLLOUTS.value, sentence)


def judge_diverged(before: int, after: int) -> Verdict:
    """Whether no more roll-outs of flights left out diverge with what is added."""
    sentence = f"{after} roll-outs of flights left out diverge with it, {before} before"
    return Verdict("diverged roll-outs", after <= before, float(after), float(before), "roll-outs", sentence)
