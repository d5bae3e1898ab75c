# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where a simulation and flights disagree, what is missing and how far it closes the gap, as one page."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
from latex2mathml.converter import convert as mathml

from quadpi_core.discrepancy.by_condition import Segment
from quadpi_core.discrepancy.discrepancy_result import FoundEffect, Study
from quadpi_core.flight import AXES
from quadpi_core.report import discrepancy_text as text
from quadpi_core.report.decimation import bins_within
from quadpi_core.report.discrepancy_figures import (
    LINES,
    gap_figure,
    map_figure,
    profile_figure,
    residual_figure,
)
from quadpi_core.report.page import (
    cells,
    figure,
    figure_of_flight,
    flight_menu,
    footer,
    heading,
    section,
    table,
    write_page,
)
from quadpi_core.report.style import number, percent, unit
from quadpi_core.simulation.effect_registry import EFFECTS

# All time histories together draw so many samples, at about 11 bytes each in the page.
_DRAWN_SAMPLES = 300_000
_MOST_RANGES, _MOST_SEGMENTS = 12, 12


def write_discrepancy_page(path: Path, study: Study) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        study: what was found.

    Raises:
        OutputError: if `path` cannot be written.
    """
    discovery, where = study.discovery, study.where
    bins = bins_within(_DRAWN_SAMPLES, LINES * len(where.residuals))
    loud = [axis for axis in AXES if any(part.axis == axis for part in where.ranges)]
    figures = {"profiles": profile_figure(where.profiles), "gap": gap_figure(discovery.gap)}
    if loud:
        figures["maps"] = map_figure(where.residuals, loud)
    for flight in where.residuals:
        figures[f"residual {flight.flight}"] = residual_figure(flight, discovery.gap.floor, bins)
    parts = [
        heading("simulation against flights", text.verdict(study), _facts(study)),
        _where(study, loud),
        _what(study),
        _gap(study),
        *([_flown(study)] if study.flown_again else []),
        _left(study),
        f"<nav>{flight_menu({'': _loudest_first(study)})}</nav>",
        _histories(study, bins),
        _definitions(),
    ]
    write_page(path, f"quadpi: {study.simulation.name} against flights", parts, figures)


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


def _where(study: Study, loud: Sequence[str]) -> str:
    content = figure("profiles")
    telling = study.where.telling
    if telling:
        head = f'<tr><th>axis</th><th class="text">at</th>{cells("th", ("energy", "time"))}</tr>'
        rows = [
            f'<td>{part.axis}</td><td class="text">{escape(part.conditions)}</td>'
            + cells("td", (percent(part.share), percent(part.time_share)))
            for part in telling[:_MOST_RANGES]
        ]
        content = table(head, rows) + content
    else:
        content = f"<p>{escape(text.silent(study))}</p>" + content
    if loud:
        content += (
            '<h3>Maps</h3><p class="caption">Mean of measured − simulated: red where more was measured than '
            "simulated, blue where less. Cells in which next to nothing was flown are left out.</p>"
            + figure("maps")
        )
    return section(
        "Where",
        "Conditions that hold most of the residual energy of an axis beyond what noise and tolerances allow, "
        "in the least time. Below, the root mean square of the residual over the quantity that tells most of "
        "each axis.",
        content,
    )


def _what(study: Study) -> str:
    effects = study.discovery.effects
    if not effects:
        content = "<p>No effect of the library is named.</p>"
    else:
        content = "".join(_effect(effect) for effect in effects)
    return section(
        "What",
        "Each effect with its probability against every other in its place, and the 95 % intervals of its "
        "parameters. Coefficients of the simulation were free within their tolerances throughout.",
        content,
    )


def _effect(found: FoundEffect) -> str:
    effect = EFFECTS[found.name]
    summary, _, rest = inspect.cleandoc(effect.function.__doc__ or "").partition("\n\n")
    rows = [
        f'<td class="text">{escape(p.name)}</td>'
        + cells(
            "td",
            (
                f"{p.value:.0f}" if declared.whole else number(p.value),
                "" if declared.whole else f"{number(p.lower)} … {number(p.upper)}",
                escape(p.unit),
            ),
        )
        for p, declared in zip(found.parameters, effect.parameters, strict=True)
    ]
    head = f'<tr><th class="text">parameter</th>{cells("th", ("value", "95 % interval", "unit"))}</tr>'
    formula = (
        f"{mathml(effect.formula, display='block')}"
        f"<details><summary>LaTeX</summary><code>{escape(effect.formula)}</code></details>"
        if effect.formula
        else ""
    )
    if found.shape:
        shape = ", ".join(f"{name.removeprefix('shape_')} {value:.2f}" for name, value in found.shape.items())
        formula += f"<p>Shaped by these flights (effects.md tells how): {escape(shape)}.</p>"
    apart = f"<p>{escape(text.ambiguity(found))}</p>" if found.rivals else ""
    return (
        f"<h3>{escape(text.words(found.name))} · {percent(found.probability)}</h3>"
        f'<p class="caption">{escape(summary)} Shows in {", ".join(found.axes)}. {escape(rest)}</p>'
        f"{formula}{table(head, rows)}{apart}"
    )


def _gap(study: Study) -> str:
    gap = study.discovery.gap
    head = f"<tr>{cells('th', ('axis', '', 'before', 'after', 'floor', 'closed'))}</tr>"
    rows = []
    for k, (axis, share) in enumerate(zip(AXES, text.removable(study.discovery), strict=True)):
        rows.append(
            f'<td>{axis}</td><td class="unit">{unit(axis)}</td>'
            + cells("td", (number(float(values[k])) for values in (gap.before, gap.after, gap.floor)))
            + f"<td>{'–' if share is None else percent(share)}</td>"
        )
    return section(
        f"Before and after: {percent(gap.reduction)} of the gap is closed",
        "Root mean square of measured − simulated on flights left out in turn, each with what the others "
        "found, up to 20 Hz. The floor is the noise of the measurement, which no simulation can close.",
        f'<div class="pair">{table(head, rows)}{figure("gap")}</div>',
    )


def _flown(study: Study) -> str:
    head = f'<tr><th></th><th class="text"></th>{cells("th", ("before", "after", "floor"))}</tr>'
    rows = [
        f'<td>{escape(kind)}</td><td class="text">{escape(name)}</td>'
        + cells("td", (number(own) for own in (error.before, error.after, error.floor)))
        for kind, name, error in text.flown_again(study)
    ]
    note = text.flown_note(study)
    return section(
        "Flown again",
        "Roll-out: from many measured states the simulation goes on alone with the measured rotor speeds; "
        "root mean square of the error at the end. Closed loop: the same references flown again; root mean "
        "square distance from the flight. Each flight with what the others found. The floor has the measured "
        "wrench, or the true path, in the place of the simulation.",
        table(head, rows) + (f"<p>{escape(note)}</p>" if note else ""),
    )


def _left(study: Study) -> str:
    sentences = [text.unexplained(study.discovery)]
    fly = list(dict.fromkeys(m for e in study.discovery.effects if e.rivals for m in e.shown_by))
    items = [*fly, *(name for name in study.not_flown if name not in fly)]
    if items:
        sentences.append("What to fly next, because these flights do not hold it or cannot tell it:")
    listed = "".join(f"<li>{escape(item)}</li>" for item in items)
    return section(
        "What is left, and what to fly next",
        "Left is what functions of motion, rotors, place, heading and time predict from flight to flight.",
        "".join(f"<p>{escape(sentence)}</p>" for sentence in sentences)
        + (f"<ul>{listed}</ul>" if listed else ""),
    )


def _histories(study: Study, bins: int) -> str:
    segments = study.where.segments[:_MOST_SEGMENTS]
    listed = ""
    if segments:
        columns = cells("th", ("from [s]", "to [s]", "energy"))
        head = f'<tr><th>flight</th><th class="text">axis</th>{columns}</tr>'
        listed = (
            "<details><summary>Times that hold most of the residual energy</summary>"
            + table(head, (_segment(segment) for segment in segments))
            + "</details>"
        )
    return section(
        "Residuals over time",
        "Measured − simulated, up to 20 Hz, and the same with what the other flights found. Band: twice the "
        f"noise. Of each of {bins} equal parts of a flight the lowest and highest samples are drawn.",
        listed + figure_of_flight("residual"),
    )


def _segment(segment: Segment) -> str:
    name = escape(segment.flight)
    times = cells("td", (f"{segment.start_s:.0f}", f"{segment.end_s:.0f}", percent(segment.share)))
    return f'<td><button data-flight="{name}">{name}</button></td><td class="text">{segment.axis}</td>{times}'


def _definitions() -> str:
    return footer(
        {
            "Residual": "Measured wrench less what the simulation gives for the measured state and rotor "
            "speeds.",
            "Residual energy": "Sum of squares of the residual of an axis, less what noise and tolerances "
            "account for on average. A range has at least twice the root mean square that they allow; the "
            "chance that any is named on flights in which no effect is found is 5 %.",
            "Closed": "Share of the squares above the floor that is gone.",
            "Probability": "Against all other effects of the library in its place, all thought equally "
            "likely beforehand.",
        }
    )
