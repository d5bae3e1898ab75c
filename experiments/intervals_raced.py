# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew results/intervals-raced.md: intervals of this package against others, on the same errors.

The flights of a data set are left out in four turns, and the model of the others predicts them as the live
path would. What it errs is kept in the work folder: delete that where a model has changed.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from interval_rivals import ALPHA, RULES, Race, Said
from model_methods import (
    CONFIDENCE,
    DATA_SETS,
    NETWORK_HZ,
    DataSet,
    Job,
    geometric,
    read,
    spread_over_speeds,
    thinned,
    trains_networks,
)
from numpy.typing import NDArray
from page_tables import RESULTS, ROOT, renew, stamp
from region_rivals import REGIONS, RegionResult, region_result

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.interval_rules import FEWEST_INSIDE, delay, inside_range
from quadpi_core.models.kind_registry import kind_named
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.paths import data_directory
from quadpi_core.report.table import Column, Row, Table, markdown_table
from quadpi_core.vehicle import Vehicle

PAGE = RESULTS / "intervals-raced.md"
METHODS = ("physical", "polynomial", "bootstrap")
RATES_HZ = (10.0, 50.0, 500.0)
# All flights but of a few sets with more, and turns in which they are left out.
MOST_FLIGHTS, TURNS = 40, 4
WINDOW_S = 2.0
# The winner is chosen on these and judged on the others; named before those were raced.
CHOSEN_ON = ("Crazyflie, brushless", "Crazyflie, brushed", "nanodrone")
SPLIT, OWN = "split conformal", "own"
# What a winner must cover, in how many of flights and axes [%], in the whole and in the worst window.
COVERED, WORST_COVERED, FLIGHTS_PERCENT = 0.93, 0.80, 95.0


@dataclass(frozen=True, eq=False)
class Errors:
    """What a model errs on a flight that it was identified without, as the live path has it.

    Attributes:
        turn: in which it was left out.
        rate_hz: of its samples.
        error: (N, 6) measured − centre of the interval, N and Nm.
        half: (N, 6) half width of the model's own interval.
        speed: (N,) m/s.
        inside: (N,) whether every input lies in the range of the flights of the model.
    """

    turn: int
    rate_hz: float
    error: Array
    half: Array
    speed: Array
    inside: NDArray[np.bool_]


def model_of(flights: Sequence[PreparedFlight], vehicle: Vehicle, method: str) -> AerodynamicModel:
    """A model in default settings, less the fit over several steps, which changes predictions ahead alone."""
    kind = kind_named(method)
    if any(option.name == "multi_step" for option in fields(kind)):
        changes: dict[str, Any] = {"multi_step": False}
        kind = replace(kind, **changes)
    if trains_networks(method):
        flights = [thinned(flight, NETWORK_HZ) for flight in flights]
    options = IdentifyOptions(method=kind, confidence=CONFIDENCE)
    return identify(flights, vehicle, load_pools("quadrotor"), options)


def errors_of(flights: Sequence[PreparedFlight], vehicle: Vehicle, method: str, turn: int) -> list[Errors]:
    """Errors on the flights of a turn of a model of the others."""
    others = [flight for k, flight in enumerate(flights) if k % TURNS != turn]
    model, inputs = model_of(others, vehicle, method), np.concatenate([own.inputs for own in others])
    found = []
    for flight in flights[turn::TURNS]:
        live, known = flight.judged, flight.judged.known
        said = model.evaluate(live.inputs[known], CONFIDENCE, live.derivatives[known])
        found.append(
            Errors(
                turn,
                1.0 / float(np.median(np.diff(flight.time))),
                live.wrench[known] - 0.5 * (said.lower + said.upper),
                0.5 * (said.upper - said.lower),
                np.linalg.norm(live.inputs[known, :3], axis=1),
                inside_range(live.inputs[known], inputs),
            )
        )
    return found


