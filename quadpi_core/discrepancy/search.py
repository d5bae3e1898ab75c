# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The search: which effects, if any, explain what flights and simulation disagree in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadpi_core.discrepancy.candidates import Candidate
from quadpi_core.discrepancy.effect_regression import Design
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.evidence import Fit, null_gains, residual_weights
from quadpi_core.discrepancy.shape_fit import Closing
from quadpi_core.discrepancy.unexplained import Left, generic_spectra, predicted
from quadpi_core.flight import AXES
from quadpi_core.frames import Array

MOST_EFFECTS = 3
_DRAWS = 1000
# Share of searches on flights without any effect that may name one.
FALSE_ALARMS = 0.01
_ROUNDS = 3
# A further effect has to gain this share, within bounds, of what those before it add; what they gained is
# little where tolerances cover them. Two laws of the literature for one effect differ by so much that another
# effect may seem to mend the difference. Another law mends more of it than a number that is wrong in an exact
# one; most is mended of a law.
_FURTHER_SHARE, _FURTHER_LEAST, _FURTHER_NUMBER, _FURTHER_LAW = 0.05, 20.0, 100.0, 200.0
_BESIDE_LAW = 350.0
# What a law that is off calls for is a force or a moment at some place or time. One that scales what acts
# does not gain by it (none in 20 development cases); a true one gains little, as tolerances cover it.
_SCALING = frozenset({"payload", "inertia", "thrust_coefficient"})
# Odds of about a hundred and fifty, whatever the calibration says.
_LEAST_EVIDENCE = 5.0
# A set is named alone where its evidence exceeds that of every other by this: odds of about a hundred. Laws
# are not exact either: one that is off by a third leaves this share of what an effect gained, and another
# effect that does as well may be the true one.
NAMED_ALONE, _ALIKE = 4.6, 0.1
# Of the typical size: what is smaller is no finding, however certain.
_SMALLEST = 0.13
# Of the noise: what is less closes no gap. In a hover all motion is noise of the estimator, and so are the
# forces that a simulation makes of it.
_HEARD = 0.1
# On flights left out: share of what was left of an axis, and of what an effect takes from all of them, by
# which the effect may enlarge what is left of the axis. Coefficients settle elsewhere beside it.
_GROWS = 0.5
_FEW_FLIGHTS = 4
# Of the discrepancy that can be predicted from flight to flight: what may stay without a name.
UNEXPLAINED_SHARE = 0.05


@dataclass(frozen=True)
class Found:
    """What a search found.

    Attributes:
        design: the regression.
        chosen: indices of the candidates that were named.
        fit: of them.
        closing: what they close the gap by.
        gain: evidence of the set over none.
        threshold: that a further effect has to exceed.
        rivals: per chosen candidate, others that do about as well in its place, best first, each with its
            odds against the chosen one.
        left: what generic functions predict beyond the set.
        named: (6,) squares that the effects take away beside the coefficients as they were found, in
            variances of the noise of `left`.
    """

    design: Design
    chosen: tuple[int, ...]
    fit: Fit
    closing: Closing
    gain: float
    threshold: float
    rivals: dict[int, list[tuple[int, float]]]
    left: Left
    named: Array


def search(flights: Sequence[Compared], candidates: Sequence[Candidate], seed: int) -> Found:
    """Look for effects in flights.

    Args:
        flights: two at least.
        candidates: to look for.
        seed: of the calibration of the threshold.
    """
    design = Design(flights, candidates)
    threshold = max(
        float(
            np.quantile(
                null_gains(
                    design.gram,
                    design.tolerances,
                    [block for block in design.blocks if block.offset is None],
                    _DRAWS,
                    np.random.default_rng(seed),
                ),
                1.0 - FALSE_ALARMS,
            )
        ),
        _LEAST_EVIDENCE,
    )
    none = _require(design.fit(()))
    _settle(design)
    chosen: tuple[int, ...] = ()
    idle: set[int] = set()
    found, gain = none, 0.0
    while len(chosen) < MOST_EFFECTS:
        further = _further(design, chosen, found, threshold, idle)
        if further is None:
            break
        larger, found, more = further
        gain += more
        chosen, found = _without_idle(design, larger, found, threshold)
        # What was dropped does not come back: two could take turns for ever.
        idle |= set(larger) - set(chosen)
    rivals = _rivals(design, chosen, found)
    rows = design.left(found)
    names, spectra = generic_spectra(flights)
    left = predicted(rows, spectra, names)
    return Found(
        design=design,
        chosen=chosen,
        fit=found,
        closing=Closing.of(design, chosen),
        gain=gain,
        threshold=threshold,
        rivals=rivals,
        left=left,
        named=_named(design, found, left),
    )


