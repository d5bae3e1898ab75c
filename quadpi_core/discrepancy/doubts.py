# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Why the result of a search is not believed, so that the verdict is "unknown".

A search can only choose among the effects of its library. What is missing may be something else, which then
shows in one of four ways: a residual that other flights predict; noise that no sensor has; coefficients that
move, alone or together, far beyond their tolerances; or effects that do not close the gap, on whose
parameters flights disagree, or whose parameters may be zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from quadpi_core.discrepancy.acceptance import FEW_FLIGHTS
from quadpi_core.discrepancy.closure import Gap
from quadpi_core.discrepancy.discrepancy_result import ERROR_NAMES, Discovery, FoundEffect, Rollouts
from quadpi_core.discrepancy.result_verdicts import (
    FAR_COEFFICIENT,
    allowed_squares,
    judge_agreement,
    judge_closed,
    judge_coefficients,
    judge_coefficients_together,
    judge_colour,
    judge_disputed,
    judge_diverged,
    judge_intervals,
    judge_not_zero,
    judge_rollouts,
    judge_unexplained,
    predictable,
)
from quadpi_core.discrepancy.search import Found
from quadpi_core.discrepancy.uncertain_parts import of_coefficient
from quadpi_core.discrepancy.verdict import Verdict
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.simulation.effect_registry import EFFECTS


def checks(
    found: Found,
    effects: Sequence[FoundEffect],
    unexplained: float,
    gap: Gap,
    held: npt.NDArray[np.bool_],
    axis: str = "",
) -> tuple[Verdict, ...]:
    """Tests of the whole result of a search, passed or not.

    Args:
        found: result of the search.
        effects: named effects.
        unexplained: see :class:`Discovery`.
        gap: gap on flights left out.
        held: axes (6,) of which the simulation's own intervals hold what they say: no coefficient and no
            noise in them is doubted.
        axis: the axis that `unexplained` is of; empty for all together.
    """
    sensors = np.where(held[:, None], np.inf, found.sensors)
    named = _named(found, sensors)
    verdicts = [
        judge_unexplained(unexplained, axis),
        *_coefficients(found, sensors, named),
        _noise(found, sensors, named),
        judge_intervals([] if effects else _broken(found, held)),
    ]
    verdicts += [judge_not_zero(effect.name, may_be_zero(effect)) for effect in effects]
    return (*verdicts, *map(judge_disputed, found.disputed), *(_closing(found, gap) if effects else ()))


def _broken(found: Found, held: npt.NDArray[np.bool_]) -> list[str]:
    """Axes with intervals of the simulation that the flights break; none of a simulation without any."""
    own = zip(AXES, held, found.stated, strict=True)
    return [axis for axis, inside, stated in own if stated > 0.0 and not inside]


def judged_by_gap(discovery: Discovery, gap: Gap) -> tuple[Verdict, ...]:
    """The tests of a discovery of named effects, with those on the gap made of another one."""
    of_gap = _closing(discovery.found, gap)
    tests = {check.test for check in of_gap}
    return (*(check for check in discovery.checks if check.test not in tests), *of_gap)


def judged_by_rollouts(discovery: Discovery, rollouts: Rollouts) -> Discovery:
    """The discovery, rejected and "unknown" where flights left out are simulated worse with its effects.

    Their gap must not grow, and their roll-outs must get no worse, one by one or by those that diverge.
    """
    errors = {ERROR_NAMES[name]: error for name, error in rollouts.errors.items()}
    verdict = judge_rollouts(
        {name: error.before for name, error in errors.items()},
        {name: error.after for name, error in errors.items()},
    )
    lost = {when: rollouts.lost.get(when, 0) for when in ("before", "after")}
    judged = (verdict, judge_diverged(lost["before"], lost["after"]))
    # A gap that grows fails the test of the closed share already.
    worse = discovery.gap.reduction < 0.0 or not all(own.passed for own in judged)
    return replace(
        discovery,
        checks=(*discovery.checks, *judged),
        verdict="unknown" if worse else discovery.verdict,
        rejected=worse,
    )