def errors_file(job: Job, data_set: DataSet, method: str) -> Path:
    """Where the errors of a method on a data set are kept."""
    return job.work / "errors" / f"{data_set.title}-{method}.npz".replace(", ", "-").replace(" ", "-")


def errors_on(job: Job, data_set: DataSet, method: str) -> list[Errors]:
    """Errors of a method on all flights of a data set, computed once."""
    file = errors_file(job, data_set, method)
    if not file.is_file():
        everything, vehicle, _ = read(job, data_set)
        own = spread_over_speeds(everything, job.most_flights)
        found = [one for turn in range(min(TURNS, len(own))) for one in errors_of(own, vehicle, method, turn)]
        file.parent.mkdir(parents=True, exist_ok=True)
        arrays = {f"{k}:{c.name}": getattr(one, c.name) for k, one in enumerate(found) for c in fields(one)}
        np.savez(file, **arrays)
    with np.load(file) as kept:
        names = [one.name for one in fields(Errors)]
        flights = range(len(kept.files) // len(names))
        return [Errors(**{name: kept[f"{k}:{name}"][()] for name in names}) for k in flights]


def race_of(flights: Sequence[Errors], rate_hz: float) -> tuple[Race, int]:
    """All flights at about a rate, and the stride."""
    step = max(round(flights[0].rate_hz / rate_hz), 1)
    rate, length = flights[0].rate_hz / step, max(len(one.error[::step]) for one in flights)
    error, half = (np.full((length, len(flights), len(AXES)), value) for value in (np.nan, 1.0))
    speed = np.full((length, len(flights)), np.nan)
    for k, one in enumerate(flights):
        rows = slice(len(one.error[::step]))
        error[rows, k], half[rows, k], speed[rows, k] = (
            of[::step] for of in (one.error, one.half, one.speed)
        )
    return Race(error, half, speed, np.array([one.turn for one in flights]), rate, delay(rate)), step


@dataclass(frozen=True, eq=False)
class Result:
    """Of a rule on a data set, a method and a rate.

    Attributes:
        winkler, width: (6,) means over flights.
        coverage, worst: of flights mostly inside the ranges of their model: inside, and least over WINDOW_S.
        micros: time a sample of six axes, learning included [µs].
    """

    winkler: Array
    width: Array
    coverage: Array
    worst: Array
    micros: float


def scored(race: Race, said: Said, flights: Sequence[Errors], step: int) -> Result:
    """How good intervals are."""
    winkler, width, coverage, worst = [], [], [], []
    window = round(WINDOW_S * race.rate_hz)
    for k, flight in enumerate(flights):
        rows = np.isfinite(race.error[:, k, 0])
        off, half = np.abs(race.error[rows, k] - said.centre[rows, k]), said.half[rows, k]
        winkler.append(np.mean(2.0 * half + 2.0 / ALPHA * np.maximum(off - half, 0.0), axis=0))
        width.append(2.0 * np.mean(half, axis=0))
        held, inside = off <= half, flight.inside[::step]
        if np.mean(inside) >= FEWEST_INSIDE:
            coverage.append(np.mean(held[inside], axis=0))
            sums = np.concatenate((np.zeros((1, len(AXES))), np.cumsum(held, axis=0)))
            length = min(window, len(held))
            worst.append(np.min(sums[length:] - sums[:-length], axis=0) / length)
    return Result(np.mean(winkler, axis=0), np.mean(width, axis=0), np.ravel(coverage), np.ravel(worst), 0.0)


def raced(flights: Sequence[Errors], rate_hz: float) -> dict[str, Result]:
    """All rules on the errors of a method on a data set."""
    race, step = race_of(flights, rate_hz)
    results = {}
    for name, rule in RULES.items():
        begin = perf_counter()
        said = rule(race)
        micros = 1e6 * (perf_counter() - begin) / int(np.isfinite(race.error[..., 0]).sum())
        results[name] = replace(scored(race, said, flights, step), micros=micros)
    return results


@dataclass(frozen=True)
class Entry:
    """One race: the results of all rules."""

    data_set: str
    method: str
    rate_hz: float
    results: Mapping[str, Result]

    def ratio(self, rule: str) -> float:
        """Winkler score of a rule over that of split conformal, geometric mean over the axes."""
        ratio = geometric(self.results[rule].winkler / self.results[SPLIT].winkler)
        assert ratio is not None
        return ratio


def ratio(entries: Sequence[Entry], rule: str) -> float | None:
    """Geometric mean over races, in which data sets count the same."""
    titles = {own.data_set for own in entries}
    each = [[own.ratio(rule) for own in entries if own.data_set == name] for name in titles]
    return geometric(np.array([geometric(np.array(own)) for own in each]))


def shares(entries: Sequence[Entry], rule: str) -> list[float]:
    """Shares [%] of flights and axes that are covered, and whose worst window is."""
    results = [own.results[rule] for own in entries]
    covered = np.concatenate([own.coverage for own in results]) >= COVERED
    worst = np.concatenate([own.worst for own in results]) >= WORST_COVERED
    return [100.0 * float(np.mean(each)) for each in (covered, worst)]


def winner(entries: Sequence[Entry]) -> str:
    """The rule of the least Winkler score on the sets that are chosen on, of those that cover."""
    chosen_on = [own for own in entries if own.data_set in CHOSEN_ON]
    covering = [name for name in RULES if min(shares(chosen_on, name)) >= FLIGHTS_PERCENT]
    return min(covering, key=lambda name: ratio(chosen_on, name) or np.inf)


_ONE, _TWO, _PERCENT = "{:.1f}".format, "{:.2f}".format, "{:.0f}".format
_COVERS = (Column("flights ≥ 93 %", _PERCENT), Column("worst 2 s ≥ 80 %", _PERCENT))


def summary(entries: Sequence[Entry]) -> str:
    """All rules, on the sets that the winner is chosen on and on those that it is judged on."""
    rows: list[Row] = []
    chosen_on = [own for own in entries if own.data_set in CHOSEN_ON]
    judged = [own for own in entries if own.data_set not in CHOSEN_ON]
    for name in RULES:
        widths = [own.results[name].width / own.results[SPLIT].width for own in judged]
        coverage = np.concatenate([own.results[name].coverage for own in judged])
        micros = [float(own.results[name].micros) for own in entries if own.rate_hz == RATES_HZ[-1]]
        rows.append(
            [
                *(name, ratio(chosen_on, name), *shares(chosen_on, name)),
                *(ratio(judged, name), *shares(judged, name), 100.0 * float(coverage.mean())),
                *(geometric(np.array(widths)), float(np.median(micros))),
            ]
        )
    columns = [
        *(Column("rule", is_text=True), Column("chosen on: score", _TWO), *_COVERS),
        *(Column("judged on: score", _TWO), *_COVERS, Column("coverage %", _ONE)),
        *(Column("width", _TWO), Column("µs", _PERCENT)),
    ]
    return f"{markdown_table(Table(columns, rows))}\n\nChosen: **{winner(entries)}**."


def by_set(entries: Sequence[Entry]) -> str:
    """Each race: split conformal is 1."""
    best, rows = winner(entries), list[Row]()
    others = [name for name in RULES if not name.startswith((OWN, "state space"))]
    for own in entries:
        covering = [name for name in others if min(shares([own], name)) >= FLIGHTS_PERCENT]
        told = [min(names, key=own.ratio, default=None) for names in (covering, others)]
        rows.append(
            [
                *(own.data_set, own.method, f"{own.rate_hz:g}", own.ratio(OWN)),
                *(own.ratio(best), *shares([own], best)),
                *("–" if name is None else f"{own.ratio(name):.2f} {name}" for name in told),
            ]
        )
    columns = [Column(heading, is_text=True) for heading in ("data set", "method")]
    columns += [Column("Hz"), Column(OWN, _TWO), Column(best, _TWO), *_COVERS]
    columns += [Column(f"best of others{which}", is_text=True) for which in (" that covers", "")]
    return markdown_table(Table(columns, rows))


def by_method(entries: Sequence[Entry]) -> str:
    """The models' own intervals, on the data sets that all methods have."""
    rows: list[Row] = []
    methods = dict.fromkeys(own.method for own in entries)
    by_name = {(own.method, own.data_set): own for own in entries if own.rate_hz == RATES_HZ[1]}
    titles = [one.title for one in DATA_SETS if all((method, one.title) in by_name for method in methods)]
    for method in methods:
        each = [by_name[method, title] for title in titles]
        values = np.concatenate([own.results[OWN].coverage for own in each])
        first = [by_name[METHODS[0], title].results[OWN].winkler for title in titles]
        scores = [own.results[OWN].winkler / one for own, one in zip(each, first, strict=True)]
        rows.append([method, geometric(np.array(scores)), 100.0 * float(values.mean()), *shares(each, OWN)])
    columns = [
        Column("method", is_text=True),
        Column(f"score / {METHODS[0]}", _TWO),
        Column("coverage %", _ONE),
    ]
    return f"{markdown_table(Table([*columns, *_COVERS], rows))}\n\nOn {', '.join(titles)}."


def joint(job: Job, titles: Sequence[str]) -> str:
    """Regions of all axes at once, of the physical model at 50 Hz, by rule over all data sets."""
    found: dict[str, list[RegionResult]] = {}
    for data_set in DATA_SETS:
        if data_set.title not in titles:
            continue
        race, _ = race_of(errors_on(job, data_set, METHODS[0]), RATES_HZ[1])
        for name, rule in REGIONS.items():
            found.setdefault(name, []).append(region_result(rule(race), round(WINDOW_S * race.rate_hz)))
    first = next(iter(found.values()))
    rows: list[Row] = []
    for name, results in found.items():
        widths = [
            float(np.mean(own.width)) / float(np.mean(one.width))
            for own, one in zip(results, first, strict=True)
        ]
        coverage, worst = (np.concatenate([getattr(o, n) for o in results]) for n in ("coverage", "worst"))
        held = [100.0 * float(np.mean(of >= at)) for of, at in ((coverage, COVERED), (worst, WORST_COVERED))]
        rows.append([name, geometric(np.array(widths)), 100.0 * float(coverage.mean()), *held])
    columns = [Column("region", is_text=True), Column("width", _TWO), Column("coverage %", _ONE), *_COVERS]
    return f"{markdown_table(Table(columns, rows))}\n\nOn {', '.join(titles)}."


def main(arguments: Sequence[str] | None = None) -> None:
    """Race, and renew the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=data_directory(), help="folder of real flights")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "intervals", help="for errors and races")
    parser.add_argument("--page", type=Path, default=PAGE, help="to renew")
    parser.add_argument("--methods", default=",".join(METHODS), help="kinds of model, separated by commas")
    parser.add_argument("--kept", action="store_true", help="only what has errors in the work folder")
    options = parser.parse_args(arguments)
    job = Job(options.data.resolve(), options.work.resolve(), tuple(options.methods.split(",")), MOST_FLIGHTS)
    entries = [
        Entry(data_set.title, method, rate_hz, raced(errors_on(job, data_set, method), rate_hz))
        for method in job.methods
        for data_set in DATA_SETS
        if not options.kept or errors_file(job, data_set, method).is_file()
        for rate_hz in (RATES_HZ if method == METHODS[0] else RATES_HZ[1:2])
    ]
    tables = {"rules": summary(entries), "races": by_set(entries), "methods": by_method(entries)}
    titles = dict.fromkeys(entry.data_set for entry in entries if entry.method == METHODS[0])
    tables["regions"] = joint(job, list(titles))
    renew(options.page, {name: f"{table}\n\n*{stamp()}*" for name, table in tables.items()})


if __name__ == "__main__":
    main()
