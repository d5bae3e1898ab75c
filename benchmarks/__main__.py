# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Run benchmarks, show them in one table, write out/bench.json and, of a whole run, the page of results."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import pkgutil
import platform
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from rich.console import Console, Group
from rich.text import Text

import benchmarks
from benchmarks import Result, UnavailableError
from quadpi_core.paths import write_json
from quadpi_core.report.table import Cell, Column, Mark, Row, Table, markdown_table, terminal_table

OUTPUT = Path("out") / "bench.json"
PAGE = Path("experiments") / "results" / "performance.md"
_PAGE_TEXT = """# How fast it is

Made by `make bench`: every figure is measured in the same run as what it is compared with, as machines
differ and are rarely quiet. This run: {machine}. {failures}

{table}

What each was measured against, and on what:

{notes}
"""


def main() -> int:
    """Give 0 if every benchmark ran or was skipped, 1 if one failed, 2 for an unknown name."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--only", metavar="NAME", help="a figure, or a file of this folder without .py")
    only = parser.parse_args().only
    modules = [module for module in find_modules() if only is None or only in {*module.NAMES, stem(module)}]
    if not modules:
        known = ", ".join(name for module in find_modules() for name in module.NAMES)
        print(f"no benchmark {only!r}; known: {known}", file=sys.stderr)
        return 2
    console = Console()
    results: list[Result] = []
    remarks: dict[str, str] = {}
    failed = False
    for module in modules:
        with console.status(f"{stem(module)} …"):
            try:
                results += module.run()
            except UnavailableError as reason:
                remarks[stem(module)] = f"skipped: {reason}"
            except Exception as error:  # one broken benchmark must not take the others' figures along
                failed = True
                remarks[stem(module)] = f"failed: {type(error).__name__}: {error}"
    console.print(summary(results, remarks))
    # One benchmark alone renews its own figures and leaves the others'.
    earlier = json.loads(OUTPUT.read_text()) if only is not None and OUTPUT.is_file() else {}
    write_json(OUTPUT, earlier | as_json(results))
    console.print(f"written to {OUTPUT}")
    if only is None:
        PAGE.write_text(as_page(results, remarks))
        console.print(f"written to {PAGE}")
    return 1 if failed else 0


def find_modules() -> Iterator[ModuleType]:
    """The modules of this package that measure something."""
    for info in pkgutil.iter_modules(benchmarks.__path__, prefix="benchmarks."):
        if not info.name.endswith("__main__"):
            module = importlib.import_module(info.name)
            if hasattr(module, "NAMES"):
                yield module


def stem(module: ModuleType) -> str:
    """Name of the file."""
    return module.__name__.rpartition(".")[2]


def as_json(results: list[Result]) -> dict[str, dict[str, object]]:
    """Figures by name."""
    return {
        result.name: {
            "value": result.value,
            "unit": result.unit,
            "baseline": result.baseline,
            "goal": result.goal,
            "holds": result.holds,
        }
        for result in results
    }


def summary(results: list[Result], remarks: dict[str, str]) -> Group:
    """The figures for the terminal, what each was measured against, and why a benchmark gave none."""
    notes = _notes(results, remarks).items()
    return Group(
        terminal_table(_table(results)), *(Text.assemble((name, "bold"), f": {note}") for name, note in notes)
    )


def as_page(results: list[Result], remarks: dict[str, str]) -> str:
    """The same as Markdown, with the machine that it was measured on."""
    failed = [result.name for result in results if result.holds is False]
    return _PAGE_TEXT.format(
        machine=_machine(),
        failures=f"Not reached: {', '.join(failed)}." if failed else "Every goal is reached.",
        table=markdown_table(_table(results)),
        notes="\n".join(f"- `{name}`: {note}" for name, note in _notes(results, remarks).items()),
    )


def _table(results: list[Result]) -> Table:
    """A row per figure."""
    columns = [Column("figure", is_text=True, is_code=True)]
    columns += [Column(heading, is_text=True) for heading in ("value", "goal", "holds")]
    holds = {True: Cell("yes", Mark.GOOD), False: Cell("no", Mark.FAULT), None: Cell("")}
    rows: list[Row] = []
    for result in results:
        bound = "at most" if result.at_most else "at least"
        goal = "" if result.goal is None else f"{bound} {result.goal:g}"
        rows.append([result.name, f"{result.value:.3g} {result.unit}", goal, holds[result.holds]])
    return Table(columns, rows)


def _notes(results: list[Result], remarks: dict[str, str]) -> dict[str, str]:
    return {result.name: result.baseline for result in results} | remarks


def _machine() -> str:
    """Processor, cores and Python."""
    processor = platform.machine()
    information = Path("/proc/cpuinfo")
    if information.is_file():
        names = re.findall(r"^model name\s*:\s*(.*)$", information.read_text(), re.MULTILINE)
        processor = names[0] if names else processor
    return f"{os.cpu_count()} cores of {processor}, Python {platform.python_version()}"


if __name__ == "__main__":
    sys.exit(main())
