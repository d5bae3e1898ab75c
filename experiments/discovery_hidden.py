# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The hidden benchmark of `quadpi discrepancy`: real flights with exact changes, searched and scored.

Models are kept as long as what they come from stays the same, searches as long as all code and configuration
do. A whole run of the half to report renews results/discovery-hidden.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from blind.cases import SIZES
from discovery import figures_table, fingerprint, run
from hidden.cases import FLEETS, HALVES, KINDS, REPORT, Case, all_cases, short_cases
from hidden.changes import CHANGES
from hidden.measures import SHOWN, Finding, figures, order
from hidden.searching import Task, kept, searched
from page_tables import RESULTS, ROOT, renew, stamp

from quadpi_core.parallel import Workers
from quadpi_core.paths import data_directory, whole_output
from quadpi_core.report.table import Column, Table, markdown_table

PAGE = RESULTS / "discovery-hidden.md"


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return markdown_table(Table([Column(own, is_text=True) for own in headings], [list(row) for row in rows]))


def _counted(findings: Sequence[Finding]) -> str:
    """How often each outcome came, of visible cases, and how many are not visible."""
    counts = Counter(f.outcome for f in findings if f.visible)
    words = [f"{counts[word]} {word}" for word in SHOWN if counts[word]]
    if unseen := [f for f in findings if not f.visible]:
        told = Counter(f.answer.verdict.partition(":")[0] for f in unseen)
        words.append(f"({', '.join(f'{count} `{verdict}`' for verdict, count in told.items())})")
    return ", ".join(words) or "–"


def changes_table(findings: Sequence[Finding]) -> str:
    """What became of each change, or pair, at each size."""
    rows = []
    for names in dict.fromkeys(f.case.changes for f in sorted(findings, key=order) if f.case.changes):
        own = [f for f in findings if f.case.changes == names]
        cells = [_counted([f for f in own if f.case.size == size]) for size in SIZES]
        rows.append((" + ".join(names), *cells))
    return _table(("hidden", "full size", "half", "quarter"), rows)


def fleets_table(findings: Sequence[Finding]) -> str:
    """Of each fleet what became of its kinds of cases."""
    kinds = [kind for kind in KINDS if any(f.case.kind == kind for f in findings)]
    rows = []
    for fleet in dict.fromkeys(f.case.fleet for f in sorted(findings, key=order)):
        own = [f for f in findings if f.case.fleet == fleet]
        rows.append((fleet, *(_counted([f for f in own if f.case.kind == kind]) for kind in kinds)))
    return _table(("flights", *kinds), rows)


def failures_table(findings: Sequence[Finding]) -> str:
    """Every visible case that is not right, and every wrong name."""
    failed = [f for f in findings if not f.found and (f.visible or f.answer.verdict != "none")]
    rows = [
        (
            f.case.fleet,
            f"{' + '.join(f.case.changes) or f.case.kind} × {f.case.size:g}, split {f.case.split}",
            " ".join(f.broken) or "–",
            f.answer.words.replace("effects", f.outcome, 1),
        )
        for f in sorted(failed, key=order)
    ]
    return _table(("flights", "hidden", "axes outside", "found"), rows)


def hidden_table() -> str:
    """What is hidden at full size, and the right answers."""
    rows = []
    for name, change in CHANGES.items():
        case = Case("crazyflie", change.kind, (name,), 1.0, 0)
        truth = case.truth()
        right = [" + ".join(f"`{own}`" for own in names) or "nothing" for names in truth.right]
        exact = ", ".join(f"`{p}`" for p in truth.parameters) or "–"
        rows.append(
            (name, change.words, change.kind, " or ".join(right + ["`unknown`"] * truth.unknown), exact)
        )
    return _table(("change", "full size", "kind", "right", "parameters that follow exactly"), rows)


