# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew results/discovery-real.md: physical models beside real flights they were not identified on.

Everything is done by the commands that a user has, so that what accepts a result here is what accepts it
there. Results are kept by the content of code and configuration: an interrupted run goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from discovery import fingerprint
from hidden.cases import Logs
from page_tables import RESULTS, ROOT, renew, stamp

from quadpi_core.flight import AXES
from quadpi_core.report.table import Column, Row, Table, markdown_table

PAGE = RESULTS / "discovery-real.md"
# Rounds of the search: of the simulation, then of the simulation with what was added.
ROUNDS = 2
# Candidates that the page shows beside those of the result.
_REFUSED_SHOWN = 4


CRAZYFLIE = Logs.of("imrc_brushless", "eckart{}", "00 02 04 07 09 12 14 16 18 20")
NEUROBEM = Logs.of("neurobem", "bemnn20210218{}.mat", "170320seg2 172600seg1")
INDIFLIGHT = Logs.of("indiflight", "LOG00{}.BFL", "230 257 259 264 269 276 279")


@dataclass(frozen=True)
class Case:
    """A physical model of some flights, searched with others.

    Attributes:
        name: of its folder of results, and of its table on the page.
        vehicle: its file.
        identified: logs of the model.
        searched: other logs.
    """

    name: str
    vehicle: str
    identified: Logs
    searched: Logs


CASES = (
    Case(
        "neurobem",
        "neurobem",
        NEUROBEM,
        Logs("neurobem", ("bemnn20210218171908seg2.mat", "bemnn20210223104803seg2.mat")),
    ),
    Case(
        "crazyflie",
        "crazyflie_rpm",
        CRAZYFLIE,
        Logs.of("imrc_brushless", "eckart{}", "01 06 11 15 19"),
    ),
    Case(
        "brushed",
        "crazyflie_rpm",
        CRAZYFLIE,
        Logs.of("imrc_brushed", "jana{}", "00 02 03 10"),
    ),
    Case(
        "brushed-drop-outs",
        "crazyflie_rpm",
        CRAZYFLIE,
        Logs.of("imrc_brushed", "jana{}", "20 23 24 27"),
    ),
    Case(
        "slung-load",
        "crazyflie_rpm",
        CRAZYFLIE,
        Logs.of("imrc_payload", "eckart{}", "14 18 20 24 46 61 68 73"),
    ),
    Case(
        "indiflight",
        "indiflight",
        INDIFLIGHT,
        Logs.of("indiflight", "LOG00{}.BFL", "231 273 277"),
    ),
)


def quadpi(*arguments: str) -> None:
    """Run a command; SystemExit with what it said where it fails."""
    command = [sys.executable, "-m", "quadpi_core.cli", *arguments]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if ran.returncode:
        raise SystemExit(f"quadpi {arguments[0]}: {ran.stderr.strip() or ran.stdout.strip()}")


def rounds(case: Case, work: Path) -> list[dict[str, Any]]:
    """What `discrepancy` says of each round: the JSON that it wrote, now or earlier."""
    missing = [path for path in (*case.identified.paths, *case.searched.paths) if not path.exists()]
    if missing:
        raise SystemExit(f"no flight {missing[0]}: set QUADPI_DATA")
    simulation = work / "models" / case.identified.folder
    if not simulation.exists():
        options = ("--vehicle", case.vehicle, "--method", "physical", "--workers", "1")
        simulation.parent.mkdir(parents=True, exist_ok=True)
        quadpi("identify", *map(str, case.identified.paths), *options, "-o", str(simulation))
    found: list[dict[str, Any]] = []
    for number in range(1, ROUNDS + 1):
        folder = work / f"{case.name}-{number}"
        if not folder.exists():
            logs = map(str, case.searched.paths)
            quadpi("discrepancy", str(simulation), *logs, "--workers", "1", "-o", str(folder))
            print(f"{case.name}: round {number}", flush=True)
        found.append(json.loads((folder / "discrepancy.json").read_text(encoding="utf-8")))
        simulation = folder / f"{case.vehicle}.yaml"
        if simulation.name not in found[-1]["files"]:
            break
    return found


def section(case: Case, found: Sequence[Mapping[str, Any]]) -> str:
    """Tables of the page on one case."""
    seconds = sum(flight["duration_s"] for flight in found[0]["flights"].values())
    parts = [
        f"Identified on {', '.join(case.identified.names)}; searched with {', '.join(case.searched.names)}, "
        f"{seconds:.0f} s in the air."
    ]
    for number, result in enumerate(found, start=1):
        added = any(name.endswith(".yaml") for name in result["files"])
        verdict = (
            f"Round {number}: verdict `{result['verdict']}`; {'added' if added else 'nothing is added'}."
        )
        doubts = f" Because {'; '.join(result['doubts'])}." if result["doubts"] else ""
        parts += [f"{verdict}{doubts}", candidates_table(result), errors_table(result)]
    return "\n\n".join(part for part in parts if part)


