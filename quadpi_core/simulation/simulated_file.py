# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a simulation is read from: a vehicle file with the key `simulation`, or the folder of a model.

A model folder stands for the vehicle file that :meth:`.AerodynamicModel.vehicle_file` gives, so both fly the
same.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import yaml

from quadpi_core.config import read_config
from quadpi_core.config_schema import ReadBy, Section, Within, check_config, parse_config
from quadpi_core.errors import VehicleError
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_folder import MODEL_FILE
from quadpi_core.paths import whole_output
from quadpi_core.thresholds import Threshold
from quadpi_core.vehicle import Vehicle, simulation_section
from quadpi_core.version import __version__

MOTOR_TIME_CONSTANT = Threshold(
    "time constant of a motor",
    0.033,
    "s",
    "of a vehicle identified from flights without recorded commands, which alone would tell it",
    "rotor speeds lag their command by 25 to 45 ms on quadrotors of 37 to 770 g; 33 ms on the Bebop 2",
)


@dataclass(frozen=True)
class IdentifiedRange:
    """Ranges (19,) of the inputs over the flights that a vehicle was identified on."""

    lower: Array
    upper: Array

    def to_section(self) -> dict[str, list[float]]:
        """The content of `simulation.identified_range` in a vehicle file."""
        pairs = zip(self.lower.tolist(), self.upper.tolist(), strict=True)
        return {name: list(pair) for name, pair in zip(INPUT_NAMES, pairs, strict=True)}


def _read_range(data: Any) -> IdentifiedRange | None:
    if data is None:
        return None
    limits = check_config(dict[str, tuple[float, float]], data)
    if set(limits) != set(INPUT_NAMES):
        raise ValueError(f"must have a range for each of {', '.join(INPUT_NAMES)}")
    lower, upper = np.array([limits[name] for name in INPUT_NAMES]).T
    if not (np.all(np.isfinite(lower)) and np.all(np.isfinite(upper)) and np.all(lower <= upper)):
        raise ValueError("must hold pairs of numbers, the smaller first")
    return IdentifiedRange(lower, upper)


@dataclass(frozen=True, kw_only=True)
class SimulationSection(Section):
    """The key `simulation` of a vehicle file.

    Attributes:
        motor_time_constant_s: time constant of the first-order response of a rotor's speed.
        rotor_local: aerodynamics measured in a wind tunnel, read by `rotor_local`.
        physical: aerodynamics identified from flights, read by `physical_aerodynamics`.
        identified_range: of the flights that they were identified on.
        effects: effects, read by :func:`quadpi_core.simulation.flying.own_effects`.
        tolerances: tolerances, read where simulations are compared with flights.
    """

    motor_time_constant_s: Annotated[float, Within(0.001, 1.0)] | None = None
    rotor_local: Any = None
    physical: Any = None
    identified_range: Annotated[IdentifiedRange | None, ReadBy(_read_range)] = None
    effects: Any = None
    tolerances: Any = None


class SimulatedFile(NamedTuple):
    """A file or folder with the vehicle and the simulation that it holds."""

    path: Path
    vehicle: Vehicle
    section: SimulationSection


def read_simulation(name_or_path: str | Path) -> SimulatedFile:
    """Read a vehicle that may be simulated.

    Args:
        name_or_path: name of a file in config/vehicles, path of a vehicle file, or folder of a model.

    Raises:
        VehicleError: naming the file and the key that is unknown or impossible.
        ModelError: for a folder that is no model, and a model that is no simulation, saying why.
    """
    folder = model_folder(name_or_path)
    if folder is None:
        path, data = simulation_section(name_or_path)
        vehicle = Vehicle.load(path)
    else:
        path = folder
        _, vehicle, data = _of_model(folder)
    section = parse_config(SimulationSection, data, str(path), VehicleError, ("simulation",))
    return SimulatedFile(path, vehicle, section)


def model_folder(name_or_path: str | Path) -> Path | None:
    """The folder that a name or path of a vehicle says, if it is the folder of a model."""
    path = Path(name_or_path)
    return path if (path / MODEL_FILE).is_file() else None


def _of_model(folder: Path) -> tuple[AerodynamicModel, Vehicle, dict[str, Any]]:
    """The model in a folder, its vehicle, and the key `simulation` that flies as the model."""
    model = AerodynamicModel.load(folder)
    section, vehicle = model.simulation_section(), model.load_vehicle()
    motor = {"motor_time_constant_s": motor_time_constant(vehicle)}
    limits = IdentifiedRange(model.envelope.lower, model.envelope.upper)
    return model, vehicle, {**motor, **section, "identified_range": limits.to_section()}


def motor_time_constant(vehicle: Vehicle) -> float:
    """Of the motors [s], as the vehicle file of the vehicle's name has them, if it is of this vehicle."""
    with contextlib.suppress(VehicleError):
        _, data = simulation_section(vehicle.name)
        if Vehicle.load(vehicle.name).fingerprint == vehicle.fingerprint:
            return float(data.get("motor_time_constant_s", MOTOR_TIME_CONSTANT.value))
    return MOTOR_TIME_CONSTANT.value


def vehicle_content(name_or_path: str | Path) -> tuple[str, dict[str, Any]]:
    """Name and content of a vehicle file, or of the one that flies as the model in a folder.

    Raises:
        VehicleError, ModelError: see :func:`read_simulation`.
    """
    folder = model_folder(name_or_path)
    if folder is None:
        path, data = read_config("vehicle", name_or_path, VehicleError)
        return path.name, data
    _, vehicle, section = _of_model(folder)
    return folder.name, {**vehicle.to_file(), "simulation": section}


def write_vehicle_file(folder: Path, path: Path) -> None:
    """Write the vehicle file that flies as the model in a folder; it appears whole or not at all.

    Raises:
        ModelError: for a folder that is no model, and a model that is no simulation, saying why.
        VehicleError: if its vehicle is not known.
        OutputError: if the file cannot be written.
    """
    if model_folder(folder) is None:
        AerodynamicModel.load(folder)
        raise VehicleError(f"{folder}: not the folder of a model")
    model, vehicle, section = _of_model(folder)
    source = f"Identified by quadpi {__version__} from flights: model {model.identity}."
    data = {"source": source, **vehicle.to_file(), "simulation": section}
    text: str = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)
    with whole_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
