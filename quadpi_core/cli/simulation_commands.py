# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on simulations: `quadpi simulate`, `discrepancy`, `export` and `demo`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import (
    SOME_LEFT_OUT,
    Confidence,
    HtmlFile,
    JsonFile,
    Mapping,
    OptionalVehicle,
    batch_of_flights,
    check_outputs,
    open_console,
    print_left_out,
    print_quality,
    shown_work,
    write_result,
)
from quadpi_core.errors import QuadpiError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quadpi_core.flight_files import FlightLeftOut
    from quadpi_core.reading_options import ReadingOptions


def _print_catalogue(wanted: bool) -> None:
    if wanted:
        from quadpi_core.report.simulation_page import catalogue_tables
        from quadpi_core.report.table import terminal_table

        console = open_console()
        for table in catalogue_tables():
            console.print(terminal_table(table))
        raise typer.Exit


def simulate(
    scenario: Annotated[str, typer.Argument(help="Scenario in config/scenarios, or a YAML file.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the bags.")],
    flight: Annotated[
        list[str] | None, typer.Option(help="Only this flight of the scenario; may be repeated.")
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Vehicle in config/vehicles, a YAML file, or the folder of a physical model; default: the "
            "scenario's."
        ),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            help="Sensors in config/noise, a YAML file, or the folder of a model: those of its vehicle; "
            "default: the scenario's."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of noise and gusts; default: the scenario's.")
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(help="Switch on an effect: NAME, or NAME:PARAMETER=VALUE[,…]; may be repeated."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Flights at a time; default: one per core.")
    ] = None,
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
    _list: Annotated[
        bool,
        typer.Option("--list", callback=_print_catalogue, is_eager=True, help="Show scenarios and effects."),
    ] = False,
) -> None:
    """Fly a scenario: a bag per flight, with its truth on /truth/…."""
    from quadpi_core.config_schema import is_config_path
    from quadpi_core.parallel import Workers
    from quadpi_core.report.simulation_page import (
        excursion_sentences,
        flight_json,
        flight_table,
        summarise,
        write_simulation_page,
    )
    from quadpi_core.report.table import progress_bar, terminal_table
    from quadpi_core.simulation.scenario import choose_flights, load_scenario, parse_effects
    from quadpi_core.simulation.simulated_bags import simulate as fly
    from quadpi_core.simulation.simulated_file import model_folder

    the_scenario = load_scenario(scenario)
    plans = choose_flights(
        the_scenario,
        flight or (),
        vehicle=vehicle,
        noise=noise,
        seed=seed,
        effects=parse_effects(effect or ()),
    )
    given = [Path(name) for name in (scenario, vehicle, noise) if name]
    files = [path for path in given if is_config_path(path) or model_folder(path) is not None]
    check_outputs(files, *(output / f"{plan.name}.mcap" for plan in plans), json_file, html_file)
    console = open_console()
    with progress_bar(console) as progress:
        flights = fly(plans, output, workers=Workers(workers, progress=progress))
    summaries = [summarise(flown.plan, flown.truth) for flown in flights]
    bags = [flown.bag for flown in flights]
    console.print(terminal_table(flight_table(summaries, bags)))
    for sentence in excursion_sentences(flown.truth for flown in flights):
        console.print(sentence, soft_wrap=True)
    write_result(json_file, flight_json(the_scenario.name, summaries, bags))
    if html_file is not None:
        write_simulation_page(html_file, [(flown.plan, flown.truth) for flown in flights])


DATA, PAGE = "discrepancy.json", "discrepancy.html"


