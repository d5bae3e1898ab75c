# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The aerodynamics of a vehicle that can be simulated, whichever law its file holds."""

from __future__ import annotations

from pathlib import Path

from quadpi_core.errors import VehicleError
from quadpi_core.simulation.physical_aerodynamics import PhysicalAerodynamics
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.simulated_aerodynamics import SimulatedAerodynamics
from quadpi_core.simulation.simulated_file import read_simulation

LAWS: tuple[type[SimulatedAerodynamics], ...] = (RotorLocalModel, PhysicalAerodynamics)


def load_aerodynamics(name_or_path: str | Path) -> SimulatedAerodynamics:
    """Read the aerodynamics of a vehicle file, or of the folder of a model.

    Raises:
        VehicleError: naming the file and the key that is missing, unknown or impossible, or of which there
            are two.
        ModelError: see :func:`.read_simulation`.
    """
    file = read_simulation(name_or_path)
    given = [law for law in LAWS if getattr(file.section, law.key) is not None]
    if len(given) > 1:
        keys = " and ".join(f"`simulation.{law.key}`" for law in given)
        raise VehicleError(
            f"{file.path}: {keys} exclude each other: a vehicle has one law of its aerodynamics"
        )
    return (given or LAWS)[0].load(name_or_path)
