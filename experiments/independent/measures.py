# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What searches of the independent benchmark said against what was hidden, scored as the blind ones are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from blind.cases import NULL, OUT, SINGLE
from blind.scoring import Answer, Figure

from independent.searching import MODES

# Said with at least this probability counts as confident.
CONFIDENT = 0.9


@dataclass(frozen=True)
class Finding:
    """One search, opened.

    Attributes:
        answer: what was hidden and what was said.
        mapping, mode: of the flights and of the simulation.
        vehicle: that flew.
        each_coefficient: see `cases.IndependentCase.each_coefficient`.
        probabilities: that the search gives each effect that it names.
        seconds: that the search took.
    """

    answer: Answer
    mapping: str
    mode: str
    vehicle: str
    each_coefficient: bool
    probabilities: Mapping[str, float]
    seconds: float

    @classmethod
    def of(cls, found: Mapping[str, Any]) -> Finding:
        """From what :func:`independent.searching.searched` gives."""
        return cls(
            answer=Answer.of(found, found["truth"]),
            mapping=found["mapping"],
            mode=found["mode"],
            vehicle=found["vehicle"],
            each_coefficient=found["each_coefficient"],
            probabilities={effect["name"]: effect["probability"] for effect in found["result"]["effects"]},
            seconds=found["seconds"],
        )


def columns(findings: Sequence[Finding]) -> dict[str, list[Finding]]:
    """Findings by mapping and kind of simulation."""
    mappings = sorted({finding.mapping for finding in findings})
    named = {
        f"{mapping}, {mode}": [f for f in findings if (f.mapping, f.mode) == (mapping, mode)]
        for mapping in mappings
        for mode in MODES
    }
    return {name: some for name, some in named.items() if some}


def figures(findings: Sequence[Finding]) -> list[Figure]:
    """Every share of the figures to reach, over the findings that it is about."""
    nulls = [f for f in findings if f.answer.hidden.kind == NULL]
    singles = [f for f in findings if f.answer.hidden.kind == SINGLE]
    full, half = ([f for f in singles if f.answer.hidden.size == size] for size in (1.0, 0.5))
    outside = [f for f in findings if f.answer.hidden.kind == OUT]
    confident = [
        (name in f.answer.hidden.effects)
        for f in findings
        if f.answer.verdict == "effects"
        for name, probability in f.probabilities.items()
        if probability >= CONFIDENT
    ]
    estimates = [inside for f in (*full, *half) if f.answer.in_set for inside in f.answer.inside]

    def figure(name: str, hits: Iterable[bool], goal: float, *, at_most: bool = False) -> Figure:
        found = list(hits)
        return Figure(name, sum(found), len(found), goal, at_most)

    return [
        figure(
            "nulls: false alarms",
            (f.answer.verdict != "none" for f in nulls if not f.each_coefficient),
            0.02,
            at_most=True,
        ),
        figure(
            "nulls, every coefficient off by itself: false alarms",
            (f.answer.verdict != "none" for f in nulls if f.each_coefficient),
            0.02,
            at_most=True,
        ),
        figure("full size: named", (f.answer.right for f in full), 0.9),
        figure("… or one of the set that is reported", (f.answer.in_set for f in full), 0.9),
        figure("half size: named", (f.answer.right for f in half), 0.45),
        figure("… or one of the set that is reported", (f.answer.in_set for f in half), 0.45),
        figure("any size: wrong name", (bool(f.answer.wrong) for f in singles), 0.02, at_most=True),
        figure("any size: `unknown`", (f.answer.verdict == "unknown" for f in singles), 0.1, at_most=True),
        figure("outside the library: `unknown`", (f.answer.verdict == "unknown" for f in outside), 0.9),
        figure("parameters inside their interval of 95 %", estimates, 0.9),
        figure(
            "additions that make flights or roll-outs worse that were not fitted",
            (bool(f.answer.worse) for f in findings if f.answer.left is not None),
            0.0,
            at_most=True,
        ),
        figure(f"named with {CONFIDENT:.0%} or more: hidden", confident, 0.9),
    ]


def said(finding: Finding) -> str:
    """What became of a case, in a word or the names."""
    answer = finding.answer
    if answer.right:
        return "right"
    if answer.hidden.kind == OUT and answer.verdict == "unknown":
        return "right"
    if answer.in_set and answer.hidden.kind == SINGLE:
        return "in the set"
    return answer.words


def order(finding: Finding) -> tuple[str, tuple[str, ...], float, int]:
    """Cases in the order of tables."""
    hidden = finding.answer.hidden
    return hidden.kind, hidden.effects, -hidden.size, hidden.seed
