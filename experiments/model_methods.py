# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew results/models.md: every kind of model on real flights that it was not identified on.

Of each data set some flights are left out in turn, then the fastest together. What was found is kept by the
content of flights, settings and code, so that an interrupted run goes on where it was.
"""

from __future__ import annotations

import argparse
import ast
import functools
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from page_tables import RESULTS, ROOT, renew, stamp

from quadpi_core.errors import QuadpiError, one_line
from quadpi_core.evaluation.evaluate import predict_flight
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import LiveSamples, PreparedFlight, prepare_flights
from quadpi_core.logs.importing import import_logs
from quadpi_core.models.interval_rules import inside_interval
from quadpi_core.models.kind_registry import KINDS, kind_named
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.parallel import Workers
from quadpi_core.paths import data_directory, write_json
from quadpi_core.report.table import Column, Row, Table, markdown_table
from quadpi_core.vehicle import Vehicle

PAGE = RESULTS / "models.md"
CONFIDENCE = 0.95
# Flights of a data set, spread evenly over its speeds: all of the largest set would take half a day.
MOST_FLIGHTS = 6
# The fastest flights are those within this share of the greatest speed: repetitions of one trajectory.
FASTEST = 0.9
# Share of the samples of a flight that may be faster than its speed.
_FASTER = 0.001
# Networks are trained on this many samples a second: on all samples a model takes ten minutes of two cores,
# and each data set has up to seven of them.
NETWORK_HZ = 20.0
IN_TURN, FASTEST_OUT = "in turn", "the fastest"
BOTH = (IN_TURN, FASTEST_OUT)
REFERENCE = "polynomial"
# What `identify` finds in flights whose rotor speeds are wrong: they would judge the sensor.
SPOILED, SPOILED_WORDS = "stuck rotor", "a rotor reads the same for long in flight"
# A method whose intervals cover less is no default, however small its errors.
LEAST_COVERAGE = 0.90


@dataclass(frozen=True)
class DataSet:
    """Flights of one vehicle.

    Attributes:
        title: for people.
        pattern: of the logs in the folder of real flights.
        vehicle: its file.
        changes: of the numbers in that file, for a vehicle that differs from it in these alone.
        mapping: of columns, for tables.
        published: RMSE per axis of the data set's own model, [N, Nm]; empty where none is published.
        source: of that, in words.
    """

    title: str
    pattern: str
    vehicle: str
    changes: Mapping[str, float] = field(default_factory=dict)
    mapping: str | None = None
    published: tuple[float, ...] = ()
    source: str = ""


DATA_SETS = (
    DataSet(
        *("NeuroBEM", "neurobem/*.mat", "neurobem"),
        published=(0.187, 0.193, 0.612, 0.0097, 0.0105, 0.0053),
        source="the authors' blade elements and network, on all their 13 test flights after training on "
        "flights as fast",
    ),
    DataSet("Crazyflie, brushless", "imrc_brushless/*", "crazyflie_rpm"),
    DataSet("Crazyflie, brushed", "imrc_brushed/*", "crazyflie_rpm", {"mass_kg": 0.0347}),
    DataSet("Crazyflie, slung load", "imrc_payload/*", "crazyflie_rpm", {"mass_kg": 0.0397}),
    DataSet("nanodrone", "nanodrone/*.parquet", "nanodrone", mapping="nanodrone"),
    DataSet("IndiFlight", "indiflight/*.BFL", "indiflight"),
)


@dataclass(frozen=True)
class Judged:
    """What a model says of flights left out: root-mean-square error, coverage and mean width (6,) each."""

    rmse: list[float]
    coverage: list[float]
    width: list[float]

    @classmethod
    def mean(cls, flights: Sequence[Judged]) -> Judged:
        """Over flights, each counting the same; errors by their squares."""
        squares = np.mean(np.square([own.rmse for own in flights]), axis=0)
        coverage, width = (np.mean([getattr(own, name) for own in flights], axis=0) for name in _SHARES)
        return cls(np.sqrt(squares).tolist(), coverage.tolist(), width.tolist())


_SHARES = ("coverage", "width")


@dataclass(frozen=True)
class Case:
    """Flights that a model is identified on, and those left out that it is judged on."""

    name: str
    identified: tuple[PreparedFlight, ...]
    judged: tuple[PreparedFlight, ...]


@dataclass(frozen=True)
class Job:
    """What is asked for.

    Attributes:
        data: folder of real flights.
        work: folder of results and bags.
        methods: kinds of model.
        most_flights: of a data set.
        sets: to look at.
        kept: methods of which the results at hand are taken, and said so where they are of other code; the
            others are renewed.
    """

    data: Path
    work: Path
    methods: tuple[str, ...]
    most_flights: int = MOST_FLIGHTS
    sets: tuple[DataSet, ...] = DATA_SETS
    kept: tuple[str, ...] = ()


def is_spoiled(flight: PreparedFlight) -> bool:
    """Whether the rotor speeds of a flight are wrong."""
    return any(finding.mistake == SPOILED for finding in flight.quality.findings)


def speed(flight: PreparedFlight) -> float:
    """Airspeed [m/s] that a flight reaches."""
    return float(np.quantile(np.linalg.norm(flight.inputs[:, :3], axis=1), 1.0 - _FASTER))


def spread_over_speeds(flights: Sequence[PreparedFlight], most: int) -> list[PreparedFlight]:
    """At most so many flights, evenly from the slowest to the fastest, in order of speed."""
    ordered = sorted(flights, key=speed)
    places = np.unique(np.round(np.linspace(0, len(ordered) - 1, min(most, len(ordered)))).astype(int))
    return [ordered[place] for place in places]


def cases(flights: Sequence[PreparedFlight]) -> Iterator[Case]:
    """The fastest flights left out together, then each flight in turn; flights in order of speed."""
    limit = FASTEST * speed(flights[-1])
    slow = tuple(flight for flight in flights if speed(flight) < limit)
    yield Case(FASTEST_OUT, slow, tuple(flight for flight in flights if speed(flight) >= limit))
    for k, flight in enumerate(flights):
        yield Case(IN_TURN, (*flights[:k], *flights[k + 1 :]), (flight,))


def judge(case: Case, vehicle: Vehicle, method: str) -> list[Judged]:
    """A model of the flights of a case, on each of those left out.

    Raises:
        ModelError: for what cannot be identified.
    """
    identified = list(case.identified)
    if trains_networks(method):
        identified = [thinned(flight, NETWORK_HZ) for flight in identified]
    kind = kind_named(method)
    if any(option.name == "multi_step" for option in fields(kind)):
        # Takes most of the time, and changes predictions ahead alone, which are not judged here.
        changes: dict[str, Any] = {"multi_step": False}
        kind = replace(kind, **changes)
    options = IdentifyOptions(method=kind, confidence=CONFIDENCE)
    model = identify(identified, vehicle, load_pools("quadrotor"), options)
    found = []
    for flight in case.judged:
        result = predict_flight(model, flight, CONFIDENCE)
        error = result.measured - result.predicted
        inside = inside_interval(result.measured, result.lower, result.upper)
        found.append(
            Judged(
                np.sqrt(np.mean(np.square(error), axis=0)).tolist(),
                np.mean(inside, axis=0).tolist(),
                np.mean(result.upper - result.lower, axis=0).tolist(),
            )
        )
    return found


def trains_networks(method: str) -> bool:
    """Whether a kind of model imports the room that trains."""
    return any(name.startswith("quadpi_core.training") for name in imported(_module(method)))


def thinned(flight: PreparedFlight, rate_hz: float) -> PreparedFlight:
    """A flight with about so many samples a second."""
    live, stride = flight.live, max(1, round(1.0 / (float(np.median(np.diff(flight.time))) * rate_hz)))
    arrays: dict[str, Any] = {
        column.name: np.ascontiguousarray(values[::stride])
        for column in fields(flight)
        if isinstance(values := getattr(flight, column.name), np.ndarray)
    }
    return replace(
        flight,
        **arrays,
        live=None if live is None else LiveSamples(*(np.ascontiguousarray(own[::stride]) for own in live)),
    )


def _module(method: str) -> str:
    return type(kind_named(method)).__module__


@functools.cache
def imported(module: str) -> frozenset[str]:
    """The modules of the package that a module is made of: itself, and what they import, at any depth.

    Those that read flights are left out: results are kept by what was read.
    """
    found, left = {module}, [module]
    while left:
        for node in ast.walk(_parsed(left.pop())):
            if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("quadpi_core."):
                continue
            named = [f"{node.module}.{alias.name}" for alias in node.names]
            for name in {node.module or "", *named} - found:
                if name.split(".")[1] not in _READING and _file(name).is_file():
                    found.add(name)
                    left.append(name)
    return frozenset(found)


_READING = ("logs", "messages", "screening", "estimator", "monitor", "signals")


def _file(module: str) -> Path:
    return ROOT.joinpath(*module.split(".")).with_suffix(".py")


def _parsed(module: str) -> ast.Module:
    return ast.parse(_file(module).read_text())


@functools.cache
def code(method: str) -> str:
    """Hash of the code that a model of a method and its judgement depend on, words for people apart."""
    modules = imported(_module(method)) | imported(identify.__module__) | imported(predict_flight.__module__)
    digest = hashlib.sha256()
    for name in sorted(modules):
        tree = _parsed(name)
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node):
                node.body = node.body[1:]
        digest.update(f"{name}\0{ast.dump(tree)}".encode())
    return digest.hexdigest()


def content(flights: Sequence[PreparedFlight]) -> str:
    """Hash of flights as they were read."""
    digest = hashlib.sha256()
    for flight in flights:
        live = flight.judged
        for values in (flight.time, flight.inputs, flight.wrench, live.inputs, live.wrench, live.known):
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def outcome(job: Job, case: Case, vehicle: Vehicle, method: str) -> dict[str, Any] | None:
    """What was found for a case, now or earlier: `flights`, or the `error` that it ends with.

    None where results of the method are kept and this is not among them. It names the `code` that found it,
    and its `version` for people.
    """
    basis = [method, vehicle.fingerprint, content(case.identified), content(case.judged), NETWORK_HZ]
    key = hashlib.sha256(json.dumps(basis).encode()).hexdigest()[:24]
    file = job.work / "results" / f"{method}-{key}.json"
    if file.is_file():
        kept: dict[str, Any] = json.loads(file.read_text())
        if kept["code"] == code(method) or method in job.kept:
            return kept
    if method in job.kept:
        return None
    begin = perf_counter()
    found: dict[str, Any]
    try:
        found = {"flights": [asdict(own) for own in judge(case, vehicle, method)]}
    except QuadpiError as error:
        found = {"error": one_line(error)}
    found |= {"seconds": perf_counter() - begin, "code": code(method), "version": stamp()}
    file.parent.mkdir(parents=True, exist_ok=True)
    write_json(file, found)
    return found


@dataclass(frozen=True)
class Compared:
    """A data set with what each method says, by case and method.

    Attributes:
        data_set: looked at.
        judged: by case and method; only where every model of the case could be identified.
        flights: names of those that were used, in order of speed, and their greatest speed [m/s].
        fastest: number of the fastest, left out together.
        remarks: on flights and models that are missing.
        earlier: versions that kept results are from, by method.
    """

    data_set: DataSet
    judged: dict[tuple[str, str], Judged]
    flights: tuple[tuple[str, float], ...]
    fastest: int
    remarks: tuple[str, ...]
    earlier: Mapping[str, frozenset[str]] = field(default_factory=dict)


def flights_by_log(
    data_set: DataSet, data: Path, bags: Path
) -> tuple[dict[Path, PreparedFlight], Vehicle, dict[str, list[str]]]:
    """Flights of a data set by their log, or its bag in a folder; its vehicle; logs not read, by reason."""
    changes: dict[str, Any] = dict(data_set.changes)
    vehicle = replace(Vehicle.load(data_set.vehicle), **changes)
    flights, remarks = dict[Path, PreparedFlight](), dict[str, list[str]]()
    for log in sorted(data.glob(data_set.pattern)):
        try:
            path = log
            if data_set.mapping is not None:
                bags.mkdir(parents=True, exist_ok=True)
                path = import_logs([log], vehicle, bags, data_set.mapping, workers=Workers(1))[0].bag
            (flight,) = prepare_flights([path], vehicle, workers=Workers(1))
        except QuadpiError as error:
            why = one_line(error).replace(str(log), "").removeprefix(": ")
            remarks.setdefault(why, []).append(log.stem)
            continue
        if is_spoiled(flight):
            remarks.setdefault(SPOILED_WORDS, []).append(log.stem)
        else:
            flights[path] = flight
    return flights, vehicle, remarks


def read(job: Job, data_set: DataSet) -> tuple[list[PreparedFlight], Vehicle, list[str]]:
    """Flights of a data set, its vehicle, and what could not be read."""
    bags = job.work / "bags" / data_set.vehicle
    flights, vehicle, remarks = flights_by_log(data_set, job.data, bags)
    sentences = [f"{', '.join(names)}: {why}" for why, names in remarks.items()]
    if not flights and not remarks:
        sentences.append(f"no flights in {data_set.pattern} of the folder of real flights")
    return list(flights.values()), vehicle, sentences


def compared(job: Job, data_set: DataSet) -> Compared:
    """All methods on a data set."""
    everything, vehicle, remarks = read(job, data_set)
    if len(everything) < 3:
        if everything:
            remarks.append(f"{len(everything)} flights are too few to leave some out")
        return Compared(data_set, {}, (), 0, tuple(remarks))
    flights = spread_over_speeds(everything, job.most_flights)
    if len(flights) < len(everything):
        remarks.append(f"{len(flights)} of {len(everything)} flights, evenly over their speeds")
    judged, fastest, earlier = {}, 0, dict[str, frozenset[str]]()
    for method in job.methods:
        found: dict[str, list[Judged]] = {IN_TURN: [], FASTEST_OUT: []}
        errors: dict[str, str] = {}
        missing: list[str] = []
        for case in cases(flights):
            result = outcome(job, case, vehicle, method)
            names = ", ".join(flight.name for flight in case.judged)
            if case.name == FASTEST_OUT:
                fastest = len(case.judged)
            if result is None:
                missing.append(case.name)
                continue
            if result["code"] != code(method):
                earlier[method] = earlier.get(method, frozenset()) | {result["version"]}
            if "error" in result:
                errors[case.name] = f"without {names}: {result['error']}"
            else:
                found[case.name] += [Judged(**own) for own in result["flights"]]
                print(f"{data_set.title}: {method}: {names}: {result['seconds']:.0f} s", flush=True)
        for name, own in found.items():
            if name in missing:
                remarks.append(f"{method}, {name}: not computed")
            elif name in errors:
                remarks.append(f"{method}, {name}: {errors[name]}")
            elif own:
                judged[name, method] = Judged.mean(own)
    if others := [name for name in KINDS.names() if name not in job.methods]:
        remarks.append(f"{', '.join(others)}: not computed")
    spoken = tuple((flight.name, speed(flight)) for flight in flights)
    return Compared(data_set, judged, spoken, fastest, tuple(remarks), earlier)


def ratios(sets: Sequence[Compared], case: str, method: str) -> Array:
    """Errors over those of the reference, one for each axis and data set that both have."""
    found = [
        np.array(own.judged[case, method].rmse) / np.array(own.judged[case, REFERENCE].rmse)
        for own in sets
        if (case, method) in own.judged and (case, REFERENCE) in own.judged
    ]
    return np.array(found).reshape(-1, len(AXES))


def geometric(values: Array) -> float | None:
    """Geometric mean; None of nothing."""
    return float(np.exp(np.mean(np.log(values)))) if values.size else None


def summary(sets: Sequence[Compared], methods: Sequence[str]) -> Table:
    """One row per case and method, over all data sets."""
    rows: list[Row] = []
    for case in BOTH:
        for method in methods:
            own = [one.judged[case, method] for one in sets if (case, method) in one.judged]
            if not own:
                continue
            errors, coverage = ratios(sets, case, method), np.array([one.coverage for one in own])
            widths = [
                np.array(one.judged[case, method].width) / np.array(one.judged[case, REFERENCE].width)
                for one in sets
                if (case, method) in one.judged and (case, REFERENCE) in one.judged
            ]
            rows.append(
                [
                    *(case, method, str(len(own)), geometric(errors)),
                    *(float(errors.max()) if errors.size else None, geometric(np.array(widths))),
                    *(100.0 * float(coverage.mean()), 100.0 * float(coverage.min())),
                ]
            )
    share, percent = "{:.2f}".format, "{:.1f}".format
    return Table(
        [
            Column("left out", is_text=True),
            Column("method", is_text=True),
            Column("data sets"),
            Column(f"error / {REFERENCE}", share),
            Column("worst", share),
            Column(f"width / {REFERENCE}", share),
            Column("coverage %", percent),
            Column("least", percent),
        ],
        rows,
    )


def best(sets: Sequence[Compared], methods: Sequence[str]) -> str | None:
    """The method with the least errors on flights left out, of those that all data sets have and that cover.

    The geometric mean is over data sets, axes and both ways of leaving out, which count the same.
    """
    scores = {}
    whole = [own for own in sets if own.flights]
    for method in methods:
        if not whole or any((case, method) not in own.judged for own in whole for case in BOTH):
            continue
        coverage = np.mean([own.judged[IN_TURN, method].coverage for own in whole])
        errors = np.array([ratios(whole, case, method) for case in BOTH])
        if coverage >= LEAST_COVERAGE:
            scores[method] = geometric(errors)
    return min(scores, key=lambda name: scores[name] or np.inf) if scores else None


def table_of(own: Compared, methods: Sequence[str]) -> Table:
    """Error, coverage and width of each method on each axis."""
    rows: list[Row] = []
    for case in BOTH:
        for method in methods:
            if (case, method) not in own.judged:
                continue
            judged = own.judged[case, method]
            rows.append([case, method, "RMSE", *(f"{value:.3g}" for value in judged.rmse)])
            rows.append([case, method, "coverage %", *(f"{100.0 * value:.1f}" for value in judged.coverage)])
            rows.append([case, method, "width", *(f"{value:.3g}" for value in judged.width)])
    if own.data_set.published:
        rows.append(["", "published", "RMSE", *(f"{value:.3g}" for value in own.data_set.published)])
    headings = (Column("left out", is_text=True), Column("method", is_text=True), Column("", is_text=True))
    return Table([*headings, *(Column(axis) for axis in AXES)], rows)


def section(own: Compared, methods: Sequence[str]) -> str:
    """A data set on the page."""
    parts = [f"### {own.data_set.title}"]
    if own.flights:
        names = ", ".join(f"{name} ({top:.1f})" for name, top in own.flights)
        parts.append(
            f"Flights by their greatest speed in m/s: {names}. The fastest, left out together: {own.fastest}."
        )
        parts.append(markdown_table(table_of(own, methods)))
    if own.data_set.published:
        parts.append(f"Published: {own.data_set.source}.")
    if own.remarks:
        parts.append("\n".join(f"- {remark}" for remark in own.remarks))
    return "\n\n".join(parts)


def tables(job: Job) -> dict[str, str]:
    """The tables of the page by their names."""
    sets = [compared(job, data_set) for data_set in job.sets]
    chosen = best(sets, job.methods)
    said = "No method has results on all data sets." if chosen is None else f"Best: **{chosen}**."
    dated = [stamp()]
    for method in job.methods:
        versions = frozenset[str]().union(*(own.earlier.get(method, ()) for own in sets))
        if versions:
            commits = sorted(version.partition("commit ")[2] or version for version in versions)
            dated.append(f"{method}: {', '.join(commits)}")
    return {
        "summary": f"{markdown_table(summary(sets, job.methods))}\n\n{said}\n\n*{'; '.join(dated)}*",
        "sets": "\n\n".join(section(own, job.methods) for own in sets),
    }


def parser_of(description: str | None, page: Path, work: str) -> argparse.ArgumentParser:
    """Command line of a script that goes through :data:`DATA_SETS` and renews a page."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--data", type=Path, default=data_directory(), help="folder of real flights")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / work, help="for bags and results")
    parser.add_argument("--page", type=Path, default=page, help="to renew")
    parser.add_argument("--only", default="", help="data sets whose title contains this")
    return parser


def main(arguments: Sequence[str] | None = None) -> None:
    """Renew the page."""
    parser = parser_of(__doc__, PAGE, "models")
    parser.add_argument("--methods", default=",".join(KINDS.names()), help="with commas")
    parser.add_argument("--flights", type=int, default=MOST_FLIGHTS, help="of a data set, at most")
    parser.add_argument(
        "--keep", default="", help="methods whose results at hand are taken as they are, none computed"
    )
    options = parser.parse_args(arguments)
    job = Job(
        options.data.resolve(),
        options.work.resolve(),
        tuple(options.methods.split(",")),
        options.flights,
        tuple(own for own in DATA_SETS if options.only in own.title),
        tuple(options.keep.split(",")),
    )
    renew(options.page, tables(job))


if __name__ == "__main__":
    main()
