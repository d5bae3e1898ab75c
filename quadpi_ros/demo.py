# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi demo`: the whole story on real flights, the live nodes included."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.text import Text

from quadpi_core.errors import QuadpiError
from quadpi_core.identification import CUTOFF_HZ, identify, predict_flight, prepare_flights
from quadpi_core.intervals.evaluate import evaluate_flights
from quadpi_core.logs.importing import import_logs
from quadpi_core.models import load_pools
from quadpi_core.paths import data_directory, write_json
from quadpi_core.report.html import write_report
from quadpi_core.report.live import LiveReplay
from quadpi_core.report.tables import evaluation_table, held_out_table
from quadpi_core.vehicle import Vehicle
from quadpi_ros.collector import AlarmChange
from quadpi_ros.session import SessionResult, run_session

VEHICLE = "neurobem"
CONFIDENCE = 0.95
# The flight above this speed is kept from identification: the model has to extrapolate on it.
FASTEST_IDENTIFIED_M_S = 12.0

_LEVEL_STYLES = ("green", "yellow", "bold red")

NO_DATA = """{directory}: the demo needs NeuroBEM flights there (University of Zurich, 2021: merged test \
flights bemnn*.mat, one N x 41 matrix each), two or more below and one above {fastest:g} m/s; name the \
folder that holds neurobem/ with --data or $QUADPI_DATA"""


def run_demo(data: Path | None, output: Path, rate: float, console: Console) -> None:
    """Identify, evaluate, replay live and report; all files go to `output`.

    Raises:
        QuadpiError: saying what to provide where the flights are absent.
    """
    if not 0.0 < rate < np.inf:
        raise QuadpiError(f"--rate must be positive, found {rate:g}")
    directory = (data or data_directory()) / "neurobem"
    logs = sorted(directory.glob("*.mat"))
    what_to_provide = NO_DATA.format(directory=directory, fastest=FASTEST_IDENTIFIED_M_S)
    if not logs:
        raise QuadpiError(what_to_provide)
    vehicle = Vehicle.load(VEHICLE)

    console.rule("1  Import: flight logs to MCAP bags")
    identified: list[Path] = []
    extrapolated: list[Path] = []
    for bag, recording, _ in import_logs(logs, vehicle, output / "bags"):
        speed = float(np.linalg.norm(recording.odometry.velocity, axis=1).max())
        (identified if speed < FASTEST_IDENTIFIED_M_S else extrapolated).append(bag)
        console.print(f"{bag}: {len(recording.imu)} IMU samples, up to {speed:.1f} m/s")
    if len(identified) < 2 or not extrapolated:
        raise QuadpiError(what_to_provide)

    console.rule("2  Identify: stepwise polynomials on the slower flights")
    with console.status("Estimating states") as status:
        flights = prepare_flights(identified, vehicle, CUTOFF_HZ["default"])
        model = identify(
            flights,
            vehicle,
            load_pools("quadrotor"),
            cutoff_hz=CUTOFF_HZ["default"],
            confidence=CONFIDENCE,
            progress=lambda axis: status.update(f"Identifying {axis}"),
        ).save(output / "model")
    for axis in model.axes:
        chosen = [row for row in model.selection[axis] if row["coefficient"] is not None]
        terms = ", ".join(row["term"] for row in chosen)
        console.print(f"[bold]{axis}[/bold]  R² {chosen[-1]['r2']:.3f}  {escape(terms)}")

    console.print(model.calibration())
    console.print(held_out_table(model))

    console.rule("3  Evaluate: does the interval cover?")
    flights += prepare_flights(extrapolated, vehicle, CUTOFF_HZ["default"])
    results = [predict_flight(model, flight, CONFIDENCE) for flight in flights]
    groups = {
        "identification": [bag.stem for bag in identified],
        "extrapolation": [bag.stem for bag in extrapolated],
    }
    evaluation = evaluate_flights(
        results, groups, model.training_range, CONFIDENCE, model=model.identity, vehicle=vehicle.name
    )
    console.print(evaluation_table(evaluation))

    console.rule(f"4  Live: {extrapolated[0].name} through the ROS 2 nodes at {rate:g} x real time")
    console.print(
        "Alarm and inputs outside their training range, the farthest first, by a share of that range:"
    )
    session = run_session(
        extrapolated[0],
        output / "model",
        vehicle=VEHICLE,
        rate=rate,
        on_alarm=lambda change: _show(console, change),
    )
    live = session.summary()
    console.print(
        f"{live['samples_in']} IMU samples in, {live['predictions_out']} predictions out, "
        f"{live['dropped']} dropped; alarm for {live['alarm_fraction']:.0%} of the time; "
        f"latency {live['latency_ms_p50']:.1f} ms median, {live['latency_ms_p99']:.1f} ms p99"
    )

    console.rule("5  Report")
    summary = evaluation | {"live": live}
    write_json(output / "summary.json", summary)
    write_report(
        output / "report.html", evaluation, results, model, _replay(extrapolated[0].stem, session, live)
    )
    console.print(f"Open {output / 'report.html'}; figures in {output / 'summary.json'}")


def _show(console: Console, change: AlarmChange) -> None:
    console.print(Text(str(change), style=_LEVEL_STYLES[change.level]))


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
    )
