# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a search for discrepancies found, for the terminal; fits 80 characters."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from quadpi_core.discrepancy.by_condition import Range
from quadpi_core.discrepancy.discrepancy_result import Study
from quadpi_core.flight import AXES
from quadpi_core.report import discrepancy_text as text
from quadpi_core.report.style import number, percent
from quadpi_core.report.terminal_tables import axis_with_unit
from quadpi_core.simulation.effect_registry import EFFECTS

_MOST_RANGES = 8


def discrepancy_tables(study: Study) -> Group:
    """Verdict, where, what, the gap before and after, and what is left to do."""
    discovery = study.discovery
    parts: list[Table | Text] = [Text(text.verdict(study), style="bold"), Text()]
    if study.simulation.code:
        parts.insert(1, Text(f"Code that ran: {study.simulation.code}.", style="dim"))
    telling = study.where.telling
    if telling:
        parts.append(_where(telling[:_MOST_RANGES]))
    else:
        parts += [Text(f"Where: {text.silent(study)}"), Text()]
    if discovery.effects:
        parts.append(_effects(study))
    parts.append(_gap(study))
    if study.flown_again:
        parts += [_flown(study), Text(text.flown_note(study), style="dim")]
    parts += [Text(text.ambiguity(effect)) for effect in discovery.effects if effect.rivals]
    if discovery.verdict != "none":
        parts.append(Text(text.unexplained(discovery)))
    if study.not_flown:
        parts.append(Text(f"Not flown: {', '.join(study.not_flown)}.", style="dim"))
    return Group(*parts)


def _where(ranges: Sequence[Range]) -> Table:
    table = Table(title="Where", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("axis", no_wrap=True)
    table.add_column("at")
    for heading in ("residual energy", "time"):
        table.add_column(heading, justify="right", no_wrap=True)
    for part in ranges:
        table.add_row(part.axis, Text(part.conditions), percent(part.share), percent(part.time_share))
    return table


def _effects(study: Study) -> Table:
    table = Table(title="What", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("effect", no_wrap=True)
    table.add_column("prob.", justify="right", no_wrap=True)
    table.add_column("axes", overflow="fold")
    table.add_column("parameters, 95 % interval")
    for effect in study.discovery.effects:
        whole = {p.name for p in EFFECTS[effect.name].parameters if p.whole}
        lines = [f"{p.name} {text.parameter_text(p, whole=p.name in whole)}" for p in effect.parameters]
        if effect.shape:
            lines.append("its law shaped by these flights")
        table.add_row(
            Text(effect.name), percent(effect.probability), " ".join(effect.axes), Text("\n".join(lines))
        )
    return table


def _flown(study: Study) -> Table:
    table = Table(title="Flown again, error RMS", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    table.add_column("")
    for heading in ("before", "after", "floor"):
        table.add_column(heading, justify="right", no_wrap=True)
    for kind, name, error in text.flown_again(study):
        table.add_row(kind, Text(name), *(number(own) for own in (error.before, error.after, error.floor)))
    return table


def _gap(study: Study) -> Table:
    gap = study.discovery.gap
    table = Table(
        title=f"Gap, flights left out in turn: {percent(gap.reduction)} closed",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    table.add_column("axis", no_wrap=True)
    for heading in ("RMSE before", "after", "floor", "closed"):
        table.add_column(heading, justify="right", no_wrap=True)
    for k, (axis, share) in enumerate(zip(AXES, text.removable(study.discovery), strict=True)):
        numbers = [number(float(values[k])) for values in (gap.before, gap.after, gap.floor)]
        table.add_row(axis_with_unit(axis), *numbers, "–" if share is None else percent(share))
    return table
