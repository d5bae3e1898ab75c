# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi validate`: do the intervals hold under noise?"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import check_outputs, open_console, shown_work, write_result
from quadpi_core.errors import QuadpiError


def validate(
    paths: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Model folders, then bags of simulated flights; none: the paper's own validation."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder for models and finished realisations, to resume from."),
    ] = None,
    realisations: Annotated[int, typer.Option(min=1, help="Of the noise, on each flight.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all noise.")] = 0,
    noise: Annotated[str, typer.Option(help="On states: a name in config/noise, or a YAML file.")] = "paper",
    settings: Annotated[
        Literal["default", "paper"] | None,
        typer.Option(help="Settings of the paper's methods, where no model is given; default: paper."),
    ] = None,
    confidence: options.Confidence = None,
    vehicle: options.OptionalVehicle = None,
    device: options.PublishedDevice = None,
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    workers: options.ProcessCount = None,
    scheduler: options.Scheduler = None,
    json_file: options.JsonFile = None,
    html_file: options.HtmlFile = None,
) -> None:
    """Put noise on simulated flights a thousand times: do the intervals hold? The paper's tables."""
    from quadpi_core.evaluation.evaluate import is_model_folder
    from quadpi_core.paper.published import published_case, published_tables
    from quadpi_core.paper.realisations import run_realisations
    from quadpi_core.paper.validation_case import given_case
    from quadpi_core.paper.validation_result import summarise
    from quadpi_core.parallel import Workers
    from quadpi_core.report.progress_bar import progress_bar
    from quadpi_core.report.validation_page import validation_summary

    kept = (None, None) if output is None else (output / "models", output / "realisations")
    check_outputs(paths or [], json_file, html_file, folders=kept)
    console = open_console()
    training: Sequence[Any] = ()
    published = None
    if paths:
        for option, value in (("--settings", settings), ("--device", device)):
            if value is not None:
                raise QuadpiError(f"{option}: only without models, for the paper's own validation")
        folders = [path for path in paths if is_model_folder(path)]
        bags = [path for path in paths if path not in folders]
        part = options.time_range(from_s, to_s)
        case = given_case(
            folders, bags, vehicle=vehicle, noise=noise, confidence=confidence, seed=seed, part=part
        )
    else:
        if from_s is not None or to_s is not None:
            raise QuadpiError("--from, --to: are parts of flights, and none is given")
        with progress_bar(console) as progress:
            own = published_case(
                settings=settings or "paper",
                noise=noise,
                confidence=0.95 if confidence is None else confidence,
                seed=seed,
                device=device or "cpu",
                folder=kept[0],
                progress=progress,
            )
        case, training, published = own.case, own.training, published_tables()
    case.check()
    try:
        with shown_work(console, workers, scheduler) as counting:
            tally = run_realisations(case, realisations, folder=kept[1], workers=counting)
    except KeyboardInterrupt as interruption:
        if output is not None:
            interruption.args = ("finished realisations are kept, and the next run resumes from them",)
        raise
    result = summarise(case, tally, training=training, published=published)
    console.print(validation_summary(result))
    write_result(json_file, result.to_json())
    if html_file is not None:
        from quadpi_core.paper.realisations import spread
        from quadpi_core.report.validation_page import SHOWN, write_validation_page

        names = [flight.name for flight in case.flights]
        shown = partial(spread, realisations=range(SHOWN))
        spreads = Workers(workers, scheduler).map(shown, names, shared=case)
        write_validation_page(html_file, result, case, dict(zip(names, spreads, strict=True)))
