# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The command line `quadpi`. Known errors print one line and exit with status 2.

Each command imports what it needs when it runs, so that `--help` answers at once.
"""

from __future__ import annotations

import logging
import signal
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperGroup

from quadpi_core import __version__
from quadpi_core.errors import QuadpiError

if TYPE_CHECKING:
    from rich.console import Console


class _Commands(TyperGroup):
    """Says in one line that a command was interrupted, before click makes something of it."""

    def invoke(self, ctx: Any) -> Any:
        """See click.Group."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interruption:
            print(f"quadpi: interrupted; {str(interruption) or 'nothing is half written'}", file=sys.stderr)
            # What a shell gives for SIGTERM and SIGINT.
            raise typer.Exit(143 if isinstance(interruption, _Terminated) else 130) from None


class _Terminated(KeyboardInterrupt):
    """SIGTERM: what is half done is cleared away as on Ctrl-C."""


app = typer.Typer(
    cls=_Commands,
    help="How far can an aerodynamic model of a quadrotor be trusted?",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

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
Workers = Annotated[int | None, typer.Option(min=1, help="Processes to use; default: one per core.")]
FileWorkers = Annotated[
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


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"quadpi {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """How far can an aerodynamic model of a quadrotor be trusted?"""


@app.command("import")
def import_(
    logs: Annotated[
        list[Path],
        typer.Argument(help="Logs of any known format, tables or bags: docs/import-logs.md lists them."),
    ],
    vehicle: VehicleName,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the bags.")],
    mapping: Annotated[
        str | None,
        typer.Option(
            help="What columns or messages of others are, or an autopilot's rotor order: a name in "
            "config/mappings (tables, autopilots) or config/adapters (bags), or a file."
        ),
    ] = None,
    align: Annotated[
        bool, typer.Option("--align", help="Shift motion capture in time so that its turns match the gyro.")
    ] = False,
    workers: FileWorkers = None,
    scheduler: Scheduler = None,
) -> None:
    """Convert flight logs to MCAP bags with the standard topics."""
    from quadpi_core.logs.importing import import_logs
    from quadpi_core.report.progress import counting
    from quadpi_core.vehicle import Vehicle

    _check_outputs(logs, folders=[output])
    console = _console()
    the_vehicle = Vehicle.load(vehicle)
    with counting(console, "Logs", len(logs)) as progress:
        bags = import_logs(
            logs,
            the_vehicle,
            output,
            mapping,
            align=align,
            workers=workers,
            scheduler=scheduler,
            progress=progress,
        )
    for bag, imu_samples, topics, alignment, missing in bags:
        console.print(f"{bag}: {imu_samples} IMU samples; topics {', '.join(topics)}", soft_wrap=True)
        if alignment is not None:
            console.print(
                f"  mocap/pose moved by {alignment.offset_s * 1e3:+.1f} ms, correlation with the gyro "
                f"{alignment.correlation:.3f} over {alignment.matches} samples"
            )
        for sentence in missing:
            console.print(f"  {sentence}", soft_wrap=True)


@app.command()
def info(
    path: Annotated[Path, typer.Argument(help="A log, a bag or a model folder.")],
    vehicle: OptionalVehicle = None,
    mapping: Annotated[
        str | None, typer.Option(help="Mapping for a table or bag, as `import` takes it.")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Show what a log, bag or model holds: topics, rates, gaps, envelope, suspicious sensors."""
    from quadpi_core.report.info import describe

    _check_outputs([path], json_file)
    tables, data = describe(path, vehicle, mapping)
    console = _console()
    for table in tables:
        console.print(table)
    _write_json(json_file, data)


@app.command()
def identify(
    bags: Bags,
    vehicle: VehicleName,
    output: Annotated[Path, typer.Option("-o", "--output", help="Model folder to write.")],
    method: Annotated[
        Literal["polynomial", "bootstrap", "quality-driven"], typer.Option(help="Kind of model.")
    ] = "polynomial",
    candidates: Annotated[
        str, typer.Option(help="Candidate pools: a name in config/candidates, or a YAML file.")
    ] = "quadrotor",
    axes: Annotated[
        str | None, typer.Option(help="Axes to identify, such as Fx,Fz,My; default: all.")
    ] = None,
    settings: Annotated[
        Literal["default", "paper"], typer.Option(help="Calibrated on held-out flights, or as in the paper.")
    ] = "default",
    stop: Annotated[
        Literal["pse", "r2", "bic", "leave-one-flight-out"] | None,
        typer.Option(help="When to stop adding terms; default: the settings' rule."),
    ] = None,
    cutoff_hz: Annotated[
        float | None, typer.Option(help="Cut-off of the low-pass over all signals; default: 30, paper: 100.")
    ] = None,
    confidence: Annotated[float, typer.Option(help="Coverage of the intervals.")] = 0.95,
    false_alarms_per_hour: Annotated[
        float, typer.Option(help="Rate that the limits of the alarm are calibrated to.")
    ] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the networks of an ensemble.")] = 0,
    device: Annotated[
        Literal["cpu", "cuda"], typer.Option(help="That trains an ensemble; flying needs none.")
    ] = "cpu",
    workers: FileWorkers = None,
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
) -> None:
    """Identify a model on flights; every flight calibrates the intervals while it is left out."""
    from quadpi_core.identification import CUTOFF_HZ, prepare_flights, require_options
    from quadpi_core.identification import identify as identify_model
    from quadpi_core.models.pool import load_pools, select_axes
    from quadpi_core.models.storage import require_replaceable
    from quadpi_core.report.progress import counting, identifying
    from quadpi_core.report.tables import held_out_table, selection_table
    from quadpi_core.vehicle import Vehicle

    _check_outputs(bags, json_file, html_file, folders=[output])
    require_replaceable(output)
    console = _console()
    cutoff = CUTOFF_HZ[settings] if cutoff_hz is None else cutoff_hz
    the_vehicle = Vehicle.load(vehicle)
    pools = select_axes(load_pools(candidates), axes)
    require_options(pools, method=method, settings=settings, stop=stop, confidence=confidence, device=device)
    with counting(console, "Reading flights", len(bags)) as read:
        flights = prepare_flights(
            bags, the_vehicle, cutoff, workers=workers, scheduler=scheduler, progress=read
        )
    with identifying(console) as progress:
        model = identify_model(
            flights,
            the_vehicle,
            pools,
            cutoff_hz=cutoff,
            method=method,
            settings=settings,
            stop=stop,
            confidence=confidence,
            seed=seed,
            device=device,
            false_alarms_per_hour=false_alarms_per_hour,
            progress=progress,
        ).save(output)
    for axis in model.axes:
        if model.selection[axis]:
            console.print(selection_table(model.selection[axis], axis))
    names = ", ".join(flight.name for flight in model.flights)
    console.print(
        f"{method} model {model.identity} of {model.vehicle} from {names}: {output}", soft_wrap=True
    )
    console.print(model.calibration(), soft_wrap=True)
    console.print(model.alarm_limits.sentence(), soft_wrap=True)
    if held_out := held_out_table(model):
        console.print(held_out)
    if json_file or html_file:
        groups = {"identification": [flight.name for flight in flights]}
        _report(model, flights, groups, confidence, json_file, html_file)


@app.command()
def evaluate(
    paths: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Model folders, then flights, which together form the group `all`; none: the paper's own "
            "table, of simulated flights in a wind tunnel."
        ),
    ] = None,
    group: Annotated[
        list[str] | None,
        typer.Option(help="A group of flights: NAME=BAG, with commas or repeated for several bags."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder for the paper's bags and models, to go on from."),
    ] = None,
    confidence: Confidence = None,
    adaptive: Adaptive = False,
    vehicle: OptionalVehicle = None,
    device: PublishedDevice = None,
    workers: FileWorkers = None,
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
) -> None:
    """Judge intervals on flights: coverage, width and errors of one model, or of several side by side."""
    from quadpi_core.comparison import compare, given_comparison, is_model_folder
    from quadpi_core.report.comparison import comparison_table, write_comparison_page
    from quadpi_core.report.tables import evaluation_table

    console = _console()
    if paths or group:
        if output is not None:
            raise QuadpiError(
                "-o: keeps what the paper's table is made from, where no model and flight is given"
            )
        if device is not None:
            raise QuadpiError("--device: trains for the paper's table, where no model and flight is given")
        if not paths:
            raise QuadpiError(
                "no model given: name model folders first, or nothing at all for the paper's table"
            )
        folders = [path for place, path in enumerate(paths) if place == 0 or is_model_folder(path)]
        members = group_bags([path for path in paths if path not in folders], group or [])
        _check_outputs(
            [*folders, *(path for bags in members.values() for path in bags)], json_file, html_file
        )
        comparison = given_comparison(
            folders, members, vehicle=vehicle, confidence=confidence, workers=workers, scheduler=scheduler
        )
    else:
        from quadpi_core.validation.windtunnel import wind_tunnel

        if vehicle is not None:
            raise QuadpiError(
                "--vehicle: the paper's table is of the HDBeetle; of others name models and flights"
            )
        kept = (None, None) if output is None else (output / "bags", output / "models")
        _check_outputs([], json_file, html_file, folders=kept)
        with console.status("") as status:
            comparison = wind_tunnel(
                confidence=0.95 if confidence is None else confidence,
                device=device or "cpu",
                folder=output,
                workers=workers,
                scheduler=scheduler,
                progress=status.update,
            )
    models = comparison.models
    if len(models) == 1:
        (model,) = models.values()
        flights, level = comparison.flights[model.cutoff_hz], comparison.confidence
        evaluation = _report(
            model, flights, comparison.groups, level, json_file, html_file, adaptive=adaptive
        )
        console.print(evaluation_table(evaluation))
        return
    results, compared = compare(comparison, adaptive=adaptive)
    console.print(comparison_table(compared))
    _write_json(json_file, compared)
    if html_file is not None:
        write_comparison_page(html_file, compared, results, models)


@app.command()
def replay(
    model: ModelFolder,
    bags: Bags,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Bag to write; for several flights, a folder for theirs.")
    ],
    confidence: Confidence = None,
    adaptive: Adaptive = False,
    vehicle: OptionalVehicle = None,
    workers: FileWorkers = None,
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
) -> None:
    """Write the bag that the live nodes would have published for a flight; the same bytes each time."""
    from dataclasses import asdict

    from quadpi_core.models import AerodynamicModel
    from quadpi_core.monitor import MonitorSettings
    from quadpi_core.monitor.replay import replay as replay_bag
    from quadpi_core.monitor.replay import replay_all, replay_outputs
    from quadpi_core.report.progress import counting
    from quadpi_core.vehicle import Vehicle

    several = len(bags) > 1
    _check_outputs([model, *bags], *(replay_outputs(bags, output) if several else [output]), json_file)
    the_model = AerodynamicModel.load(model)
    the_vehicle = Vehicle.load(vehicle or the_model.vehicle)
    the_model.require(the_vehicle)
    settings = MonitorSettings(adaptive=adaptive)
    console = _console()
    if several:
        with counting(console, "Flights", len(bags)) as progress:
            replayed = replay_all(
                the_model,
                the_vehicle,
                bags,
                output,
                confidence=confidence,
                settings=settings,
                workers=workers,
                scheduler=scheduler,
                progress=progress,
            )
        summary = {"flights": {name: asdict(flight) for name, flight in replayed.items()}}
    else:
        summary = asdict(
            replay_bag(the_model, the_vehicle, bags[0], output, confidence=confidence, settings=settings)
        )
    console.print_json(data=summary)
    _write_json(json_file, summary)