def _settle(design: Design) -> None:
    """Linearise every candidate where it fits best alone, with the columns of its form."""
    best: dict[int, tuple[float, Array]] = {}
    for turn in range(_ROUNDS + 1):
        at = {}
        for index, candidate in enumerate(design.candidates):
            if turn > 0 and candidate.linear:
                continue
            found, here = design.fit((index,), form=False), design.points[index]
            if found is not None and (index not in best or found.log_evidence >= best[index][0]):
                best[index] = (found.log_evidence, here)
                if turn < _ROUNDS:
                    at[index] = design.parameters(index, found)
            elif index in best:
                # Too far: half of the way, and at last none of it.
                at[index] = 0.5 * (best[index][1] + here) if turn < _ROUNDS else best[index][1]
        for index, point in at.items():
            design.move(index, point)
        design.refresh()


def _needed(design: Design, index: int, beside: Sequence[int], found: Fit, threshold: float) -> float:
    """Evidence that an effect has to gain beside others, by what these add in their fit."""
    if not beside:
        return threshold
    if _scales_beside_law(design, index, beside):
        return _FURTHER_LEAST
    if any(design.candidates[other].form > 0.0 for other in beside):
        most = _BESIDE_LAW
    else:
        most = _FURTHER_LAW if design.candidates[index].form > 0.0 else _FURTHER_NUMBER
    return float(np.clip(_FURTHER_SHARE * design.energy(beside, found), _FURTHER_LEAST, most))


def _scales_beside_law(design: Design, index: int, beside: Sequence[int]) -> bool:
    """Whether an effect alone of a set scales whatever acts, and a law of the set may be off."""
    others = [design.candidates[other] for other in beside]
    alone = _SCALING & {design.candidates[index].name, *(other.name for other in others)}
    return alone == {design.candidates[index].name} and any(other.form > 0.0 for other in others)


def _further(
    design: Design, chosen: tuple[int, ...], found: Fit, threshold: float, idle: set[int]
) -> tuple[tuple[int, ...], Fit, float] | None:
    """The set with the best effect, not among the idle, that stands beside those chosen; its fit and gain.

    An effect that drives flights that are left out away gives its turn to the next. At one that is not heard,
    too small or gains too little, the search ends: what is left is noise or another law that looks like it,
    and any effect that does less well would be named for the same, unless no law can look like it.
    """
    before = left_out_squares(design, chosen)
    ended = False
    for larger, fit in _grown(design, chosen):
        more = fit.log_evidence - found.log_evidence
        (added,) = set(larger) - set(chosen)
        if added in idle or (ended and not _scales_beside_law(design, added, chosen)):
            continue
        needed = _needed(design, added, chosen, found, threshold)
        if more < needed or design.loudness(added, fit) < _HEARD:
            ended = True
            continue
        state = design.state()
        refined = _refine(design, larger, fit)
        if refined is not None and not _stays(before, left_out_squares(design, larger), design):
            design.restore(state)
            continue
        beside = None if refined is None else _beside_what_it_leaves(design, larger, refined)
        if beside is None:
            design.restore(state)
            ended = True
            continue
        return larger, beside, more
    return None


def _beside_what_it_leaves(design: Design, chosen: tuple[int, ...], found: Fit) -> Fit | None:
    """Fit of a set with what it leaves taken for noise; None where an effect is of no size then.

    Of no size by their laws alone, too: what the room of a form makes of an effect is not the effect.
    """
    if not _sizeable(design, chosen, found):
        return None
    design.weigh(design.noise_beside(chosen, found))
    plain = design.fit(chosen, form=False)
    return design.fit(chosen) if plain is not None and _sizeable(design, chosen, plain) else None


def _without_idle(
    design: Design, chosen: tuple[int, ...], found: Fit, threshold: float
) -> tuple[tuple[int, ...], Fit]:
    """The set without effects that are not needed any more, now that a better one is there."""
    for index in chosen:
        fewer = tuple(other for other in chosen if other != index)
        rest = design.fit(fewer) if fewer else None
        if rest is None or not _sizeable(design, fewer, rest):
            continue
        if found.log_evidence - rest.log_evidence < _needed(design, index, fewer, rest, threshold):
            state = design.state()
            refined = _refine(design, fewer, rest)
            if refined is not None:
                design.weigh(design.noise_beside(fewer, refined))
                return fewer, _require(design.fit(fewer))
            design.restore(state)
    return chosen, found


