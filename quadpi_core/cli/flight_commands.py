# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on flights: `quadpi info`, `import`, `replay`, `report` and `view`."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
import yaml

from quadpi_core.cli import options
from quadpi_core.cli.options import (
    SOME_LEFT_OUT,
    Confidence,
    OptionalVehicle,
    batch_of_flights,
    check_outputs,
    open_console,
    print_left_out,
    print_quality,
    shown_work,
    write_result,
)
from quadpi_core.config_schema import Positive, Section, Within, is_config_path, parse_config, read_config
from quadpi_core.errors import QuadpiError, VehicleError
from quadpi_core.paths import require_file, whole_output
from quadpi_core.report.table import Cell, Column, Mark, Row, Table, count, number, percent
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_core.monitor.replay import ReplaySummary


def info(
    path: Annotated[
        Path, typer.Argument(help="A log (FILE#2: the second flight in it), a bag or a model folder.")
    ],
    vehicle: options.OptionalVehicle = None,
    mapping: options.Mapping = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    json_file: options.JsonFile = None,
) -> None:
    """Show what a log, bag or model holds: topics, rates, gaps, envelope, suspicious sensors."""
    from quadpi_core.report.info_tables import describe

    check_outputs([path], json_file)
    tables, data = describe(
        path,
        vehicle,
        options.reading_options(topics, namespace, mapping, part=options.time_range(from_s, to_s)),
    )
    console = open_console()
    for table in tables:
        console.print(table)
    write_result(json_file, data)


def import_logs(
    logs: Annotated[
        list[Path],
        typer.Argument(
            help="Logs of any known format, tables or bags: docs/import-logs.md lists them. FILE#2 is the "
            "second flight in a file."
        ),
    ],
    vehicle: options.VehicleName,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the bags.")],
    mapping: options.Mapping = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    align: Annotated[
        bool,
        typer.Option(
            "--align",
            help="Shift what another clock stamped so that turns match the gyro, thrust the accelerometer.",
        ),
    ] = False,
    workers: options.FileProcessCount = None,
    scheduler: options.Scheduler = None,
    json_file: options.JsonFile = None,
) -> None:
    """Convert flight logs to MCAP bags with the standard topics."""
    from quadpi_core.logs import importing
    from quadpi_core.vehicle import Vehicle

    check_outputs(logs, json_file, folders=[output])
    how = options.reading_options(topics, namespace, mapping, part=options.time_range(from_s, to_s))
    console = open_console()
    the_vehicle = Vehicle.load(vehicle)
    with batch_of_flights() as left_out:
        with shown_work(console, workers, scheduler) as reading:
            flights = importing.import_logs(
                logs, the_vehicle, output, how, align=align, workers=reading, left_out=left_out
            )
        for flight in flights:
            console.print(
                f"{flight.bag}: {flight.imu_samples} IMU samples; topics {', '.join(flight.topics)}",
                soft_wrap=True,
            )
            for topic, alignment in flight.alignments.items():
                console.print(
                    f"  {topic} moved by {alignment.offset_s * 1e3:+.1f} ms, correlation with the IMU "
                    f"{alignment.correlation:.3f} over {alignment.matches} samples, "
                    f"{alignment.overlap_s:.1f} s",
                    soft_wrap=True,
                )
            for sentence in flight.missing:
                console.print(f"  {sentence}", soft_wrap=True)
        print_quality(console, ((flight.log, flight.quality) for flight in flights))
        write_result(
            json_file,
            {"bags": [flight.to_json() for flight in flights], "left_out": list(map(asdict, left_out))},
        )


def replay(
    model: options.ModelFolder,
    bags: options.Bags,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Bag to write; for several flights, a folder for theirs.")
    ],
    confidence: options.Confidence = None,
    adaptive: options.Adaptive = False,
    change: options.Change = True,
    vehicle: options.OptionalVehicle = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    workers: options.FileProcessCount = None,
    scheduler: options.Scheduler = None,
    json_file: options.JsonFile = None,
) -> None:
    """Write the bag that the live nodes would have published for a flight; the same bytes each time."""
    from dataclasses import asdict

    from quadpi_core.flight_files import bags_in, named_files
    from quadpi_core.models.aerodynamic import AerodynamicModel
    from quadpi_core.monitor import MonitorSettings
    from quadpi_core.monitor.replay import replay as replay_bag
    from quadpi_core.monitor.replay import replay_all
    from quadpi_core.report.table import terminal_table

    several = len(bags) > 1
    check_outputs([model, *bags], *(set(bags_in(output, bags)) if several else [output]), json_file)
    how = options.reading_options(topics, namespace, part=options.time_range(from_s, to_s))
    the_model = AerodynamicModel.load(model)
    the_vehicle = the_model.load_vehicle(vehicle)
    settings = MonitorSettings(adaptive=adaptive, change=change)
    console = open_console()
    with batch_of_flights() as left_out:
        if several:
            with shown_work(console, workers, scheduler) as replaying:
                replayed = replay_all(
                    the_model,
                    the_vehicle,
                    bags,
                    output,
                    confidence=confidence,
                    settings=settings,
                    mapping=how,
                    workers=replaying,
                    left_out=left_out,
                )
            summary = {
                "flights": {name: asdict(flight) for name, flight in replayed.items()},
                "left_out": list(map(asdict, left_out)),
            }
        else:
            (file,) = named_files(bags)
            replayed = {
                file.name: replay_bag(
                    the_model,
                    the_vehicle,
                    file.path,
                    output,
                    confidence=confidence,
                    settings=settings,
                    mapping=how,
                )
            }
            summary = asdict(replayed[file.name])
        console.print(terminal_table(replay_table(replayed)))
        for sentence in not_judged_sentences(replayed):
            console.print(sentence, soft_wrap=True)
        console.print(f"written to {output}", soft_wrap=True)
        write_result(json_file, summary)


