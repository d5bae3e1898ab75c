# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The blind benchmark of `quadpi discrepancy`: fly vehicles with hidden effects, search, score.

Each case is flown, searched and stored: an interrupted run continues where it stopped, as long as code and
configuration stay the same. A whole run renews results/discovery.md.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from blind import elsewhere
from blind.cases import (
    KINDS,
    SINGLE,
    SIZES,
    Hidden,
    all_cases,
    development_cases,
    short_cases,
    true_parameters,
)
from blind.scoring import Answer, Figure, confusion, estimated, failures, figures
from blind.searching import searched
from page_tables import RESULTS, ROOT, renew, stamp
from reliability_diagram import IMAGES, write_diagram

from quadpi_core.parallel import Workers
from quadpi_core.paths import whole_output
from quadpi_core.report.table import Column, Table, markdown_table

PAGE = RESULTS / "discovery.md"
_BENCHMARKS = ("blind", "hidden", "independent")
_SOURCES = ("quadpi_core/**/*.py", "config/**/*.yaml", *(f"experiments/{name}/*.py" for name in _BENCHMARKS))


def fingerprint() -> str:
    """Hash of everything that the results depend on."""
    digest = hashlib.sha256()
    for path in sorted(path for pattern in _SOURCES for path in ROOT.glob(pattern)):
        digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def run(
    cases: Sequence[Any],
    folder: Path,
    workers: int | None,
    search: Callable[[None, Any], Any] = searched,
) -> list[Any]:
    """What a search gives of every case; by their `key`, those that the folder holds are not repeated."""
    folder.mkdir(parents=True, exist_ok=True)
    places = [folder / f"{case.key}.json" for case in cases]
    todo = [index for index, place in enumerate(places) if not place.exists()]
    print(f"{len(cases)} cases, {len(todo)} to search", flush=True)
    finished = 0

    def keep(index: int, found: dict[str, Any]) -> None:
        nonlocal finished
        finished += 1
        with whole_output(places[todo[index]]) as temporary:
            temporary.write_text(json.dumps(found), encoding="utf-8")
        print(f"{finished} of {len(todo)}", flush=True)

    Workers(workers).map(search, [cases[index] for index in todo], shared=None, done=keep)
    return [json.loads(place.read_text(encoding="utf-8")) for place in places]


def scored(results: Iterable[dict[str, Any]]) -> list[Answer]:
    """The seals opened."""
    return [Answer.of(found, true_parameters(Hidden.opened(found["seal"]))) for found in results]


def figures_table(some: Iterable[Figure]) -> str:
    """Figures to reach, with what was reached."""
    rows = []
    for figure in some:
        low, high = figure.interval
        goal = f"{'≤' if figure.at_most else '≥'} {100 * figure.goal:.0f}"
        share = f"{100 * figure.share:.1f}" if figure.of else "–"
        interval = f"{100 * low:.1f} – {100 * high:.1f}" if figure.of else "–"
        reached = "–" if not figure.of else "yes" if figure.reached else "**no**"
        rows.append([figure.name, f"{figure.hits} / {figure.of}", share, interval, goal, reached])
    headings = ("cases", "%", "95 % interval", "goal", "reached")
    return markdown_table(Table([Column("", is_text=True), *map(Column, headings)], rows))


def confusion_table(answers: Sequence[Answer]) -> str:
    """Of each effect at each size what became of it."""
    by_size = {size: confusion(answers, size) for size in SIZES}
    names = sorted({name for rows in by_size.values() for name in rows})
    rows = []
    for name in names:
        cells = [
            ", ".join(f"{count} {word}" for word, count in by_size[size].get(name, {}).items()) or "–"
            for size in SIZES
        ]
        rows.append([f"`{name}`", *cells])
    headings = ("hidden", "full size", "half", "quarter")
    return markdown_table(Table([Column(heading, is_text=True) for heading in headings], rows))


def failures_table(answers: Sequence[Answer]) -> str:
    """Every failure by itself."""
    rows = []
    for answer in failures(answers):
        hidden = answer.hidden
        size = f"{hidden.size:g}" if hidden.kind == SINGLE else ""
        rows.append(
            [hidden.kind, " + ".join(hidden.effects) or "nothing", size, str(hidden.seed), answer.words]
        )
    kind, effects, words = (Column(heading, is_text=True) for heading in ("kind", "hidden", "found"))
    return markdown_table(Table([kind, effects, Column("size"), Column("seed"), words], rows))


