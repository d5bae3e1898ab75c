# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Opens the seals: what searches said against what was hidden, in figures and a confusion matrix."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from blind.cases import ELSE, NULL, OUT, PAIR, POOR, SINGLE, Hidden
from blind.effects import LATE

# The parameter that says which rotor is no estimate, but another one is another answer.
ROTOR = "rotor"
# Of the normal distribution, for intervals of 95 %.
_Z = 1.959964
# Growth of an error that counts as worse: with the noise of parameters, errors of roll-outs change by less.
_GROWTH = 0.02


@dataclass(frozen=True)
class Answer:
    """What was hidden in a case, and what a search of its flights said.

    Attributes:
        verdict: "none", "effects" or "unknown".
        named: names of the effects, as found.
        sets: of names that the search says it cannot tell apart.
        left: share of the removable gap that what is added leaves, on flights that were not fitted; None
            where nothing is added, or there are no such flights.
        rollouts: of those flights, by quantity: the error without and with what is added.
        estimates: true value, lower and upper bound of every parameter of a hidden effect that was named,
            where the library means the same by it.
    """

    hidden: Hidden
    verdict: str
    named: tuple[str, ...]
    sets: tuple[tuple[str, ...], ...]
    left: float | None
    rollouts: Mapping[str, Sequence[float]] = field(default_factory=dict)
    estimates: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)

    @classmethod
    def of(cls, found: Mapping[str, Any], truth: Mapping[str, float]) -> Answer:
        """From what `searched` of a benchmark gives, and the true parameters by `effect.parameter`."""
        result = found["result"]
        named, estimates = [], {}
        for effect in result["effects"]:
            name, parameters = effect["name"], effect["parameters"]
            known = {p: truth[f"{name}.{p}"] for p in parameters if f"{name}.{p}" in truth}
            if ROTOR in known and parameters[ROTOR]["value"] != known.pop(ROTOR):
                named.append(f"{name} of another rotor")
                continue
            named.append(name)
            for p, true in known.items():
                estimates[f"{name}.{p}"] = (true, parameters[p]["lower"], parameters[p]["upper"])
        return cls(
            hidden=Hidden.opened(found["seal"]),
            verdict=result["verdict"],
            named=tuple(named),
            sets=tuple(map(tuple, result["ambiguous"])),
            left=found["left"],
            rollouts=found["rollouts"] or {},
            estimates=dict(sorted(estimates.items())),
        )

    @property
    def right(self) -> bool:
        """Exactly the hidden effects are named; where none is hidden, none."""
        verdict = "effects" if self.hidden.effects else "none"
        return self.verdict == verdict and sorted(self.named) == sorted(self.hidden.effects)

    @property
    def in_set(self) -> bool:
        """As many effects as are hidden, each named or in the set that a name stands for."""
        return self.verdict == "effects" and len(self.named) == len(self.hidden.effects) and not self.wrong

    @property
    def wrong(self) -> tuple[str, ...]:
        """Names of the verdict "effects" that are not hidden, nor in one set with an effect that is."""
        if self.verdict != "effects":
            return ()
        hidden = set(self.hidden.effects)
        excused = {name for names in self.sets if hidden & set(names) for name in names}
        return tuple(name for name in self.named if name not in hidden | excused)

    @property
    def inside(self) -> list[bool]:
        """Of each estimate whether its interval holds the truth."""
        return [lower <= true <= upper for true, lower, upper in self.estimates.values()]

    @property
    def worse(self) -> tuple[str, ...]:
        """What becomes worse of flights that were not fitted with what is added: the gap, roll-outs."""
        gap = ("gap",) if self.left is not None and self.left > 1.0 + _GROWTH else ()
        grown = [name for name, (was, now) in self.rollouts.items() if now > was * (1.0 + _GROWTH)]
        return (*gap, *grown)

    @property
    def reported(self) -> frozenset[str]:
        """All that the search named or held for possible."""
        return frozenset((*self.named, *(name for names in self.sets for name in names)))

    @property
    def words(self) -> str:
        """What the search said, for people."""
        names = ", ".join(
            " or ".join(next((s for s in self.sets if s[0] == name), (name,))) for name in self.named
        )
        worse = f"; worse: {', '.join(self.worse)}" if self.worse else ""
        return f"{self.verdict}: {names}{worse}" if names else self.verdict