def replay_table(replayed: Mapping[str, ReplaySummary]) -> Table:
    """Alarm, warning and counts by flight; an alarm is marked.

    Args:
        replayed: summaries by the name of the flight.
    """
    columns = [
        Column("flight", is_text=True, wraps=True),
        Column("alarm", percent),
        Column("first s"),
        Column("warned s"),
        Column("events", count),
        Column("not judged", percent),
        Column("predicted", percent),
        Column("dropped", count),
    ]
    rows: list[Row] = [
        [
            flight,
            Cell(own.alarm_fraction, Mark.WARNING if own.alarm_fraction > 0.0 else None),
            _seconds(own.alarm_first_s),
            _seconds(own.warning_first_s),
            own.events,
            own.not_judged_fraction,
            own.predictions_out / own.samples_in,
            Cell(own.dropped, Mark.FAULT if own.dropped else None),
        ]
        for flight, own in replayed.items()
    ]
    return Table(
        columns,
        rows,
        note="alarm: share of the time; first, warned: when the first came; predicted: share of the samples",
    )


def not_judged_sentences(replayed: Mapping[str, ReplaySummary]) -> Iterator[str]:
    """Why which share of each flight was not judged."""
    for flight, own in replayed.items():
        if own.not_judged_reasons:
            why = ", ".join(f"{one.reason} {percent(one.fraction)}" for one in own.not_judged_reasons)
            yield f"{flight}: not judged {percent(own.not_judged_fraction)} of the flight: {why}"


def _seconds(value: float | None) -> str:
    return "none" if value is None else number(value)


# Exit status where `--fail-on` asks for one.
FAILED = 1


def report(
    logs: Annotated[list[Path], typer.Argument(help="Logs of any format that quadpi reads, as they are.")],
    folder: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for report.html and report.json.")
    ] = Path("quadpi-report"),
    mass: Annotated[
        float | None, typer.Option(metavar="KG", help="Mass in flight: gives forces in newtons too.")
    ] = None,
    against: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="LOG",
            help="A good flight of the same vehicle before, which the motors are held against; may be given "
            "several times.",
        ),
    ] = None,
    fail_on: Annotated[
        str | None, typer.Option("--fail-on", metavar="alarm", help="End with status 1 if there is an alarm.")
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Vehicle file, for mass and pairs of poles; one that does not exist is asked for and kept."
        ),
    ] = None,
    mapping: options.Mapping = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
) -> None:
    """Report on logs as they are: what was flown, drag and wind, motors, battery, what to log next time."""
    from quadpi_core.field.field_report import report_on
    from quadpi_core.paths import whole_outputs, write_json
    from quadpi_core.report.field_page import report_summary, write_field_page
    from quadpi_core.report.table import terminal_table

    if fail_on not in {None, "alarm"}:
        raise QuadpiError(f"--fail-on {fail_on}: known is alarm")
    if mass is not None and not 0.0 < mass < 1e4:
        raise QuadpiError(f"--mass {mass:g}: expected kilograms above 0")
    check_outputs([*logs, *(against or ())], folders=[folder])
    known, its_mass = report_vehicle(vehicle) if vehicle else (None, None)
    report = report_on(
        logs,
        options.reading_options(topics, namespace, mapping),
        known,
        its_mass if mass is None else mass,
        against or (),
    )
    with whole_outputs(folder) as staging:
        write_field_page(staging / "report.html", report)
        write_json(staging / "report.json", report.to_json())
    console = open_console()
    for table in report_summary(report):
        console.print(terminal_table(table))
    console.print(report.verdict(), soft_wrap=True)
    console.print(f"{folder / 'report.html'}", soft_wrap=True)
    print_left_out(report.left_out)
    if fail_on and report.alarmed:
        raise typer.Exit(FAILED)
    if report.left_out:
        raise typer.Exit(SOME_LEFT_OUT)


