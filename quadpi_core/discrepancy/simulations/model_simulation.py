# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""An identified model in the place of a simulation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quadpi_core.discrepancy.simulations.callable_simulation import CallableSimulation
from quadpi_core.discrepancy.simulations.simulation_base import read_tolerances
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES, Flight
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX, flight_inputs
from quadpi_core.models.aerodynamic import AerodynamicModel


@dataclass(frozen=True)
class ModelSimulation(CallableSimulation):
    """The predictions of an identified model, whose intervals can be judged before and after.

    Flights must have passed the low-pass of the model.

    Attributes:
        model: of all six axes.
    """

    model: AerodynamicModel | None = None

    @classmethod
    def load(cls, folder: str | Path, vehicle: str | Path | None = None) -> ModelSimulation:
        """Read a model folder.

        Args:
            folder: of the model.
            vehicle: name or path of the vehicle file; unless given, by the name that the model holds.

        Raises:
            ModelError: for a folder that is no model, or a model of another vehicle.
            VehicleError: if the vehicle file cannot be read.
            DiscrepancyError: for a model that lacks an axis.
        """
        model = AerodynamicModel.load(folder)
        file = str(vehicle or model.vehicle)
        flown = model.load_vehicle(vehicle)
        lacking = [axis for axis in AXES if axis not in model.axes]
        if lacking:
            raise DiscrepancyError(
                f"model {folder}: lacks {', '.join(lacking)}; a simulation has all six axes"
            )

        def predict(flight: Flight) -> Array:
            return model.evaluate(flight_inputs(flight, flown)).predicted

        return cls(str(folder), flown, predict, read_tolerances(file), file, model=model)

    def intervals(self, flight: Flight) -> tuple[Array, Array]:
        """Lower and upper bounds (N, 6) of the model's own confidence."""
        assert self.model is not None  # by load
        found = self.model.evaluate(flight_inputs(flight, self.vehicle))
        return found.lower, found.upper

    @property
    def _about_hover(self) -> float:
        """The middle of what the model was identified on."""
        assert self.model is not None  # by load
        envelope, index = self.model.envelope, INPUT_INDEX["omega_avg"]
        return float(np.mean((envelope.lower[index], envelope.upper[index])))
