# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on models: `quadpi identify`, `evaluate`, `rollout` and `validate`."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import (
    batch_of_flights,
    check_outputs,
    choice_of_kind,
    open_console,
    print_quality,
    shown_work,
    write_result,
)
from quadpi_core.errors import QuadpiError
from quadpi_core.models import kinds
from quadpi_core.plugins import names_in

if TYPE_CHECKING:
    from rich.console import Console

    from quadpi_core.evaluation.evaluate import ComparisonCase
    from quadpi_core.evaluation.evaluation_result import Evaluation
    from quadpi_core.models.aerodynamic import AerodynamicModel
    from quadpi_core.report.page import FlightFiles


def evaluate(
    paths: Annotated[
        list[Path],
        typer.Argument(help="Model folders, then flights, which together form the group `all`."),
    ],
    group: Annotated[
        list[str] | None,
        typer.Option(help="A group of flights: NAME=BAG, with commas or repeated for several bags."),
    ] = None,
    confidence: options.Confidence = None,
    adaptive: options.Adaptive = False,
    vehicle: options.OptionalVehicle = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    all_parts: options.AllParts = False,
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    workers: options.FileProcessCount = None,
    scheduler: options.Scheduler = None,
    json_file: options.JsonFile = None,
    html_file: options.HtmlFile = None,
) -> None:
    """Judge intervals on flights: coverage, width and errors of one model, or of several side by side."""
    from quadpi_core.evaluation.evaluate import given_comparison, is_model_folder
    from quadpi_core.parallel import Workers
    from quadpi_core.report.page import FlightFiles

    console = open_console()
    how = options.reading_options(
        topics, namespace, part=options.time_range(from_s, to_s), all_parts=all_parts
    )
    folders = [path for place, path in enumerate(paths) if place == 0 or is_model_folder(path)]
    members = group_bags([path for path in paths if path not in folders], group or [])
    bags = list(dict.fromkeys(path for own in members.values() for path in own))
    check_outputs([*folders, *bags], json_file, html_file)
    files = FlightFiles.from_paths(bags, folders, vehicle)
    with batch_of_flights() as left_out:
        comparison = given_comparison(
            folders,
            members,
            vehicle=vehicle,
            confidence=confidence,
            mapping=how,
            workers=Workers(workers, scheduler),
            left_out=left_out,
        )
        for name in members.keys() - comparison.groups.keys():
            console.print(f"group {name}: all its flights were left out", soft_wrap=True)
        _print_and_write(console, comparison, files, json_file, html_file, adaptive=adaptive)


def _print_and_write(
    console: Console,
    comparison: ComparisonCase,
    files: FlightFiles,
    json_file: Path | None,
    html_file: Path | None,
    *,
    adaptive: bool,
) -> None:
    from quadpi_core.evaluation.evaluate import compare
    from quadpi_core.report.comparison_page import comparison_summary, write_comparison_page
    from quadpi_core.report.evaluation_page import evaluation_summary

    judged = next(iter(comparison.flights.values()))
    print_quality(console, ((flight.name, flight.quality) for flight in judged))
    models = comparison.models
    if len(models) == 1:
        (model,) = models.values()
        evaluation = write_evaluation(model, comparison, json_file, html_file, files, adaptive=adaptive)
        console.print(evaluation_summary(evaluation))
        return
    results, compared = compare(comparison, adaptive=adaptive)
    console.print(comparison_summary(compared))
    write_result(json_file, compared.to_json())
    if html_file is not None:
        write_comparison_page(html_file, compared, results, models, files)


def group_bags(bags: list[Path], groups: list[str]) -> dict[str, list[Path]]:
    """Flights by group: positional bags form the group `all`, others come from texts NAME=BAG[,BAG…].

    Raises:
        QuadpiError: for a text without a name or bag, or without any bag.
    """
    members: dict[str, list[Path]] = {"all": list(bags)} if bags else {}
    for text in groups:
        name, _, names = text.partition("=")
        paths = names.split(",")
        if not (name and all(paths)):
            raise QuadpiError(f"--group {text}: expected NAME=BAG")
        members.setdefault(name, []).extend(Path(path) for path in paths)
    if not members:
        raise QuadpiError("no flights given: name bags, or groups of bags with --group NAME=BAG")
    return members


