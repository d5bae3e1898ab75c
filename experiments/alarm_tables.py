# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew the tables of results/alarm.md: how well each signal predicts misses, and the rate of false alarms.

Simulated flights are flown here; real ones come from a folder, without which their rows are left out. The
same code and data give the same numbers.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt
from page_tables import RESULTS, ROOT, renew, stamp
from paper_tables import FLIGHTS
from scipy.stats import chi2

from quadpi_core.evaluation.alarm_assessment import auroc, per_hour
from quadpi_core.evaluation.evaluate import predict_flight
from quadpi_core.frames import Array
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import PreparedFlight, prepare_flights
from quadpi_core.logs.bags import read_outputs
from quadpi_core.logs.importing import import_logs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.alarm_limits import FEWEST_FLIGHTS
from quadpi_core.models.model_kind import CUTOFF_HZ, IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.monitor.alarm import alarm_time
from quadpi_core.monitor.replay import replay_all
from quadpi_core.parallel import Workers
from quadpi_core.paths import data_directory
from quadpi_core.report.table import Column, Row, Table, markdown_table, percent
from quadpi_core.results import CAUSES, EXTRAPOLATION, JUDGED, LEVEL_ALARM, LEVEL_WARNING, MISCOVERAGE
from quadpi_core.simulation.scenario import FlightPlan, load_scenario
from quadpi_core.simulation.simulated_bags import simulate
from quadpi_core.vehicle import Vehicle

PAGE = RESULTS / "alarm.md"
VEHICLE, REAL_VEHICLE = "bebop2", "neurobem"
CONFIDENCE = 0.95
SCENARIOS = ("training", "validation", "dash")
# Flights that a model of random flights is identified on, and for the rates a second model of few.
MANY, FEW = 12, FEWEST_FLIGHTS
# Models of lower seeds were looked at while limits were set, so the table has others.
FIRST_SEED = 13
# Time in which the state of a flight that begins in the air settles.
EARLY_S = 5.0
# Of each axis the largest speed in m/s, and the frequencies in Hz that it is made of.
_RANDOM = {"x": (3.5, (0.08, 0.35)), "y": (3.5, (0.08, 0.35)), "height": (1.2, (0.1, 0.4))}
# Kinds of random flights by the sines of an axis: many that share its speed, so that each flight is like the
# others, or few that share from half of it upward by chance, so that some flights are calm and some are not.
ALIKE, VARIED = "alike", "varied"
_SINES = {ALIKE: 6, VARIED: 3}
_HEIGHT_M = 15.0


@dataclass(frozen=True)
class Job:
    """Where results lie and how much is asked for.

    Attributes:
        work: folder of bags and models.
        data: folder that holds `neurobem`.
        seeds: number of models of each number of flights whose false alarms are counted.
        flights: number of unseen flights for each of these models.
        flight_s: duration of a random flight.
        ensembles: judge the width of ensembles as well, which takes their training.
        workers: that simulate, read and replay flights.
    """

    work: Path
    data: Path
    seeds: int
    flights: int
    flight_s: float
    ensembles: bool
    workers: Workers

    def random_bags(self, name: str, kind: str, seed: int, count: int) -> list[Path]:
        """Random flights of a kind; those of other seeds are other flights."""
        plans = [random_plan(f"{name}_{k:03d}", kind, (seed, k), self.flight_s) for k in range(count)]
        flown = simulate(plans, self.work / name, workers=self.workers)
        return [flight.bag for flight in flown]

    def prepared(self, bags: Sequence[Path], vehicle: str) -> list[PreparedFlight]:
        """Bags ready for identification and evaluation."""
        return prepare_flights(bags, Vehicle.load(vehicle), CUTOFF_HZ["default"], workers=self.workers)


def random_plan(name: str, kind: str, seed: tuple[int, int], duration_s: float) -> FlightPlan:
    """A flight on all axes at once, of sines whose frequencies and phases a seed draws."""
    random, sines = np.random.default_rng(seed), _SINES[kind]
    window = {"start_s": 0.5, "duration_s": duration_s - 1.0, "fade_s": 3.0}
    motion = {}
    for axis, (top, band) in _RANDOM.items():
        shares = random.uniform(0.5, 1.0) * random.dirichlet(np.ones(sines))
        speeds = top * (shares if kind == VARIED else np.full(sines, 1.0 / sines))
        frequencies, phases = random.uniform(*band, sines), random.uniform(0.0, 360.0, sines)
        motion[axis] = [
            {
                "sine": {
                    "amplitude_m": float(speed / (2.0 * math.pi * frequency)),
                    "frequency_hz": float(frequency),
                    "phase_deg": float(phase),
                    **window,
                }
            }
            for speed, frequency, phase in zip(speeds, frequencies, phases, strict=True)
        ]
    frequency, rate = random.uniform(0.05, 0.2), random.uniform(10.0, 60.0)
    amplitude = float(rate / (2.0 * math.pi * frequency))
    motion["yaw"] = [{"sine": {"amplitude_deg": amplitude, "frequency_hz": float(frequency), **window}}]
    return FlightPlan.from_dict(
        {
            "name": name,
            "scenario": "random",
            "vehicle": VEHICLE,
            "seed": int(random.integers(2**31)),
            "duration_s": duration_s,
            "height_m": _HEIGHT_M,
            "motion": motion,
            "truth_rate_hz": 1,
        },
        name,
    )


