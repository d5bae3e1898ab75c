# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What searches of changed real flights said against the right answers, scored as the blind ones are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from blind.cases import NULL, OUT, PAIR, SINGLE, Hidden
from blind.scoring import Answer, Figure

from hidden.cases import KINDS, REAL, Case
from hidden.changes import CONDITION, Truth
from quadpi_core.evaluation.metrics import clopper_pearson

# Errors of mass and length of the real load that still count as right.
_MASS, _LENGTH = 0.15, 0.1
# Share of samples that the intervals are to hold with what was found.
_HELD = 0.9
# What became of a case.
RIGHT, AMONG, PART, WRONG, MISSED, UNKNOWN, REFUSED, ERROR = (
    *("right", "told among", "in part", "wrong"),
    *("missed", "unknown", "refused by its signals", "error"),
)
SHOWN = (RIGHT, AMONG, PART, WRONG, MISSED, UNKNOWN, REFUSED, ERROR)


class Binomial(Figure):
    """A share with its exact interval of 95 % (Clopper–Pearson)."""

    @property
    def interval(self) -> tuple[float, float]:
        return clopper_pearson(self.share, self.of, 0.95)


@dataclass(frozen=True)
class Finding:
    """One search, beside the right answers.

    Attributes:
        case: what was searched.
        truth: its right answers.
        answer: what was said, against that right set of effects that it comes nearest to.
        visible: whether the change pushed samples out of the model's intervals, before any search.
        each_visible: of a pair, whether each change does so by itself.
        broken: axes whose intervals do not hold what they state, with or without the change.
        values: parameters found, by `effect.parameter`.
        held: by axis share of samples inside the intervals with what was found.
        seconds: that the search took.
    """

    case: Case
    truth: Truth
    answer: Answer
    visible: bool
    each_visible: bool
    broken: tuple[str, ...]
    values: Mapping[str, float]
    held: Mapping[str, float]
    seconds: float

    @classmethod
    def of(cls, found: Mapping[str, Any]) -> Finding:
        """From what :func:`hidden.searching.searched` gives."""
        case = Case(**found["case"] | {"changes": tuple(found["case"]["changes"])})
        truth = case.truth()
        if case.kind in {NULL, CONDITION} and set(found["broken"]) - set(found["seen"]):
            # The flights themselves are not as the model states, and nobody knows why.
            truth = replace(truth, unknown=True)
        answers = []
        for effects in truth.right or ((),):
            seal = Hidden(case.kind, effects, case.size, case.split).sealed()
            answers.append(Answer.of({**found, "seal": seal}, truth.parameters))
        return cls(
            case=case,
            truth=truth,
            answer=max(answers, key=_nearness),
            # Flights whose signals contradict each other are refused, which says why, before any search.
            visible=not found["result"]["verdict"].startswith(REFUSED)
            and (bool(found["seen"]) or (case.kind == REAL and bool(found["broken"]))),
            each_visible=bool(found.get("parts")) and all(found["parts"]),
            broken=tuple(found["broken"]),
            values={
                f"{effect['name']}.{name}": parameter["value"]
                for effect in found["result"]["effects"]
                for name, parameter in effect["parameters"].items()
            },
            held={axis: own["after"] for axis, own in found["coverage"].items()},
            seconds=found["seconds"],
        )

    @property
    def outcome(self) -> str:
        """What became of it, one of SHOWN."""
        verdict, truth = self.answer.verdict, self.truth
        if (truth.right and self.answer.right) or (truth.unknown and verdict == "unknown"):
            return RIGHT
        if truth.right and self.answer.in_set:
            return AMONG
        if verdict == "effects":
            return WRONG if self.answer.wrong else PART
        if verdict.startswith(REFUSED):
            return REFUSED
        return {"none": MISSED, "unknown": UNKNOWN}.get(verdict, ERROR)

    @property
    def found(self) -> bool:
        """Whether it is right, or told among what these flights do not tell apart."""
        return self.outcome in {RIGHT, AMONG}

    def within(self, name: str, share: float) -> bool:
        """Whether a parameter was found within a share of the true one."""
        true = self.truth.parameters[name]
        return name in self.values and abs(self.values[name] - true) <= share * abs(true)


