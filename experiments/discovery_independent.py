# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The independent benchmark of `quadpi discrepancy`: flights of RotorPy with hidden effects.

experiments/independent/README.md says what is hidden and how. Flights are flown once and kept; a search is
repeated where code or configuration changed.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from discovery import figures_table, fingerprint, run
from independent.cases import (
    DEVELOPMENT,
    OPENED,
    RESERVED,
    available,
    benchmark_cases,
    default_store,
    short_cases,
)
from independent.measures import Finding, columns, figures, order, said
from independent.searching import MAPPINGS, Task, searched
from page_tables import ROOT
from reliability_diagram import write_diagram

from quadpi_core.paths import whole_output
from quadpi_core.report.table import Column, Table, markdown_table


def cases_table(findings: Sequence[Finding]) -> str:
    """Every case with what each kind of simulation and mapping made of it."""
    by_column = columns(findings)
    rows: dict[str, dict[str, str]] = {}
    for finding in sorted(findings, key=order):
        hidden = finding.answer.hidden
        size = f" × {hidden.size:g}" if hidden.effects else ""
        name = f"{hidden.kind} {', '.join(hidden.effects)}{size}, seed {hidden.seed}, {finding.vehicle}"
        row = rows.setdefault(name, dict.fromkeys(by_column, "–"))
        row[f"{finding.mapping}, {finding.mode}"] = said(finding)
    headings = [Column(heading, is_text=True) for heading in ("hidden", *by_column)]
    return markdown_table(Table(headings, [[name, *cells.values()] for name, cells in rows.items()]))


def estimates_table(findings: Sequence[Finding]) -> str:
    """Every estimate of a parameter whose true value is known."""
    rows = []
    for finding in sorted(findings, key=order):
        hidden = finding.answer.hidden
        for name, (true, lower, upper) in finding.answer.estimates.items():
            inside = "yes" if lower <= true <= upper else "**no**"
            case = f"× {hidden.size:g}, seed {hidden.seed}, {finding.mapping}, {finding.mode}"
            rows.append([f"`{name}`", case, f"{true:.4g}", f"{lower:.4g} – {upper:.4g}", inside])
    headings = ("parameter", "case", "true", "interval", "inside")
    return markdown_table(Table([Column(heading, is_text=True) for heading in headings], rows))


def not_searched(tasks: Sequence[Task], found: Sequence[Sequence[Any]]) -> list[str]:
    """Cases of tasks without results, which RotorPy cannot fly; each once."""
    hidden = [task.case.hidden for task, several in zip(tasks, found, strict=True) if not several]
    titles = [f"{' + '.join(own.effects) or 'nothing'} × {own.size:g} of seed {own.seed}" for own in hidden]
    return list(dict.fromkeys(titles))


def as_json(results: Sequence[dict[str, Any]], findings: Sequence[Finding]) -> dict[str, Any]:
    """All of it for a program."""
    return {
        "figures": {
            name: [
                {
                    "name": figure.name,
                    "hits": figure.hits,
                    "of": figure.of,
                    "interval": figure.interval,
                    "goal": figure.goal,
                    "at_most": figure.at_most,
                }
                for figure in figures(some)
            ]
            for name, some in columns(findings).items()
        },
        "cases": [
            {
                "kind": finding.answer.hidden.kind,
                "hidden": finding.answer.hidden.effects,
                "size": finding.answer.hidden.size,
                "seed": finding.answer.hidden.seed,
                **{
                    key: found[key]
                    for key in (
                        *("vehicle", "mapping", "mode", "truth", "seconds"),
                        *("left", "rollouts", "result", "detail"),
                    )
                },
            }
            for found, finding in zip(results, findings, strict=True)
        ],
    }


def main() -> None:
    """Fly what is missing, search, print the figures, write a JSON file and a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    few = parser.add_mutually_exclusive_group()
    few.add_argument("--short", action="store_true", help="a few cases that are plain to see")
    few.add_argument("--reserved", action="store_true", help="the seeds kept aside; read README.md first")
    parser.add_argument(
        "--seeds", type=int, nargs="+", help="some seeds of those; default: all but those opened before"
    )
    parser.add_argument("--cases", type=int, help="number of cases, the first of a shuffled list")
    parser.add_argument("--mappings", nargs="+", choices=MAPPINGS, default=MAPPINGS)
    parser.add_argument("--workers", type=int, help="processes; default: one per core")
    parser.add_argument(
        "--store", type=Path, default=default_store(), help="of flights, kept between versions"
    )
    parser.add_argument(
        "--work", type=Path, default=ROOT / "out" / "discovery-independent", help="for results by case"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "discovery-independent.json")
    parser.add_argument(
        "--diagram",
        type=Path,
        help="of the probabilities, such as experiments/results/images/reliability-independent.svg",
    )
    options = parser.parse_args()
    if not available():
        sys.exit("no rotorpy here; `make bench` installs it")
    if options.short:
        cases = short_cases()
    else:
        seeds = RESERVED if options.reserved else DEVELOPMENT
        known = RESERVED if options.reserved else (*DEVELOPMENT, *OPENED)
        if strange := set(options.seeds or ()) - set(known):
            parser.error(f"seeds {sorted(strange)} are none of {', '.join(map(str, known))}")
        cases = benchmark_cases(options.seeds or seeds)[: options.cases]
    tasks = [Task(case, options.store, mapping) for mapping in options.mappings for case in cases]
    found = run(tasks, options.work / fingerprint(), options.workers, searched)
    results = [one for several in found for one in several]
    if not results:
        sys.exit("RotorPy cannot fly any of these cases")
    findings = [Finding.of(one) for one in results]
    parts = [
        f"{len(cases)} cases, {len(results)} searches; "
        f"one takes {median(f.seconds for f in findings):.0f} s (median)."
    ]
    if grounded := not_searched(tasks, found):
        parts.append(f"Not searched, as RotorPy loses its path: {', '.join(grounded)}.")
    parts += [f"### {name}\n\n{figures_table(figures(some))}" for name, some in columns(findings).items()]
    print("\n\n".join(parts))
    parts += [f"### Every case\n\n{cases_table(findings)}", f"### Estimates\n\n{estimates_table(findings)}"]
    if options.diagram is not None:
        write_diagram(options.diagram, results, f"Flights of RotorPy, {len(results)} searches")
    with whole_output(options.out) as temporary:
        temporary.write_text(json.dumps(as_json(results, findings), indent=1), encoding="utf-8")
    with whole_output(options.out.with_suffix(".md")) as temporary:
        temporary.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
