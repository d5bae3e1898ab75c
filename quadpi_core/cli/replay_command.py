# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi replay`: what the live nodes would have published for flights."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import (
    batch_of_flights,
    check_outputs,
    open_console,
    shown_work,
    write_result,
)


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
    from quadpi_core.report.replay_table import not_judged_sentences, replay_table
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
