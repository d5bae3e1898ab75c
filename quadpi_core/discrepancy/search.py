# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The search: which effects, if any, explain what flights and simulation disagree in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from quadpi_core.discrepancy.candidates import Candidate
from quadpi_core.discrepancy.contributions import Compared
from quadpi_core.discrepancy.design import Design
from quadpi_core.discrepancy.evidence import Fit, null_gains
from quadpi_core.discrepancy.generic import Left, generic_spectra, predicted

MOST_EFFECTS = 3
_BEAM = 8
_DRAWS = 1000
# Share of searches on flights without any effect that may name one.
FALSE_ALARMS = 0.01
_ROUNDS = 2
# A set is named alone where its evidence exceeds that of every other by this: odds of about a hundred.
NAMED_ALONE = 4.6
# Of the typical size: what is smaller is no finding, however certain.
_SMALLEST = 0.05
# Of the discrepancy that can be predicted from flight to flight: what may stay without a name.
UNEXPLAINED_SHARE = 0.1


@dataclass(frozen=True)
class Found:
    """What a search found.

    Attributes:
        design: the regression.
        chosen: indices of the candidates that were named.
        fit: of them.
        gain: evidence of the set over none.
        threshold: that a further effect has to exceed.
        rivals: per chosen candidate, other candidates that do as well in its place.
        left: what generic functions predict beyond the set.
        explained: squares in variances of the noise that the set takes away on flights left out.
    """

    design: Design
    chosen: tuple[int, ...]
    fit: Fit
    gain: float
    threshold: float
    rivals: dict[int, list[tuple[int, float]]]
    left: Left
    explained: float


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
        3.0,
    )
    none = _require(design.fit(()))
    _settle(design)
    chosen: tuple[int, ...] = ()
    found = none
    for sets in _larger_sets(design):
        best_set, best = sets[0]
        if best.log_evidence < found.log_evidence + threshold:
            break
        chosen, found = best_set, best
    chosen, found = _refine(design, chosen, found)
    rivals = _rivals(design, chosen, found)
    rows = design.left(found)
    names, spectra = generic_spectra(flights)
    left = predicted(rows, spectra, design.noise, names)
    return Found(
        design=design,
        chosen=chosen,
        fit=found,
        gain=found.log_evidence - none.log_evidence,
        threshold=threshold,
        rivals=rivals,
        left=left,
        explained=_explained(design, chosen),
    )


def _settle(design: Design) -> None:
    """Linearise every candidate where it fits best alone, with the columns of its form."""
    at = list(design.points)
    for index, candidate in enumerate(design.candidates):
        found = design.fit((index,))
        if found is not None:
            at[index] = candidate.within_bounds(design.parameters(index, found))
    for index in range(len(design.candidates)):
        design.move(index, at[index])
    design.refresh()


def _larger_sets(design: Design) -> Iterator[list[tuple[tuple[int, ...], Fit]]]:
    """Sets of one effect, two, … with their fits, best first; larger ones grow from the best."""
    best: list[tuple[tuple[int, ...], Fit]] = []
    for size in range(1, MOST_EFFECTS + 1):
        grown: dict[tuple[int, ...], Fit] = {}
        for base in [()] if size == 1 else [chosen for chosen, _ in best[:_BEAM]]:
            names = {design.candidates[index].name for index in base}
            for index, candidate in enumerate(design.candidates):
                chosen = tuple(sorted((*base, index)))
                if candidate.name in names or chosen in grown:
                    continue
                found = design.fit(chosen)
                if found is not None and _sizeable(design, chosen, found):
                    grown[chosen] = found
        best = sorted(grown.items(), key=lambda item: -item[1].log_evidence)
        if not best:
            return
        yield best


def _sizeable(design: Design, chosen: tuple[int, ...], found: Fit) -> bool:
    return all(np.abs(found.of(design.blocks[index].parameters)).max() > _SMALLEST for index in chosen)


def _refine(design: Design, chosen: tuple[int, ...], found: Fit) -> tuple[tuple[int, ...], Fit]:
    """Linearise the chosen again where they fit together."""
    for _ in range(_ROUNDS):
        if not chosen:
            break
        for index in chosen:
            candidate = design.candidates[index]
            design.move(index, candidate.within_bounds(design.parameters(index, found)))
        design.refresh()
        found = _require(design.fit(chosen))
    return chosen, found


def _rivals(design: Design, chosen: tuple[int, ...], found: Fit) -> dict[int, list[tuple[int, float]]]:
    """For each chosen candidate those that do about as well in its place, with how much worse they do."""
    rivals: dict[int, list[tuple[int, float]]] = {}
    for index in chosen:
        others = tuple(other for other in chosen if other != index)
        names = {design.candidates[other].name for other in chosen}
        close = []
        for rival, candidate in enumerate(design.candidates):
            if candidate.name in names:
                continue
            swapped = design.fit(tuple(sorted((*others, rival))))
            if swapped is None or not _sizeable(design, (rival,), swapped):
                continue
            if found.log_evidence - swapped.log_evidence < NAMED_ALONE:
                close.append((rival, found.log_evidence - swapped.log_evidence))
        rivals[index] = sorted(close, key=lambda item: item[1])
    return rivals


def _explained(design: Design, chosen: tuple[int, ...]) -> float:
    """Squares that the chosen effects take away from flights left out in turn, in variances of the noise."""
    if not chosen:
        return 0.0
    total = 0.0
    for own in design.per_flight:
        others = design.gram - own
        without = _require(design.fit((), others))
        # Where bounds leave nothing of an effect, the others do not know of it.
        with_effects = design.fit(chosen, others) or without
        for found, sign in ((without, 1.0), (with_effects, -1.0)):
            weights = design.weights(found)
            total += sign * float(weights @ own @ weights)
    return total


def _require(found: Fit | None) -> Fit:
    if found is None:
        raise AssertionError("bounds left nothing of a set that was fitted before")
    return found
