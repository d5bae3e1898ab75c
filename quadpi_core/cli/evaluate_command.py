# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi evaluate`: one model on flights, or several side by side."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import (
    batch_of_flights,
    check_outputs,
    open_console,
    print_quality,
    write_result,
)
from quadpi_core.errors import QuadpiError

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
