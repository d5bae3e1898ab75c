# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi demo`: identify, evaluate, replay through the live nodes and report, on bundled or real flights."""

from __future__ import annotations

import shlex
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.text import Text

from quadpi_core.errors import QuadpiError
from quadpi_core.evaluation.evaluate import judge
from quadpi_core.field.field_report import report_on
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.logs.importing import import_logs
from quadpi_core.models.kind_registry import kind_of
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.parallel import Workers
from quadpi_core.paths import bags_directory, write_json
from quadpi_core.reading_options import ReadingOptions
from quadpi_core.report.evaluation_figures import LiveReplay
from quadpi_core.report.evaluation_page import evaluation_summary, write_evaluation_page
from quadpi_core.report.field_page import write_field_page
from quadpi_core.report.info_tables import best_known_table, held_out_table
from quadpi_core.report.page import FlightFiles
from quadpi_core.report.table import progress_bar, terminal_table
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.view_server import ADDRESS, PORT, port_problem
from quadpi_ros.live_session import SessionResult, run_session

CONFIDENCE = 0.95
# Real logs below the bundled bags: of a vehicle as it was, and with a nut near motor 3.
REAL_LOGS = "crazypad"
NORMAL, WITH_NUT = "normal_flight_E9_log00", "add_weight_W3_near_M3_E9_log00"
# Faster NeuroBEM flights are not identified on, so that the model has to extrapolate on them.
FASTEST_IDENTIFIED_M_S = 12.0
# Of about a hundred.
PARAMETERS_SHOWN = 10

_LEVEL_STYLES = ("green", "yellow", "bold red")

NO_DATA = """{directory}: the demo on real flights needs those of NeuroBEM there (University of Zurich, \
2021: merged test flights bemnn*.mat, one N x 41 matrix each), two or more below and one above {fastest:g} \
m/s; name the folder that holds neurobem/ with --data or $QUADPI_DATA, or neither for the bundled flights"""


@dataclass(frozen=True)
class DemoFlights:
    """Flights of the demo.

    Attributes:
        vehicle: of all flights.
        groups: bags by group; the model is identified on the first.
        replayed: bag that is played through the live nodes.
    """

    vehicle: Vehicle
    groups: dict[str, list[Path]]
    replayed: Path

    @property
    def identified(self) -> list[Path]:
        """The bags of the first group."""
        return next(iter(self.groups.values()))


def run_demo(data: Path | None, output: Path, rate: float, console: Console, view: bool = True) -> None:
    """Identify, evaluate, replay live and report; all files go to `output`.

    Args:
        data: folder of real flights; None for the bundled ones.
        output: folder for all results.
        rate: speed of the live replay; 1 is real time.
        console: for progress and results.
        view: whether to serve the live part as a page, which opens where there is a display.

    Raises:
        QuadpiError: saying which flights to provide if they are missing.
    """
    if not 0.0 < rate < np.inf:
        raise QuadpiError(f"--rate must be positive, found {rate:g}")
    flights = _bundled_flights(console) if data is None else _real_flights(data, output, console)
    _run(flights, output, rate, console, view)


def _bundled_flights(console: Console) -> DemoFlights:
    folder = bags_directory()
    groups = {
        "identification": [folder / f"train_{number}.mcap" for number in (1, 2, 3, 4)],
        "interpolation": [folder / "interpolation.mcap"],
        "extrapolation": [folder / "extrapolation.mcap"],
    }
    console.rule("1  Flights: bags of quadpi's own simulation")
    for group, bags in groups.items():
        console.print(f"{group}: {', '.join(bag.name for bag in bags)}")
    return DemoFlights(Vehicle.load("bebop2"), groups, groups["extrapolation"][0])


def _real_flights(data: Path, output: Path, console: Console) -> DemoFlights:
    directory = data / "neurobem"
    logs = sorted(directory.glob("*.mat"))
    what_to_provide = NO_DATA.format(directory=directory, fastest=FASTEST_IDENTIFIED_M_S)
    if not logs:
        raise QuadpiError(what_to_provide)
    vehicle = Vehicle.load("neurobem")
    console.rule("1  Import: flight logs to MCAP bags")
    groups: dict[str, list[Path]] = {"identification": [], "extrapolation": []}
    for flight in import_logs(logs, vehicle, output / "bags"):
        odometry = read_recording(flight.bag, vehicle).odometry
        if odometry is None:
            raise QuadpiError(what_to_provide)
        speed = float(np.linalg.norm(odometry.velocity, axis=1).max())
        groups["identification" if speed < FASTEST_IDENTIFIED_M_S else "extrapolation"].append(flight.bag)
        console.print(f"{flight.bag}: {flight.imu_samples} IMU samples, up to {speed:.1f} m/s")
    if len(groups["identification"]) < 2 or not groups["extrapolation"]:
        raise QuadpiError(what_to_provide)
    return DemoFlights(vehicle, groups, groups["extrapolation"][0])


