# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi export`: a model, or a flight with its results, in the form of another tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from quadpi_core.cli.options import Confidence, OptionalVehicle, check_outputs, open_console
from quadpi_core.errors import QuadpiError

_SUFFIXES = {"vehicle": (".yaml", ".yml"), "rerun": (".rrd",)}


def export(
    path: Annotated[Path, typer.Argument(help="Model folder, or for rerun a flight.", metavar="MODEL|BAG")],
    output: Annotated[Path, typer.Option("-o", "--output", help="File to write.")],
    form: Annotated[
        Literal["vehicle", "rerun"],
        typer.Option(
            "--format",
            help="vehicle: a vehicle file that flies as the model; rerun: a recording of a flight and its "
            "results for the Rerun viewer.",
        ),
    ] = "vehicle",
    model: Annotated[
        list[Path] | None,
        typer.Option(
            help="rerun: model folder to judge the flight by; may be given several times, and the first "
            "gives the alarm. Without one, the results in the bag."
        ),
    ] = None,
    vehicle: OptionalVehicle = None,
    confidence: Confidence = None,
) -> None:
    """Write a model or a flight in another form: a vehicle file, or a recording for the Rerun viewer."""
    if output.suffix not in _SUFFIXES[form]:
        raise QuadpiError(f"{output}: a {form} file ends in {_SUFFIXES[form][0]}")
    if form == "vehicle":
        for name, given in (("model", model), ("vehicle", vehicle), ("confidence", confidence)):
            if given is not None:
                raise QuadpiError(f"--{name}: is for a flight; a vehicle file follows from the model alone")
        _export_vehicle(path, output)
    else:
        _export_flight(path, output, model or [], vehicle, confidence)


def _export_vehicle(model: Path, output: Path) -> None:
    from quadpi_core.simulation.vehicle_export import write_vehicle_file

    check_outputs([model], output)
    write_vehicle_file(model, output)
    open_console().print(f"{output}: flies as {model}, under the name {output.stem}", soft_wrap=True)


def _export_flight(
    bag: Path, output: Path, folders: list[Path], vehicle: str | None, confidence: float | None
) -> None:
    from quadpi_core.models.aerodynamic import AerodynamicModel
    from quadpi_core.view.bag_view import flight_parts
    from quadpi_core.view.rerun_recording import write_rerun_file

    check_outputs([bag, *folders], output)
    models = [AerodynamicModel.load(folder) for folder in folders]
    for name, given in (("vehicle", vehicle), ("confidence", confidence)):
        if given is not None and not models:
            raise QuadpiError(f"--{name}: is that of the models, and there is no --model")
    the_vehicle = models[0].load_vehicle(vehicle) if models else None
    command = f"quadpi export {bag} --format rerun -o {output}"
    parts = flight_parts(bag, models, the_vehicle, confidence, command)
    write_rerun_file(parts, output, {model.identity: model.described() for model in models})
    open_console().print(f"{output}: open it with: rerun {output}", soft_wrap=True)
