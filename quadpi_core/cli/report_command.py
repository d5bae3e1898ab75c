# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi report`: any log of a multirotor, as it is."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated

import typer
import yaml

from quadpi_core.cli import options
from quadpi_core.cli.options import SOME_LEFT_OUT, check_outputs, open_console, print_left_out
from quadpi_core.config import is_config_path, read_config
from quadpi_core.config_schema import Positive, Section, Within, parse_config
from quadpi_core.errors import QuadpiError, VehicleError
from quadpi_core.paths import require_file, whole_output
from quadpi_core.vehicle import Vehicle

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
    report = report_on(
        logs,
        options.reading_options(topics, namespace, mapping),
        known,
        its_mass if mass is None else mass,
        against or (),
    )
    with whole_outputs(folder) as staging:
        write_field_page(staging / "report.html", report)
        write_json(staging / "report.json", report.to_json())
    console = open_console()
    for table in report_summary(report):
        console.print(terminal_table(table))
    console.print(report.verdict(), soft_wrap=True)
    console.print(f"{folder / 'report.html'}", soft_wrap=True)
    print_left_out(report.left_out)
    if fail_on and report.alarmed:
        raise typer.Exit(FAILED)
    if report.left_out:
        raise typer.Exit(SOME_LEFT_OUT)


@dataclass(frozen=True)
class KnownValues(Section):
    """A vehicle file with what a report uses alone; null for what is not known."""

    mass_kg: Positive | None = None
    pole_pairs: Annotated[int, Within(positive=True)] | None = None


_ASKED = {
    "mass_kg": "mass in flight, kg, for forces in newtons",
    "pole_pairs": "pairs of poles of a motor, for rotor speeds of electrical ones",
}


def report_vehicle(name_or_path: str) -> tuple[Vehicle | int | None, float | None]:
    """The vehicle, or what is known of its pairs of poles, and its mass in kg.

    A file that does not exist is asked for on a terminal, value by value, and written.

    Raises:
        VehicleError: naming the file, where it does not exist and there is no terminal, or holds no vehicle.
    """
    if is_config_path(name_or_path) and not Path(name_or_path).exists():
        _ask(Path(name_or_path))
    path, data = read_config("vehicle", name_or_path, VehicleError)
    if not isinstance(data, dict) or not set(data) <= {one.name for one in fields(KnownValues)}:
        vehicle = Vehicle.load(name_or_path)
        return vehicle, vehicle.mass_kg
    known = parse_config(KnownValues, data, str(path), VehicleError)
    return known.pole_pairs, known.mass_kg


def _number(answer: str) -> object:
    """A number, None for an empty answer, else the answer itself, which is refused."""
    try:
        return yaml.safe_load(answer)
    except yaml.YAMLError:
        return answer


def _ask(path: Path) -> None:
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        names = " and ".join(_ASKED)
        raise VehicleError(f"{path}: does not exist; write {names} into it, or run on a terminal, which asks")
    require_file(path)
    given = {
        name: typer.prompt(f"{name}: {meaning} (empty: not known)", default="", show_default=False)
        for name, meaning in _ASKED.items()
    }
    answers = {name: _number(answer) for name, answer in given.items()}
    known = parse_config(KnownValues, answers, str(path), VehicleError)
    with whole_output(path) as temporary:
        temporary.write_text(yaml.safe_dump(asdict(known), sort_keys=False), encoding="utf-8")
