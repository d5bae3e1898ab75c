# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi export`: a model, or a flight with its results, in the form of another tool."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import (
    SOME_LEFT_OUT,
    Confidence,
    Mapping,
    OptionalVehicle,
    check_outputs,
    open_console,
    print_left_out,
)
from quadpi_core.errors import QuadpiError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quadpi_core.flight_files import FlightLeftOut
    from quadpi_core.reading_options import ReadingOptions

# Forms of a model, and of a flight; their files end so.
_MODELS = {
    "px4": (".params",),
    "ardupilot": (".parm", ".param"),
    "sdf": (".sdf",),
    "mjcf": (".xml",),
    "json": (".json",),
}
_SUFFIXES = {
    "vehicle": (".yaml", ".yml"),
    "rerun": (".rrd",),
    "flight": (".csv", ".parquet"),
    **_MODELS,
}
# Options beside the output that each form takes.
_TAKES = {
    **dict.fromkeys(("px4", "ardupilot", "json"), ("log",)),
    **dict.fromkeys(("sdf", "mjcf"), ()),
    "vehicle": (),
    "rerun": ("model", "vehicle", "confidence", "rate", "topics", "namespace", "from", "to"),
    "flight": ("vehicle", "mapping", "topics", "namespace", "from", "to"),
}


def export(
    path: Annotated[
        Path, typer.Argument(help="Model folder, or for rerun and flight a flight.", metavar="MODEL|BAG")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="File to write.")],
    form: Annotated[
        Literal["vehicle", "px4", "ardupilot", "sdf", "mjcf", "json", "rerun", "flight"],
        typer.Option(
            "--format",
            help="vehicle: a vehicle file that flies as the model; px4 and ardupilot: parameters (.params, "
            ".parm); sdf, mjcf: a model for Gazebo or MuJoCo (.sdf, .xml); json: the same numbers; each with "
            "its 95 % interval. rerun: a recording of a flight and its results for the Rerun viewer; flight: "
            "the smoothed flight as a table (.csv, .parquet), on which a simulator can be run.",
        ),
    ] = "vehicle",
    log: Annotated[
        list[Path] | None,
        typer.Option(
            help="px4, ardupilot, json: a log of the vehicle as it is, for the thrust of hover and the curve "
            "of thrust over command; may be given several times."
        ),
    ] = None,
    model: Annotated[
        list[Path] | None,
        typer.Option(
            help="rerun: model folder to judge the flight by; may be given several times, and the first "
            "gives the alarm. Without one, the results in the bag."
        ),
    ] = None,
    vehicle: OptionalVehicle = None,
    confidence: Confidence = None,
    mapping: Mapping = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    rate: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            metavar="HZ",
            help="rerun: rows a second of each series at most; the least and the largest value between them "
            "are kept. Default 50; the rate of the flight or more keeps every sample.",
        ),
    ] = None,
) -> None:
    """Write a model or a flight in another form: a vehicle file, a recording for Rerun, or a table."""
    if output.suffix not in _SUFFIXES[form]:
        raise QuadpiError(f"{output}: a file of the form {form} ends in {' or '.join(_SUFFIXES[form])}")
    given: dict[str, object] = {
        "log": log,
        "model": model,
        "vehicle": vehicle,
        "confidence": confidence,
        "mapping": mapping,
        "rate": rate,
    }
    given |= {"topics": topics, "namespace": namespace or None, "from": from_s, "to": to_s}
    for name, value in given.items():
        if value is not None and name not in _TAKES[form]:
            raise QuadpiError(f"--{name}: is not for --format {form}")
    how = options.reading_options(topics, namespace, mapping, part=options.time_range(from_s, to_s))
    if form == "vehicle":
        _export_vehicle(path, output)
    elif form in _MODELS:
        _export_parameters(path, output, form, log or [])
    elif form == "rerun":
        _export_recording(path, output, model or [], vehicle, confidence, rate, how)
    else:
        _export_flight(path, output, vehicle, how)


def _export_vehicle(model: Path, output: Path) -> None:
    from quadpi_core.simulation.simulated_file import write_vehicle_file

    check_outputs([model], output)
    write_vehicle_file(model, output)
    open_console().print(f"{output}: flies as {model}, under the name {output.stem}", soft_wrap=True)


