# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Every candidate of a search with its evidence: named effects first, then refused ones, best first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from quadpi_core.discrepancy.acceptance import Judgement
from quadpi_core.discrepancy.evidence import residual_weights
from quadpi_core.discrepancy.search import Found
from quadpi_core.flight import AXES
from quadpi_core.frames import Array

# Share of the floor's square by which an axis has to exceed it: less is no gap that an effect could close.
LEAST_ABOVE_FLOOR = 0.05


@dataclass(frozen=True)
class RankedCandidate:
    """What speaks for and against one candidate.

    Attributes:
        name: name of the effect.
        label: the name with the rotor, where there is one.
        named: whether it is among the effects of the result.
        beside: names of the effects beside which it was judged last.
        gain: evidence that it gained there [nat]; None where it failed an earlier test.
        needed: evidence that it needed there [nat].
        test: name of the test that decided.
        reason: sentence of that test.
        closes: by axis, the share of the gap above the floor that is credited to its contribution, fitted
            beside the named effects and the tolerances, see :class:`Reduction`; negative where the axis gets
            worse. Axes without a gap are left out; empty for a candidate that was not fitted.
        cancels: those of the axes that it makes worse with the coefficients as stated, and better only with
            coefficients that move against it.
        rivals: labels of candidates that do about as well in its place, with their odds against it.
    """

    name: str
    label: str
    named: bool
    beside: tuple[str, ...]
    gain: float | None
    needed: float | None
    test: str
    reason: str
    closes: Mapping[str, float]
    cancels: tuple[str, ...]
    rivals: Mapping[str, float]

    def to_json(self) -> dict[str, Any]:
        """As JSON holds it."""
        return {
            "name": self.name,
            "label": self.label,
            "named": self.named,
            "beside": list(self.beside),
            "evidence_nat": self.gain,
            "needed_nat": self.needed,
            "test": self.test,
            "reason": self.reason,
            "closes": dict(self.closes),
            "cancels": list(self.cancels),
            "rivals": dict(self.rivals),
        }


def ranked_candidates(found: Found) -> tuple[RankedCandidate, ...]:
    """The candidates of a search, each by its last judgement: named first, then by evidence over need."""
    regression = found.regression
    places = {candidate.label: index for index, candidate in enumerate(regression.candidates)}
    last = {judgement.label: judgement for judgement in found.judgements}
    chosen = {regression.candidates[index].label for index in found.chosen}
    # An effect that was named may have been judged again, and rejected, in the place of another.
    accepted = {own.label: own for own in found.judgements if own.accepted and own.label in chosen}
    closed = _Closed.of(found)
    ranked = [_ranked(found, own, places[label], closed) for label, own in (last | accepted).items()]
    return tuple(sorted(ranked, key=lambda own: (not own.named, -_over_need(own))))


def _over_need(candidate: RankedCandidate) -> float:
    if candidate.gain is None or not candidate.needed:
        return -np.inf
    return candidate.gain / candidate.needed


def _ranked(found: Found, judgement: Judgement, index: int, closed: _Closed) -> RankedCandidate:
    evidence = next((verdict for verdict in judgement.verdicts if verdict.test == "evidence"), None)
    candidates = found.regression.candidates
    closes, cancels = closed.shares(index) if evidence else ({}, ())
    return RankedCandidate(
        name=judgement.effect,
        label=judgement.label,
        named=index in found.chosen,
        beside=judgement.beside,
        gain=evidence.value if evidence else None,
        needed=evidence.threshold if evidence else None,
        test=judgement.reason.test,
        reason=judgement.reason.sentence,
        closes=closes,
        cancels=cancels,
        rivals={candidates[rival].label: odds for rival, odds in found.rivals.get(index, ())},
    )


@dataclass(frozen=True)
class _Closed:
    """What each candidate closes beside the named effects.

    Attributes:
        found: result of the search.
        removable: (6,) squares of the residual above the floor; 0 for an axis without a gap.
    """

    found: Found
    removable: Array

    @classmethod
    def of(cls, found: Found) -> _Closed:
        gap = found.gap()
        squares = found.regression.columns.squares(residual_weights(1, ()))
        above = np.square(gap.before) - np.square(gap.floor)
        is_gap = above > LEAST_ABOVE_FLOOR * np.square(gap.floor)
        share = np.divide(above, np.square(gap.before), out=np.zeros(len(AXES)), where=is_gap)
        return cls(found, share * squares)

    def shares(self, index: int) -> tuple[dict[str, float], tuple[str, ...]]:
        """Share of the gap of each axis that a candidate closes, and axes that it cancels coefficients in."""
        chosen, regression = self.found.chosen, self.found.regression
        fit = self.found.fit if index in chosen else regression.fit(tuple(sorted((*chosen, index))))
        if fit is None:
            return {}, ()
        reduction = regression.reduction((index,), fit)
        gaps = [axis for axis, own in enumerate(self.removable) if own > 0.0]
        closes = {AXES[axis]: float(reduction.credited[axis] / self.removable[axis]) for axis in gaps}
        cancels = [AXES[axis] for axis in gaps if reduction.stated[axis] < 0.0 < reduction.fitted[axis]]
        return closes, tuple(cancels)
