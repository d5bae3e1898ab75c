# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew the tables of results/paper-tables.md: the paper's experiments simulated, and on real flights.

The same code and data give the same bytes.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist, fmean
from typing import NamedTuple, ParamSpec, TypeVar

from page_tables import RESULTS, ROOT, TablesError, renew, stamp
from paper import published
from paper.numbers import METHODS
from paper.published import SETTINGS
from paper.result_tables import tunnel_table, validation_table

from quadpi_core.config_schema import check_config
from quadpi_core.errors import QuadpiError
from quadpi_core.evaluation.evaluation_result import AxisMetrics, Comparison
from quadpi_core.flight import AXES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.paths import data_directory
from quadpi_core.report.comparison_page import comparison_table
from quadpi_core.report.info_tables import structure_table
from quadpi_core.report.table import Column, Table, markdown_table

Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")

PAGE = RESULTS / "paper-tables.md"
# The real flights by top speed in m/s, and the paper's groups of them.
FLIGHTS = {
    "3.5": "bemnn20210223104803seg2",
    "6.5": "bemnn20210218170320seg2",
    "11.3": "bemnn20210218171908seg2",
    "14.3": "bemnn20210218172600seg1",
}
GROUPS = {"identification": ("3.5", "11.3"), "interpolation": ("6.5",), "extrapolation": ("14.3",)}
# Sums over several threads are not the same bits on every machine.
ONE_THREAD = {"OMP_NUM_THREADS": "1"}


@dataclass(frozen=True)
class Job:
    """Where results lie and how much is asked for.

    Attributes:
        work: folder of bags, models and JSON.
        data: folder that holds `neurobem`.
        realisations: of the noise in the validation.
    """

    work: Path
    data: Path
    realisations: int

    def quadpi(self, *arguments: object) -> None:
        """Run a command.

        Raises:
            TablesError: if it fails.
        """
        words = [str(argument) for argument in arguments]
        print(f"quadpi {' '.join(words)}\n", end="", flush=True)
        ran = subprocess.run(
            [sys.executable, "-m", "quadpi_core.cli", *words],
            cwd=ROOT,
            env=os.environ | ONE_THREAD,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
        if ran.returncode:
            raise TablesError(f"quadpi {words[0]}: {ran.stderr.strip()}")

    def all_of(self, commands: Iterable[Sequence[object]]) -> None:
        """Run commands that do not depend on each other, one per core at a time."""
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(lambda command: self.quadpi(*command), commands))

    def bags(self) -> dict[str, Path]:
        """The real flights by speed."""
        folder = self.work / "neurobem" / "bags"
        logs = [self.data / "neurobem" / f"{name}.mat" for name in FLIGHTS.values()]
        self.quadpi("import", *logs, "--vehicle", "neurobem", "-o", folder)
        return {speed: folder / f"{name}.mcap" for speed, name in FLIGHTS.items()}


def in_one_thread(
    work: Callable[Arguments, Result], *arguments: Arguments.args, **options: Arguments.kwargs
) -> Result:
    """What a function returns, called in a new process whose mathematics have one thread."""
    os.environ.update(ONE_THREAD)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        return process.submit(work, *arguments, **options).result()


def validation(job: Job) -> str:
    """The two tables of the simulation, both settings."""
    found = {}
    for settings in SETTINGS:
        print(f"validation, {settings} settings", flush=True)
        folder = job.work / f"validation-{settings}"
        found[settings] = in_one_thread(published.validate, settings, job.realisations, folder)
    flights = len(found[SETTINGS[0]].result.flights)
    return "\n\n".join(
        [
            f"Realisations of the noise: {job.realisations}, on each of {flights} flights.",
            *(
                f"**{title}**\n\n{markdown_table(validation_table(found, axes))}"
                for title, axes in (("Forces", AXES[:3]), ("Moments", AXES[3:]))
            ),
        ]
    )


def tunnel(job: Job) -> str:
    """The table of the wind tunnel, simulated."""
    print("wind tunnel", flush=True)
    return markdown_table(tunnel_table(in_one_thread(published.tunnel_comparison, job.work / "tunnel")))


def simulation_structures(job: Job) -> str:
    """Polynomials of the simulated vehicle, from the models that the validation kept."""
    return _structures({s: job.work / f"validation-{s}" / "models" / "polynomial" for s in SETTINGS})


def tunnel_structures(job: Job) -> str:
    """Polynomials of the HDBeetle, from the models that the wind tunnel kept."""
    return _structures({s: job.work / "tunnel" / "models" / f"polynomial-{s}" for s in SETTINGS})


def _structures(folders: dict[str, Path]) -> str:
    """The terms of a polynomial of each settings, three axes side by side as in the paper."""
    parts = []
    for settings, folder in folders.items():
        model = AerodynamicModel.load(folder)
        tables = [model.axes[start : start + 3] for start in range(0, len(model.axes), 3)]
        parts += [f"**{settings} settings**"]
        parts += [markdown_table(structure_table(model.selection, axes)) for axes in tables]
    return "\n\n".join(parts)


def neurobem(job: Job) -> str:
    """The three groups on real flights."""
    bags = job.bags()
    learned = [bags[speed] for speed in GROUPS["identification"]]
    folders = {(m, s): job.work / "neurobem" / f"{m}-{s}" for m in METHODS for s in SETTINGS}
    job.all_of(
        ("identify", *learned, *_kind(method, settings), "-o", folder)
        for (method, settings), folder in folders.items()
    )
    groups = [
        word
        for name, speeds in GROUPS.items()
        for word in ("--group", f"{name}={','.join(str(bags[speed]) for speed in speeds)}")
    ]
    found = job.work / "neurobem" / "groups.json"
    job.quadpi("evaluate", *folders.values(), *groups, "--json", found)
    return markdown_table(comparison_table(_read(Comparison, found)))