def figures(findings: Sequence[Finding]) -> list[Figure]:
    """Every share of the figures to reach, over those findings that it is about."""
    visible = {kind: [f for f in findings if f.case.kind == kind and f.visible] for kind in KINDS}
    singles, pairs, nulls = visible[SINGLE], visible[PAIR], [f for f in findings if f.case.kind == NULL]
    changed = [f for f in findings if f.case.kind in {SINGLE, PAIR, CONDITION}]
    loaded = [f for f in findings if "slung_load.mass_kg" in f.truth.parameters]
    brushed = [f for f in findings if f.case.kind == REAL and f not in loaded]
    told = [f for f in loaded if _load_named(f)]
    inside = [own for f in findings if f.case.kind in {SINGLE, PAIR} and f.found for own in f.answer.inside]
    alarms = [f.answer.verdict == "effects" for f in nulls]
    worse = [bool(f.answer.worse) for f in findings if f.answer.left is not None]
    missed = [f.answer.verdict == "none" for f in findings if f.broken]

    def figure(name: str, hits: Iterable[bool], goal: float, *, at_most: bool = False) -> Figure:
        found = [bool(hit) for hit in hits]
        return Binomial(name, sum(found), len(found), goal, at_most)

    return [
        figure("one change, visible: right, or told among", (f.found for f in singles), 0.85),
        figure("… right", (f.outcome == RIGHT for f in singles), 0.85),
        figure("any change: a wrong name", (f.outcome == WRONG for f in changed), 0.02, at_most=True),
        figure("pairs, visible: both right, or told among", (f.found for f in pairs), 0.7),
        figure(
            "… of which each change is visible by itself", (f.found for f in pairs if f.each_visible), 0.7
        ),
        figure("conditions, visible: none, or told", (f.found for f in visible[CONDITION]), 0.85),
        figure("no law of the library, visible: `unknown`", (f.found for f in visible[OUT]), 0.9),
        figure("nothing hidden: `effects`", alarms, 0.0, at_most=True),
        figure("an interval is broken: `none`", missed, 0.0, at_most=True),
        figure("parameters inside their interval of 95 %", inside, 0.9),
        figure("additions that make flights left out or roll-outs worse", worse, 0.0, at_most=True),
        figure("real load: `effects` with `slung_load`", map(_load_named, loaded), 0.9),
        figure("… nothing else but its hook, a `payload`", (f.found for f in loaded), 0.9),
        figure("… and its hook as well", (f.found and "payload" in f.answer.named for f in loaded), 0.9),
        figure("… its mass within 15 %", (f.within("slung_load.mass_kg", _MASS) for f in told), 0.9),
        figure("… its length within 10 %", (f.within("slung_load.length_m", _LENGTH) for f in told), 0.9),
        figure("… with it 90 % of Fx, Fy, Fz inside the intervals", map(_forces_held, told), 0.9),
        figure("brushed beside brushless: thrust or speed scale", (f.found for f in brushed), 0.9),
    ]


def order(finding: Finding) -> tuple[str, ...]:
    """Findings in the order of tables."""
    case = finding.case
    return (case.kind, *case.changes, f"{10.0 - case.size:g}", case.fleet, f"{case.split:03d}")


def _load_named(finding: Finding) -> bool:
    return finding.answer.verdict == "effects" and "slung_load" in finding.answer.named


def _forces_held(finding: Finding) -> bool:
    return bool(finding.held) and all(finding.held.get(axis, 1.0) >= _HELD for axis in ("Fx", "Fy", "Fz"))


def _nearness(answer: Answer) -> tuple[bool, bool, int, int]:
    named = set(answer.named) & set(answer.hidden.effects)
    return answer.right, answer.in_set, -len(answer.wrong), len(named)
