# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The command `quadpi discrepancy`: from what was typed to files and a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from quadpi_core.cli.outputs import print_quality
from quadpi_core.discrepancy.discrepancy_result import study_json
from quadpi_core.discrepancy.effect_sets import write_addition
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.study import read_flights, study
from quadpi_core.paths import whole_outputs, write_json
from quadpi_core.report.discrepancy_page import discrepancy_summary, write_discrepancy_page
from quadpi_core.report.progress import counting

DATA, PAGE = "discrepancy.json", "discrepancy.html"


def run(
    console: Console,
    text: str,
    bags: Sequence[Path],
    output: Path,
    *,
    vehicle: str | None,
    allow_code: bool,
    names: Sequence[str] | None,
    seed: int,
    json_file: Path | None,
    html_file: Path | None,
    workers: int | None,
    scheduler: str | None,
) -> None:
    """Search, show what was found, and write it: all files or none.

    Args:
        console: for progress and tables.
        text: names the simulation, see :func:`quadpi_core.discrepancy.loading.load_simulation`.
        bags: of the flights.
        output: folder for all files.
        vehicle: of a simulation that does not name one.
        allow_code: see there.
        names: of effects to look for; unless given, all.
        seed: of all draws.
        json_file: for another copy of the JSON.
        html_file: for another copy of the page.
        workers: see :func:`quadpi_core.parallel.map_files`.
        scheduler: see there.

    Raises:
        QuadpiError: for simulations, flights and outputs that will not do.
    """
    simulation = load_simulation(text, vehicle, bags, allow_code=allow_code)
    with counting(console, "Reading flights", len(bags)) as progress:
        flights = read_flights(bags, simulation, workers=workers, scheduler=scheduler, progress=progress)
    print_quality(console, zip(bags, (flight.quality for flight in flights), strict=True))
    with console.status("Searching"):
        found = study(simulation, flights, names=names, seed=seed)
    with whole_outputs(output) as staging, console.status("Writing"):
        added = [file.name for file in write_addition(found.discovery, staging)]
        data: dict[str, Any] = {**study_json(found), "files": added}
        write_json(staging / DATA, data)
        write_discrepancy_page(staging / PAGE, found)
        if json_file is not None:
            write_json(json_file, data)
        if html_file is not None:
            write_discrepancy_page(html_file, found)
    console.print(discrepancy_summary(found))
    console.print(f"{output}: {', '.join([PAGE, DATA, *added])}", soft_wrap=True)
