# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a search for discrepancies found, in sentences that the terminal and the page share."""

from __future__ import annotations

from collections.abc import Sequence

from quadpi_core.discrepancy.discrepancy_result import (
    BeforeAfter,
    Discovery,
    FoundEffect,
    FoundParameter,
    Study,
)
from quadpi_core.flight import AXES
from quadpi_core.report.style import number, percent

_FLOWN = {
    "position_m": "position [m]",
    "velocity_m_s": "velocity [m/s]",
    "attitude_deg": "attitude [deg]",
    "rates_rad_s": "rates [rad/s]",
}


def verdict(study: Study) -> str:
    """The result in a sentence or two."""
    discovery, flights = study.discovery, f"{len(study.flights)} flights"
    named = _joined([effect_name(effect) for effect in discovery.effects])
    closed = f"{percent(discovery.gap.reduction)} of the gap that noise does not explain"
    if discovery.verdict == "none":
        return (
            f"Nothing is missing: what separates {study.simulation.name} and {flights} is within its stated "
            "tolerances and the noise."
        )
    if discovery.verdict == "effects":
        return f"{study.simulation.name} lacks {named}. Adding it closes {closed}, on flights left out."
    share = percent(discovery.unexplained)
    unknown = f"{study.simulation.name} lacks something that no effect of the library explains."
    if not discovery.effects:
        return unknown
    return (
        f"{unknown} {named.capitalize()} comes closest, but {share} of the discrepancy that can be predicted "
        "has no name."
    )


def effect_name(effect: FoundEffect) -> str:
    """In words, with those that it cannot be told from."""
    name = words(effect.name)
    if not effect.rivals:
        return name
    return f"{name} (or {', or '.join(words(rival) for rival in effect.rivals)})"


def words(name: str) -> str:
    """The name of an effect as people say it."""
    return name.replace("_", " ")


def parameter_text(parameter: FoundParameter, *, whole: bool) -> str:
    """Value, interval and unit of a parameter; a whole number has no interval."""
    if whole:
        return f"{parameter.value:.0f}"
    interval = f"({number(parameter.lower)} … {number(parameter.upper)})"
    return f"{number(parameter.value)} {interval} {parameter.unit}".rstrip()


def ambiguity(effect: FoundEffect) -> str:
    """What an effect cannot be told from, and what to fly."""
    return (
        f"{words(effect.name).capitalize()} explains these flights as well as "
        f"{_joined([words(rival) for rival in effect.rivals], 'or')} would. To tell them apart, fly "
        f"{_joined(effect.shown_by)}."
    )


def unexplained(discovery: Discovery) -> str:
    """What is left once the effects are there."""
    if not discovery.unexplained_by:
        return "Nothing that one flight tells of another is left: the rest is noise."
    axes = "; ".join(f"{axis} with {', '.join(by)}" for axis, by in discovery.unexplained_by.items())
    share = percent(discovery.unexplained)
    return f"{share} of the discrepancy that can be predicted is left, and goes with: {axes}."


def silent(study: Study) -> str:
    """Why no place is named."""
    if study.discovery.effects:
        return (
            "No bin stands out by its size: coefficients within their tolerances could hide as much. It is "
            "the form of the residual that tells the effect."
        )
    return "No axis exceeds what noise and tolerances allow, in any condition."


def removable(discovery: Discovery) -> list[float | None]:
    """Per axis of `AXES` the share of the squares above the floor that is closed; None where few are."""
    shares: list[float | None] = []
    for before, after, floor in zip(
        discovery.gap.before, discovery.gap.after, discovery.gap.floor, strict=True
    ):
        above = before**2 - floor**2
        shares.append(float(1.0 - max(after**2 - floor**2, 0.0) / above) if above > 0.05 * floor**2 else None)
    assert len(shares) == len(AXES)
    return shares


def flown_again(study: Study) -> list[tuple[str, str, BeforeAfter]]:
    """What was flown again: kind of flight, quantity with its unit, errors before, after and floor."""
    if study.flown_again is None:
        return []
    rollout, loop = study.flown_again.rollout, study.flown_again.closed_loop
    kinds = ((f"roll-out, {rollout.horizon_s:g} s", rollout.errors), ("closed loop", loop.errors))
    return [
        (kind, name, errors[key]) for kind, errors in kinds for key, name in _FLOWN.items() if key in errors
    ]


def flown_note(study: Study) -> str:
    """What could not be flown again, and how often intervals hold the measurement; empty for nothing."""
    if study.flown_again is None:
        return ""
    loop, coverage = study.flown_again.closed_loop, study.flown_again.coverage
    notes = [f"Closed loop: {loop.missing}."] if loop.missing else []
    notes += [f"Lost: {text}." for text in loop.lost]
    if coverage:
        shares = ", ".join(
            f"{axis} {percent(own.before)} → {percent(own.after)}" for axis, own in coverage.items()
        )
        notes.append(f"Coverage of the model's intervals: {shares}.")
    return " ".join(notes)


def _joined(names: Sequence[str], last: str = "and") -> str:
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"
