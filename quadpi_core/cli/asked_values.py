# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a report may know of a vehicle beside its logs: read from a file, or asked for once and kept there."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated

import typer
import yaml

from quadpi_core.config import is_config_path, read_config
from quadpi_core.config_schema import Positive, Section, Within, parse_config
from quadpi_core.errors import VehicleError
from quadpi_core.paths import require_file, whole_output
from quadpi_core.vehicle import Vehicle


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
