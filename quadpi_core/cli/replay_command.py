# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi replay`: what the live nodes would have published for flights."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from quadpi_core.cli.options import (
    Adaptive,
    Bags,
    Confidence,
    FileProcessCount,
    JsonFile,
    ModelFolder,
    OptionalVehicle,
    Scheduler,
    check_outputs,
    open_console,
    write_result,
)


def replay(
    model: ModelFolder,
    bags: Bags,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Bag to write; for several flights, a folder for theirs.")
    ],
    confidence: Confidence = None,
    adaptive: Adaptive = False,
    vehicle: OptionalVehicle = None,
    workers: FileProcessCount = None,
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
) -> None:
    """Write the bag that the live nodes would have published for a flight; the same bytes each time."""
    from dataclasses import asdict

    from quadpi_core.models.aerodynamic import AerodynamicModel
    from quadpi_core.monitor import MonitorSettings
    from quadpi_core.monitor.replay import replay as replay_bag
    from quadpi_core.monitor.replay import replay_all, replay_outputs
    from quadpi_core.parallel import Workers
    from quadpi_core.report.progress_bar import progress_bar

    several = len(bags) > 1
    check_outputs([model, *bags], *(replay_outputs(bags, output) if several else [output]), json_file)
    the_model = AerodynamicModel.load(model)
    the_vehicle = the_model.load_vehicle(vehicle)
    settings = MonitorSettings(adaptive=adaptive)
    console = open_console()
    if several:
        with progress_bar(console) as progress:
            replayed = replay_all(
                the_model,
                the_vehicle,
                bags,
                output,
                confidence=confidence,
                settings=settings,
                workers=Workers(workers, scheduler, progress),
            )
        summary = {"flights": {name: asdict(flight) for name, flight in replayed.items()}}
    else:
        summary = asdict(
            replay_bag(the_model, the_vehicle, bags[0], output, confidence=confidence, settings=settings)
        )
    console.print_json(data=summary)
    write_result(json_file, summary)
