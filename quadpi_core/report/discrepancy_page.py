# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where a simulation and flights disagree, which effect is missing, and how far it closes the gap.

The same tables and sentences are shown on the terminal and on a self-contained page.
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from latex2mathml.converter import convert as mathml
from rich.console import Group, RenderableType
from rich.text import Text

from quadpi_core.discrepancy.acceptance import Judgement
from quadpi_core.discrepancy.discrepancy_result import (
    BeforeAfter,
    Discovery,
    FoundEffect,
    FoundParameter,
    Study,
)
from quadpi_core.flight import AXES
from quadpi_core.report.coverage_verdict import listing
from quadpi_core.report.discrepancy_figures import (
    LINES,
    gap_figure,
    map_figure,
    profile_figure,
    residual_figure,
)
from quadpi_core.report.evaluation_page import axis_cell
from quadpi_core.report.page import Page
from quadpi_core.report.plots import bins_within
from quadpi_core.report.style import number, percent
from quadpi_core.report.table import Column, Row, Table, terminal_table
from quadpi_core.simulation.effect_registry import EFFECTS

# Rows of the tables of conditions and of times; the terminal shows fewer.
_MOST_RANGES, _MOST_ON_TERMINAL, _MOST_SEGMENTS = 12, 8, 12
# Rejected candidates that the terminal shows of the last round of the search; the page shows all.
_MOST_REJECTED = 3
_FLOWN = {
    "position_m": "position [m]",
    "velocity_m_s": "velocity [m/s]",
    "attitude_deg": "attitude [deg]",
    "rates_rad_s": "rates [rad/s]",
}


def discrepancy_summary(study: Study) -> Group:
    """Verdict, where, what, the gap before and after, and what is left to do; fits 80 characters."""
    discovery = study.discovery
    parts: list[RenderableType] = [Text(discrepancy_verdict(study), style="bold")]
    if study.simulation.code:
        parts.append(Text(f"Code that ran: {study.simulation.code}.", style="dim"))
    parts.append(Text())
    if study.where.telling:
        parts.append(terminal_table(_range_table(study, _MOST_ON_TERMINAL)))
    else:
        parts += [Text(f"Where: {no_range_sentence(study)}"), Text()]
    if discovery.effects:
        parts.append(terminal_table(_effect_table(study)))
    parts.append(terminal_table(_judgement_table(_decisive_judgements(discovery))))
    parts.append(terminal_table(_gap_table(discovery)))
    if study.flown_again:
        parts.append(terminal_table(_flown_again_table(study)))
        if note := flown_again_note(study):
            parts.append(Text(note, style="dim"))
    parts += [Text(ambiguity_sentence(effect)) for effect in discovery.effects if effect.rivals]
    if discovery.verdict != "none":
        parts.append(Text(unexplained_sentence(discovery)))
    if study.not_flown:
        parts.append(Text(f"Not flown: {', '.join(study.not_flown)}.", style="dim"))
    return Group(*parts)


