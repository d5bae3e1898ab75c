# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi identify`: a model from flights."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from quadpi_core.cli import options
from quadpi_core.cli.evaluate_command import write_evaluation
from quadpi_core.cli.options import (
    batch_of_flights,
    check_outputs,
    choice_of_kind,
    open_console,
    print_quality,
    shown_work,
)
from quadpi_core.models import kinds
from quadpi_core.plugins import names_in

if TYPE_CHECKING:
    from rich.console import Console

    from quadpi_core.models.aerodynamic import AerodynamicModel


def _known_kind(name: str | None) -> str | None:
    from quadpi_core.models.kind_registry import KINDS

    if name is not None and name not in KINDS.names():
        raise typer.BadParameter(f"{name!r} is not one of {', '.join(KINDS.names())}.")
    return name


def identify(
    context: typer.Context,
    bags: options.Bags,
    vehicle: options.VehicleName,
    output: Annotated[Path, typer.Option("-o", "--output", help="Model folder to write.")],
    method: Annotated[  # noqa: ARG001 - its command has read it
        str | None,
        typer.Option(
            callback=_known_kind,
            help=f"Kind of model: {', '.join(names_in(kinds))}, or one of an installed package. "
            "Ensembles of networks (bootstrap, quality-driven) err more and are not recommended. "
            "Each has options of its own: --method NAME --help. "
            f"Default: the first of {', '.join(kinds.DEFAULTS)} that has all options given.",
        ),
    ] = None,
    candidates: Annotated[
        str,
        typer.Option(
            help="Pools that some methods choose from: a name in config/candidates, or a YAML file."
        ),
    ] = "quadrotor",
    axes: Annotated[
        str | None, typer.Option(help="Axes to identify, such as Fx,Fz,My; default: all.")
    ] = None,
    settings: Annotated[
        Literal["default", "paper"], typer.Option(help="Calibrated on held-out flights, or as in the paper.")
    ] = "default",
    cutoff_hz: Annotated[
        float | None, typer.Option(help="Cut-off of the low-pass over all signals; default: 30, paper: 100.")
    ] = None,
    confidence: Annotated[float, typer.Option(help="Coverage of the intervals.")] = 0.95,
    keep_flawed: Annotated[
        bool,
        typer.Option(
            "--keep-flawed", help="Also learn from flights with a finding that says to leave them out."
        ),
    ] = False,
    from_commands: options.FromCommands = False,
    false_alarms_per_hour: Annotated[
        float, typer.Option(help="False alarms per hour that the limits of the alarm are calibrated to.")
    ] = 1.0,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    all_parts: options.AllParts = False,
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    verbose: Annotated[
        bool, typer.Option("--verbose", help="Also print every parameter or term, and the log of the fit.")
    ] = False,
    workers: options.FileProcessCount = None,
    scheduler: options.Scheduler = None,
    json_file: options.JsonFile = None,
    html_file: options.HtmlFile = None,
) -> None:
    """Identify a model on flights; every flight calibrates the intervals while it is left out."""
    from quadpi_core.evaluation.evaluate import ComparisonCase
    from quadpi_core.identification.commanded_flights import prepare_with_motors
    from quadpi_core.identification.identify import check_options
    from quadpi_core.identification.identify import identify as identify_model
    from quadpi_core.models.candidate_pool import load_pools, select_axes
    from quadpi_core.models.kind_registry import kind_of
    from quadpi_core.models.model_folder import require_replaceable
    from quadpi_core.models.model_kind import CUTOFF_HZ, IdentifyOptions
    from quadpi_core.report.page import FlightFiles
    from quadpi_core.report.table import progress_bar
    from quadpi_core.vehicle import Vehicle

    check_outputs(bags, json_file, html_file, folders=[output])
    require_replaceable(output)
    how = options.reading_options(
        topics, namespace, part=options.time_range(from_s, to_s), all_parts=all_parts
    )
    console = open_console()
    cutoff = CUTOFF_HZ[settings] if cutoff_hz is None else cutoff_hz
    the_vehicle = Vehicle.load(vehicle)
    pools = select_axes(load_pools(candidates), axes)
    chosen = IdentifyOptions(
        cutoff_hz=cutoff,
        method=context.obj,
        settings=settings,
        confidence=confidence,
        false_alarms_per_hour=false_alarms_per_hour,
    )
    check_options(chosen, pools)
    with batch_of_flights() as left_out:
        with shown_work(console, workers, scheduler) as reading:
            read = prepare_with_motors(
                bags,
                the_vehicle,
                cutoff,
                mapping=how,
                workers=reading,
                left_out=left_out,
                from_commands=from_commands,
                keep_flawed=keep_flawed,
                shortest_s=kind_of(chosen).shortest_s,
            )
        flights, the_vehicle = read.flights, read.vehicle
        if read.said:
            console.print(read.said, soft_wrap=True)
        print_quality(console, ((flight.name, flight.quality) for flight in flights))
        with progress_bar(console) as progress:
            model = identify_model(flights, the_vehicle, pools, chosen, progress)
            # First without, so that nothing is lost where flights cannot be compared.
            model.save(output)
            if model.kind.is_simulation:
                # No other kind needs the room of the search.
                from quadpi_core.discrepancy.sound_learning import learned_from

                model = learned_from(model, flights, progress).save(output)
        _print_model(console, model, verbose=verbose, choice=choice_of_kind(context))
        console.print(f"written to {output}; quadpi info {output} shows every parameter", soft_wrap=True)
        if json_file or html_file:
            groups = {"identification": [flight.name for flight in flights]}
            case = ComparisonCase(
                {model.name: model}, {cutoff: flights}, groups, confidence, left_out=left_out
            )
            write_evaluation(
                model, case, json_file, html_file, FlightFiles.from_paths(bags, [output], vehicle)
            )


def _print_model(console: Console, model: AerodynamicModel, *, verbose: bool, choice: str | None) -> None:
    """What matters first; with `verbose`, the rest as well."""
    from quadpi_core.models.alarm_limits import change_sentence
    from quadpi_core.report.evaluation_page import support_text
    from quadpi_core.report.info_tables import (
        fact_tables,
        headline_table,
        held_out_table,
        least_held_out,
        selection_table,
    )
    from quadpi_core.report.table import terminal_table

    tables = [headline_table(model)]
    if verbose:
        tables += [
            selection_table(model.selection[axis], axis) for axis in model.axes if model.selection[axis]
        ]
        tables += [*fact_tables(model), held_out_table(model)]
    for table in tables:
        if table is not None:
            console.print(terminal_table(table))
    if choice is not None:
        console.print(choice, soft_wrap=True)
    names = ", ".join(flight.name for flight in model.flights)
    console.print(f"{model.method} model {model.identity} of {model.vehicle} from {names}", soft_wrap=True)
    console.print(model.calibration(), soft_wrap=True)
    if least := least_held_out(model):
        console.print(least, soft_wrap=True)
    console.print(support_text(model.support(model.confidence)), soft_wrap=True)
    console.print(model.alarm_limits.sentence(), soft_wrap=True)
    console.print(change_sentence(model.change_limits), soft_wrap=True)
