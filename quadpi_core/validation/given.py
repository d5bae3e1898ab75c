# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Models and bags that the user names, as a validation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.simulation.noise import SensorSuite
from quadpi_core.validation.case import ValidationCase, ValidationError
from quadpi_core.validation.flights import recorded_flight
from quadpi_core.vehicle import Vehicle


def given_case(
    folders: Sequence[Path],
    bags: Sequence[Path],
    *,
    vehicle: str | None = None,
    noise: str = "paper",
    confidence: float | None = None,
    seed: int = 0,
) -> ValidationCase:
    """Validation of stored models on the truth of simulated flights.

    Args:
        folders: of the models, of one vehicle and one low-pass; their names are those in the result.
        bags: that `quadpi simulate` wrote, of the same vehicle.
        vehicle: name or path of the vehicle file; default: the one that the first model names.
        noise: name in config/noise, or path.
        confidence: of the intervals; default: the models' own.
        seed: of all noise.

    Raises:
        ValidationError: where models or bags are missing, two models share a name, or their confidences
            differ and none is given.
        ModelError, LogError, VehicleError, SimulationError: for what cannot be read.
    """
    if not folders or not bags:
        missing = "model folder" if not folders else "bag of a simulated flight"
        raise ValidationError(
            f"no {missing} given: name model folders and bags, or nothing for the paper's own"
        )
    models: dict[str, AerodynamicModel] = {}
    for folder in folders:
        model = AerodynamicModel.load(folder)
        if model.name in models:
            raise ValidationError(
                f"{folder}: another model is called {model.name}; rename one of the folders"
            )
        models[model.name] = model
    first = next(iter(models.values()))
    the_vehicle = Vehicle.load(vehicle or first.vehicle)
    levels = {model.confidence for model in models.values()}
    if confidence is None and len(levels) > 1:
        raise ValidationError("the models have different confidences: give one with --confidence")
    return ValidationCase(
        vehicle=the_vehicle,
        models=models,
        flights=tuple(recorded_flight(bag, the_vehicle) for bag in bags),
        noise=SensorSuite.load(noise).states,
        confidence=first.confidence if confidence is None else confidence,
        seed=seed,
    )
