# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Load simulations by the names that the command line accepts."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from quadpi_core import array_checks
from quadpi_core.config_schema import Section, Text, Within, is_config_path, nearest, parse_config
from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.other_simulations import CallableSimulation, ModelSimulation, RecordedSimulation
from quadpi_core.discrepancy.simulations import Simulation, VehicleSimulation, read_tolerances
from quadpi_core.discrepancy.whitening import EDGES_HZ
from quadpi_core.errors import DiscrepancyError, ModelError, QuadpiError, one_line
from quadpi_core.flight import AXES
from quadpi_core.flight_files import LeftOutFlights
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.paths import JSON_BYTES_MAX, config_directory, parse_json, read_bounded
from quadpi_core.plugins import imported
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.simulation.applied_effects import read_effects
from quadpi_core.simulation.flying import own_effects
from quadpi_core.simulation.simulated_aerodynamics import PhysicalAerodynamics
from quadpi_core.vehicle import Vehicle

RECORDED = "recorded"
# Bytes in the name of a file that a file system takes.
_NAME_MAX = 250
ADJUSTED_MAX = Threshold(
    "largest adjustment of a coefficient",
    10.0,
    "tolerances",
    "a coefficient that is further off is no correction of the simulation",
    CONVENTION,
)


@dataclass(frozen=True, kw_only=True)
class _AdditionFile(Section):
    """The content of an `addition.json`: effects and adjustments that a search added.

    Attributes:
        adjusted: by name of the coefficient, in multiples of its tolerance.
        version: of quadpi that wrote the file.
    """

    simulation: Text
    vehicle: Text | None = None
    effects: dict[str, Any] = field(default_factory=dict)
    adjusted: dict[str, Annotated[float, Within(-ADJUSTED_MAX.value, ADJUSTED_MAX.value)]] = field(
        default_factory=dict
    )
    version: Any = None


def load_simulation(
    text: str | Path,
    vehicle: str | Path | None = None,
    bags: Path | str | Iterable[Path | str] = (),
    *,
    mapping: MappingOrOptions = None,
    allow_code: bool = False,
    within: tuple[Path, ...] = (),
    left_out: LeftOutFlights = None,
) -> Simulation:
    """Load a simulation by its name, path or function.

    Args:
        text: name or path of a vehicle file that can be simulated; folder of an identified model;
            `module:function` of Python, found from the working directory or installed; `recorded`, a wrench
            in the bags; or an `addition.json` that an earlier search wrote.
        vehicle: name or path of the vehicle file, for those that do not name one.
        bags: bags or logs that a recorded wrench is read from.
        mapping: of those, see :func:`quadpi_core.logs.read_recording`.
        allow_code: whether an `addition.json` may name a function. Its module is then imported, so the author
            of the file chooses what runs here. A function named by `text` itself is always allowed.
        within: files of additions that refer to this one, so that none refers to itself.
        left_out: list to which bags without a wrench that can be used are added; without it, the first is an
            error.

    Raises:
        ArgumentError: for what are no name or paths.
        DiscrepancyError: for a name of no simulation, a function that cannot be imported, a missing vehicle,
            and an invalid addition.
        QuadpiError: of vehicle files, models and bags that cannot be read.
    """
    array_checks.path("simulation", text)
    text, bags = str(text), array_checks.paths("bags", bags)
    if vehicle is not None:
        vehicle = str(array_checks.path("vehicle", vehicle))
    path = Path(text)
    if any(len(part.encode(errors="replace")) > _NAME_MAX for part in path.parts) or "\0" in text:
        raise DiscrepancyError(f"{text}: no simulation: a name that no file has")
    if path.suffix == ".json":
        addition = _read_addition(path, vehicle, allow_code, within)
        try:
            base = load_simulation(
                addition.simulation,
                vehicle or addition.vehicle,
                bags,
                mapping=mapping,
                allow_code=allow_code,
                within=(*within, path.resolve()),
                left_out=left_out,
            )
        except QuadpiError as error:
            raise DiscrepancyError(f"{path}: {error}") from error
        if isinstance(base, CallableSimulation) and base.code:
            base = replace(base, code=f"{base.code}, named by {path}")
        return AugmentedSimulation(base, read_effects(addition.effects, str(path)), addition.adjusted)
    if text == RECORDED or _names_code(text):
        if vehicle is None:
            raise DiscrepancyError(f"{text}: names no vehicle: give it with --vehicle")
        if text == RECORDED:
            return RecordedSimulation.load(vehicle, bags, mapping, left_out)
        return _callable(text, vehicle)
    simulation = _of_model(path, vehicle) if path.is_dir() else _of_vehicle(text, vehicle)
    effects = own_effects(simulation.vehicle_file) if isinstance(simulation, VehicleSimulation) else {}
    return AugmentedSimulation(simulation, effects) if effects else simulation