@dataclass(frozen=True)
class KnownValues(Section):
    """A vehicle file with what a report uses alone; null for what is not known."""

    mass_kg: Positive | None = None
    pole_pairs: Annotated[int, Within(positive=True)] | None = None


_ASKED = {
    "mass_kg": "mass in flight, kg, for forces in newtons",
    "pole_pairs": "pairs of poles of a motor, for rotor speeds of electrical ones",
}


def report_vehicle(name_or_path: str) -> tuple[Vehicle | int | None, float | None]:
    """The vehicle, or what is known of its pairs of poles, and its mass in kg.

    A file that does not exist is asked for on a terminal, value by value, and written.

    Raises:
        VehicleError: naming the file, where it does not exist and there is no terminal, or holds no vehicle.
    """
    if is_config_path(name_or_path) and not Path(name_or_path).exists():
        _ask(Path(name_or_path))
    path, data = read_config("vehicle", name_or_path, VehicleError)
    if not isinstance(data, dict) or not set(data) <= {one.name for one in fields(KnownValues)}:
        vehicle = Vehicle.load(name_or_path)
        return vehicle, vehicle.mass_kg
    known = parse_config(KnownValues, data, str(path), VehicleError)
    return known.pole_pairs, known.mass_kg


def _number(answer: str) -> object:
    """A number, None for an empty answer, else the answer itself, which is refused."""
    try:
        return yaml.safe_load(answer)
    except yaml.YAMLError:
        return answer


def _ask(path: Path) -> None:
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        names = " and ".join(_ASKED)
        raise VehicleError(f"{path}: does not exist; write {names} into it, or run on a terminal, which asks")
    require_file(path)
    given = {
        name: typer.prompt(f"{name}: {meaning} (empty: not known)", default="", show_default=False)
        for name, meaning in _ASKED.items()
    }
    answers = {name: _number(answer) for name, answer in given.items()}
    known = parse_config(KnownValues, answers, str(path), VehicleError)
    with whole_output(path) as temporary:
        temporary.write_text(yaml.safe_dump(asdict(known), sort_keys=False), encoding="utf-8")


def view(
    bag: Annotated[
        Path | None, typer.Argument(help="Flight to look at; without one, the live nodes of this ROS domain.")
    ] = None,
    model: Annotated[
        list[Path] | None,
        typer.Option(
            help="Model folder; may be given several times. Of a bag: judge it by these models, of which the "
            "first gives the alarm. Live: show the envelope of the one that flies."
        ),
    ] = None,
    vehicle: OptionalVehicle = None,
    confidence: Confidence = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    at: Annotated[
        float | None,
        typer.Option(
            min=0.0, metavar="SECONDS", help="Moment of the bag to show first, in the time of the page."
        ),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0 takes any.")] = 8710,
    bind: Annotated[
        str, typer.Option(help="Address to listen on; another than loopback lets the network in.")
    ] = "127.0.0.1",
    open_page: Annotated[
        bool | None,
        typer.Option("--open/--no-open", help="Open the page; default: where there is a display."),
    ] = None,
) -> None:
    """Show in a browser how far the model can be trusted now, and why not."""
    from quadpi_core.models.aerodynamic import AerodynamicModel
    from quadpi_core.view.rerun_recording import open_bag
    from quadpi_core.view.view_server import announce, serve_page

    models = [AerodynamicModel.load(folder) for folder in model or ()]
    if vehicle is not None and not models:
        raise QuadpiError("--vehicle: is that of the models, and there is no --model")
    console = open_console()

    if at is not None and bag is None:
        raise QuadpiError("--at: is a moment of a bag, and none is given")
    if at is not None and not math.isfinite(at):
        raise QuadpiError(f"--at {at}: is no moment")
    how = options.reading_options(topics, namespace, part=options.time_range(from_s, to_s))
    if (how.topics or how.namespace) and not (bag and models):
        raise QuadpiError("--topics, --namespace: are of a bag that --model judges")
    if bag is None and not how.part.is_whole:
        raise QuadpiError("--from, --to: are of a bag, and none is given")
    moment = "" if at is None else f"#t={at:g}"

    def say(url: str) -> None:
        announce(console.print, url + moment, open_page)

    # Ctrl-C is how it ends.
    with suppress(KeyboardInterrupt):
        if bag is not None:
            the_vehicle = models[0].load_vehicle(vehicle) if models else None
            serve_page(open_bag(bag, models, the_vehicle, confidence, how), port, bind, say)
            return
        if confidence is not None:
            raise QuadpiError("--confidence: is for a bag that --model judges; live nodes have theirs")
        try:
            # Here the command line reaches for ROS, as in `quadpi demo`.
            from quadpi_ros.view_node import view_live
        except ModuleNotFoundError as error:
            raise QuadpiError(
                f"live nodes are seen through ROS 2 ({error}); without it, look at a bag: quadpi view BAG"
            ) from error
        view_live(models, vehicle, port, bind, say)
