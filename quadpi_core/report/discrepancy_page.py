# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The result of `quadpi discrepancy` on the terminal and as a self-contained page.

Both show the same tables and sentences: where a simulation and flights disagree, which effect the simulation
lacks, and how much of the gap it closes.
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from quadpi_core.discrepancy.acceptance import Judgement
from quadpi_core.discrepancy.discrepancy_result import (
    ERROR_NAMES,
    Discovery,
    FoundEffect,
    FoundParameter,
    Study,
)
from quadpi_core.discrepancy.result_verdicts import LEAST_ABOVE_FLOOR
from quadpi_core.flight import AXES
from quadpi_core.flight_files import FlightLeftOut
from quadpi_core.report.discrepancy_evidence import (
    MOST_CANDIDATES,
    changes_table,
    evidence_table,
    gap_figure,
    map_figure,
    passed_checks,
    profile_figure,
    residual_figure,
    verdict_changes,
    words,
)
from quadpi_core.report.evaluation_figures import listing
from quadpi_core.report.evaluation_page import axis_cell
from quadpi_core.report.page import Figure, FlightFiles, Page, flight_remarks
from quadpi_core.report.table import (
    Column,
    Row,
    Table,
    number,
    number_columns,
    percent,
    terminal_table,
    text_columns,
)
from quadpi_core.simulation.applied_effects import EFFECTS

# Rows at most: of the conditions on the page and on the terminal, and of the times of the largest residuals.
_MOST_RANGES, _MOST_ON_TERMINAL, _MOST_SEGMENTS = 12, 8, 12
# Rejected candidates of the last round of the search on the terminal; the page shows all of every round.
_MOST_REJECTED = 3


def discrepancy_summary(study: Study) -> Group:
    """Verdict, conditions, effects, the gap before and after, and what to do next, within 80 characters."""
    discovery = study.discovery
    parts: list[RenderableType] = [Text(_verdict(study), style="bold")]
    if study.simulation.code:
        parts.append(Text(f"Code that ran: {study.simulation.code}.", style="dim"))
    parts.append(Text())
    if study.where.telling:
        parts.append(terminal_table(_range_table(study, _MOST_ON_TERMINAL)))
    else:
        parts += [Text(f"Where: {_no_range_sentence(study)}"), Text()]
    if discovery.effects:
        parts.append(terminal_table(_effect_table(study)))
    parts.append(terminal_table(_judgement_table(_decisive_judgements(discovery))))
    parts.append(terminal_table(_gap_table(discovery)))
    if (flown_again := _flown_again_table(study)) is not None:
        parts.append(terminal_table(flown_again))
        if note := _flown_again_note(study):
            parts.append(Text(note, style="dim"))
    parts += [Text(sentence) for sentence in _conditions(discovery)]
    if discovery.verdict != "none":
        parts.append(Text(_unexplained_sentence(discovery)))
    if changes := verdict_changes(study):
        parts.append(Text("What would change the verdict", style="bold"))
        parts += [Text(f"- {change.now} {change.then}") for change in changes]
    return Group(*parts)


