# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The table of `quadpi replay`: what the monitor said of each flight."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from quadpi_core.monitor.replay import ReplaySummary
from quadpi_core.report.style import count, number, percent
from quadpi_core.report.table import Cell, Column, Mark, Row, Table


def replay_table(replayed: Mapping[str, ReplaySummary]) -> Table:
    """Alarm, warning and counts by flight; an alarm is marked.

    Args:
        replayed: summaries by the name of the flight.
    """
    columns = [
        Column("flight", is_text=True, wraps=True),
        Column("alarm", percent),
        Column("first s"),
        Column("warned s"),
        Column("events", count),
        Column("not judged", percent),
        Column("predicted", percent),
        Column("dropped", count),
    ]
    rows: list[Row] = [
        [
            flight,
            Cell(own.alarm_fraction, Mark.WARNING if own.alarm_fraction > 0.0 else None),
            _seconds(own.alarm_first_s),
            _seconds(own.warning_first_s),
            own.events,
            own.not_judged_fraction,
            own.predictions_out / own.samples_in,
            Cell(own.dropped, Mark.FAULT if own.dropped else None),
        ]
        for flight, own in replayed.items()
    ]
    return Table(
        columns,
        rows,
        note="alarm: share of the time; first, warned: when the first came; predicted: share of the samples",
    )


def not_judged_sentences(replayed: Mapping[str, ReplaySummary]) -> Iterator[str]:
    """Why which share of each flight was not judged."""
    for flight, own in replayed.items():
        if own.not_judged_reasons:
            why = ", ".join(f"{one.reason} {percent(one.fraction)}" for one in own.not_judged_reasons)
            yield f"{flight}: not judged {percent(own.not_judged_fraction)} of the flight: {why}"


def _seconds(value: float | None) -> str:
    return "none" if value is None else number(value)
