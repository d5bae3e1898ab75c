# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi rollout`: flights predicted ahead, with tubes."""

from __future__ import annotations

from typing import Annotated

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import (
    batch_of_flights,
    check_outputs,
    open_console,
    print_quality,
    write_result,
)


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
    from quadpi_core.evaluation.rollouts import evaluate_rollouts
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
