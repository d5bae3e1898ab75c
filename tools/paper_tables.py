# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew the tables of docs/paper-tables.md by running the commands that the page names.

The page is its own template: the text between `<!-- table: NAME -->` and `<!-- end -->` is replaced, all
other text is written by hand and kept. The same code and data give the same bytes.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter

from quadpi_core.evaluation.evaluation_result import Comparison
from quadpi_core.flight import AXES
from quadpi_core.models import AerodynamicModel
from quadpi_core.paper.published import METHODS
from quadpi_core.paper.validation_result import Validation
from quadpi_core.paths import data_directory, whole_output
from quadpi_core.report.comparison_page import comparison_table
from quadpi_core.report.left_out_tables import left_out_summary, left_out_table
from quadpi_core.report.model_tables import structure_table
from quadpi_core.report.table import markdown_table
from quadpi_core.report.validation_page import validation_table
from quadpi_core.version import __version__

Result = TypeVar("Result")

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "paper-tables.md"
SETTINGS = ("paper", "default")
# The folders that the numbers depend on; a table names the last commit that changed them.
SOURCES = ("quadpi_core", "config")
# The real flights by top speed in m/s, and the paper's groups of them.
FLIGHTS = {
    "3.5": "bemnn20210223104803seg2",
    "6.5": "bemnn20210218170320seg2",
    "11.3": "bemnn20210218171908seg2",
    "14.3": "bemnn20210218172600seg1",
}
GROUPS = {"identification": ("3.5", "11.3"), "interpolation": ("6.5",), "extrapolation": ("14.3",)}


class TablesError(Exception):
    """The page cannot be renewed; the message is one line."""


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
        # One thread, for sums over several are not the same bits on every machine.
        ran = subprocess.run(
            [sys.executable, "-m", "quadpi_core.cli", *words],
            cwd=ROOT,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
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


def validation(job: Job) -> str:
    """The two tables of the simulation, both settings."""
    results = []
    for settings in SETTINGS:
        folder = job.work / f"validation-{settings}"
        found = folder / "result.json"
        count = ("--realisations", job.realisations)
        job.quadpi("validate", "--settings", settings, *count, "-o", folder, "--json", found)
        results.append(_read(Validation, found))
    flights = len(results[0].flights)
    return "\n\n".join(
        [
            f"Realisations of the noise: {job.realisations}, on each of {flights} flights.",
            *(
                f"**{title}**\n\n{markdown_table(validation_table(results, axes, with_settings=True))}"
                for title, axes in (("Forces", AXES[:3]), ("Moments", AXES[3:]))
            ),
        ]
    )


def tunnel(job: Job) -> str:
    """The table of the wind tunnel, simulated."""
    folder = job.work / "tunnel"
    job.quadpi("evaluate", "-o", folder, "--json", folder / "result.json")
    return markdown_table(comparison_table(_read(Comparison, folder / "result.json")))


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
    results: dict[str, dict[str, Comparison]] = {}
    for speed, bag in bags.items():
        results[f"{speed} m/s"] = of_flight = {}
        for kind, options in (("fixed", ()), ("adaptive", ("--adaptive",))):
            found = place / speed / f"{kind}.json"
            job.quadpi("evaluate", *(folders[speed, m] for m in METHODS), bag, *options, "--json", found)
            of_flight[kind] = _read(Comparison, found)
    *slower, fastest = results
    inside = markdown_table(left_out_summary({flight: results[flight] for flight in slower}))
    return (
        f"{markdown_table(left_out_table(results))}\n\n"
        f"Without {fastest}, which no other flight comes near: least / mean coverage of the others · largest "
        "width."
        f"\n\n{inside}"
    )


def _read(kind: type[Result], file: Path) -> Result:
    """The result that a command wrote as JSON."""
    return TypeAdapter(kind).validate_json(file.read_bytes())


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


def replaced(page: str, name: str, content: str) -> str:
    """The page with other content of one table.

    Raises:
        TablesError: if the page has not exactly one place for it.
    """
    pattern = rf"(<!-- table: {re.escape(name)} -->\n).*?(<!-- end -->)"
    text, count = re.subn(pattern, lambda m: f"{m[1]}\n{content}\n\n{m[2]}", page, flags=re.DOTALL)
    if count != 1:
        raise TablesError(f"the page has {count} places `<!-- table: {name} -->`, expected one")
    return text


def stamp() -> str:
    """Version, and the commit that last changed what numbers depend on."""
    commit = _git("log", "-1", "--format=%h", "--", *SOURCES)
    changed = " with changes since" if _git("status", "--porcelain", "--", *SOURCES) else ""
    return f"quadpi {__version__}" + (f", commit {commit}{changed}" if commit else "")


def _git(*arguments: str) -> str:
    """What git prints; nothing outside a checkout."""
    ran = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return ran.stdout.strip()


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
            content = f"{TABLES[name](job)}\n\n*{stamp()}*"
            page = replaced(options.page.read_text(encoding="utf-8"), name, content)
            with whole_output(options.page) as temporary:
                temporary.write_text(page, encoding="utf-8")
    except TablesError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