def simulation_of(section: Mapping[str, Any], vehicle: Vehicle) -> Simulation:
    """The simulation of an identified model, by the key `simulation` that it gives for a vehicle file."""
    name = f"model of {vehicle.name}"
    simulation = VehicleSimulation(PhysicalAerodynamics.from_section(vehicle, section["physical"], name))
    effects = read_effects(section.get("effects", {}), name)
    return AugmentedSimulation(simulation, effects) if effects else simulation


def _of_model(folder: Path, vehicle: str | None) -> Simulation:
    """The model in a folder, as a simulation that flies where it is one, else as predictions."""
    model = AerodynamicModel.load(folder)
    file, flown = vehicle or str(model.vehicle), model.load_vehicle(vehicle)
    lacking = [axis for axis in AXES if axis not in model.axes]
    if lacking:
        raise DiscrepancyError(f"model {folder}: lacks {', '.join(lacking)}; a simulation has all six axes")
    predictions = ModelSimulation(str(folder), flown, model, read_tolerances(file), file)
    if not model.kind.is_simulation:
        return predictions
    if model.sound is not None and model.sound.edges_hz != EDGES_HZ.value:
        raise ModelError(f"{folder}: its sound flights were compared by another version: identify it again")
    return replace(VehicleSimulation.load(folder), intervals_of=predictions, sound=model.sound)


def _of_vehicle(text: str, vehicle: str | None) -> VehicleSimulation:
    folder = config_directory() / "vehicles"
    if not is_config_path(text) and not (folder / f"{text}.yaml").is_file():
        known = sorted(file.stem for file in folder.glob("*.yaml"))
        raise DiscrepancyError(
            f"{text}: no simulation: neither a vehicle ({', '.join(known)}, or a .yaml file), nor the "
            f"folder of a model, module:function, `{RECORDED}` or an addition.json{nearest(text, known)}"
        )
    simulation = VehicleSimulation.load(text)
    if vehicle is not None and Vehicle.load(vehicle).fingerprint != simulation.vehicle.fingerprint:
        raise DiscrepancyError(f"{text}: another vehicle than {vehicle}: mass, inertia or rotors differ")
    return simulation


def _names_code(text: str) -> bool:
    path = Path(text)
    return ":" in text and path.suffix != ".json" and not path.is_dir() and not is_config_path(path)


def _callable(text: str, vehicle: str) -> CallableSimulation:
    # As for `python -m`: modules in the working directory can be imported.
    sys.path.insert(0, str(Path.cwd()))
    try:
        function = imported(text, text, DiscrepancyError)
    finally:
        sys.path.pop(0)
    if not callable(function):
        raise DiscrepancyError(f"{text}: is {type(function).__name__}, not a function")
    file = getattr(sys.modules[text.partition(":")[0]], "__file__", None)
    code, tolerances = f"{text} of {file}" if file else text, read_tolerances(vehicle)
    return CallableSimulation(text, Vehicle.load(vehicle), function, tolerances, vehicle, code)


def _read_addition(
    path: Path, vehicle: str | None, allow_code: bool, within: tuple[Path, ...]
) -> _AdditionFile:
    try:
        data: Any = parse_json(read_bounded(path, JSON_BYTES_MAX))
    except (OSError, ValueError) as error:
        raise DiscrepancyError(f"{path}: not a readable JSON file: {one_line(error)}") from error
    addition = parse_config(_AdditionFile, data, str(path), DiscrepancyError)
    if _names_code(addition.simulation) and not allow_code:
        raise DiscrepancyError(
            f"{path}: names code to run, the function {addition.simulation}: "
            "--allow-code runs it, if you trust who wrote this file"
        )
    if path.resolve() in within:
        raise DiscrepancyError(f"{path}: is an addition to itself")
    if vehicle is None and addition.vehicle is None:
        raise DiscrepancyError(f"{path}: missing key `vehicle`")
    return addition
