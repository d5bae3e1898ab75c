# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What decides whether the result of a search is believed as a whole: thresholds, and verdicts with reasons.

The functions take plain numbers, so that each threshold can be examined without a search; `doubts` takes
these numbers from a result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import chi2

from quadpi_core.discrepancy.verdict import Verdict
from quadpi_core.frames import Array
from quadpi_core.thresholds import CONVENTION, DEVELOPMENT, Threshold

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
    0.8,
    "of the squares of flights left out above the floor",
    "a model of real flights is not exact; right names close 97 % and more of simulated flights",
    CONVENTION,
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
    "right names whose law differs from the hidden one, as wind that grows with height, differ by up to ten "
    "times from flight to flight, and leave 1 % of the gap",
    DEVELOPMENT,
)
WORSE_ROLLOUTS = Threshold(
    "growth of the error of roll-outs",
    0.02,
    "of the error before",
    "errors of roll-outs beside their floor change by less than that with the noise of the parameters",
    CONVENTION,
)


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


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
    return Verdict.of(UNEXPLAINED, "unexplained", share, share <= UNEXPLAINED.value, sentence)


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
    return Verdict.of(FAR_COEFFICIENT, "coefficients", off, passed, sentence)


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
    if squares == 0.0:
        sentence = "no coefficient has to be wrong"
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
    return Verdict.of(COLOURED, "colour", float(slow[worst]), bool(slow[worst] <= COLOURED.value), sentence)


def judge_intervals(broken: Sequence[str]) -> Verdict:
    """Whether no axis is left without a name whose intervals these flights break."""
    sentence = f"the intervals of {', '.join(broken)} hold less of these flights than they state"
    if not broken:
        sentence = "no axis has broken intervals that no effect explains"
    return Verdict("intervals", not broken, float(len(broken)), 0.0, "axes", sentence)


def judge_closed(reduction: float) -> Verdict:
    """Whether the named effects close the gap of flights left out."""
    sentence = f"{_percent(reduction)} of the gap is closed, {_percent(CLOSED.value)} needed"
    if reduction < 0.0:
        sentence = f"the gap of flights left out grows by {_percent(-reduction)}"
    return Verdict.of(CLOSED, "closed", reduction, reduction >= CLOSED.value, sentence)


def judge_not_zero(effect: str, may_be_zero: bool) -> Verdict:
    """Whether an interval of a named effect's parameters excludes zero."""
    told = "every parameter" if may_be_zero else "not every parameter"
    return Verdict(
        "not zero", not may_be_zero, float(not may_be_zero), 1.0, "", f"{told} of {effect} may be zero"
    )


def judge_agreement(effect: str, disagreements: Mapping[str, float], closed: float) -> Verdict:
    """Whether flights agree on every parameter of a named effect, or all but close the gap with one for all.

    Args:
        effect: name of the effect.
        disagreements: by parameter, see :meth:`.closure.Closing.disagreement`.
        closed: closed share of the gap.
    """
    name, most = max(disagreements.items(), key=lambda item: item[1])
    far, left = most > DISAGREEMENT.value, min(max(1.0 - closed, 0.0), 1.0)
    passed = not far or left <= ALL_BUT_CLOSED.value
    sentence = (
        f"flights differ in {name} of {effect} by {most:.1f} times what one fit to all leaves open, "
        f"{DISAGREEMENT.value:g} allowed"
    )
    if far:
        sentence += f", {'but no more than' if passed else 'and'} {_percent(left)} of the gap stays"
    return Verdict.of(DISAGREEMENT, "agreement", most, passed, sentence)


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
    return Verdict.of(WORSE_ROLLOUTS, "roll-outs", most, most <= WORSE_ROLLOUTS.value, sentence)


def judge_diverged(before: int, after: int) -> Verdict:
    """Whether no more roll-outs of flights left out diverge with what is added."""
    sentence = f"{after} roll-outs of flights left out diverge with it, {before} before"
    return Verdict("diverged roll-outs", after <= before, float(after), float(before), "roll-outs", sentence)