def missed_table(answers: Sequence[Answer]) -> str:
    """Every parameter outside its interval, of those that the figure is about."""
    rows = []
    counted = estimated(answers)
    for answer in sorted(counted, key=lambda own: (own.hidden.effects, -own.hidden.size, own.hidden.seed)):
        hidden = answer.hidden
        for (name, (true, lower, upper)), inside in zip(answer.estimates.items(), answer.inside, strict=True):
            if not inside:
                case = [f"`{name}`", " + ".join(hidden.effects), f"{hidden.size:g}", str(hidden.seed)]
                rows.append([*case, f"{true:.4g}", f"{lower:.4g} – {upper:.4g}"])
    parameter, hidden_words = (Column(heading, is_text=True) for heading in ("parameter", "hidden"))
    numbers = map(Column, ("size", "seed", "true", "interval"))
    return markdown_table(Table([parameter, hidden_words, *numbers], rows))


def summary(results: Sequence[dict[str, Any]]) -> str:
    """How many cases, and how long a search takes."""
    kinds = [Hidden.opened(found["seal"]).kind for found in results]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(sorted(kinds)))
    seconds = median(found["seconds"] for found in results)
    return f"{len(results)} cases: {counts}. A search of 8 flights takes {seconds:.0f} s (median)."


def as_json(results: Sequence[dict[str, Any]], answers: Sequence[Answer]) -> dict[str, Any]:
    """All of it for a program."""
    return {
        "figures": [
            {
                "name": figure.name,
                "hits": figure.hits,
                "of": figure.of,
                "interval": figure.interval,
                "goal": figure.goal,
                "at_most": figure.at_most,
            }
            for figure in figures(answers)
        ],
        "confusion": {f"{size:g}": confusion(answers, size) for size in SIZES},
        "cases": [
            {
                "kind": answer.hidden.kind,
                "hidden": answer.hidden.effects,
                "size": answer.hidden.size,
                "seed": answer.hidden.seed,
                "left": answer.left,
                "rollouts": answer.rollouts,
                "estimates": answer.estimates,
                "seconds": found["seconds"],
                "result": found["result"],
            }
            for found, answer in zip(results, answers, strict=True)
        ],
    }


def main() -> None:
    """Run, print the figures, write out/discovery.json and the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    few = parser.add_mutually_exclusive_group()
    few.add_argument("--short", action="store_true", help="a few cases; the page stays as it is")
    few.add_argument(
        "--development",
        action="store_true",
        help="cases of other seeds, to look at while the search changes; the page stays as it is",
    )
    few.add_argument("--cases", type=int, help="number of cases, evenly mixed; the page is not renewed")
    few.add_argument("--only", choices=KINDS, help="all cases of this kind; the page stays as it is")
    parser.add_argument("--workers", type=int, help="processes; default: one per core")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "discovery", help="for results by case")
    parser.add_argument("--json", type=Path, default=ROOT / "out" / "discovery.json")
    parser.add_argument("--page", type=Path, default=PAGE, help="to renew")
    parser.add_argument(
        "--diagram", type=Path, help="of the probabilities; a whole run renews that of the page"
    )
    options = parser.parse_args()
    whole = not (options.short or options.development or options.cases or options.only)
    if options.short:
        cases = short_cases()
    elif options.development:
        cases = development_cases()
    else:
        cases = all_cases()[: options.cases]
        if options.only:
            cases = [case for case in cases if Hidden.opened(case.seal).kind == options.only]
    if whole and not elsewhere.available():
        print("no rotorpy here: its flights are left out; `make bench` installs it")
    results = run(cases, options.work / fingerprint(), options.workers)
    answers = scored(results)
    tables = {
        "summary": summary(results),
        "figures": figures_table(figures(answers)),
        "confusion": confusion_table(answers),
        "failures": failures_table(answers),
        "parameters": missed_table(answers),
    }
    print("\n\n".join(tables.values()))
    with whole_output(options.json) as temporary:
        temporary.write_text(json.dumps(as_json(results, answers), indent=1), encoding="utf-8")
    diagram = options.diagram or (IMAGES / "reliability-blind.svg" if whole else None)
    if diagram is not None:
        write_diagram(diagram, results, f"Blind benchmark, {len(results)} cases")
    if not whole:
        return
    renew(options.page, tables | {"figures": f"{tables['figures']}\n\n*{stamp()}*"})


if __name__ == "__main__":
    main()