def _run(flights: DemoFlights, output: Path, rate: float, console: Console, view: bool) -> None:
    vehicle = flights.vehicle
    options = IdentifyOptions(confidence=CONFIDENCE)
    console.rule(f"2  Identify: {kind_of(options).label} of the slower flights")
    with progress_bar(console) as progress:
        reading = Workers(progress=progress)
        prepared = prepare_flights(flights.identified, vehicle, options.cutoff_hz, workers=reading)
        pools = load_pools("quadrotor")
        model = identify(prepared, vehicle, pools, options, progress=progress).save(output / "model")
    if parameters := best_known_table(model, PARAMETERS_SHOWN):
        console.print(terminal_table(parameters))
    console.print(model.calibration())
    if held_out := held_out_table(model):
        console.print(terminal_table(held_out))

    console.rule("3  Evaluate: does the interval cover?")
    others = [bag for bags in list(flights.groups.values())[1:] for bag in bags]
    prepared += prepare_flights(others, vehicle, options.cutoff_hz)
    groups = {name: [bag.stem for bag in bags] for name, bags in flights.groups.items()}
    results, evaluation = judge(model, prepared, groups, CONFIDENCE)
    console.print(evaluation_summary(evaluation))

    console.rule(f"4  Live: {flights.replayed.name} through the ROS 2 nodes at {rate:g} x real time")
    page = None
    if view and (problem := port_problem()):
        console.print(f"No page: {problem.partition(';')[0]}")
    elif view:
        console.print(f"Page at http://{ADDRESS}:{PORT}/ while the flight lasts")
        page = ["--vehicle", vehicle.name, "--model", str(output / "model")]
    console.print(
        "Alarm and inputs outside their training range, the farthest first, by a share of that range:"
    )
    session = run_session(
        flights.replayed,
        output / "model",
        vehicle=vehicle.name,
        rate=rate,
        on_alarm=lambda change: console.print(Text(str(change), style=_LEVEL_STYLES[change.level])),
        page=page,
    )
    live = session.summary()
    times = {level: live[f"{level}_first_s"] for level in ("warning", "alarm")}
    first = "".join(f"first {level} at {time:.1f} s; " for level, time in times.items() if time is not None)
    console.print(
        f"{live['samples_in']} IMU samples in, {live['predictions_out']} predictions out, "
        f"{live['dropped']} dropped; {first}alarm for {live['alarm_fraction']:.0%} of the time; "
        f"latency {live['latency_ms_p50']:.1f} ms median, {live['latency_ms_p99']:.1f} ms p99"
    )

    console.rule("5  Report")
    summary = evaluation.to_json() | {"live": live}
    write_json(output / "summary.json", summary)
    replay = _replay(flights.replayed.stem, session, live)
    bags = {bag.stem: bag for own in flights.groups.values() for bag in own}
    files = FlightFiles(bags, [output / "model"])
    write_evaluation_page(output / "report.html", evaluation, results, model, replay, files)
    console.print(f"Open {output / 'report.html'}; figures in {output / 'summary.json'}")
    again = f"{called_as()} view {flights.replayed} --model {output / 'model'}"
    console.print(f"See the flight again: {again}", soft_wrap=True)
    first_alarm_s = live["alarm_first_s"]
    if first_alarm_s is not None:
        at = f"--at {first_alarm_s - replay.begins_s:.2f}"
        counts = f"as the page counts from the first prediction, {replay.begins_s:.2f} s into the flight"
        console.print(f"and at its first alarm: add {at}, {counts}", soft_wrap=True)
    _report_on_real_logs(output / "real", console)


def _report_on_real_logs(output: Path, console: Console) -> None:
    """A report on a real flight with a nut near a motor, against one without: any log, one command."""
    logs = bags_directory() / REAL_LOGS
    console.rule("6  Real flights: a report on logs as they are")
    command = f"report {logs / WITH_NUT} --against {logs / NORMAL} -o {output}"
    console.print(f"{called_as()} {command}", soft_wrap=True)
    report = report_on([logs / WITH_NUT], ReadingOptions(), against=[logs / NORMAL])
    output.mkdir(parents=True, exist_ok=True)
    write_field_page(output / "report.html", report)
    write_json(output / "report.json", report.to_json())
    console.print(report.verdict(), soft_wrap=True)
    for remark in report.flights[0].remarks:
        console.print(f"- {remark.sentence}", soft_wrap=True)
    console.print(f"Open {output / 'report.html'}")


def called_as() -> str:
    """How a shell here reaches the command line: by name, or where that is not on the path by its file."""
    program = Path(sys.executable).with_name("quadpi")
    if shutil.which("quadpi") or not program.exists():
        return "quadpi"
    inside = program.is_relative_to(Path.cwd())
    return shlex.quote(str(program.relative_to(Path.cwd()) if inside else program))


def _replay(flight: str, session: SessionResult, statistics: dict[str, float | int | None]) -> LiveReplay:
    alarms = session.alarms
    return LiveReplay(
        flight=flight,
        statistics=statistics,
        time=1e-9 * (alarms.time_ns - session.imu_stamps_ns[0]),
        level=alarms.level,
        leverage=alarms.leverage,
        width=alarms.width,
        inputs_outside=alarms.inputs_outside,
        begins_s=1e-9 * (session.predictions.time_ns[0] - session.imu_stamps_ns[0]),
    )