@dataclass(frozen=True)
class Figure:
    """A share with its interval of 95 % (Wilson) beside what it has to reach."""

    name: str
    hits: int
    of: int
    goal: float
    at_most: bool = False

    @property
    def share(self) -> float:
        return self.hits / self.of if self.of else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        return wilson(self.hits, self.of)

    @property
    def reached(self) -> bool:
        return self.share <= self.goal if self.at_most else self.share >= self.goal


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Interval of 95 % of a share."""
    if of == 0:
        return math.nan, math.nan
    share, spread = hits / of, _Z * _Z / of
    middle = (share + 0.5 * spread) / (1.0 + spread)
    half = _Z * math.sqrt(share * (1.0 - share) / of + 0.25 * spread / of) / (1.0 + spread)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def figures(answers: Sequence[Answer]) -> list[Figure]:
    """Every share of the figures to reach, over the answers that it is about."""

    def over(kind: str, size: float | None = None) -> list[Answer]:
        return [
            answer for answer in answers if answer.hidden.kind == kind and size in (None, answer.hidden.size)
        ]

    def figure(name: str, hits: Iterable[bool], goal: float, *, at_most: bool = False) -> Figure:
        hits = list(hits)
        return Figure(name, sum(hits), len(hits), goal, at_most)

    singles, full, half = over(SINGLE), over(SINGLE, 1.0), over(SINGLE, 0.5)
    pairs, told = over(PAIR), [answer for answer in over(POOR) if answer.verdict != "none"]
    closed = [answer for answer in (*full, *pairs) if answer.in_set and answer.left is not None]
    late = [answer for answer in closed if LATE & set(answer.hidden.effects)]
    additive = [answer for answer in closed if answer not in late]
    insides = [inside for answer in estimated(answers) for inside in answer.inside]
    added = [answer for answer in answers if answer.left is not None]
    return [
        figure("nulls: false alarms", (not a.right for a in over(NULL)), 0.02, at_most=True),
        figure("single effects, full size: named", (a.right for a in full), 0.95),
        figure("… or one of the set that is reported", (a.in_set for a in full), 0.95),
        figure("single effects, half size: named", (a.right for a in half), 0.45),
        figure("… or one of the set that is reported", (a.in_set for a in half), 0.45),
        figure("single effects, any size: wrong name", (bool(a.wrong) for a in singles), 0.01, at_most=True),
        figure("outside the library: unknown", (a.verdict == "unknown" for a in over(OUT)), 0.95),
        figure("pairs: exactly right", (a.right for a in pairs), 0.85),
        figure("… or of the sets that are reported", (a.in_set for a in pairs), 0.85),
        figure("pairs: a spurious extra", (bool(a.wrong) for a in pairs), 0.03, at_most=True),
        figure(
            "under-excited: the truth among what is reported",
            (set(a.hidden.effects) <= a.reported for a in told),
            0.98,
        ),
        figure("flights of RotorPy, full size: named", (a.right for a in over(ELSE)), 0.95),
        figure("… or one of the set that is reported", (a.in_set for a in over(ELSE)), 0.95),
        figure(
            "gap left by effects rightly found: at most 2 %",
            (a.left is not None and a.left <= 0.02 for a in additive),
            0.95,
        ),
        figure(
            "gap left by delay and wind rightly found: at most 5 %",
            (a.left is not None and a.left <= 0.05 for a in late),
            0.95,
        ),
        figure("parameters inside their interval of 95 %", insides, 0.9),
        figure(
            "additions that make flights or roll-outs worse that were not fitted",
            (bool(answer.worse) for answer in added),
            0.0,
            at_most=True,
        ),
    ]


def estimated(answers: Sequence[Answer]) -> list[Answer]:
    """Answers whose parameters count: effects that were found in flights that show them."""
    return [answer for answer in answers if answer.hidden.kind in (SINGLE, PAIR) and answer.in_set]


def confusion(answers: Sequence[Answer], size: float) -> dict[str, Counter[str]]:
    """What was said of each hidden effect at a size, in the words of :func:`told`."""
    rows: dict[str, Counter[str]] = {}
    for answer in answers:
        if answer.hidden.kind == SINGLE and answer.hidden.size == size:
            rows.setdefault(answer.hidden.effects[0], Counter())[told(answer)] += 1
    return dict(sorted(rows.items()))


def told(answer: Answer) -> str:
    """In a word what became of a hidden effect."""
    if answer.right:
        return "right"
    if answer.in_set:
        return "in the set"
    if answer.verdict == "effects":
        return " + ".join(sorted(answer.named))
    return answer.verdict


def failures(answers: Sequence[Answer]) -> list[Answer]:
    """Answers that count against a figure: not what was hidden where it was to be found, or made worse."""

    def fails(answer: Answer) -> bool:
        kind, size = answer.hidden.kind, answer.hidden.size
        if answer.worse:
            return True
        if kind == OUT:
            return answer.verdict != "unknown"
        if kind == POOR:
            return answer.verdict != "none" and not set(answer.hidden.effects) <= answer.reported
        if kind == SINGLE and size < 1.0:
            return bool(answer.wrong)
        return not (answer.right or answer.in_set)

    def order(answer: Answer) -> tuple[str, float, tuple[str, ...], int]:
        return answer.hidden.kind, -answer.hidden.size, answer.hidden.effects, answer.hidden.seed

    return sorted(filter(fails, answers), key=order)