def model_of(flights: Sequence[PreparedFlight], vehicle: str, method: str = "polynomial") -> AerodynamicModel:
    """A model in default settings."""
    pools = load_pools("quadrotor")
    return identify(
        flights,
        Vehicle.load(vehicle),
        pools,
        IdentifyOptions(cutoff_hz=CUTOFF_HZ["default"], method=method, confidence=CONFIDENCE),
    )


@dataclass(frozen=True)
class Case:
    """Flights that a model is identified on, and others that it is judged on."""

    name: str
    vehicle: str
    identified: Sequence[PreparedFlight]
    judged: Sequence[PreparedFlight]


def simulated_cases(job: Job) -> list[Case]:
    """Models of the scenario `training` and of random flights, on each other's flights and faster ones."""
    flights = {
        name: job.prepared(
            [f.bag for f in simulate(load_scenario(name).flights, job.work / name, workers=job.workers)],
            VEHICLE,
        )
        for name in SCENARIOS
    }
    flights["random"] = job.prepared(job.random_bags("random", VARIED, 0, MANY), VEHICLE)
    return [
        Case(f"`{one}` → `{other}`", VEHICLE, flights[one], flights[other])
        for one in ("training", "random")
        for other in ("training", "validation", "dash", "random")
        if one != other
    ]


def real_cases(job: Job) -> list[Case]:
    """Each real flight by a model of the others; none where there are no real flights."""
    folder = job.data / "neurobem"
    if not folder.is_dir():
        print(f"no rows of real flights: none in {folder} (--data FOLDER)", flush=True)
        return []
    logs = [folder / f"{name}.mat" for name in FLIGHTS.values()]
    imported = import_logs(logs, Vehicle.load(REAL_VEHICLE), job.work / "neurobem")
    flights = job.prepared([flight.bag for flight in imported], REAL_VEHICLE)
    return [
        Case(
            f"NeuroBEM, the others → {speed} m/s",
            REAL_VEHICLE,
            [f for f in flights if f is not flight],
            [flight],
        )
        for speed, flight in zip(FLIGHTS, flights, strict=True)
    ]


def signal_areas(case: Case, model: AerodynamicModel) -> tuple[float, dict[str, float | None]]:
    """Share of the samples missed, and the area under the ROC curve of each signal for them."""
    missed, scores = [], {name: list[Array]() for name in ("inputs", "leverage", "width")}
    for flight in case.judged:
        result = predict_flight(model, flight, CONFIDENCE, with_alarm=True)
        assert result.alarm is not None
        judged = result.alarm.why_not_judged == JUDGED
        missed.append(result.alarm.missed[judged].any(axis=1))
        for name, own in scores.items():
            own.append(result.alarm.scores[name][judged])
    positive = np.concatenate(missed)
    areas = {name: auroc(np.concatenate(values), positive) for name, values in scores.items()}
    return float(np.mean(positive)), areas


# Signals of each method, with their headings; an ensemble has no leverage.
_SIGNALS: dict[str, dict[str, str]] = {
    "polynomial": {"inputs": "range", "leverage": "leverage", "width": "width"},
    "bootstrap": {"inputs": "range", "width": "width"},
    "quality-driven": {"inputs": "range", "width": "width"},
}


def signals(job: Job) -> str:
    """One table per method: area under the ROC curve of each signal for misses."""
    cases = simulated_cases(job) + real_cases(job)
    methods: list[str] = ["polynomial"]
    if job.ensembles:
        methods += ["bootstrap", "quality-driven"]
    parts = []
    for method in methods:
        names = _SIGNALS[method]
        rows: list[Row] = []
        found = []
        for case, before in zip(cases, [None, *cases], strict=False):
            print(f"{method}: {case.name}", flush=True)
            if before is None or case.identified is not before.identified:
                model = model_of(case.identified, case.vehicle, method)
            share, areas = signal_areas(case, model)
            found.append([areas[name] for name in names])
            rows.append([case.name, share, *found[-1]])
        rows.append(["mean", "", *np.nanmean(np.array(found, dtype=np.float64), axis=0).tolist()])
        columns = [
            Column("identified on → judged on", is_text=True),
            Column("samples missed", percent),
            *(Column(heading, "{:.2f}".format) for heading in names.values()),
        ]
        parts.append(f"**{method}**\n\n{markdown_table(Table(columns, rows))}")
    return "\n\n".join(parts)