def left_out(job: Job) -> str:
    """Every real flight by models of the others."""
    bags = job.bags()
    place = job.work / "neurobem" / "left-out"
    folders = {(speed, method): place / speed / method for speed in bags for method in METHODS}
    job.all_of(
        ("identify", *_others(bags, speed), *_kind(method, "default"), "-o", folder)
        for (speed, method), folder in folders.items()
    )
    results = []
    for speed, bag in bags.items():
        by_kind = []
        for kind, options in (("fixed", ()), ("adaptive", ("--adaptive",))):
            found = place / speed / f"{kind}.json"
            job.quadpi("evaluate", *(folders[speed, m] for m in METHODS), bag, *options, "--json", found)
            by_kind.append(left_out_results(f"{speed} m/s", kind, _read(Comparison, found)))
        results += [result for of_model in zip(*by_kind, strict=True) for result in of_model]
    fastest = results[-1].flight
    inside = left_out_summary([result for result in results if result.flight != fastest])
    return (
        f"{markdown_table(left_out_table(results))}\n\n"
        f"Without {fastest}, which no other flight comes near: least / mean coverage of the others · largest "
        "width."
        f"\n\n{markdown_table(inside)}"
    )


class LeftOut(NamedTuple):
    """A flight judged by a model of the others.

    Attributes:
        flight, model: names.
        intervals: "fixed" or "adaptive".
        confidence: nominal coverage of the intervals.
        axes: metrics by axis.
    """

    flight: str
    model: str
    intervals: str
    confidence: float
    axes: Mapping[str, AxisMetrics]

    def width_ratio(self, axis: str) -> float:
        """Mean width over that of a perfect constant interval on normal errors of the same RMSE."""
        metrics = self.axes[axis]
        return metrics.mpiw / (2.0 * NormalDist().inv_cdf(0.5 + 0.5 * self.confidence) * metrics.rmse)


def left_out_results(flight: str, intervals: str, found: Comparison) -> list[LeftOut]:
    """The results of all models on one flight."""
    return [
        LeftOut(flight, name, intervals, found.confidence, model.groups["all"].axes)
        for name, model in found.models.items()
    ]


def left_out_table(results: Sequence[LeftOut]) -> Table:
    """Coverage in percent on each flight, and mean width over that of an ideal constant interval."""
    axes = _axes_of(results)
    rows = [
        [
            *(result.flight, result.model, result.intervals),
            *(
                f"{100.0 * result.axes[axis].picp:.1f} · {result.width_ratio(axis):.2f}"
                if axis in result.axes
                else None
                for axis in axes
            ),
        ]
        for result in results
    ]
    headings = (Column(name, is_text=True, once=True) for name in ("flight", "model"))
    return Table([*headings, Column("intervals", is_text=True), *map(Column, axes)], rows)


def left_out_summary(results: Sequence[LeftOut]) -> Table:
    """Least and mean coverage over flights, and the largest width over that of an ideal constant interval."""
    axes = _axes_of(results)
    rows = []
    for model, intervals in dict.fromkeys((result.model, result.intervals) for result in results):
        own = [result for result in results if (result.model, result.intervals) == (model, intervals)]
        cells = []
        for axis in axes:
            held = [result for result in own if axis in result.axes]
            coverage = [100.0 * result.axes[axis].picp for result in held]
            widest = max((result.width_ratio(axis) for result in held), default=0.0)
            cells.append(f"{min(coverage):.1f} / {fmean(coverage):.1f} · {widest:.2f}" if held else None)
        rows.append([model, intervals, *cells])
    headings = Column("model", is_text=True, once=True), Column("intervals", is_text=True)
    return Table([*headings, *map(Column, axes)], rows)


def _axes_of(results: Sequence[LeftOut]) -> list[str]:
    """Axes that some model holds."""
    return [axis for axis in AXES if any(axis in result.axes for result in results)]


def _read(kind: type[Result], file: Path) -> Result:
    """The result that a command wrote as JSON."""
    return check_config(kind, json.loads(file.read_bytes()))


def _others(bags: dict[str, Path], speed: str) -> list[Path]:
    return [bag for other, bag in bags.items() if other != speed]


def _kind(method: str, settings: str) -> tuple[str, ...]:
    return ("--vehicle", "neurobem", "--method", method, "--settings", settings)


# In the order in which they are made: structures come from the models of the tables before them.
TABLES: dict[str, Callable[[Job], str]] = {
    "validation": validation,
    "simulation-structures": simulation_structures,
    "tunnel": tunnel,
    "tunnel-structures": tunnel_structures,
    "neurobem": neurobem,
    "left-out": left_out,
}
ON_REAL_FLIGHTS = ("neurobem", "left-out")


def main() -> None:
    """Renew the page table by table, so that an interruption loses one at most."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=data_directory(), help="folder that holds neurobem/")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "tables", help="for bags, models, JSON")
    parser.add_argument("--page", type=Path, default=PAGE, help="to renew")
    parser.add_argument("--only", choices=TABLES, action="append", help="this table; may be repeated")
    parser.add_argument("--realisations", type=int, default=1000, help="of the noise in the validation")
    options = parser.parse_args()
    job = Job(options.work.resolve(), options.data.resolve(), options.realisations)
    try:
        for name in [name for name in TABLES if not options.only or name in options.only]:
            if name in ON_REAL_FLIGHTS and not (job.data / "neurobem").is_dir():
                print(f"table {name} stays as it is: no flights in {job.data / 'neurobem'} (--data FOLDER)")
                continue
            renew(options.page, {name: f"{TABLES[name](job)}\n\n*{stamp()}*"})
    except (TablesError, QuadpiError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
