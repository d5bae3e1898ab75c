# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Several models of one vehicle judged on the same groups of flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from quadpi_core import __version__
from quadpi_core.errors import ModelError
from quadpi_core.identification import PreparedFlight, judge
from quadpi_core.intervals.evaluate import FlightResult
from quadpi_core.models.aerodynamic import AerodynamicModel


def load_models(folders: Sequence[Path]) -> dict[str, AerodynamicModel]:
    """Stored models by name.

    Raises:
        ModelError: for what is no model, and two of the same name.
    """
    models: dict[str, AerodynamicModel] = {}
    for folder in folders:
        model = AerodynamicModel.load(folder)
        if model.name in models:
            raise ModelError(f"{folder}: another model is called {model.name}; rename one of the folders")
        models[model.name] = model
    return models


def common_confidence(models: Mapping[str, AerodynamicModel], confidence: float | None) -> float:
    """The confidence that is asked for, else that of all models.

    Raises:
        ModelError: if none is asked for and theirs differ.
    """
    if confidence is not None:
        return confidence
    levels = {model.confidence for model in models.values()}
    if len(levels) > 1:
        raise ModelError("the models have different confidences: give one with --confidence")
    return levels.pop()


def compare(
    models: Mapping[str, AerodynamicModel],
    flights: Mapping[float, Sequence[PreparedFlight]],
    groups: Mapping[str, Sequence[str]],
    confidence: float,
    *,
    adaptive: bool = False,
    published: Mapping[str, Any] | None = None,
) -> tuple[dict[str, list[FlightResult]], dict[str, Any]]:
    """What each model says of the flights, and how good that is.

    Args:
        models: of the vehicle that flew, by the name that they have in the result.
        flights: the same flights after each low-pass (Hz) that the models take.
        groups: names of the flights in each group.
        confidence: nominal coverage of the intervals.
        adaptive: see :func:`quadpi_core.identification.predict_flight`.
        published: numbers to set beside, as of :func:`quadpi_core.validation.windtunnel.published_table`.

    Returns:
        Per model one result per flight, and plain JSON: `quadpi_version`, `vehicle`, `confidence`,
        `adaptive`, `groups.NAME` (names of its flights), `published`, and `models.NAME` with `settings`,
        `cutoff_hz` and the keys of :func:`quadpi_core.intervals.evaluate.evaluate_flights`.

    Raises:
        EvaluationError: for groups and flights that do not fit.
        ModelError: for a confidence that a model has no intervals of.
    """
    results: dict[str, list[FlightResult]] = {}
    evaluations: dict[str, Any] = {}
    for name, model in models.items():
        results[name], evaluation = judge(
            model, flights[model.cutoff_hz], groups, confidence, adaptive=adaptive
        )
        evaluations[name] = {"settings": model.settings, "cutoff_hz": model.cutoff_hz, **evaluation}
    return results, {
        "quadpi_version": __version__,
        "vehicle": next(iter(models.values())).vehicle,
        "confidence": confidence,
        "adaptive": adaptive,
        "groups": {name: list(members) for name, members in groups.items()},
        "published": published,
        "models": evaluations,
    }