@dataclass(frozen=True)
class Counts:
    """Alarms on flights on which there should be none.

    Attributes:
        hours: that the alarm judged.
        alarms: (2,) numbers of alarms of EXTRAPOLATION and MISCOVERAGE.
        early: those of them in the first :data:`EARLY_S`.
        warned: hours at a warning or an alarm of EXTRAPOLATION.
    """

    hours: float
    alarms: npt.NDArray[np.int64]
    early: int
    warned: float

    @classmethod
    def total(cls, parts: Sequence[Counts]) -> Counts:
        """All of several together."""
        return cls(*(sum(getattr(part, field.name) for part in parts) for field in fields(cls)))

    def row(self) -> list[str]:
        """Cells from the hours on."""
        count = int(self.alarms.sum())
        rates = [per_hour(number, self.hours) for number in (count, *poisson_interval(count))]
        mean, low, high = ("–" if rate is None else f"{rate:.2g}" for rate in rates)
        rate = f"{mean} ({low} to {high})"
        counts = map(str, (*self.alarms, self.early))
        return [f"{self.hours:.2f}", *counts, rate, f"{100.0 * self.warned / self.hours:.2g} %"]


def poisson_interval(count: int, confidence: float = 0.95) -> tuple[float, float]:
    """Confidence interval of the expected number from a Poisson count (Garwood 1936)."""
    tail = 0.5 * (1.0 - confidence)
    low = 0.5 * float(chi2.ppf(tail, 2 * count)) if count else 0.0
    return low, 0.5 * float(chi2.ppf(1.0 - tail, 2 * count + 2))


def count_alarms(replayed: Path) -> Counts:
    """Alarms in the bag of a replayed flight.

    Raises:
        ValueError: if the bag holds no alarm.
    """
    _, alarms = read_outputs(replayed)
    if alarms is None:
        raise ValueError(f"{replayed} holds no alarm")
    columns = [CAUSES.index(EXTRAPOLATION), CAUSES.index(MISCOVERAGE)]
    raised = (alarms.cause_level[:, columns] == LEVEL_ALARM).astype(np.int64)
    begins = np.diff(raised, axis=0, prepend=0) == 1
    start_ns, end_ns = int(alarms.time_ns[0]), int(alarms.time_ns[-1])
    hours = 1e-9 * (end_ns - start_ns) / 3600.0
    warned = alarm_time(alarms.time_ns, alarms.cause_level[:, columns[0]], end_ns, LEVEL_WARNING).fraction
    return Counts(
        hours=hours,
        alarms=begins.sum(axis=0),
        early=int(begins[alarms.time_ns < start_ns + round(1e9 * EARLY_S)].sum()),
        warned=hours * warned,
    )


def rates(job: Job) -> str:
    """False alarms of models of many and of few random flights, on others of their kind, by replay."""
    vehicle, rows = Vehicle.load(VEHICLE), []
    for kind in (ALIKE, VARIED):
        found: dict[int, list[Counts]] = {MANY: [], FEW: []}
        for seed in range(FIRST_SEED, FIRST_SEED + job.seeds):
            training = job.prepared(job.random_bags("rates", kind, 2 * seed, MANY), VEHICLE)
            bags = job.random_bags("unseen", kind, 2 * seed + 1, job.flights)
            for number, counts in found.items():
                model = model_of(training[:number], VEHICLE)
                replayed = job.work / "replayed"
                replay_all(model, vehicle, bags, replayed, workers=job.workers)
                parts = [count_alarms(replayed / bag.name) for bag in bags]
                counts.append(Counts.total(parts))
                print(f"{kind}, model {seed} of {number} flights: {counts[-1]}", flush=True)
        for number, counts in found.items():
            start = [kind, str(number)]
            rows += [[*start, str(seed), *count.row()] for seed, count in enumerate(counts, start=FIRST_SEED)]
            rows.append([*start, "all", *Counts.total(counts).row()])
    headings = (
        "identified on",
        "model",
        "unseen hours",
        "EXTRAPOLATION",
        "MISCOVERAGE",
        f"of these in the first {EARLY_S:g} s",
        "alarms per hour (95 %)",
        "warned",
    )
    return markdown_table(Table([Column("flights", is_text=True), *map(Column, headings)], rows))


TABLES: dict[str, Callable[[Job], str]] = {"rates": rates, "signals": signals}


def main(arguments: Sequence[str] | None = None) -> None:
    """Renew the page table by table, so that an interruption loses one at most."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=data_directory(), help="folder that holds neurobem/")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "alarm", help="for bags")
    parser.add_argument("--page", type=Path, default=PAGE, help="to renew")
    parser.add_argument("--only", choices=TABLES, action="append", help="this table; may be repeated")
    parser.add_argument(
        "--seeds", type=int, default=4, help="models of each kind whose false alarms are counted"
    )
    parser.add_argument("--flights", type=int, default=64, help="unseen ones for each of them")
    parser.add_argument("--flight-s", type=float, default=60.0, help="duration of a random flight")
    parser.add_argument("--no-ensembles", action="store_true", help="spare their training")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    options = parser.parse_args(arguments)
    job = Job(
        work=options.work.resolve(),
        data=options.data.resolve(),
        seeds=options.seeds,
        flights=options.flights,
        flight_s=options.flight_s,
        ensembles=not options.no_ensembles,
        workers=Workers(options.workers),
    )
    for name in [name for name in TABLES if not options.only or name in options.only]:
        renew(options.page, {name: f"{TABLES[name](job)}\n\n*{stamp()}*"})


if __name__ == "__main__":
    main()
