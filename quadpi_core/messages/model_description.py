# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which models a monitor flies, what they were trained on and where it publishes: JSON in a latched string.

As `robot_description` gives every tool the vehicle, `~/description` of a monitor gives it the training
ranges, and what inputs are computed with, whether or not it can read the model's folder.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from quadpi_core.errors import LogError, VehicleError
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.vehicle import Vehicle


@dataclass(frozen=True)
class DescribedModel:
    """What a page has to know of a model.

    Attributes:
        identity: name and hash.
        vehicle: that it was identified for.
        lower: (19,) smallest value of each input on the training flights.
        upper: (19,) largest value.
        cutoff_hz: of its low-pass; None where the monitor does not say it.
    """

    identity: str
    vehicle: str
    lower: Array
    upper: Array
    cutoff_hz: float | None = None


@dataclass(frozen=True)
class MonitorDescription:
    """The models of a monitor, the one that gives the alarm first.

    Attributes:
        models: by identity.
        topics: resolved names, by the names of the topics before remapping.
        vehicle: of all models; None where the monitor does not say it.
    """

    models: dict[str, DescribedModel]
    topics: dict[str, str]
    vehicle: Vehicle | None = None


def pack_description(
    models: Sequence[DescribedModel], topics: Mapping[str, str], vehicle: Vehicle | None = None
) -> str:
    """The JSON of a description."""
    rows = [
        {
            "identity": model.identity,
            "vehicle": model.vehicle,
            "cutoff_hz": model.cutoff_hz,
            "training": {
                name: [float(model.lower[k]), float(model.upper[k])] for k, name in enumerate(INPUT_NAMES)
            },
        }
        for model in models
    ]
    whole: dict[str, Any] = {"models": rows, "topics": dict(topics)}
    if vehicle is not None:
        whole["vehicle"] = {"name": vehicle.name, "file": vehicle.to_file()}
    return json.dumps(whole, allow_nan=False)


def unpack_description(text: str) -> MonitorDescription:
    """The description in its JSON.

    Raises:
        LogError: for a text that is none.
    """
    try:
        given = json.loads(text)
        models = {}
        for model in given["models"]:
            ranges = np.array([model["training"][name] for name in INPUT_NAMES], dtype=float)
            if ranges.shape != (len(INPUT_NAMES), 2) or not np.isfinite(ranges).all():
                raise ValueError("a training range is no pair of numbers")
            identity = str(model["identity"])
            models[identity] = DescribedModel(
                identity, str(model["vehicle"]), ranges[:, 0], ranges[:, 1], _cutoff(model.get("cutoff_hz"))
            )
        topics = {str(name): str(topic) for name, topic in given["topics"].items()}
        vehicle = None
        if (flown := given.get("vehicle")) is not None:
            name = str(flown["name"])
            vehicle = Vehicle.of_file(flown["file"], name, f"vehicle {name}")
    except (
        *(ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError),
        VehicleError,
    ) as error:
        raise LogError(f"not the description of a monitor: {error}") from error
    return MonitorDescription(models, topics, vehicle)


def _cutoff(given: Any) -> float | None:
    if given is None:
        return None
    cutoff_hz = float(given)
    if not 0.0 < cutoff_hz < np.inf:
        raise ValueError(f"the cut-off {cutoff_hz:g} Hz is no frequency")
    return cutoff_hz