def summary(findings: Sequence[Finding]) -> str:
    """How many cases, how many are visible, and how long a search takes."""
    counts = Counter(f.case.kind for f in findings)
    words = ", ".join(f"{counts[kind]} {kind}" for kind in KINDS if counts[kind])
    seen = sum(f.visible for f in findings)
    seconds = median(f.seconds for f in findings)
    return f"{len(findings)} cases: {words}; {seen} of them visible. A search takes {seconds:.0f} s (median)."


def as_json(results: Sequence[dict[str, Any]], findings: Sequence[Finding]) -> dict[str, Any]:
    """All of it for a program."""
    return {
        "figures": [
            {
                **{key: getattr(own, key) for key in ("name", "hits", "of", "goal", "at_most")},
                "interval": own.interval if own.of else None,
            }
            for own in figures(findings)
        ],
        "cases": [
            {**found, "visible": finding.visible, "outcome": finding.outcome, "named": finding.answer.named}
            for found, finding in zip(results, findings, strict=True)
        ],
    }


def chosen(options: argparse.Namespace) -> list[Case]:
    """The cases that the options ask for."""
    keep: list[Callable[[Case], bool]] = []
    if options.half:
        keep.append(lambda case: FLEETS[case.fleet].half == options.half)
    if options.only:
        keep.append(lambda case: options.only in {case.kind, *case.changes})
    if options.vehicle:
        keep.append(lambda case: case.fleet in options.vehicle)
    cases = short_cases() if options.short else all_cases(splits=options.splits)
    return [case for case in cases if all(test(case) for test in keep)][: options.cases]


def main() -> None:
    """Identify what is missing, search, print the figures, write out/discovery-hidden.json and the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=HALVES, help="of the flights, by vehicle; default: both")
    parser.add_argument("--short", action="store_true", help="six cases that are plain to see")
    parser.add_argument("--only", choices=(*KINDS, *CHANGES), help="cases of this kind, or with this change")
    parser.add_argument("--vehicle", choices=tuple(FLEETS), nargs="+", help="cases of these flights")
    parser.add_argument("--cases", type=int, help="number of cases, the first of a shuffled list")
    parser.add_argument("--splits", type=int, default=2, help="random splits by change and size; default: 2")
    parser.add_argument("--workers", type=int, help="processes; default: one per core")
    parser.add_argument("--list", action="store_true", help="print the cases, search nothing")
    parser.add_argument(
        "--work", type=Path, default=ROOT / "out" / "discovery-hidden", help="for results by case"
    )
    parser.add_argument("--json", type=Path, default=ROOT / "out" / "discovery-hidden.json")
    parser.add_argument("--page", type=Path, default=PAGE, help="to renew")
    options = parser.parse_args()
    cases = chosen(options)
    if not cases:
        parser.error("no case is all of that")
    if options.list:
        print("\n".join(case.key for case in cases))
        return
    folders = [data_directory() / folder for case in cases for folder in FLEETS[case.fleet].folders]
    if absent := [folder for folder in folders if not folder.is_dir()]:
        sys.exit(f"no real flights in {absent[0]}: set QUADPI_DATA")
    tasks = [Task(case, options.work / "models") for case in cases]
    models = {task.model.folder: task.model for task in tasks}
    missing = [model for folder, model in models.items() if not folder.exists()]
    print(f"{len(models)} models, {len(missing)} to identify", flush=True)
    Workers(options.workers).map(kept, missing, shared=None)
    results = run(tasks, options.work / fingerprint(), options.workers, searched)
    findings = [Finding.of(found) for found in results]
    tables = {
        "summary": summary(findings),
        "figures": figures_table([own for own in figures(findings) if own.of]),
        "changes": changes_table(findings),
        "flights": fleets_table(findings),
        "failures": failures_table(findings),
    }
    print("\n\n".join(tables.values()))
    with whole_output(options.json) as temporary:
        temporary.write_text(json.dumps(as_json(results, findings), indent=1), encoding="utf-8")
    narrowed = options.short or options.only or options.vehicle or options.cases
    if options.half == REPORT and not narrowed:
        renew(
            options.page, tables | {"hidden": hidden_table(), "summary": f"{tables['summary']} *{stamp()}*"}
        )


if __name__ == "__main__":
    main()