def candidates_table(result: Mapping[str, Any]) -> str:
    """The named effects with their parameters, and the refused candidates with most evidence."""
    parameters = {
        effect["name"]: ", ".join(
            f"{name} {p['value']:.3g} ({p['lower']:.3g} … {p['upper']:.3g})"
            if p["upper"] > p["lower"]
            else f"{name} {p['value']:.3g}"
            for name, p in effect["parameters"].items()
        )
        for effect in result["effects"]
    }
    named = [own for own in result["candidates"] if own["named"]]
    refused = [own for own in result["candidates"] if not own["named"] and own["needed_nat"]]
    rows: list[Row] = []
    for own in (*named, *refused[:_REFUSED_SHOWN]):
        closes = ", ".join(
            f"{axis} {100.0 * share:.0f}" for axis, share in own["closes"].items() if abs(share) >= 0.01
        )
        if own["cancels"]:
            closes += f"; only against coefficients: {', '.join(own['cancels'])}"
        told = parameters[own["name"]] if own["named"] else f"refused: {own['reason']}"
        evidence = f"{own['evidence_nat']:.0f} of {own['needed_nat']:.0f}"
        rows.append([f"`{own['label']}`", evidence, closes or "–", told])
    headings = (
        "effect",
        "evidence, of what is needed [nat]",
        "closes of the gap [%]",
        "95 %, or why refused",
    )
    return (
        markdown_table(Table([Column(heading, is_text=True) for heading in headings], rows)) if rows else ""
    )


def errors_table(result: Mapping[str, Any]) -> str:
    """Errors one step ahead, of roll-outs, and coverage of intervals, before and after."""
    rows: list[Row] = [_errors(f"{axis}, RMSE", result["gap"][axis]) for axis in AXES]
    if "rollout" in result:
        rollout = result["rollout"]
        for name, unit in {"velocity_m_s": "m/s", "attitude_deg": "°", "rates_rad_s": "rad/s"}.items():
            if name in rollout:
                words = f"roll-out of {rollout['horizon_s']:g} s, {name.split('_')[0]} [{unit}]"
                rows.append(_errors(words, rollout[name]))
        if lost := rollout.get("lost"):
            rows.append(
                ["roll-outs that diverge", *(str(lost[when]) for when in ("before", "after", "floor"))]
            )
    for axis, share in result.get("coverage", {}).items():
        shares = [f"{100.0 * share[when]:.1f} %" for when in ("before", "after")]
        rows.append([f"{axis}, inside the intervals", *shares, "–"])
    columns = [Column("flights left out [N, Nm]", is_text=True), *map(Column, ("before", "after", "floor"))]
    return markdown_table(Table(columns, rows))


def _errors(name: str, error: Mapping[str, float]) -> Row:
    return [name, *(f"{error[when]:.3g}" for when in ("before", "after", "floor"))]


def summary(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """One row per case and round: what comes closest, whether it is added, and roll-outs."""
    rows: list[Row] = []
    for name, results in found.items():
        for number, result in enumerate(results, start=1):
            effects = ", ".join(f"`{effect['name']}`" for effect in result["effects"]) or "–"
            added = any(file.endswith(".yaml") for file in result["files"])
            rollout = result.get("rollout", {})
            moved = [
                f"{rollout[key]['before']:.3g} → {rollout[key]['after']:.3g}" if key in rollout else "–"
                for key in ("velocity_m_s", "attitude_deg", "rates_rad_s")
            ]
            closed = f"{100.0 * result['gap']['reduction']:.0f} %" if result["effects"] else "–"
            rows.append([name, str(number), f"`{result['verdict']}`", effects, closed, *moved, _said(added)])
    words = ("flights", "round", "verdict", "closest")
    numbers = ("gap closed", "velocity [m/s]", "attitude [°]", "rates [rad/s]", "added")
    return markdown_table(
        Table([*(Column(word, is_text=True) for word in words), *map(Column, numbers)], rows)
    )


def _said(added: bool) -> str:
    return "yes" if added else "no"


def main() -> None:
    """Identify, search, and renew the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = [case.name for case in CASES]
    parser.add_argument("--only", choices=names, nargs="+", help="print these, write nothing")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "discovery-real", help="for results")
    options = parser.parse_args()
    cases = [case for case in CASES if case.name in (options.only or names)]
    # Commands run in the root of the repository, wherever this does.
    work = options.work.resolve() / fingerprint()
    found = {case.name: rounds(case, work) for case in cases}
    tables = {case.name: section(case, found[case.name]) for case in cases}
    tables["summary"] = summary(found)
    if options.only:
        print("\n\n".join(tables.values()))
        return
    tables["summary"] += f"\n\n*{stamp()}*"
    renew(PAGE, tables)


if __name__ == "__main__":
    main()
