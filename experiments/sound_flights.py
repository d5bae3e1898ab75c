# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew the tables of results/alarm.md on sound flights: simulated, of vehicles not tuned on, and real.

Each model of some flights judges others of their kind: how many raise CHANGE, of which 5 % of flights may,
and how often EXTRAPOLATION and MISCOVERAGE are raised in an hour. Flights: of our simulation and of RotorPy.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from alarm_tables import PAGE, VARIED, poisson_interval, random_plan
from independent import recording as rotorpy_logs
from independent.airframes import HERE, Airframe, airframes
from independent.flying import fly, paths
from independent.hidden_effects import Flown
from model_methods import DATA_SETS, DataSet, flights_by_log
from page_tables import renew, stamp
from scipy.stats import binom, binomtest

from quadpi_core.flight import Recording
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import PreparedFlight, prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.alarm_limits import change_sentence
from quadpi_core.models.model_kind import CUTOFF_HZ, IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.monitor.replay import monitored, recorded_flight
from quadpi_core.parallel import Workers
from quadpi_core.paths import data_directory
from quadpi_core.report.table import Column, Row, Table, markdown_table
from quadpi_core.results import CAUSES, CHANGE, EXTRAPOLATION, LEVEL_ALARM, MISCOVERAGE
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import FlightPlan
from quadpi_core.simulation.sensor_noise import SensorSuite
from quadpi_core.simulation.simulated_bags import fly_and_sense, simulate
from quadpi_core.vehicle import Vehicle

SIMULATED = "hdbeetle"
# What a model is asked for, and what CHANGE states.
RATE_PER_HOUR, SHARE = 0.1, 0.05
# Flights that a model of our simulation is identified on; of RotorPy, sets of its eight paths.
FLIGHTS, SETS = 12, 2
DURATION_S = 60.0
# Sets of as many flights as CHANGE takes; of the nano-drone benchmark all manoeuvres.
REAL = (
    *(
        one
        for one in DATA_SETS
        if one.title in ("Crazyflie, brushless", "Crazyflie, slung load", "IndiFlight")
    ),
    DataSet("nano-drone benchmark", "nanodrone_benchmark/*", "nanodrone", mapping="nanodrone"),
)
# Room of the seeds of a model's sets.
_SETS_MOST = 1000
# Halves judge each other where each has enough flights for CHANGE, else quarters are left out.
_HALVES = 16
_MAPPING = str(HERE / "mappings" / "mocap.yaml")


@dataclass(frozen=True)
class Judged:
    """What the alarm says of sound flights.

    Attributes:
        flights: number of them.
        hours: that were judged.
        changed: flights that raise CHANGE.
        extrapolation, miscoverage: alarms.
        with_any: flights with any alarm of these three.
    """

    flights: int
    hours: float
    changed: int
    extrapolation: int
    miscoverage: int
    with_any: int

    @classmethod
    def total(cls, parts: Sequence[Judged]) -> Judged:
        """All of several together."""
        return cls(*(sum(getattr(part, field.name) for part in parts) for field in fields(cls)))

    def row(self, *names: str) -> Row:
        """Of the table."""
        share = binomtest(self.changed, self.flights).proportion_ci(0.95)
        count = self.extrapolation + self.miscoverage
        rate, low, high = (number / self.hours for number in (count, *poisson_interval(count)))
        return [
            *names,
            str(self.flights),
            f"{self.hours:.2f}",
            f"{self.changed} ({100.0 * share.low:.2g} to {100.0 * share.high:.2g} %)",
            str(self.extrapolation),
            str(self.miscoverage),
            f"{rate:.2g} ({low:.2g} to {high:.2g})",
            str(self.with_any),
        ]


def judged(model: AerodynamicModel, vehicle: Vehicle, recordings: Iterable[Recording]) -> Judged:
    """Replay sound flights, as `quadpi replay` does."""
    columns = [CAUSES.index(cause) for cause in (CHANGE, EXTRAPOLATION, MISCOVERAGE)]
    found = []
    for recording in recordings:
        monitor = Monitor(model, vehicle, None)
        levels, stamps = [np.zeros((1, 3))], []
        for part, conditions in monitored(recorded_flight(recording, vehicle), [monitor]):
            _, alarms, _ = monitor.step(*part.samples, conditions)
            levels.append(alarms.cause_level[:, columns] == LEVEL_ALARM)
            stamps.append(alarms.time_ns)
        change, extrapolation, miscoverage = (np.diff(np.concatenate(levels), axis=0) > 0).sum(axis=0)
        span_ns = int(np.ptp(np.concatenate(stamps)))
        any_alarm = change + extrapolation + miscoverage > 0
        counts = (int(change > 0), int(extrapolation), int(miscoverage), int(any_alarm))
        found.append(Judged(1, 1e-9 * span_ns / 3600.0, *counts))
    return Judged.total(found)


def model_of(flights: Sequence[PreparedFlight], vehicle: Vehicle) -> AerodynamicModel:
    """A physical model in default settings, but for the stated rate."""
    options = IdentifyOptions(
        cutoff_hz=CUTOFF_HZ["default"], method="physical", false_alarms_per_hour=RATE_PER_HOUR
    )
    return identify(flights, vehicle, load_pools("quadrotor"), options)


def _plans(seed: int, count: int) -> list[FlightPlan]:
    """Random flights of our simulation; those of other seeds are other flights."""
    plans = [random_plan(f"sound_{seed}_{k:03d}", VARIED, (seed, k), DURATION_S) for k in range(count)]
    return [replace(plan, vehicle=SIMULATED) for plan in plans]