def left_out_squares(design: Design, chosen: Sequence[int]) -> Array:
    """Squares (6,) in variances of the noise that each flight is left with by a fit of all others."""
    squares = np.zeros(len(AXES))
    for place, found in enumerate(Closing.by_laws(design, chosen).left_out):
        left = np.square(design.combined(place, found.left))
        squares += np.sum(left / design.noise[:, design.bands[place]], axis=1)
    return squares


def _stays(before: Array, after: Array, design: Design) -> bool:
    """Whether no axis of the flights left out is driven away, of squares (6,) before and after an effect.

    They need not come closer: coefficients far beyond their tolerances may have closed the same gap. Of few
    flights each is flown in its own way, and the others do not tell what it takes.
    """
    room = _GROWS * (before + max(0.0, float(before.sum() - after.sum())))
    return len(design.flights) < _FEW_FLIGHTS or bool(np.all(after - before <= room))


def _grown(design: Design, chosen: tuple[int, ...]) -> list[tuple[tuple[int, ...], Fit]]:
    """The set with one effect more, for each that can be added, best first."""
    grown = []
    for index, candidate in enumerate(design.candidates):
        if any(candidate.excludes(design.candidates[other]) for other in chosen):
            continue
        larger = tuple(sorted((*chosen, index)))
        found = design.fit(larger)
        if found is not None and _sizeable(design, larger, found):
            grown.append((larger, found))
    return sorted(grown, key=lambda item: -item[1].log_evidence)


def _sizeable(design: Design, chosen: tuple[int, ...], found: Fit) -> bool:
    return all(np.abs(found.of(design.blocks[index].parameters)).max() > _SMALLEST for index in chosen)


def _refine(design: Design, chosen: tuple[int, ...], found: Fit) -> Fit | None:
    """Linearise the chosen again where they fit together; None where bounds then leave nothing of one.

    A step to where they fit worse, as far ones of a tether are, is taken half.
    """
    curved = any(not design.candidates[index].linear for index in chosen)
    best, at = found, [design.points[index] for index in chosen]
    refined: Fit | None = found
    to = [design.parameters(index, found) for index in chosen]
    for _ in range(_ROUNDS):
        _move(design, chosen, to)
        refined = design.fit(chosen)
        if refined is not None and (not curved or refined.log_evidence > best.log_evidence - _LEAST_EVIDENCE):
            best, at, to = refined, to, [design.parameters(index, refined) for index in chosen]
        elif not curved:
            return None
        else:
            to = [0.5 * (old + new) for old, new in zip(at, to, strict=True)]
    if refined is best:
        return best
    _move(design, chosen, at)
    return design.fit(chosen)


def _move(design: Design, chosen: Sequence[int], points: Sequence[Array]) -> None:
    for index, point in zip(chosen, points, strict=True):
        design.move(index, point)
    design.refresh()


def _rivals(design: Design, chosen: tuple[int, ...], found: Fit) -> dict[int, list[tuple[int, float]]]:
    """For each chosen candidate those that do about as well in its place, with their odds."""
    rivals: dict[int, list[tuple[int, float]]] = {}
    for index in chosen:
        others = tuple(other for other in chosen if other != index)
        beside = [design.candidates[other] for other in others]
        without = design.fit(others) or _require(design.fit(()))
        margin = max(NAMED_ALONE, _ALIKE * (found.log_evidence - without.log_evidence))
        scales = _scales_beside_law(design, index, others)
        close = []
        for rival, candidate in enumerate(design.candidates):
            if candidate.name == design.candidates[index].name or any(map(candidate.excludes, beside)):
                continue
            # What was taken for the error of a law does not come back as a rival.
            if scales and candidate.name not in _SCALING:
                continue
            swapped = design.fit(tuple(sorted((*others, rival))))
            if swapped is None or not _sizeable(design, (rival,), swapped):
                continue
            behind = found.log_evidence - swapped.log_evidence
            if behind < margin:
                close.append((rival, float(np.exp(-behind * NAMED_ALONE / margin))))
        rivals[index] = sorted(close, key=lambda item: -item[1])
    return rivals


def _named(design: Design, found: Fit, left: Left) -> Array:
    weights = residual_weights(len(found.left), ())
    weights[design.tolerances] = found.left[design.tolerances]
    named = np.zeros(len(AXES))
    for place, (rows, band) in enumerate(zip(design.left(found), design.bands, strict=True)):
        without = design.combined(place, weights)
        named += np.sum((without**2 - rows**2) / left.noise[:, band], axis=1)
    return named


def _require(found: Fit | None) -> Fit:
    if found is None:
        raise AssertionError("bounds left nothing of a set that was fitted before")
    return found
