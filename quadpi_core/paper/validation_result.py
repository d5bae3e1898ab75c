# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Coverage and width of all realisations, as plain JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quadpi_core import __version__
from quadpi_core.evaluation import metrics
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.paper.realisations import HIGHEST, LOWEST, Counts, Tally
from quadpi_core.paper.validation_case import ValidationCase
from quadpi_core.simulation.sensor_noise import StateNoise

VARIATIONS = ("model_variation", "measurement_variation", "combined_variation")
# Published coverage and width, as they stand in :mod:`quadpi_core.paper.published`.
Published = Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]]


def summarise(
    case: ValidationCase,
    tally: Tally,
    *,
    training: Sequence[PreparedFlight] = (),
    published: Published | None = None,
) -> dict[str, Any]:
    """What the realisations say of each model; the result is plain JSON, null where something is undefined.

    Keys: `quadpi_version`, `vehicle`, `confidence`, `seed`, `realisations`, `noise.…`, `cutoff_hz`,
    `flights.NAME.{duration_s, samples}` and `models.NAME.{model, method, settings, axes.AXIS, flights}`. Each
    axis holds `training` (null without training flights) and three variations:

    - `model_variation`: predictions from noisy inputs in the interval at the noise-free inputs;
    - `measurement_variation`: noisy measurements in the same interval;
    - `combined_variation`: noisy measurements in the interval at the noisy inputs, as a flight shows it;
      `training` is the same on the training flights;

    each with `picp` over all realisations, flights and samples, `picp_sd` over realisations, `mpiw`, `range`
    of what is to be covered (predictions or measurements, the mean over realisations), `nmpiw` = mpiw / range
    and `nmpiw_training` = mpiw over the range of the measured training data. `models.NAME.flights.NAME.AXIS`
    holds the `picp` of the three variations on one flight.

    Args:
        case: that was validated.
        tally: of its realisations.
        training: noisy flights that the models were identified on.
        published: numbers to set beside; returned as `published`.
    """
    sizes = np.array([len(flight) for flight in case.flights])
    return {
        "quadpi_version": __version__,
        "vehicle": case.vehicle.name,
        "confidence": case.confidence,
        "seed": case.seed,
        "realisations": len(tally.width),
        "noise": _with_units(case.noise),
        "cutoff_hz": next(iter(case.models.values())).cutoff_hz,
        "flights": {
            flight.name: {"duration_s": float(flight.time[-1] - flight.time[0]), "samples": len(flight)}
            for flight in case.flights
        },
        "models": {
            name: {
                "model": model.identity,
                "method": model.method,
                "settings": model.settings,
                "axes": _axes(case, tally, place, training, sizes),
                "flights": _flights(case, tally, place, sizes),
            }
            for place, (name, model) in enumerate(case.models.items())
        },
        "published": published,
    }


def _axes(
    case: ValidationCase, tally: Tally, place: int, training: Sequence[PreparedFlight], sizes: Counts
) -> dict[str, Any]:
    name, model = list(case.models.items())[place]
    total = int(sizes.sum())
    reference_width = sum((r.upper - r.lower).sum(axis=0) for r in case.references[name]) / total
    noisy_width = tally.width[:, place].sum(axis=(0, 1)) / (total * len(tally.width))
    predicted, measured = _spans(tally.predicted[:, place]), _spans(tally.measured)
    seen = _training(model, training, case.confidence)

    def variation(inside: Counts, width: Array, extents: Array, axis: str) -> dict[str, Any]:
        k = AXES.index(axis)
        coverage = inside[:, place, :, k].sum(axis=1) / total
        extent, mpiw = float(extents[:, k].mean()), float(width[k])
        return {
            "picp": float(coverage.mean()),
            "picp_sd": float(coverage.std(ddof=1)) if len(coverage) > 1 else None,
            "mpiw": mpiw,
            "range": extent,
            "nmpiw": mpiw / extent if extent > 0.0 else None,
            "nmpiw_training": mpiw / model.training_range[axis],
        }

    return {
        axis: {
            "training": seen.get(axis),
            "model_variation": variation(tally.model, reference_width, predicted, axis),
            "measurement_variation": variation(tally.measurement, reference_width, measured, axis),
            "combined_variation": variation(tally.combined, noisy_width, measured, axis),
        }
        for axis in model.axes
    }


def _flights(case: ValidationCase, tally: Tally, place: int, sizes: Counts) -> dict[str, Any]:
    model = list(case.models.values())[place]
    counts = zip(VARIATIONS, (tally.model, tally.measurement, tally.combined), strict=True)
    shares = {variation: inside[:, place].mean(axis=0) / sizes[:, None] for variation, inside in counts}
    return {
        flight.name: {
            axis: {variation: float(share[k, AXES.index(axis)]) for variation, share in shares.items()}
            for axis in model.axes
        }
        for k, flight in enumerate(case.flights)
    }


def _training(
    model: AerodynamicModel, flights: Sequence[PreparedFlight], confidence: float
) -> dict[str, dict[str, float]]:
    """Coverage and width on the flights that a model was identified on."""
    if not flights:
        return {}
    said = model.evaluate(np.concatenate([flight.inputs for flight in flights]), confidence)
    measured = np.concatenate([flight.wrench for flight in flights])
    result = {}
    for axis in model.axes:
        column = (slice(None), AXES.index(axis))
        lower, upper, extent = said.lower[column], said.upper[column], float(np.ptp(measured[column]))
        width = metrics.mpiw(lower, upper)
        result[axis] = {
            "picp": metrics.picp(measured[column], lower, upper),
            "mpiw": width,
            "range": extent,
            "nmpiw": width / extent,
        }
    return result


def _spans(extremes: Array) -> Array:
    """Range (R, 6) in each realisation, over all flights, of extremes (R, F, 6, 2)."""
    spans: Array = extremes[..., HIGHEST].max(axis=1) - extremes[..., LOWEST].min(axis=1)
    return spans


def _with_units(noise: StateNoise) -> dict[str, float]:
    return {
        "velocity_m_s": noise.velocity,
        "attitude_rad": noise.attitude,
        "rates_rad_s": noise.rates,
        "specific_force_m_s2": noise.specific_force,
        "rotor_speeds_rad_s": noise.rotor_speeds,
    }
