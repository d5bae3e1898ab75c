# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

Bags = Annotated[list[Path], typer.Argument(help="Flights: MCAP bags, or any log that `import` reads.")]
ModelFolder = Annotated[Path, typer.Argument(help="Model folder, as written by `identify`.")]
VehicleName = Annotated[str, typer.Option("--vehicle", help="Vehicle in config/vehicles, or a YAML file.")]
OptionalVehicle = Annotated[
    str | None, typer.Option("--vehicle", help="Vehicle; default: the one that the bag or model names.")
]
JsonFile = Annotated[Path | None, typer.Option("--json", help="Also write the result as JSON.")]
HtmlFile = Annotated[Path | None, typer.Option("--html", help="Also write a self-contained page.")]
Adaptive = Annotated[
    bool, typer.Option("--adaptive", help="Intervals that adapt to the measured wrench as the flight goes.")
]
Confidence = Annotated[float | None, typer.Option(help="Coverage of the intervals; default: the model's.")]
ProcessCount = Annotated[int | None, typer.Option(min=1, help="Processes to use; default: one per core.")]
FileProcessCount = Annotated[
    int | None,
    typer.Option(min=1, help="Processes to use; default: this one, from 64 flights on one per core."),
]
PublishedDevice = Annotated[
    Literal["cpu", "cuda"] | None,
    typer.Option(help="That trains the ensembles, where no model is given; default: cpu."),
]
Scheduler = Annotated[
    str | None, typer.Option(help="Address of a Dask scheduler, whose workers to use instead.")
]
