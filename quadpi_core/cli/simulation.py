# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Commands that simulate, or look at simulations: simulate, validate, discrepancy."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from quadpi_core.cli.options import (
    Bags,
    Confidence,
    FileWorkers,
    HtmlFile,
    JsonFile,
    OptionalVehicle,
    PublishedDevice,
    Scheduler,
    Workers,
)
from quadpi_core.cli.outputs import check_outputs, open_console, write_result
from quadpi_core.errors import QuadpiError


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
        str | None, typer.Option(help="Vehicle in config/vehicles, or a YAML file; default: the scenario's.")
    ] = None,
    noise: Annotated[
        str | None, typer.Option(help="Sensors in config/noise, or a YAML file; default: the scenario's.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Other noise and gusts; default: the scenario's seed.")
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
    """Fly a scenario in the rotor-local simulation: a bag per flight, with its truth on /truth/…."""
    from quadpi_core.config import is_config_path
    from quadpi_core.report.progress import flying
    from quadpi_core.report.simulation_page import flight_json, flight_table, summarise, write_simulation_page
    from quadpi_core.report.table import terminal_table
    from quadpi_core.simulation.run import simulate as fly
    from quadpi_core.simulation.scenario import choose_flights, load_scenario, parse_effects

    the_scenario = load_scenario(scenario)
    plans = choose_flights(
        the_scenario,
        flight or (),
        vehicle=vehicle,
        noise=noise,
        seed=seed,
        effects=parse_effects(effect or ()),
    )
    files = [Path(name) for name in (scenario, vehicle, noise) if name and is_config_path(name)]
    check_outputs(files, *(output / f"{plan.name}.mcap" for plan in plans), json_file, html_file)
    console = open_console()
    with flying(console, {plan.name: plan.duration_s for plan in plans}) as progress:
        flights = fly(plans, output, workers=workers, progress=progress)
    summaries = [summarise(flown.plan, flown.truth) for flown in flights]
    bags = [flown.bag for flown in flights]
    console.print(terminal_table(flight_table(summaries, bags)))
    write_result(json_file, flight_json(the_scenario.name, summaries, bags))
    if html_file is not None:
        write_simulation_page(html_file, [(flown.plan, flown.truth) for flown in flights])


def validate(
    paths: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Model folders, then bags of simulated flights; none: the paper's own validation."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder for models and finished realisations, to go on from."),
    ] = None,
    realisations: Annotated[int, typer.Option(min=1, help="Of the noise on each flight.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Of all noise.")] = 0,
    noise: Annotated[str, typer.Option(help="Noise on states, in config/noise, or a YAML file.")] = "paper",
    settings: Annotated[
        Literal["default", "paper"] | None,
        typer.Option(help="Of the paper's methods, where no model is given; default: paper."),
    ] = None,
    confidence: Confidence = None,
    vehicle: OptionalVehicle = None,
    device: PublishedDevice = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
) -> None:
    """Put noise on simulated flights a thousand times: do the intervals hold? The paper's tables."""
    from quadpi_core.evaluation.compare import is_model_folder
    from quadpi_core.paper.published import published_case, published_tables
    from quadpi_core.paper.realisations import run_realisations
    from quadpi_core.paper.validation_case import given_case
    from quadpi_core.paper.validation_result import summarise
    from quadpi_core.report.progress import counting
    from quadpi_core.report.validation_page import validation_summary

    kept = (None, None) if output is None else (output / "models", output / "realisations")
    check_outputs(paths or [], json_file, html_file, folders=kept)
    console = open_console()
    training: Sequence[Any] = ()
    published = None
    if paths:
        for option, value in (("--settings", settings), ("--device", device)):
            if value is not None:
                raise QuadpiError(f"{option}: is for the paper's own validation, where no model is given")
        folders = [path for path in paths if is_model_folder(path)]
        bags = [path for path in paths if path not in folders]
        case = given_case(folders, bags, vehicle=vehicle, noise=noise, confidence=confidence, seed=seed)
    else:
        with console.status("") as status:
            own = published_case(
                settings=settings or "paper",
                noise=noise,
                confidence=0.95 if confidence is None else confidence,
                seed=seed,
                device=device or "cpu",
                folder=kept[0],
                progress=status.update,
            )
        case, training, published = own.case, own.training, published_tables()
    case.check()
    try:
        with counting(console, "Realisations", realisations) as progress:
            tally = run_realisations(
                case, realisations, folder=kept[1], workers=workers, scheduler=scheduler, progress=progress
            )
    except KeyboardInterrupt as interruption:
        if output is not None:
            interruption.args = ("what is finished is kept, and the next run goes on from there",)
        raise
    result = summarise(case, tally, training=training, published=published)
    console.print(validation_summary(result))
    write_result(json_file, result.to_json())
    if html_file is not None:
        from quadpi_core.paper.realisations import spread
        from quadpi_core.parallel import map_tasks
        from quadpi_core.report.validation_page import SHOWN, write_validation_page

        names = [flight.name for flight in case.flights]
        spreads = map_tasks(
            partial(spread, realisations=range(SHOWN)),
            names,
            shared=case,
            workers=workers,
            scheduler=scheduler,
        )
        write_validation_page(html_file, result, case, dict(zip(names, spreads, strict=True)))


def discrepancy(
    simulation: Annotated[
        str,
        typer.Argument(
            help="What to compare with: a vehicle that can be simulated (name or file), a model folder, "
            "module:function, `recorded` for a wrench in the bags, or the addition.json of an earlier run."
        ),
    ],
    bags: Bags,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for what was found.")],
    effects: Annotated[
        str | None, typer.Option(help="Effects to look for, such as wind,payload; default: all.")
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option(help="Vehicle, where the simulation does not name one.")
    ] = None,
    allow_code: Annotated[
        bool,
        typer.Option("--allow-code", help="Run the function that an addition.json names; trust its author."),
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of the draws that thresholds come from.")] = 0,
    workers: FileWorkers = None,
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
) -> None:
    """Find where a simulation and flights disagree, name the missing effect, add it, show the gap shrink."""
    from quadpi_core.cli.discrepancy import run

    inputs = [*bags, *(path for path in (Path(simulation),) if path.exists())]
    check_outputs(inputs, json_file, html_file, folders=[output])
    run(
        open_console(),
        simulation,
        bags,
        output,
        vehicle=vehicle,
        allow_code=allow_code,
        names=None if effects is None else effects.split(","),
        seed=seed,
        json_file=json_file,
        html_file=html_file,
        workers=workers,
        scheduler=scheduler,
    )