def simulated(number: int, count: int, work: Path) -> Judged:
    """One model of our simulation, on others of its flights."""
    vehicle, flown = Vehicle.load(SIMULATED), SimulatedVehicle.load(SIMULATED)
    bags = [flight.bag for flight in simulate(_plans(2 * number, FLIGHTS), work, workers=Workers(1))]
    model = model_of(prepare_flights(bags, vehicle, CUTOFF_HZ["default"]), vehicle)
    print(model.alarm_limits.sentence(), flush=True)
    plans = _plans(2 * number + 1, count)
    suite = SensorSuite.load(plans[0].noise)
    return judged(model, vehicle, (fly_and_sense(plan, flown, suite)[1].recording for plan in plans))


def _rotorpy(airframe: Airframe, sets: Iterable[int], work: Path) -> Iterator[Path]:
    """Logs of RotorPy along its eight paths, of each seed."""
    for number in sets:
        random = np.random.default_rng((2026, number))
        flown = Flown(airframe, airframe.parameters)
        for path in paths(airframe, random):
            named = replace(path, name=f"{path.name}_{number:03d}")
            yield rotorpy_logs.write(flown, fly(flown, named, random), random, work)


def rotorpy(airframe: Airframe, number: int, sets: int, work: Path) -> Judged:
    """One model of flights of RotorPy, on others of them."""
    vehicle, first = Vehicle.load(str(airframe.file)), number * _SETS_MOST
    training = list(_rotorpy(airframe, range(first, first + SETS), work))
    model = model_of(prepare_flights(training, vehicle, CUTOFF_HZ["default"], mapping=_MAPPING), vehicle)
    print(model.alarm_limits.sentence(), flush=True)
    unseen = _rotorpy(airframe, range(first + SETS, first + SETS + sets), work)
    return judged(model, vehicle, (read_recording(log, vehicle, _MAPPING) for log in unseen))


def real(data_set: DataSet, data: Path, work: Path) -> tuple[Judged, list[str]]:
    """Flights of a data set, by models of the others in turns, and what each model states of CHANGE."""
    flights, vehicle, _ = flights_by_log(data_set, data, work)
    paths, turns = list(flights), 2 if len(flights) >= _HALVES else 4
    found, stated = [], []
    for turn in range(turns):
        others = [flights[path] for k, path in enumerate(paths) if k % turns != turn]
        model = model_of(others, vehicle)
        stated.append(change_sentence(model.change_limits))
        print(stated[-1], flush=True)
        left_out = (read_recording(path, vehicle) for path in paths[turn::turns])
        found.append(judged(model, vehicle, left_out))
    return Judged.total(found), stated


def real_table(data: Path, work: Path) -> str:
    """The table of real flights."""
    rows: list[Row] = []
    for data_set in REAL:
        found, stated = real(data_set, data, work / data_set.vehicle)
        calibrated = sum("estimated" in sentence and "no share" not in sentence for sentence in stated)
        rows.append(found.row(data_set.title, f"{calibrated} of {len(stated)}"))
        print(*rows[-1], sep=" | ", flush=True)
    return _table(rows, "models that state a share")


def _table(rows: Sequence[Row], second: str = "model") -> str:
    headings = (
        *(second, "unseen flights", "hours", "raise CHANGE (95 %)", "EXTRAPOLATION", "MISCOVERAGE"),
        "alarms of these two per hour (95 %)",
        "flights with any alarm",
    )
    return markdown_table(Table([Column("vehicle", is_text=True), *map(Column, headings)], rows))


def main(arguments: Sequence[str] | None = None) -> None:
    """Renew the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, default=PAGE, help="to renew")
    parser.add_argument("--models", type=int, default=10, help="of our simulation")
    parser.add_argument("--first", type=int, default=0, help="model; others are of other flights")
    parser.add_argument("--flights", type=int, default=306, help="of a minute that each of them judges")
    parser.add_argument(
        "--sets", type=int, default=25, help="of RotorPy's eight flights that its model judges, or 0"
    )
    parser.add_argument("--data", type=Path, default=data_directory(), help="folder of real flights")
    parser.add_argument("--only", choices=("real", "simulated"), help="one of the tables")
    options = parser.parse_args(arguments)
    if options.only != "simulated":
        with tempfile.TemporaryDirectory() as folder:
            table = real_table(options.data.resolve(), Path(folder))
        renew(options.page, {"sound real": f"{table}\n\n*{stamp()}*"})
    if options.only != "real":
        simulated_table(options)


def simulated_table(options: argparse.Namespace) -> None:
    """Renew the table of simulated flights after each model, so that an interruption loses one at most."""
    rows: list[Row] = []
    named = f"\n\nAsked for: {RATE_PER_HOUR:g} per hour, {100.0 * SHARE:g} % of flights.\n\n*{stamp()}*"
    _, small = airframes()

    def add(row: Row) -> None:
        rows.append(row)
        print(*row, sep=" | ", flush=True)

    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        if options.sets:
            number = options.first
            add(rotorpy(small, number, options.sets, work).row("RotorPy's Crazyflie", str(number + 1)))
        found = []
        for number in range(options.first, options.first + options.models):
            found.append(simulated(number, options.flights, work))
            add(found[-1].row(SIMULATED, str(number + 1)))
            whole = Judged.total(found)
            enough = int(binom.ppf(0.95, whole.flights, SHARE))
            last = whole.row(SIMULATED, "all")
            words = f"\n\nOf {whole.flights} flights at most {enough} raise CHANGE in 95 of 100 such tables, "
            renew(options.page, {"sound": _table([*rows, last]) + words + f"were it 5 %.{named}"})


if __name__ == "__main__":
    main()
