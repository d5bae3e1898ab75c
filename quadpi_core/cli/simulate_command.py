# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi simulate`: flights of a scenario as MCAP bags."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from quadpi_core.cli.options import HtmlFile, JsonFile, check_outputs, open_console, write_result


def _print_catalogue(wanted: bool) -> None:
    if wanted:
        from quadpi_core.report.simulation_page import catalogue_tables
        from quadpi_core.report.table import terminal_table

        console = open_console()
        for table in catalogue_tables():
            console.print(terminal_table(table))
        raise typer.Exit


def simulate(
    scenario: Annotated[str, typer.Argument(help="Scenario in config/scenarios, or a YAML file.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the bags.")],
    flight: Annotated[
        list[str] | None, typer.Option(help="Only this flight of the scenario; may be repeated.")
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Vehicle in config/vehicles, a YAML file, or the folder of a physical model; default: the "
            "scenario's."
        ),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            help="Sensors in config/noise, a YAML file, or the folder of a model: those of its vehicle; "
            "default: the scenario's."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of noise and gusts; default: the scenario's.")
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(help="Switch on an effect: NAME, or NAME:PARAMETER=VALUE[,…]; may be repeated."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Flights at a time; default: one per core.")
    ] = None,
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
    _list: Annotated[
        bool,
        typer.Option("--list", callback=_print_catalogue, is_eager=True, help="Show scenarios and effects."),
    ] = False,
) -> None:
    """Fly a scenario: a bag per flight, with its truth on /truth/…."""
    from quadpi_core.config import is_config_path
    from quadpi_core.parallel import Workers
    from quadpi_core.report.simulation_page import (
        excursion_sentences,
        flight_json,
        flight_table,
        summarise,
        write_simulation_page,
    )
    from quadpi_core.report.table import progress_bar, terminal_table
    from quadpi_core.simulation.scenario import choose_flights, load_scenario, parse_effects
    from quadpi_core.simulation.simulated_bags import simulate as fly
    from quadpi_core.simulation.simulated_file import model_folder

    the_scenario = load_scenario(scenario)
    plans = choose_flights(
        the_scenario,
        flight or (),
        vehicle=vehicle,
        noise=noise,
        seed=seed,
        effects=parse_effects(effect or ()),
    )
    given = [Path(name) for name in (scenario, vehicle, noise) if name]
    files = [path for path in given if is_config_path(path) or model_folder(path) is not None]
    check_outputs(files, *(output / f"{plan.name}.mcap" for plan in plans), json_file, html_file)
    console = open_console()
    with progress_bar(console) as progress:
        flights = fly(plans, output, workers=Workers(workers, progress=progress))
    summaries = [summarise(flown.plan, flown.truth) for flown in flights]
    bags = [flown.bag for flown in flights]
    console.print(terminal_table(flight_table(summaries, bags)))
    for sentence in excursion_sentences(flown.truth for flown in flights):
        console.print(sentence, soft_wrap=True)
    write_result(json_file, flight_json(the_scenario.name, summaries, bags))
    if html_file is not None:
        write_simulation_page(html_file, [(flown.plan, flown.truth) for flown in flights])