def may_be_zero(effect: FoundEffect) -> bool:
    """Whether the interval of every parameter that was estimated holds zero."""
    estimated = [parameter for parameter in effect.parameters if parameter.upper > parameter.lower]
    return all(parameter.lower < 0.0 < parameter.upper for parameter in estimated) and bool(estimated)


def _coefficients(found: Found, sensors: Array, named: float) -> tuple[Verdict, Verdict]:
    """Whether coefficients, each and together, explain little beyond what they may beside the effects."""
    regression = found.regression
    columns = regression.columns
    own_tolerance = {
        f"{effect.name}.{p.name}": effect.tolerance for effect in EFFECTS.values() for p in effect.parameters
    }
    # A centre of gravity elsewhere, for one, is elsewhere from the accelerometer too.
    moved = {regression.candidates[index].effect.tolerance for index in found.chosen} - {""}
    names = columns.tolerance_names
    judged = np.array([own_tolerance.get(name) not in moved for name in names])
    values = found.fit.of(columns.tolerances)
    # In a hover whose motion is noise of the estimator, coefficients of motion move far and explain nothing.
    rows = sum(map(len, columns.bands))
    felt = predictable(np.square(values) * columns.squares_of_each(columns.tolerances, sensors), rows)
    values = np.where(judged & felt.any(axis=0), values, 0.0)

    def share(beyond: Array) -> float:
        """Squares that parts of coefficients explain, of those and the squares of the named effects."""
        weights = np.zeros(columns.width)
        weights[columns.tolerances] = beyond
        explained = float(np.sum(columns.squares(weights, sensors)))
        return explained / max(named + explained, 1.0)

    off, own = values.copy(), np.ones(len(values))
    for index, law in enumerate(columns.tolerance_laws):
        if law:
            shared = names.index(law)
            off[index], own[index] = of_coefficient(values[index], values[shared]), of_coefficient(1.0, 0.0)
            off[shared] = 0.0
    excess = np.maximum(np.abs(off) - FAR_COEFFICIENT.value, 0.0) / own
    far = np.flatnonzero(excess)
    each = judge_coefficients(
        {names[index]: float(off[index]) for index in far},
        {names[index]: share(np.diag(excess)[index]) for index in far},
    )
    squares, allowed = float(values @ values), allowed_squares(sum(judged))
    beyond = 1.0 - np.sqrt(min(1.0, allowed / squares)) if squares > 0.0 else 0.0
    return each, judge_coefficients_together(squares, sum(judged), share(beyond * values))


def _closing(found: Found, gap: Gap) -> tuple[Verdict, ...]:
    """Whether the named effects close the gap, and flights agree on them or close it all the same.

    Flights so few that they do not predict each other do not disagree either.
    """
    verdicts = [judge_closed(gap.reduction)]
    for index in found.chosen if len(found.regression.flights) >= FEW_FLIGHTS.value else ():
        candidate = found.regression.candidates[index]
        names = [candidate.effect.parameters[own].name for own in candidate.free]
        ratios = dict(zip(names, found.disagreement(index).tolist(), strict=True))
        verdicts.append(judge_agreement(candidate.label, ratios, gap.reduction))
    return tuple(verdicts)


def _noise(found: Found, sensors: Array, named: float) -> Verdict:
    """Whether the noise of each axis can be that of sensors, or is little beside the named effects.

    The noise (6, C) of sensors is infinite in an axis that is not judged.
    """
    ratio = found.left.noise / sensors
    rows = sum(np.bincount(band, minlength=ratio.shape[1]) for band in found.regression.columns.bands)
    more = np.maximum(ratio - 1.0, 0.0) @ rows
    share = more / max(named + float(np.sum(more)), 1.0)
    return judge_colour(np.sqrt(ratio.max(axis=1)), share, AXES)


def _named(found: Found, sensors: Array) -> float:
    """Squares that are credited to the effects, in variances of the sensors."""
    reduction = found.regression.reduction(found.chosen, found.fit, sensors)
    return max(0.0, float(np.sum(reduction.credited)))
