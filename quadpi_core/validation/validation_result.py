# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Coverage and width over all realisations of the noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, astuple, dataclass, field
from typing import Any

import numpy as np

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.validation.validation_case import HIGHEST, LOWEST, Counts, Tally, ValidationCase
from quadpi_core.version import __version__

VARIATIONS = ("model_variation", "measurement_variation", "combined_variation")


@dataclass(frozen=True)
class Variation:
    """Coverage and width under noise, over all realisations, flights and samples.

    Attributes:
        picp: coverage as a fraction.
        picp_sd: its standard deviation over realisations; None for a single one.
        mpiw: mean width of the interval, N or Nm.
        range: of the covered predictions or measurements; the mean over realisations.
        nmpiw: mean width over that range; None where the range is zero.
        nmpiw_training: mean width over the range of the measured training data.
    """

    picp: float
    picp_sd: float | None
    mpiw: float
    range: float
    nmpiw: float | None
    nmpiw_training: float


@dataclass(frozen=True)
class AxisValidation:
    """What the intervals of one axis cover.

    Attributes:
        training: always None, a key that readers of the JSON file may expect.
        model_variation: predictions from noisy inputs in the interval at the noise-free inputs.
        measurement_variation: noisy measurements in the same interval.
        combined_variation: noisy measurements in the interval at the noisy inputs, as a flight shows it.
    """

    training: None = field(default=None, kw_only=True)
    model_variation: Variation
    measurement_variation: Variation
    combined_variation: Variation


@dataclass(frozen=True)
class FlightCoverage:
    """Coverage of the three variations on one flight, as fractions."""

    model_variation: float
    measurement_variation: float
    combined_variation: float


@dataclass(frozen=True)
class ModelValidation:
    """One model: its identity, method and settings, its axes, and the coverage by flight and axis."""

    model: str
    method: str
    settings: str
    axes: Mapping[str, AxisValidation]
    flights: Mapping[str, Mapping[str, FlightCoverage]]


@dataclass(frozen=True)
class ValidationFlight:
    """Length of one flight."""

    duration_s: float
    samples: int


@dataclass(frozen=True)
class NoiseLevels:
    """Standard deviations of the white noise on the states, in the order of `sensor_noise.StateNoise`."""

    velocity_m_s: float
    attitude_rad: float
    rates_rad_s: float
    specific_force_m_s2: float
    rotor_speeds_rad_s: float


@dataclass(frozen=True)
class Validation:
    """Models validated under noise; the names of the attributes are the keys of the JSON file.

    Attributes:
        quadpi_version: that validated.
        vehicle: name of the vehicle file.
        confidence: nominal coverage of the intervals.
        seed: of all noise.
        realisations: of the noise on each flight.
        noise: its levels.
        cutoff_hz: low-pass of the models.
        flights: by name.
        models: by name.
        published: always None, as `training` of an axis.
    """

    quadpi_version: str
    vehicle: str
    confidence: float
    seed: int
    realisations: int
    noise: NoiseLevels
    cutoff_hz: float
    flights: Mapping[str, ValidationFlight]
    models: Mapping[str, ModelValidation]
    published: None = None

    def to_json(self) -> dict[str, Any]:
        """As JSON holds it."""
        return asdict(self)


def summarise(case: ValidationCase, tally: Tally) -> Validation:
    """Summarise the realisations of a case by model and axis."""
    sizes = np.array([len(flight) for flight in case.flights])
    return Validation(
        quadpi_version=__version__,
        vehicle=case.vehicle.name,
        confidence=case.confidence,
        seed=case.seed,
        realisations=len(tally.width),
        noise=NoiseLevels(*astuple(case.noise)),
        cutoff_hz=next(iter(case.models.values())).cutoff_hz,
        flights={
            flight.name: ValidationFlight(float(flight.time[-1] - flight.time[0]), len(flight))
            for flight in case.flights
        },
        models={
            name: ModelValidation(
                model.identity,
                model.method,
                model.settings,
                _axes(case, tally, place, sizes),
                _flights(case, tally, place, sizes),
            )
            for place, (name, model) in enumerate(case.models.items())
        },
    )


def _axes(case: ValidationCase, tally: Tally, place: int, sizes: Counts) -> dict[str, AxisValidation]:
    name, model = list(case.models.items())[place]
    total = int(sizes.sum())
    reference_width = sum((r.upper - r.lower).sum(axis=0) for r in case.references[name]) / total
    noisy_width = tally.width[:, place].sum(axis=(0, 1)) / (total * len(tally.width))
    predicted, measured = _spans(tally.predicted[:, place]), _spans(tally.measured)

    def variation(inside: Counts, width: Array, extents: Array, axis: str) -> Variation:
        k = AXES.index(axis)
        coverage = inside[:, place, :, k].sum(axis=1) / total
        extent, mpiw = float(extents[:, k].mean()), float(width[k])
        return Variation(
            picp=float(coverage.mean()),
            picp_sd=float(coverage.std(ddof=1)) if len(coverage) > 1 else None,
            mpiw=mpiw,
            range=extent,
            nmpiw=mpiw / extent if extent > 0.0 else None,
            nmpiw_training=mpiw / model.training_range[axis],
        )

    return {
        axis: AxisValidation(
            model_variation=variation(tally.model, reference_width, predicted, axis),
            measurement_variation=variation(tally.measurement, reference_width, measured, axis),
            combined_variation=variation(tally.combined, noisy_width, measured, axis),
        )
        for axis in model.axes
    }


def _flights(
    case: ValidationCase, tally: Tally, place: int, sizes: Counts
) -> dict[str, dict[str, FlightCoverage]]:
    model = list(case.models.values())[place]
    counts = (tally.model, tally.measurement, tally.combined)
    shares = [inside[:, place].mean(axis=0) / sizes[:, None] for inside in counts]
    return {
        flight.name: {
            axis: FlightCoverage(*(float(share[k, AXES.index(axis)]) for share in shares))
            for axis in model.axes
        }
        for k, flight in enumerate(case.flights)
    }


def _spans(extremes: Array) -> Array:
    """Range (R, 6) in each realisation, over all flights, of extremes (R, F, 6, 2)."""
    return extremes[..., HIGHEST].max(axis=1) - extremes[..., LOWEST].min(axis=1)
