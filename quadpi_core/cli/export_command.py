# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi export`: a model in the form of another tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from quadpi_core.cli.options import ModelFolder, check_outputs, open_console


def export(
    model: ModelFolder,
    output: Annotated[Path, typer.Option("-o", "--output", help="File to write.")],
    form: Annotated[
        Literal["vehicle"], typer.Option("--format", help="vehicle: a vehicle file that flies as the model.")
    ] = "vehicle",
) -> None:
    """Write a model in another form, such as a vehicle file that `simulate` and `discrepancy` take."""
    from quadpi_core.errors import QuadpiError
    from quadpi_core.simulation.vehicle_export import write_vehicle_file

    if output.suffix not in (".yaml", ".yml"):
        raise QuadpiError(f"{output}: a {form} file ends in .yaml")
    check_outputs([model], output)
    write_vehicle_file(model, output)
    open_console().print(f"{output}: flies as {model}, under the name {output.stem}", soft_wrap=True)
