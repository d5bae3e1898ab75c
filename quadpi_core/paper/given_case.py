# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Models and bags that the user names, as a validation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from quadpi_core.evaluation.compare import common_confidence, load_models
from quadpi_core.paper.clean_flights import recorded_flight
from quadpi_core.paper.validation_case import ValidationCase, ValidationError
from quadpi_core.simulation.sensor_noise import SensorSuite


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
        ValidationError: where models or bags are missing.
        ModelError: for what is no model, two models of one name, and confidences that differ where none is
            given.
        LogError, VehicleError, SimulationError: for what cannot be read.
    """
    if not folders or not bags:
        missing = "model folder" if not folders else "bag of a simulated flight"
        raise ValidationError(
            f"no {missing} given: name model folders and bags, or nothing for the paper's own"
        )
    models = load_models(folders)
    first = next(iter(models.values()))
    level = common_confidence(models, confidence)
    the_vehicle = first.load_vehicle(vehicle)
    return ValidationCase(
        vehicle=the_vehicle,
        models=models,
        flights=tuple(recorded_flight(bag, the_vehicle) for bag in bags),
        noise=SensorSuite.load(noise).states,
        confidence=level,
        seed=seed,
    )