def discrepancy(
    simulation: Annotated[
        str,
        typer.Argument(
            help="What to compare with: a vehicle that can be simulated (name or file), a model folder, "
            "module:function, `recorded` for a wrench in the bags, or the addition.json of an earlier run."
        ),
    ],
    bags: options.Bags,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")],
    effects: Annotated[
        str | None, typer.Option(help="Effects to look for, such as wind,payload; default: all.")
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option(help="Vehicle, where the simulation does not name one.")
    ] = None,
    mapping: options.Mapping = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    from_commands: options.FromCommands = False,
    allow_code: Annotated[
        bool,
        typer.Option("--allow-code", help="Run the function that an addition.json names; trust its author."),
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draws that ranges are tested with.")] = 0,
    workers: options.FileProcessCount = None,
    scheduler: options.Scheduler = None,
    json_file: options.JsonFile = None,
    html_file: options.HtmlFile = None,
) -> None:
    """Find where a simulation and flights disagree, name the missing effect, add it, show the gap shrink."""
    from quadpi_core.discrepancy.augmented_simulation import write_addition
    from quadpi_core.discrepancy.discrepancy_result import study_json
    from quadpi_core.discrepancy.loading import load_simulation
    from quadpi_core.discrepancy.study import read_flights, study
    from quadpi_core.paths import whole_outputs, write_json
    from quadpi_core.report.discrepancy_evidence import write_formulas
    from quadpi_core.report.discrepancy_page import discrepancy_summary, write_discrepancy_page
    from quadpi_core.report.page import FlightFiles
    from quadpi_core.simulation.simulated_file import model_folder

    inputs = [*bags, *(path for path in (Path(simulation),) if path.exists())]
    check_outputs(inputs, json_file, html_file, folders=[output])
    console = open_console()
    how = options.reading_options(topics, namespace, mapping, part=options.time_range(from_s, to_s))
    names = None if effects is None else effects.split(",")
    with batch_of_flights() as left_out:
        the_simulation = load_simulation(
            simulation, vehicle, bags, mapping=how, allow_code=allow_code, left_out=left_out
        )
        with shown_work(console, workers, scheduler) as reading:
            flights = read_flights(
                bags,
                the_simulation,
                mapping=how,
                workers=reading,
                left_out=left_out,
                from_commands=from_commands,
            )
        print_quality(console, ((flight.name, flight.quality) for flight in flights))
        with console.status("Searching"):
            result = study(the_simulation, flights, names=names, seed=seed)
        data = {**study_json(result), "left_out": list(map(asdict, left_out))}
        for name, flight in data["flights"].items():
            if count := flight["unjudged_samples"]:
                console.print(
                    f"{name}: {count} samples left out, which the simulation cannot judge", soft_wrap=True
                )
            if flight["in_sample"]:
                console.print(f"{name}: the simulation was identified on this flight", soft_wrap=True)
        # A simulation that is no model cannot judge: who looks at a moment names a model.
        files = FlightFiles.from_paths(bags, [model_folder(simulation) or Path("MODEL")], vehicle)
        with whole_outputs(output) as staging, console.status("Writing"):
            addition = write_addition(result.discovery, staging)
            written = [addition, *write_formulas(result.discovery.effects, staging)] if addition else []
            data["files"] = added = [file.name for file in written]
            write_json(staging / DATA, data)
            write_discrepancy_page(staging / PAGE, result, files, left_out)
            if json_file is not None:
                write_json(json_file, data)
            if html_file is not None:
                write_discrepancy_page(html_file, result, files, left_out)
        console.print(discrepancy_summary(result))
        console.print(f"{output}: {', '.join([PAGE, DATA, *added])}", soft_wrap=True)


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
    from quadpi_core.field.motor_use import thrust_curve, untold_curve
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


def demo(
    data: Annotated[
        Path | None,
        typer.Option(envvar="QUADPI_DATA", help="Folder of real flights; default: the bundled ones."),
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for all that the demo makes.")
    ] = Path("out/demo"),
    rate: Annotated[float, typer.Option(help="Speed of the live replay; 1 is real time.")] = 1.0,
    view: Annotated[
        bool, typer.Option(help="Serve the live part as a page; it opens where there is a display.")
    ] = True,
) -> None:
    """Run the whole story: identify, evaluate, replay a flight through the live nodes, report."""
    try:
        # The one place where the command line reaches for ROS: the demo starts the live nodes.
        from quadpi_ros.demo import run_demo
    except ModuleNotFoundError as error:
        raise QuadpiError(f"the demo needs ROS 2 for its live nodes ({error}): run `make demo`") from error

    run_demo(data, output, rate, open_console(), view)