def write_evaluation(
    model: AerodynamicModel,
    case: ComparisonCase,
    json_file: Path | None,
    html_file: Path | None,
    files: FlightFiles | None = None,
    *,
    adaptive: bool = False,
) -> Evaluation:
    """Judge the intervals of one model of a case, and write the files that are given."""
    from quadpi_core.evaluation.evaluate import judge
    from quadpi_core.report.evaluation_page import write_evaluation_page

    flights = case.flights[model.cutoff_hz]
    results, evaluation = judge(model, flights, case.groups, case.confidence, adaptive=adaptive)
    evaluation = replace(evaluation, left_out=case.left_out)
    write_result(json_file, evaluation.to_json())
    if html_file is not None:
        write_evaluation_page(html_file, evaluation, results, model, files=files)
    return evaluation


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
    from quadpi_core.models.kind_registry import kind_of
    from quadpi_core.models.model_folder import require_replaceable
    from quadpi_core.models.model_kind import CUTOFF_HZ, IdentifyOptions
    from quadpi_core.models.regressors import load_pools, select_axes
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


def rollout(
    model: options.ModelFolder,
    bags: options.Bags,
    horizon: Annotated[float, typer.Option(help="Seconds to predict ahead.")] = 0.5,
    confidence: options.Confidence = None,
    vehicle: options.OptionalVehicle = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    json_file: options.JsonFile = None,
    html_file: options.HtmlFile = None,
) -> None:
    """Predict flights ahead, open loop by the measured rotor speeds, with tubes; from every tenth sample."""
    from quadpi_core.evaluation.evaluate import evaluate_rollouts
    from quadpi_core.models.aerodynamic import AerodynamicModel
    from quadpi_core.report.page import FlightFiles
    from quadpi_core.report.table import progress_bar, terminal_table
    from quadpi_core.report.validation_page import rollout_summary, write_rollout_page

    check_outputs([model, *bags], json_file, html_file)
    how = options.reading_options(topics, namespace, part=options.time_range(from_s, to_s))
    the_model = AerodynamicModel.load(model)
    the_vehicle = the_model.load_vehicle(vehicle)
    console = open_console()
    with batch_of_flights() as left_out:
        with progress_bar(console) as progress:
            flights, evaluation = evaluate_rollouts(
                the_model,
                bags,
                the_vehicle,
                horizon_s=horizon,
                confidence=confidence,
                mapping=how,
                progress=progress,
                left_out=left_out,
            )
        print_quality(console, evaluation.data_quality.items())
        console.print(terminal_table(rollout_summary(evaluation)))
        write_result(json_file, evaluation.to_json())
        if html_file is not None:
            files = FlightFiles.from_paths(bags, [model], vehicle)
            write_rollout_page(html_file, flights, evaluation, files)


def validate(
    paths: Annotated[list[Path], typer.Argument(help="Model folders, then bags of simulated flights.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder for finished realisations, to resume from."),
    ] = None,
    realisations: Annotated[int, typer.Option(min=1, help="Of the noise, on each flight.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all noise.")] = 0,
    noise: Annotated[str, typer.Option(help="On states: a name in config/noise, or a YAML file.")] = "paper",
    confidence: options.Confidence = None,
    vehicle: options.OptionalVehicle = None,
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    workers: options.ProcessCount = None,
    scheduler: options.Scheduler = None,
    json_file: options.JsonFile = None,
    html_file: options.HtmlFile = None,
) -> None:
    """Put noise on simulated flights a thousand times: do the intervals hold?"""
    from quadpi_core.evaluation.evaluate import is_model_folder
    from quadpi_core.parallel import Workers
    from quadpi_core.report.validation_page import validation_summary
    from quadpi_core.validation.validation_case import given_case, run_realisations
    from quadpi_core.validation.validation_result import summarise

    cache_folder = None if output is None else output / "realisations"
    check_outputs(paths, json_file, html_file, folders=[cache_folder])
    console = open_console()
    folders = [path for path in paths if is_model_folder(path)]
    bags = [path for path in paths if path not in folders]
    part = options.time_range(from_s, to_s)
    case = given_case(
        folders, bags, vehicle=vehicle, noise=noise, confidence=confidence, seed=seed, part=part
    )
    case.check()
    try:
        with shown_work(console, workers, scheduler) as counting:
            tally = run_realisations(case, realisations, folder=cache_folder, workers=counting)
    except KeyboardInterrupt as interruption:
        if output is not None:
            interruption.args = ("finished realisations are kept, and the next run resumes from them",)
        raise
    result = summarise(case, tally)
    console.print(validation_summary(result))
    write_result(json_file, result.to_json())
    if html_file is not None:
        from quadpi_core.report.validation_page import SHOWN, write_validation_page
        from quadpi_core.validation.validation_case import spread

        names = [flight.name for flight in case.flights]
        shown = partial(spread, realisations=range(SHOWN))
        spreads = Workers(workers, scheduler).map(shown, names, shared=case)
        write_validation_page(html_file, result, case, dict(zip(names, spreads, strict=True)))