def _print_catalogue(wanted: bool) -> None:
    if wanted:
        from quadpi_core.report.catalogue import catalogue

        console = _console()
        for table in catalogue():
            console.print(table)
        raise typer.Exit


@app.command()
def simulate(
    scenario: Annotated[str, typer.Argument(help="Scenario in config/scenarios, or a YAML file.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the bags.")],
    flight: Annotated[
        list[str] | None, typer.Option(help="Only this flight of the scenario; may be repeated.")
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option(help="Vehicle in config/vehicles, or a YAML file; default: the scenario's.")
    ] = None,
    noise: Annotated[
        str | None, typer.Option(help="Sensors in config/noise, or a YAML file; default: the scenario's.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Other noise and gusts; default: the scenario's seed.")
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
    """Fly a scenario in the rotor-local simulation: a bag per flight, with its truth on /truth/…."""
    from quadpi_core.config import is_config_path
    from quadpi_core.report.flights import flight_json, flight_table, summarise
    from quadpi_core.report.progress import flying
    from quadpi_core.simulation.choice import choose_flights, parse_effects
    from quadpi_core.simulation.run import simulate as fly
    from quadpi_core.simulation.scenario import load_scenario

    the_scenario = load_scenario(scenario)
    plans = choose_flights(
        the_scenario,
        flight or (),
        vehicle=vehicle,
        noise=noise,
        seed=seed,
        effects=parse_effects(effect or ()),
    )
    files = [Path(name) for name in (scenario, vehicle, noise) if name and is_config_path(name)]
    _check_outputs(files, *(output / f"{plan.name}.mcap" for plan in plans), json_file, html_file)
    console = _console()
    with flying(console, {plan.name: plan.duration_s for plan in plans}) as progress:
        flights = fly(plans, output, workers=workers, progress=progress)
    summaries = [summarise(flown.plan, flown.truth) for flown in flights]
    bags = [flown.bag for flown in flights]
    console.print(flight_table(summaries, bags))
    _write_json(json_file, flight_json(the_scenario.name, summaries, bags))
    if html_file is not None:
        from quadpi_core.report.simulation import write_simulation_page

        write_simulation_page(html_file, [(flown.plan, flown.truth) for flown in flights])


@app.command()
def validate(
    paths: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Model folders, then bags of simulated flights; none: the paper's own validation."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder for models and finished realisations, to go on from."),
    ] = None,
    realisations: Annotated[int, typer.Option(min=1, help="Of the noise on each flight.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Of all noise.")] = 0,
    noise: Annotated[str, typer.Option(help="Noise on states, in config/noise, or a YAML file.")] = "paper",
    settings: Annotated[
        Literal["default", "paper"] | None,
        typer.Option(help="Of the paper's methods, where no model is given; default: paper."),
    ] = None,
    confidence: Confidence = None,
    vehicle: OptionalVehicle = None,
    device: PublishedDevice = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
) -> None:
    """Put noise on simulated flights a thousand times: do the intervals hold? The paper's tables."""
    from quadpi_core.comparison import is_model_folder
    from quadpi_core.report.progress import counting
    from quadpi_core.report.validation import validation_tables
    from quadpi_core.validation.chunks import run_realisations
    from quadpi_core.validation.given import given_case
    from quadpi_core.validation.published import published_case, published_tables
    from quadpi_core.validation.result import summarise

    kept = (None, None) if output is None else (output / "models", output / "realisations")
    _check_outputs(paths or [], json_file, html_file, folders=kept)
    console = _console()
    training: Sequence[Any] = ()
    published = None
    if paths:
        for option, value in (("--settings", settings), ("--device", device)):
            if value is not None:
                raise QuadpiError(f"{option}: is for the paper's own validation, where no model is given")
        folders = [path for path in paths if is_model_folder(path)]
        bags = [path for path in paths if path not in folders]
        case = given_case(folders, bags, vehicle=vehicle, noise=noise, confidence=confidence, seed=seed)
    else:
        with console.status("") as status:
            own = published_case(
                settings=settings or "paper",
                noise=noise,
                confidence=0.95 if confidence is None else confidence,
                seed=seed,
                device=device or "cpu",
                folder=kept[0],
                progress=status.update,
            )
        case, training, published = own.case, own.training, published_tables()
    case.check()
    try:
        with counting(console, "Realisations", realisations) as progress:
            tally = run_realisations(
                case, realisations, folder=kept[1], workers=workers, scheduler=scheduler, progress=progress
            )
    except KeyboardInterrupt as interruption:
        if output is not None:
            interruption.args = ("what is finished is kept, and the next run goes on from there",)
        raise
    result = summarise(case, tally, training=training, published=published)
    console.print(validation_tables(result))
    _write_json(json_file, result)
    if html_file is not None:
        from quadpi_core.parallel import map_tasks
        from quadpi_core.report.bands import SHOWN
        from quadpi_core.report.validation import write_validation_page
        from quadpi_core.validation.realisations import spread

        names = [flight.name for flight in case.flights]
        spreads = map_tasks(
            partial(spread, realisations=range(SHOWN)),
            names,
            shared=case,
            workers=workers,
            scheduler=scheduler,
        )
        write_validation_page(html_file, result, case, dict(zip(names, spreads, strict=True)))


@app.command()
def discrepancy(
    simulation: Annotated[
        str,
        typer.Argument(
            help="What to compare with: a vehicle that can be simulated (name or file), a model folder, "
            "module:function, `recorded` for a wrench in the bags, or the addition.json of an earlier run."
        ),
    ],
    bags: Bags,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for what was found.")],
    effects: Annotated[
        str | None, typer.Option(help="Effects to look for, such as wind,payload; default: all.")
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option(help="Vehicle, where the simulation does not name one.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the draws that thresholds come from.")] = 0,
    workers: FileWorkers = None,
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
) -> None:
    """Find where a simulation and flights disagree, name the missing effect, add it, show the gap shrink."""
    from quadpi_core.discrepancy.command import run

    inputs = [*bags, *(path for path in (Path(simulation),) if path.exists())]
    _check_outputs(inputs, json_file, html_file, folders=[output])
    run(
        _console(),
        simulation,
        bags,
        output,
        vehicle=vehicle,
        names=None if effects is None else effects.split(","),
        seed=seed,
        json_file=json_file,
        html_file=html_file,
        workers=workers,
        scheduler=scheduler,
    )


@app.command()
def demo(
    data: Annotated[
        Path | None,
        typer.Option(envvar="QUADPI_DATA", help="Folder of real flights; default: the bundled ones."),
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for all that the demo makes.")
    ] = Path("out/demo"),
    rate: Annotated[float, typer.Option(help="Speed of the live replay; 1 is real time.")] = 1.0,
) -> None:
    """Run the whole story: identify, evaluate, replay a flight through the live nodes, report."""
    try:
        # The one place where the command line reaches for ROS: the demo starts the live nodes.
        from quadpi_ros.demo import run_demo
    except ModuleNotFoundError as error:
        raise QuadpiError(f"the demo needs ROS 2 for its live nodes ({error}): run `make demo`") from error

    run_demo(data, output, rate, _console())


def group_bags(bags: list[Path], groups: list[str]) -> dict[str, list[Path]]:
    """Flights by group, from the positional bags (group `all`) and the texts NAME=BAG[,BAG…].

    Raises:
        QuadpiError: for a text without a name or bag, and where no bag is given at all.
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


def _report(
    model: Any,
    flights: Sequence[Any],
    groups: Mapping[str, Sequence[str]],
    confidence: float,
    json_file: Path | None,
    html_file: Path | None,
    *,
    adaptive: bool = False,
) -> dict[str, Any]:
    from quadpi_core.identification import judge
    from quadpi_core.report.html import write_report

    results, evaluation = judge(model, flights, groups, confidence, adaptive=adaptive)
    _write_json(json_file, evaluation)
    if html_file is not None:
        write_report(html_file, evaluation, results, model)
    return evaluation


def _check_outputs(inputs: Sequence[Path], *files: Path | None, folders: Sequence[Path | None] = ()) -> None:
    """Refuse what cannot be written, and an output in the place of an input or another output, or within."""
    from quadpi_core.paths import require_file, require_folder

    taken = [path.resolve() for path in inputs]
    for output in filter(None, (*folders, *files)):
        place = output.resolve()
        if any(place.is_relative_to(path) for path in taken):
            raise QuadpiError(f"{output}: would replace or alter an input or another output; choose another")
        taken.append(place)
    for folder in filter(None, folders):
        require_folder(folder)
    for file in filter(None, files):
        require_file(file)


def _write_json(path: Path | None, data: dict[str, Any]) -> None:
    from quadpi_core.paths import write_json

    if path is not None:
        write_json(path, data)


def _console() -> Console:
    from rich.console import Console

    return Console()


def _terminate(*_: object) -> None:
    raise _Terminated


def main() -> None:
    """Entry point of the command `quadpi`."""
    signal.signal(signal.SIGTERM, _terminate)
    # Where Dask is interrupted, it does not fetch what its tasks raise for that reason.
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    try:
        app()
    except QuadpiError as error:
        print(f"quadpi: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