def write_discrepancy_page(path: Path, study: Study) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        study: what was found.

    Raises:
        OutputError: if `path` cannot be written.
    """
    discovery, where = study.discovery, study.where
    bins = bins_within(LINES * len(where.residuals))
    loud = [axis for axis in AXES if any(part.axis == axis for part in where.ranges)]
    figures = {"profiles": profile_figure(where.profiles), "gap": gap_figure(discovery.gap)}
    if loud:
        figures["maps"] = map_figure(where.residuals, loud)
    for flight in where.residuals:
        figures[f"residual {flight.flight}"] = residual_figure(flight, discovery.gap.floor, bins)
    to_tell_apart = [item for effect in discovery.effects if effect.rivals for item in effect.shown_by]
    Page(
        title=f"quadpi: {study.simulation.name} against flights",
        about="simulation against flights",
        verdict=discrepancy_verdict(study),
        facts=_facts(study),
        definitions=_DEFINITIONS,
        figures=figures,
    ).write(
        path,
        "discrepancy.html",
        bins=bins,
        ranges=_range_table(study, _MOST_RANGES) if where.telling else None,
        no_range=no_range_sentence(study),
        maps=bool(loud),
        effects=[EffectSection.of(effect) for effect in discovery.effects],
        judgements=_judgement_table(discovery.found.judgements),
        reduction=percent(discovery.gap.reduction),
        gap=_gap_table(discovery),
        flown_again=_flown_again_table(study) if study.flown_again else None,
        flown_note=flown_again_note(study),
        unexplained=unexplained_sentence(discovery),
        fly_next=list(dict.fromkeys([*to_tell_apart, *study.not_flown])),
        flights=_loudest_first(study),
        segments=_segment_table(study) if where.segments else None,
    )


_DEFINITIONS = {
    "Residual": "Measured wrench less what the simulation gives for the measured state and rotor speeds.",
    "Residual energy": "Sum of squares of the residual of an axis, less what noise and tolerances account "
    "for on average. A range has at least twice the root mean square that they allow; the chance that any is "
    "named on flights in which no effect is found is 5 %.",
    "Closed": "Share of the squares above the floor that is gone.",
    "Probability": "Against all other effects of the library in its place, all thought equally likely "
    "beforehand.",
}


def _loudest_first(study: Study) -> list[str]:
    """Names of flights; those that are furthest above the noise come first in the menu."""
    floor = study.discovery.gap.floor
    above = {own.flight: float(np.square(own.before / floor).mean()) for own in study.where.residuals}
    return sorted(above, key=lambda name: -above[name])


def _facts(study: Study) -> dict[str, str]:
    seconds = sum(float(flight.time[-1] - flight.time[0]) for flight in study.flights)
    return {
        "simulation": study.simulation.name,
        **({"code that ran": study.simulation.code} if study.simulation.code else {}),
        "vehicle": study.simulation.vehicle.name,
        "flights": f"{len(study.flights)}, {number(seconds)}\u00a0s in the air",
    }


def _range_table(study: Study, most: int) -> Table:
    """Conditions that hold most of the residual energy."""
    columns = [
        Column("axis", is_text=True),
        Column("at", is_text=True, wraps=True),
        Column("residual energy", percent),
        Column("time", percent),
    ]
    ranges = study.where.telling[:most]
    rows: list[Row] = [[part.axis, part.conditions, part.share, part.time_share] for part in ranges]
    return Table(columns, rows, title="Where")


def _effect_table(study: Study) -> Table:
    """The effects that were found, with their parameters."""
    columns = [
        Column("effect", is_text=True),
        Column("prob.", percent),
        Column("axes", is_text=True, wraps=True),
        Column("parameters, 95 % interval", is_text=True, wraps=True),
    ]
    rows: list[Row] = []
    for effect in study.discovery.effects:
        whole = {parameter.name for parameter in EFFECTS[effect.name].parameters if parameter.whole}
        lines = [f"{p.name} {parameter_text(p, whole=p.name in whole)}" for p in effect.parameters]
        if effect.shape:
            lines.append("its law shaped by these flights")
        rows.append([effect.name, effect.probability, " ".join(effect.axes), "\n".join(lines)])
    return Table(columns, rows, title="What")


@dataclass(frozen=True)
class EffectSection:
    """What the page says about one effect; an empty text is left out."""

    title: str
    description: str
    formula: str
    latex: str
    shape: str
    parameters: Table
    ambiguity: str

    @classmethod
    def of(cls, found: FoundEffect) -> EffectSection:
        """The section of an effect."""
        effect = EFFECTS[found.name]
        summary, _, rest = inspect.cleandoc(effect.function.__doc__ or "").partition("\n\n")
        columns = [
            Column("parameter", is_text=True),
            Column("value", number),
            Column("95 % interval"),
            Column("unit"),
        ]
        rows: list[Row] = [
            [p.name, f"{p.value:.0f}" if known.whole else p.value, interval_text(p, known.whole), p.unit]
            for p, known in zip(found.parameters, effect.parameters, strict=True)
        ]
        shape = (f"{name.removeprefix('shape_')} {value:.2f}" for name, value in found.shape.items())
        return cls(
            title=f"{words(found.name)} · {percent(found.probability)}",
            description=f"{summary} Shows in {', '.join(found.axes)}. {rest}",
            formula=mathml(effect.formula, display="block") if effect.formula else "",
            latex=effect.formula,
            shape=", ".join(shape),
            parameters=Table(columns, rows),
            ambiguity=ambiguity_sentence(found) if found.rivals else "",
        )


def _decisive_judgements(discovery: Discovery) -> list[Judgement]:
    """The candidates that were accepted, and the best of those that were rejected in the last round."""
    judgements = discovery.found.judgements
    last = [own for own in judgements if own.beside == judgements[-1].beside and not own.accepted]
    return [own for own in judgements if own.accepted or own in last[:_MOST_REJECTED]]


def _judgement_table(judgements: Sequence[Judgement]) -> Table:
    """Why candidates were accepted or rejected, in the order of the search."""
    columns = [
        Column("beside", is_text=True, wraps=True, once=True),
        Column("candidate", is_text=True),
        Column("verdict", is_text=True, wraps=True),
    ]
    rows: list[Row] = [
        [
            ", ".join(own.beside) or "nothing",
            own.label,
            f"{'accepted' if own.accepted else 'rejected'}: {own.reason.sentence}",
        ]
        for own in judgements
    ]
    return Table(columns, rows, title="Candidates, best first")


def _gap_table(discovery: Discovery) -> Table:
    """Root mean square error of each axis before and after, and the share that is closed."""
    gap = discovery.gap
    columns = [
        Column("axis", is_text=True),
        Column("RMSE before", number),
        Column("after", number),
        Column("floor", number),
        Column("closed", percent),
    ]
    rows: list[Row] = [
        [axis_cell(axis), float(gap.before[k]), float(gap.after[k]), float(gap.floor[k]), closed]
        for k, (axis, closed) in enumerate(zip(AXES, closed_shares(discovery), strict=True))
    ]
    return Table(columns, rows, title=f"Gap, flights left out in turn: {percent(gap.reduction)} closed")


def _flown_again_table(study: Study) -> Table:
    """Errors of flights that were flown again."""
    columns = [
        Column("test", is_text=True, once=True),
        Column("error, RMS", is_text=True),
        *(Column(when, number) for when in ("before", "after", "floor")),
    ]
    rows: list[Row] = [
        [kind, name, error.before, error.after, error.floor] for kind, name, error in flown_again_rows(study)
    ]
    return Table(columns, rows, title="Flown again")


def _segment_table(study: Study) -> Table:
    """Times that hold most of the residual energy."""
    columns = [
        Column("flight", is_text=True, chooses_flight=True),
        Column("axis", is_text=True),
        Column("from [s]", "{:.0f}".format),
        Column("to [s]", "{:.0f}".format),
        Column("energy", percent),
    ]
    segments = study.where.segments[:_MOST_SEGMENTS]
    rows: list[Row] = [[part.flight, part.axis, part.start_s, part.end_s, part.share] for part in segments]
    return Table(columns, rows)


def discrepancy_verdict(study: Study) -> str:
    """The result in a sentence or two."""
    discovery, flights = study.discovery, f"{len(study.flights)} flights"
    named = listing([effect_name(effect) for effect in discovery.effects])
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
    return f"{number(parameter.value)} ({interval_text(parameter, whole)}) {parameter.unit}".rstrip()


def interval_text(parameter: FoundParameter, whole: bool) -> str:
    """The 95 % interval of a parameter; a whole number has none."""
    return "" if whole else f"{number(parameter.lower)} … {number(parameter.upper)}"


def ambiguity_sentence(effect: FoundEffect) -> str:
    """What an effect cannot be told from, and what to fly."""
    return (
        f"{words(effect.name).capitalize()} explains these flights as well as "
        f"{listing([words(rival) for rival in effect.rivals], 'or')} would. To tell them apart, fly "
        f"{listing(effect.shown_by)}."
    )


def unexplained_sentence(discovery: Discovery) -> str:
    """What is left once the effects are there."""
    if not discovery.unexplained_by:
        return "No residual is left that other flights predict: the rest is noise."
    axes = "; ".join(f"{axis} with {', '.join(by)}" for axis, by in discovery.unexplained_by.items())
    share = percent(discovery.unexplained)
    return f"{share} of the discrepancy that can be predicted is left, and goes with: {axes}."


def no_range_sentence(study: Study) -> str:
    """Why no place is named."""
    if study.discovery.effects:
        return (
            "No bin stands out by its size: coefficients within their tolerances could hide as much. It is "
            "the form of the residual that tells the effect."
        )
    return "No axis exceeds what noise and tolerances allow, in any condition."


def closed_shares(discovery: Discovery) -> list[float | None]:
    """Per axis of `AXES` the share of the squares above the floor that is closed; None where few are."""
    shares: list[float | None] = []
    for before, after, floor in zip(
        discovery.gap.before, discovery.gap.after, discovery.gap.floor, strict=True
    ):
        above = before**2 - floor**2
        shares.append(float(1.0 - max(after**2 - floor**2, 0.0) / above) if above > 0.05 * floor**2 else None)
    assert len(shares) == len(AXES)
    return shares


def flown_again_rows(study: Study) -> list[tuple[str, str, BeforeAfter]]:
    """What was flown again: kind of flight, quantity with its unit, errors before, after and floor."""
    if study.flown_again is None:
        return []
    rollout, loop = study.flown_again.rollout, study.flown_again.closed_loop
    kinds = ((f"roll-out, {rollout.horizon_s:g} s", rollout.errors), ("closed loop", loop.errors))
    return [
        (kind, name, errors[key]) for kind, errors in kinds for key, name in _FLOWN.items() if key in errors
    ]


def flown_again_note(study: Study) -> str:
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
