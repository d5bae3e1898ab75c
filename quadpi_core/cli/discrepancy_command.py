# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi discrepancy`: which effect does a simulation lack?"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import batch_of_flights, check_outputs, open_console, print_quality, shown_work

DATA, PAGE = "discrepancy.json", "discrepancy.html"


def discrepancy(
    simulation: Annotated[
        str,
        typer.Argument(
            help="What to compare with: a vehicle that can be simulated (name or file), a model folder, "
            "module:function, `recorded` for a wrench in the bags, or the addition.json of an earlier run."
        ),
    ],
    bags: options.Bags,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")],
    effects: Annotated[
        str | None, typer.Option(help="Effects to look for, such as wind,payload; default: all.")
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option(help="Vehicle, where the simulation does not name one.")
    ] = None,
    mapping: options.Mapping = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    from_commands: options.FromCommands = False,
    allow_code: Annotated[
        bool,
        typer.Option("--allow-code", help="Run the function that an addition.json names; trust its author."),
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draws that ranges are tested with.")] = 0,
    workers: options.FileProcessCount = None,
    scheduler: options.Scheduler = None,
    json_file: options.JsonFile = None,
    html_file: options.HtmlFile = None,
) -> None:
    """Find where a simulation and flights disagree, name the missing effect, add it, show the gap shrink."""
    from quadpi_core.discrepancy.augmented_simulation import write_addition
    from quadpi_core.discrepancy.discrepancy_result import study_json
    from quadpi_core.discrepancy.loading import load_simulation
    from quadpi_core.discrepancy.study import read_flights, study
    from quadpi_core.paths import whole_outputs, write_json
    from quadpi_core.report.discrepancy_evidence import write_formulas
    from quadpi_core.report.discrepancy_page import discrepancy_summary, write_discrepancy_page
    from quadpi_core.report.page import FlightFiles
    from quadpi_core.simulation.simulated_file import model_folder

    inputs = [*bags, *(path for path in (Path(simulation),) if path.exists())]
    check_outputs(inputs, json_file, html_file, folders=[output])
    console = open_console()
    how = options.reading_options(topics, namespace, mapping, part=options.time_range(from_s, to_s))
    names = None if effects is None else effects.split(",")
    with batch_of_flights() as left_out:
        the_simulation = load_simulation(
            simulation, vehicle, bags, mapping=how, allow_code=allow_code, left_out=left_out
        )
        with shown_work(console, workers, scheduler) as reading:
            flights = read_flights(
                bags,
                the_simulation,
                mapping=how,
                workers=reading,
                left_out=left_out,
                from_commands=from_commands,
            )
        print_quality(console, ((flight.name, flight.quality) for flight in flights))
        with console.status("Searching"):
            result = study(the_simulation, flights, names=names, seed=seed)
        data = {**study_json(result), "left_out": list(map(asdict, left_out))}
        for name, flight in data["flights"].items():
            if count := flight["unjudged_samples"]:
                console.print(
                    f"{name}: {count} samples left out, which the simulation cannot judge", soft_wrap=True
                )
            if flight["in_sample"]:
                console.print(f"{name}: the simulation was identified on this flight", soft_wrap=True)
        # A simulation that is no model cannot judge: who looks at a moment names a model.
        files = FlightFiles.from_paths(bags, [model_folder(simulation) or Path("MODEL")], vehicle)
        with whole_outputs(output) as staging, console.status("Writing"):
            addition = write_addition(result.discovery, staging)
            written = [addition, *write_formulas(result.discovery.effects, staging)] if addition else []
            data["files"] = added = [file.name for file in written]
            write_json(staging / DATA, data)
            write_discrepancy_page(staging / PAGE, result, files, left_out)
            if json_file is not None:
                write_json(json_file, data)
            if html_file is not None:
                write_discrepancy_page(html_file, result, files, left_out)
        console.print(discrepancy_summary(result))
        console.print(f"{output}: {', '.join([PAGE, DATA, *added])}", soft_wrap=True)
