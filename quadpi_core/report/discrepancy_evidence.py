# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence for and against each effect in plain words, and what would change the verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from quadpi_core.discrepancy.discrepancy_result import Discovery, FoundEffect, RankedCandidate, Study
from quadpi_core.report.coverage_verdict import listing
from quadpi_core.report.table import Cell, Column, Mark, Row, Table
from quadpi_core.simulation.applied_effects import EFFECTS

# Candidates that a table shows at once.
MOST_CANDIDATES = 8
# Share of the needed evidence from which a refused candidate is worth further flights; so many are named.
_NEAR, _MOST_NEAR = 0.3, 3
# Share of the gap of an axis that is worth a word.
_LEAST_SHARE = 0.01

# Why a candidate was refused, before the sentence of the test that it failed.
_REFUSED = {
    "bounds": "impossible",
    "bounds, refined": "impossible",
    "bounds, reweighted": "impossible",
    "size": "too small to matter",
    "size, refined": "too small to matter",
    "size by its law": "too small to matter",
    "ordinary size": "larger than is ordinary, and another does as well",
    "not dropped": "no longer needed",
    "evidence": "too little evidence",
    "precedence": "behind a better one",
    "loudness": "quieter than the noise",
    "flights left out": "makes flights left out worse",
    "differs from zero": "may be zero",
    "barred": "barred by another search",
}
# What removes the doubt of a failed test of the whole result.
_REMEDIES = {
    "unexplained": "Look at what the rest varies with (section What is left) and where it is largest. "
    "Leave out flights in which something else acted, or add an effect of that form to the library "
    "(docs/effects.md).",
    "coefficients": "Measure that coefficient again. If it is right, something without a name acts in its "
    "place; if it is hardly known, state a wider tolerance in the vehicle file.",
    "coefficients together": "Measure the coefficients again. If they are right, something without a name "
    "acts in their place; if they are hardly known, state wider tolerances in the vehicle file.",
    "colour": "Fly in still air, and look at the sensors with `quadpi info`: gusts, or a sensor that drifts, "
    "cannot be told from a missing effect.",
    "closed": "Look for what else is missing in the conditions where the error stays large; more flights of "
    "those conditions help.",
    "intervals": "Look at what these flights have of their own (place, payload, air), and at their sensors "
    "with `quadpi info`: an effect that the library lacks breaks intervals, and one too weak to be told.",
    "not zero": "Fly more of what shows the effect, until an interval of its parameters excludes zero.",
    "agreement": "Compare what the flights that differ have of their own (payload, place, wind). If they are "
    "alike, something without a name acts, which this effect imitates on each flight in another way.",
    "disputed": "Fly what shows the one effect and not the other.",
    "closes": "Fly more of what shows the effect: where it is there, flights left out are closer with it.",
    "roll-outs": "Check the coefficients that moved with the effect, and the delays of the sensors: what "
    "fits a step ahead but not half a second is not the physics.",
    "diverged roll-outs": "Check the coefficients that moved with the effect: with it the vehicle does not "
    "fly.",
    "coverage": "Look at that axis in section What is left: the effect takes the place of something else "
    "there.",
}
# What removes the reason why a candidate with enough evidence was refused.
_REMEDIES_OF_CANDIDATES = {
    "flights left out": "Fly more flights of the same kind: if it is there, all of them must show it alike. "
    "An axis that grows may hold a second missing effect.",
    "loudness": "Fly harder: faster, or with larger steps, so that it exceeds the noise.",
    "differs from zero": "Fly more of what shows it, until an interval of its parameters excludes zero.",
    "precedence": "Remove what rejects the better one first.",
    "barred": "Fly more of what shows it: where it is there, flights left out are closer with it.",
}


class Change(NamedTuple):
    """What speaks against the verdict being another one, and what would remove it."""

    now: str
    then: str


def words(name: str) -> str:
    """Name of an effect or candidate as a text shows it."""
    return name.replace("_", " ")


def evidence_table(candidates: Sequence[RankedCandidate], verdict: str) -> Table:
    """Candidates with what speaks for and against them, in plain words; `verdict` is that of the search."""
    best = Cell("named", Mark.GOOD) if verdict == "effects" else Cell("comes closest", Mark.WARNING)
    columns = [
        Column("effect", is_text=True, wraps=True),
        Column("", is_text=True, wraps=True),
        Column("evidence", is_text=True, wraps=True),
        Column("of the gap it closes", is_text=True, wraps=True),
        Column("could as well be", is_text=True, wraps=True),
    ]
    rows: list[Row] = [
        [
            Cell(
                words(own.label),
                detail=f"beside {listing(list(map(words, own.beside)))}" if own.beside else "",
            ),
            best if own.named else Cell("refused", detail=refusal(own)),
            Cell(amount(own), detail="" if own.gain is None else f"{own.gain:.0f} of {own.needed:.0f} nat"),
            closes(own),
            "; ".join(f"{words(rival)}, {_odds(odds)}" for rival, odds in own.rivals.items()),
        ]
        for own in candidates
    ]
    return Table(columns, rows)


def refusal(candidate: RankedCandidate) -> str:
    """Why a candidate is not named."""
    if (
        candidate.test == "evidence"
        and candidate.gain is not None
        and candidate.gain >= (candidate.needed or 0)
    ):
        return "replaced by a better one"
    kind = _REFUSED.get(candidate.test, "")
    if candidate.test in ("bounds", "bounds, refined", "bounds, reweighted", "evidence"):
        return kind
    return f"{kind}: {words(candidate.reason)}" if kind else words(candidate.reason)


