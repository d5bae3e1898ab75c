# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi replay`: what the live nodes would have published for flights."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import batch_of_flights, check_outputs, open_console, shown_work, write_result
from quadpi_core.report.table import Cell, Column, Mark, Row, Table, count, number, percent

if TYPE_CHECKING:
    from quadpi_core.monitor.replay import ReplaySummary


def replay(
    model: options.ModelFolder,
    bags: options.Bags,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Bag to write; for several flights, a folder for theirs.")
    ],
    confidence: options.Confidence = None,
    adaptive: options.Adaptive = False,
    change: options.Change = True,
    vehicle: options.OptionalVehicle = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    workers: options.FileProcessCount = None,
    scheduler: options.Scheduler = None,
    json_file: options.JsonFile = None,
) -> None:
    """Write the bag that the live nodes would have published for a flight; the same bytes each time."""
    from dataclasses import asdict

    from quadpi_core.flight_files import bags_in, named_files
    from quadpi_core.models.aerodynamic import AerodynamicModel
    from quadpi_core.monitor import MonitorSettings
    from quadpi_core.monitor.replay import replay as replay_bag
    from quadpi_core.monitor.replay import replay_all
    from quadpi_core.report.table import terminal_table

    several = len(bags) > 1
    check_outputs([model, *bags], *(set(bags_in(output, bags)) if several else [output]), json_file)
    how = options.reading_options(topics, namespace, part=options.time_range(from_s, to_s))
    the_model = AerodynamicModel.load(model)
    the_vehicle = the_model.load_vehicle(vehicle)
    settings = MonitorSettings(adaptive=adaptive, change=change)
    console = open_console()
    with batch_of_flights() as left_out:
        if several:
            with shown_work(console, workers, scheduler) as replaying:
                replayed = replay_all(
                    the_model,
                    the_vehicle,
                    bags,
                    output,
                    confidence=confidence,
                    settings=settings,
                    mapping=how,
                    workers=replaying,
                    left_out=left_out,
                )
            summary = {
                "flights": {name: asdict(flight) for name, flight in replayed.items()},
                "left_out": list(map(asdict, left_out)),
            }
        else:
            (file,) = named_files(bags)
            replayed = {
                file.name: replay_bag(
                    the_model,
                    the_vehicle,
                    file.path,
                    output,
                    confidence=confidence,
                    settings=settings,
                    mapping=how,
                )
            }
            summary = asdict(replayed[file.name])
        console.print(terminal_table(replay_table(replayed)))
        for sentence in not_judged_sentences(replayed):
            console.print(sentence, soft_wrap=True)
        console.print(f"written to {output}", soft_wrap=True)
        write_result(json_file, summary)


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
