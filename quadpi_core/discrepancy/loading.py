# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Load simulations by the names that the command line accepts."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from quadpi_core import array_checks
from quadpi_core.bounded_files import JSON_BYTES_MAX, parse_json, read_bounded
from quadpi_core.config import is_config_path, nearest
from quadpi_core.config_schema import Section, Text, Within, parse_config
from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.external_simulations import CallableSimulation, ModelSimulation
from quadpi_core.discrepancy.recorded_simulation import RecordedSimulation
from quadpi_core.discrepancy.simulations import Simulation, VehicleSimulation, read_tolerances
from quadpi_core.discrepancy.whitening import EDGES_HZ
from quadpi_core.errors import DiscrepancyError, ModelError, QuadpiError, one_line
from quadpi_core.flight_files import LeftOutFlights
from quadpi_core.models.sound_flights import SoundFlights
from quadpi_core.paths import config_directory
from quadpi_core.plugins import imported
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.simulation.effect_registry import read_effects
from quadpi_core.simulation.flying import own_effects
from quadpi_core.simulation.physical_aerodynamics import PhysicalAerodynamics
from quadpi_core.thresholds import CONVENTION, Threshold
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
        vehicle = array_checks.path("vehicle", vehicle)
    path = Path(text)
    if any(len(part.encode(errors="replace")) > _NAME_MAX for part in path.parts) or "\0" in text:
        raise DiscrepancyError(f"{text}: no simulation: a name that no file has")
    if text == RECORDED:
        return RecordedSimulation.load(_required(text, vehicle), bags, mapping, left_out)
    if path.suffix == ".json":
        return _addition(path, vehicle, bags, mapping, allow_code, within, left_out)
    if path.is_dir():
        return _of_model(path, vehicle)
    if _names_code(text):
        return _callable(text, _required(text, vehicle))
    if not is_config_path(path) and not (config_directory() / "vehicles" / f"{text}.yaml").is_file():
        known = sorted(file.stem for file in (config_directory() / "vehicles").glob("*.yaml"))
        raise DiscrepancyError(
            f"{text}: no simulation: neither a vehicle ({', '.join(known)}, or a .yaml file), nor the "
            f"folder of a model, module:function, `{RECORDED}` or an addition.json{nearest(text, known)}"
        )
    return _of_vehicle(text, vehicle)


def _of_model(folder: Path, vehicle: str | Path | None) -> Simulation:
    """The model in a folder, as a simulation that flies where it is one, else as predictions."""
    predictions = ModelSimulation.load(folder, vehicle)
    assert predictions.model is not None  # by load
    if not predictions.model.kind.is_simulation:
        return predictions
    loaded = VehicleSimulation.load(folder)
    return _with_own_effects(
        replace(loaded, intervals_of=predictions, sound=_comparable(predictions.model.sound, folder))
    )


def _comparable(sound: SoundFlights | None, folder: Path) -> SoundFlights | None:
    """What sound flights leave, in the bands in which simulation and flights are compared."""
    if sound is not None and sound.edges_hz != EDGES_HZ.value:
        raise ModelError(f"{folder}: its sound flights were compared by another version: identify it again")
    return sound


def simulation_of(section: Mapping[str, Any], vehicle: Vehicle) -> Simulation:
    """The simulation of an identified model, by the key `simulation` that it gives for a vehicle file."""
    name = f"model of {vehicle.name}"
    simulation = VehicleSimulation(PhysicalAerodynamics.of(vehicle, section["physical"], name))
    effects = read_effects(section.get("effects", {}), name)
    return AugmentedSimulation(simulation, effects) if effects else simulation


def _of_vehicle(text: str, vehicle: str | Path | None) -> Simulation:
    simulation = VehicleSimulation.load(text)
    if vehicle is not None and Vehicle.load(vehicle).fingerprint != simulation.vehicle.fingerprint:
        raise DiscrepancyError(f"{text}: another vehicle than {vehicle}: mass, inertia or rotors differ")
    return _with_own_effects(simulation)


def _with_own_effects(simulation: VehicleSimulation) -> Simulation:
    effects = own_effects(simulation.vehicle_file)
    return AugmentedSimulation(simulation, effects) if effects else simulation


def _names_code(text: str) -> bool:
    path = Path(text)
    return ":" in text and path.suffix != ".json" and not path.is_dir() and not is_config_path(path)


def _required(text: str, vehicle: str | Path | None) -> str:
    if vehicle is None:
        raise DiscrepancyError(f"{text}: names no vehicle: give it with --vehicle")
    return str(vehicle)


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
    code = f"{text} of {file}" if file else text
    return CallableSimulation(
        text, Vehicle.load(vehicle), function, read_tolerances(vehicle), vehicle, code=code
    )


def _addition(
    path: Path,
    vehicle: str | Path | None,
    bags: Sequence[Path],
    mapping: MappingOrOptions,
    allow_code: bool,
    within: tuple[Path, ...],
    left_out: LeftOutFlights,
) -> AugmentedSimulation:
    try:
        data: Any = parse_json(read_bounded(path, JSON_BYTES_MAX))
    except (OSError, ValueError) as error:
        raise DiscrepancyError(f"{path}: not a readable JSON file: {one_line(error)}") from error
    addition = parse_config(_AdditionFile, data, str(path), DiscrepancyError)
    named = addition.simulation
    if _names_code(named) and not allow_code:
        raise DiscrepancyError(
            f"{path}: names code to run, the function {named}: "
            "--allow-code runs it, if you trust who wrote this file"
        )
    if path.resolve() in within:
        raise DiscrepancyError(f"{path}: is an addition to itself")
    if vehicle is None and addition.vehicle is None:
        raise DiscrepancyError(f"{path}: missing key `vehicle`")
    try:
        base = load_simulation(
            named,
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