def _export_parameters(folder: Path, output: Path, form: str, logs: list[Path]) -> None:
    from quadpi_core.field.field_report import report_on
    from quadpi_core.field.thrust_curve import thrust_curve, untold_curve
    from quadpi_core.models.aerodynamic import AerodynamicModel
    from quadpi_core.models.small_model import small_model
    from quadpi_core.paths import whole_output
    from quadpi_core.reading_options import ReadingOptions
    from quadpi_core.simulation.simulated_file import (
        Exported,
        estimates_of,
        exported_text,
        motor_time_constant,
    )

    check_outputs([folder, *logs], output)
    model = AerodynamicModel.load(folder)
    vehicle = model.load_vehicle()
    curve = untold_curve("the model knows rotor speeds alone: give a log with commands (--log)")
    left_out: Sequence[FlightLeftOut] = ()
    if logs:
        report = report_on(logs, ReadingOptions())
        left_out = report.left_out
        if len(report.vehicles) > 1:
            raise QuadpiError(f"the logs are of {len(report.vehicles)} vehicles; give those of one")
        curve = thrust_curve([(flight.log, flight.use) for flight in report.flights])
    exported = Exported(small_model(model, vehicle), curve, motor_time_constant(vehicle))
    text = exported_text(form, exported)
    with whole_output(output) as temporary:
        temporary.write_text(text, encoding="utf-8")
    console = open_console()
    for name, one in estimates_of(exported).items():
        if one.value is None:
            console.print(f"{name}: {one.reason}", soft_wrap=True)
    console.print(f"{output}: {form} of {folder}", soft_wrap=True)
    print_left_out(left_out)
    if left_out:
        raise typer.Exit(SOME_LEFT_OUT)


def _export_recording(
    bag: Path,
    output: Path,
    folders: list[Path],
    vehicle: str | None,
    confidence: float | None,
    rate: float | None,
    how: ReadingOptions,
) -> None:
    from quadpi_core.models.aerodynamic import AerodynamicModel
    from quadpi_core.view.flight_parts import flight_parts
    from quadpi_core.view.rerun_recording import RATE_HZ, write_rerun_file

    check_outputs([bag, *folders], output)
    models = [AerodynamicModel.load(folder) for folder in folders]
    for name, given in (("vehicle", vehicle), ("confidence", confidence)):
        if given is not None and not models:
            raise QuadpiError(f"--{name}: is that of the models, and there is no --model")
    if (how.topics or how.namespace) and not models:
        raise QuadpiError("--topics, --namespace: are of a flight that --model judges")
    the_vehicle = models[0].load_vehicle(vehicle) if models else None
    command = f"quadpi export {bag} --format rerun -o {output}"
    parts = flight_parts(bag, models, the_vehicle, confidence, command, how)
    known = {model.identity: model.described() for model in models}
    missing = write_rerun_file(parts, output, known, RATE_HZ if rate is None else rate)
    for topic, what in missing:
        open_console().print(f"{bag}: {topic}: {what}", soft_wrap=True)
    open_console().print(f"{output}: open it with: rerun {output}", soft_wrap=True)


def _export_flight(path: Path, output: Path, vehicle: str | None, how: ReadingOptions) -> None:
    from quadpi_core.cli.options import print_quality
    from quadpi_core.identification.prepared_flights import read_flight
    from quadpi_core.logs import identify_format
    from quadpi_core.logs.flight_table import write_flight_table
    from quadpi_core.models.model_kind import CUTOFF_HZ
    from quadpi_core.signals.wrench import measured_wrench
    from quadpi_core.vehicle import Vehicle

    check_outputs([path], output)
    container = identify_format(path).container
    name = vehicle or (container.vehicle_name(path) if container else "")
    if not name:
        raise QuadpiError(f"{path}: names no vehicle; state the one that flew (--vehicle)")
    flown = Vehicle.load(name)
    flight = read_flight(path, flown, CUTOFF_HZ["default"], how)
    write_flight_table(output, flight, measured_wrench(flight, flown))
    console = open_console()
    print_quality(console, [(path, flight.quality)])
    console.print(f"{output}: {len(flight)} samples of {flight.name}, vehicle {flown.name}", soft_wrap=True)