def write_discrepancy_page(
    path: Path,
    study: Study,
    files: FlightFiles | None = None,
    left_out: Sequence[FlightLeftOut] = (),
) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        study: what was found.
        files: of the flights, to look at moments in `quadpi view`.
        left_out: flights that were given and cannot be used.

    Raises:
        OutputError: if `path` cannot be written.
    """
    discovery, where = study.discovery, study.where
    loud = [axis for axis in AXES if any(part.axis == axis for part in where.ranges)]
    figures: dict[str, Figure] = {
        "profiles": profile_figure(where.profiles),
        "gap": gap_figure(discovery.gap),
    }
    if loud:
        figures["maps"] = map_figure(where.residuals, loud)
    floor = discovery.gap.floor
    of_flight = {own.flight: {"residual": residual_figure(own, floor)} for own in where.residuals}
    # The menu has those first whose residuals are largest over the noise.
    above = {own.flight: float(np.square(own.before / floor).mean()) for own in where.residuals}
    Page(
        title=f"quadpi: {study.simulation.name} against flights",
        about="simulation against flights",
        verdict=_verdict(study),
        facts=_facts(study),
        definitions=_DEFINITIONS,
        figures=figures,
        flight_figures=of_flight,
        files=files or FlightFiles(),
        remarks=flight_remarks({f.name: f.quality for f in study.flights}, left_out, study.in_sample),
    ).write(
        path,
        "discrepancy.html",
        evidence=evidence_table(discovery.candidates[:MOST_CANDIDATES], discovery.verdict),
        further=evidence_table(discovery.candidates[MOST_CANDIDATES:], discovery.verdict),
        changes=changes_table(verdict_changes(study)),
        passed=passed_checks(discovery),
        ranges=_range_table(study, _MOST_RANGES) if where.telling else None,
        no_range=_no_range_sentence(study),
        maps=bool(loud),
        effects=[EffectSection.from_effect(effect) for effect in discovery.effects],
        judgements=_judgement_table(discovery.found.judgements),
        reduction=percent(discovery.gap.reduction),
        gap=_gap_table(discovery),
        flown_again=_flown_again_table(study),
        flown_note=_flown_again_note(study),
        unexplained=_unexplained_sentence(discovery),
        conditions=_conditions(discovery),
        flights=sorted(above, key=lambda name: -above[name]),
        segments=_segment_table(study) if where.segments else None,
    )


_DEFINITIONS = {
    "Residual": "Measured wrench less what the simulation gives for the measured state and rotor speeds.",
    "Residual energy": "Sum of squares of the residual of an axis, less what noise and tolerances account "
    "for on average. In a range that is named, the root mean square is at least twice what they allow; on "
    "flights without a missing effect the chance that any range is named is 5 %.",
    "Closed": "Share of the mean square above the floor that is gone.",
    "Probability": "Of the effect against each other effect of the library in its place, with equal priors.",
}


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
        *(*text_columns("axis"), *text_columns("at", wraps=True)),
        *number_columns("residual energy", "time", shown=percent),
    ]
    ranges = study.where.telling[:most]
    rows: list[Row] = [[part.axis, part.conditions, part.share, part.time_share] for part in ranges]
    return Table(columns, rows, title="Where")


def _effect_table(study: Study) -> Table:
    """The effects of the result, with their parameters."""
    columns = [
        *(*text_columns("effect"), Column("prob.", percent)),
        *text_columns("axes", "parameters, 95 % interval", wraps=True),
    ]
    rows: list[Row] = []
    for effect in study.discovery.effects:
        whole = {parameter.name for parameter in EFFECTS[effect.name].parameters if parameter.whole}
        lines = [
            f"{p.name} {p.value:.0f}"
            if p.name in whole
            else f"{p.name} {number(p.value)} ({_interval(p)}) {p.unit}".rstrip()
            for p in effect.parameters
        ]
        if effect.shape:
            lines.append("law shaped by these flights")
        rows.append([effect.name, effect.probability, " ".join(effect.axes), "\n".join(lines)])
    return Table(columns, rows, title="What")


@dataclass(frozen=True)
class EffectSection:
    """Contents of the page on one effect; an empty text is not shown."""

    title: str
    description: str
    formula: str
    latex: str
    shape: str
    parameters: Table

    @classmethod
    def from_effect(cls, found: FoundEffect) -> EffectSection:
        """The section of an effect."""
        effect = EFFECTS[found.name]
        summary, _, rest = inspect.cleandoc(effect.function.__doc__ or "").partition("\n\n")
        columns = [*text_columns("parameter"), *number_columns("value")]
        columns += [Column("95 % interval"), Column("unit")]
        rows: list[Row] = [
            [p.name, *((f"{p.value:.0f}", "") if known.whole else (p.value, _interval(p))), p.unit]
            for p, known in zip(found.parameters, effect.parameters, strict=True)
        ]
        shape = (f"{name.removeprefix('shape_')} {value:.2f}" for name, value in found.shape.items())
        return cls(
            title=f"{words(found.name)} · {percent(found.probability)}",
            description=f"{summary} Shows in {', '.join(found.axes)}. {rest}",
            formula=_mathml(effect.formula),
            latex=effect.formula,
            shape=", ".join(shape),
            parameters=Table(columns, rows),
        )


def _mathml(latex: str) -> str:
    """A formula as a browser shows it; empty without the extra `reports`, when its LaTeX is all there is."""
    try:
        from latex2mathml.converter import convert
    except ImportError:
        return ""
    return str(convert(latex, display="block")) if latex else ""


def _decisive_judgements(discovery: Discovery) -> list[Judgement]:
    """The accepted candidates, and the best of those that the last round rejected."""
    judgements = discovery.found.judgements
    last = [own for own in judgements if own.beside == judgements[-1].beside and not own.accepted]
    return [own for own in judgements if own.accepted or own in last[:_MOST_REJECTED]]


def _judgement_table(judgements: Sequence[Judgement]) -> Table:
    """Why candidates were accepted or rejected, in the order of the search."""
    columns = [*text_columns("beside", wraps=True, once=True), *text_columns("candidate")]
    columns += text_columns("verdict", wraps=True)
    said = ("rejected", "accepted")
    rows: list[Row] = [
        [", ".join(own.beside) or "nothing", own.label, f"{said[own.accepted]}: {own.reason.sentence}"]
        for own in judgements
    ]
    return Table(columns, rows, title="Candidates, best first")


def _gap_table(discovery: Discovery) -> Table:
    """Root mean square error of each axis before and after, and the share that is closed."""
    gap = discovery.gap
    columns = [*text_columns("axis"), *number_columns("RMSE before", "after", "floor")]
    columns.append(Column("closed", percent))
    inside = discovery.found.inside
    if inside is not None:
        columns.append(Column(f"inside its intervals of {percent(inside.confidence)}", percent))
    rows: list[Row] = []
    for index, (axis, *errors) in enumerate(zip(AXES, gap.before, gap.after, gap.floor, strict=True)):
        before, after, floor = map(float, errors)
        above = before**2 - floor**2
        is_known = above > LEAST_ABOVE_FLOOR * floor**2
        closed = 1.0 - max(after**2 - floor**2, 0.0) / above if is_known else None
        held = [] if inside is None else [float(inside.shares[:, index].mean())]
        rows.append([axis_cell(axis), before, after, floor, closed, *held])
    return Table(columns, rows, title=f"Gap, flights left out in turn: {percent(gap.reduction)} closed")


def _flown_again_table(study: Study) -> Table | None:
    """Errors of flights that were flown again; None without any."""
    if study.discovery.flown is None:
        return None
    rollout, loop = study.discovery.flown.rollout, study.discovery.flown.closed_loop
    tests = {f"roll-out, {rollout.horizon_s:g} s": rollout.errors, "closed loop": loop.errors}
    columns = [*text_columns("test", once=True), *text_columns("error, RMS")]
    columns += number_columns("before", "after", "floor")
    rows: list[Row] = [
        [test, name, errors[key].before, errors[key].after, errors[key].floor]
        for test, errors in tests.items()
        for key, name in ERROR_NAMES.items()
        if key in errors
    ]
    return Table(columns, rows, title="Flown again")


def _segment_table(study: Study) -> Table:
    """Times that hold most of the residual energy."""
    columns = [*text_columns("flight", chooses_flight=True), *text_columns("axis")]
    columns += [*number_columns("from [s]", "to [s]", shown="{:.0f}".format), Column("energy", percent)]
    segments = study.where.segments[:_MOST_SEGMENTS]
    rows: list[Row] = [[part.flight, part.axis, part.start_s, part.end_s, part.share] for part in segments]
    return Table(columns, rows)


def _verdict(study: Study) -> str:
    """What to do, and the result in one or two sentences."""
    discovery, simulation = study.discovery, study.simulation.name
    if discovery.verdict == "none" and discovery.within_intervals and not discovery.candidates:
        return (
            f"Keep the simulation for flights like these: the intervals of {simulation} hold all axes of "
            f"{len(study.flights)} flights. No effect was looked for; one that stays inside the intervals "
            "may still be missing."
        )
    if discovery.verdict == "none":
        return (
            f"Keep the simulation. No missing effect was found: {simulation} and {len(study.flights)} "
            "flights differ by no more than the tolerances of the simulation and the noise allow."
        )
    named = listing([_name_with_rivals(effect) for effect in discovery.effects])
    if discovery.verdict == "effects":
        closed = percent(discovery.gap.reduction)
        return (
            f"{_action(discovery)}: {simulation} lacks {named}. On flights left out, adding it closes "
            f"{closed} of the gap that noise does not explain."
        )
    unknown = f"{simulation} lacks something that no effect of the library explains"
    doubts = "; ".join(discovery.doubts)
    if not discovery.effects:
        return f"Add nothing yet: {unknown}: {doubts}."
    comes = "come" if len(discovery.effects) > 1 else "comes"
    closest = f"{named[:1].upper()}{named[1:]} {comes} closest"
    return f"Add nothing yet: {unknown}. {closest}, but {doubts}."


def _action(discovery: Discovery) -> str:
    """What to do with named effects: add them, or fly what distinguishes them from their rivals."""
    shown_by = [item for effect in discovery.effects if effect.rivals for item in effect.shown_by]
    if not shown_by:
        return "Add what is missing"
    return f"Fly {listing(list(dict.fromkeys(shown_by)))} to decide"


def _name_with_rivals(effect: FoundEffect) -> str:
    rivals = f" (or {', or '.join(map(words, effect.rivals))})" if effect.rivals else ""
    return f"{words(effect.name)}{rivals}"


def _interval(parameter: FoundParameter) -> str:
    return f"{number(parameter.lower)} … {number(parameter.upper)}"


def _unexplained_sentence(discovery: Discovery) -> str:
    """What remains predictable once the effects are added."""
    if not discovery.unexplained_by:
        return "One flight predicts no residual of another."
    axes = "; ".join(f"{axis} with {', '.join(by)}" for axis, by in discovery.unexplained_by.items())
    if not discovery.unexplained:
        return f"The residual varies with: {axes}."
    share = percent(discovery.unexplained)
    return f"{share} of the predictable discrepancy is left, and varies with: {axes}."


def _no_range_sentence(study: Study) -> str:
    """Why no condition is named."""
    if study.discovery.effects:
        return (
            "No condition stands out by the size of its residual, which coefficients within their tolerances "
            "could hide. The effect shows in the form of the residual."
        )
    return "No axis exceeds what noise and tolerances allow, in any condition."


def _conditions(discovery: Discovery) -> list[str]:
    """What single flights have of their own, a sentence each."""
    sentences = [condition.sentence for condition in discovery.conditions]
    return [f"{words(own[:1].upper() + own[1:])}." for own in sentences]


def _flown_again_note(study: Study) -> str:
    """What could not be flown again, and the coverage of a model's intervals; empty for nothing."""
    if study.discovery.flown is None:
        return ""
    loop, coverage = study.discovery.flown.closed_loop, study.discovery.flown.coverage
    notes = [f"Closed loop: {loop.missing}."] if loop.missing else []
    notes += [f"Lost: {text}." for text in loop.lost]
    if coverage:
        shares = ", ".join(
            f"{axis} {percent(own.before)} → {percent(own.after)}" for axis, own in coverage.items()
        )
        notes.append(f"Coverage of the model's intervals: {shares}.")
    return " ".join(notes)
