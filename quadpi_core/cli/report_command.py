# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi report`: any log of a multirotor, as it is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import SOME_LEFT_OUT, check_outputs, open_console, print_left_out
from quadpi_core.errors import QuadpiError

# Exit status where `--fail-on` asks for one.
FAILED = 1


def report(
    logs: Annotated[list[Path], typer.Argument(help="Logs of any format that quadpi reads, as they are.")],
    folder: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for report.html and report.json.")
    ] = Path("quadpi-report"),
    mass: Annotated[
        float | None, typer.Option(metavar="KG", help="Mass in flight: gives forces in newtons too.")
    ] = None,
    against: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="LOG",
            help="A good flight of the same vehicle before, which the motors are held against; may be given "
            "several times.",
        ),
    ] = None,
    fail_on: Annotated[
        str | None, typer.Option("--fail-on", metavar="alarm", help="End with status 1 if there is an alarm.")
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Vehicle file, for mass and pairs of poles; one that does not exist is asked for and kept."
        ),
    ] = None,
    mapping: options.Mapping = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
) -> None:
    """Report on logs as they are: what was flown, drag and wind, motors, battery, what to log next time."""
    from quadpi_core.cli.asked_values import report_vehicle
    from quadpi_core.field.field_report import report_on
    from quadpi_core.paths import whole_outputs, write_json
    from quadpi_core.report.field_page import report_summary, write_field_page
    from quadpi_core.report.table import terminal_table

    if fail_on not in {None, "alarm"}:
        raise QuadpiError(f"--fail-on {fail_on}: known is alarm")
    if mass is not None and not 0.0 < mass < 1e4:
        raise QuadpiError(f"--mass {mass:g}: expected kilograms above 0")
    check_outputs([*logs, *(against or ())], folders=[folder])
    known, its_mass = report_vehicle(vehicle) if vehicle else (None, None)
    found = report_on(
        logs,
        options.reading_options(topics, namespace, mapping),
        known,
        its_mass if mass is None else mass,
        against or (),
    )
    with whole_outputs(folder) as staging:
        write_field_page(staging / "report.html", found)
        write_json(staging / "report.json", found.to_json())
    console = open_console()
    for table in report_summary(found):
        console.print(terminal_table(table))
    console.print(found.verdict(), soft_wrap=True)
    console.print(f"{folder / 'report.html'}", soft_wrap=True)
    print_left_out(found.left_out)
    if fail_on and found.alarmed:
        raise typer.Exit(FAILED)
    if found.left_out:
        raise typer.Exit(SOME_LEFT_OUT)