def amount(candidate: RankedCandidate) -> str:
    """Evidence of a candidate beside what it needs to be named."""
    if candidate.gain is None or not candidate.needed:
        return "not weighed"
    ratio = candidate.gain / candidate.needed
    if ratio >= 1.0:
        return f"{ratio:.0f} times what is needed" if ratio >= 9.5 else f"{ratio:.1f} times what is needed"
    return f"{100.0 * ratio:.0f} % of what is needed" if ratio > 0.0 else "none"


def closes(candidate: RankedCandidate) -> str:
    """Share of the gap of each axis that goes with a candidate, and of those that it makes worse."""
    better = {axis: share for axis, share in candidate.closes.items() if share >= _LEAST_SHARE}
    worse = {axis: -share for axis, share in candidate.closes.items() if share <= -_LEAST_SHARE}
    cancels = [axis for axis in candidate.cancels if axis in worse]
    worse = {axis: share for axis, share in worse.items() if axis not in cancels}
    parts = [", ".join(f"{axis} {100.0 * share:.0f} %" for axis, share in better.items())] if better else []
    if cancels:
        parts.append(f"nothing of {listing(cancels)} but with coefficients that move against it")
    if worse:
        grown = ", ".join(f"{axis} by {100.0 * share:.0f} %" for axis, share in worse.items())
        parts.append(f"makes {grown} worse")
    return "; ".join(parts) or ("nothing" if candidate.closes else "")


def _odds(odds: float) -> str:
    """Odds of a rival against the named effect."""
    if odds >= 1.0:
        return f"{odds:.3g} times as likely"
    return f"1/{1.0 / odds:.3g} as likely" if odds > 1e-3 else "hardly likely"


def changes_table(changes: Sequence[Change]) -> Table:
    """What would change the verdict."""
    columns = [
        Column("now", is_text=True, wraps=True),
        Column("what would change it", is_text=True, wraps=True),
    ]
    return Table(columns, [list(change) for change in changes])


def verdict_changes(study: Study) -> list[Change]:
    """What would change the verdict: doubts, rivals, refused effects, and what was not flown."""
    discovery = study.discovery
    failed = [check for check in discovery.checks if not check.passed]
    changes = [
        Change(f"{check.sentence[:1].upper()}{check.sentence[1:]}.", _remedy(check.test)) for check in failed
    ]
    changes += [_between_rivals(effect) for effect in discovery.effects if effect.rivals]
    changes += _refused(discovery)
    if (commanded := discovery.commanded) is not None:
        names = ", ".join(map(words, commanded.hidden))
        hidden = f" They hide most of what would show {names}." if names else ""
        changes.append(
            Change(" ".join(commanded.sentences) + hidden, "Log rotor speeds: flights with them tell more.")
        )
    if discovery.without_trace:
        changes.append(
            Change(
                f"Cannot be found by comparing these flights with this simulation: "
                f"{', '.join(map(words, discovery.without_trace))}.",
                "Fly what shows them. Wind, delays and rotor speeds need a simulation that computes its "
                "wrench from the flight: a vehicle file, a model or a function.",
            )
        )
    if discovery.within_intervals:
        changes.append(
            Change(
                "Not named, as the model's intervals hold the axes they act on: "
                f"{', '.join(map(words, discovery.within_intervals))}.",
                "A model with narrower intervals: identify it on more flights of the vehicle as it was.",
            )
        )
    if study.not_flown:
        changes.append(
            Change(
                f"Not flown: {', '.join(study.not_flown)}.",
                "Fly these: an effect that shows only there is neither found nor excluded.",
            )
        )
    return changes


def passed_checks(discovery: Discovery) -> str:
    """How far the result is from the limits of the tests that it passes; empty where nothing was named."""
    passed = [check.sentence for check in discovery.checks if check.passed]
    return f"Tests of the whole result that hold: {words('; '.join(passed))}." if passed else ""


def _remedy(test: str) -> str:
    return _REMEDIES.get(test, "Fly more flights: what is there shows in all of them.")


def _between_rivals(effect: FoundEffect) -> Change:
    return Change(
        f"{words(effect.name).capitalize()} explains these flights as well as "
        f"{listing(list(map(words, effect.rivals)), 'or')} would.",
        f"To tell them apart, fly {listing(effect.shown_by)}.",
    )


def _refused(discovery: Discovery) -> list[Change]:
    """Refused candidates with enough evidence, then those with nearly enough."""
    rivals = {rival for effect in discovery.effects for rival in effect.rivals}
    refused = [own for own in discovery.candidates if not own.named and own.name not in rivals]
    enough, near = [], []
    for own in refused:
        if own.gain is None or not own.needed:
            continue
        ratio = own.gain / own.needed
        if own.test != "evidence" and ratio >= 1.0:
            remedy = _REMEDIES_OF_CANDIDATES.get(own.test, f"Fly {EFFECTS[own.name].shown_by}.")
            now = f"{words(own.label).capitalize()} has {amount(own)}, but is refused: {refusal(own)}."
            enough.append(Change(now, remedy))
        elif own.test == "evidence" and _NEAR <= ratio < 1.0:
            then = f"{_more_flights(own, ratio)}; best {EFFECTS[own.name].shown_by}."
            near.append(Change(f"{words(own.label).capitalize()} has {amount(own)}.", then))
    return [*enough[:_MOST_NEAR], *near[:_MOST_NEAR]]


def _more_flights(candidate: RankedCandidate, share: float) -> str:
    """Whether more flights would give all of the needed evidence: evidence grows with their number."""
    if candidate.beside:
        # So does what is needed beside other effects, see `acceptance.FURTHER_SHARE`.
        others = listing(list(map(words, candidate.beside)))
        return f"More such flights may not do: what it needs grows with the evidence of {others}"
    more = 1.0 / share - 1.0
    return f"About {10 * math.ceil(10.0 * more)} % more such flights should do if it is there"
