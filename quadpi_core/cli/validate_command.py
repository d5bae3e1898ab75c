# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi validate`: do the intervals hold under noise?"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import check_outputs, open_console, shown_work, write_result


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
    from quadpi_core.validation.realisations import run_realisations
    from quadpi_core.validation.validation_case import given_case
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
        from quadpi_core.validation.realisations import spread

        names = [flight.name for flight in case.flights]
        shown = partial(spread, realisations=range(SHOWN))
        spreads = Workers(workers, scheduler).map(shown, names, shared=case)
        write_validation_page(html_file, result, case, dict(zip(names, spreads, strict=True)))
