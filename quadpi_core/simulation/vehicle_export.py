# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicle files of identified models."""

from __future__ import annotations

from pathlib import Path

import yaml

from quadpi_core.errors import VehicleError
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.paths import whole_output
from quadpi_core.simulation.simulated_file import model_folder, vehicle_content
from quadpi_core.version import __version__


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
    _, data = vehicle_content(folder)
    identity = AerodynamicModel.load(folder).identity
    source = f"Identified by quadpi {__version__} from flights: model {identity}."
    text: str = yaml.safe_dump(
        {"source": source, **data}, sort_keys=False, default_flow_style=None, width=110
    )
    with whole_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
