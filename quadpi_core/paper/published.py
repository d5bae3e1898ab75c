# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's own validation: its flights, its noise, its methods; and what it found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from quadpi_core.flight import Flight
from quadpi_core.identification.identify import MethodName, Settings
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.candidate_pool import load_pools
from quadpi_core.paper.model_cache import identify_or_take, named
from quadpi_core.paper.realisations import noise_seed
from quadpi_core.paper.validation_case import ValidationCase, flight_hash, simulated_flights
from quadpi_core.paper.validation_result import PublishedAxis, PublishedCoverage
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.sensor_noise import SensorSuite, StateNoise, contaminate
from quadpi_core.simulation.truth import LOG_HZ
from quadpi_core.vehicle import Vehicle

TRAINING, VALIDATION, CANDIDATES = "training", "validation", "bebop2_simulation"
# In the order of the paper's tables.
METHODS: tuple[MethodName, ...] = ("bootstrap", "quality-driven", "polynomial")
# Its simulated flights are not filtered: nothing lies above half the sample rate.
UNFILTERED_HZ = 0.5 * LOG_HZ

# Van Beers and de Visser, tables of the force and the moment models: PICP and MPIW over the range of the
# data, each on the training data, under model variation and under measurement variation, in percent.
_TABLES = """
Fx bootstrap       96.36 100.00 97.24  3.26  6.97  6.09
Fx quality-driven  97.18 100.00 97.84  3.46  7.00  6.28
Fx polynomial      97.59 100.00 96.89  3.95  6.30  5.63
Fy bootstrap       95.78 100.00 96.76  3.15  6.16  5.95
Fy quality-driven  97.54 100.00 98.33  3.60  7.28  7.08
Fy polynomial      96.74 100.00 96.51  3.82  5.67  5.61
Fz bootstrap       97.52  99.99 98.90  5.37  7.62  6.12
Fz quality-driven  97.59 100.00 99.40  3.02  9.25  6.92
Fz polynomial      96.68 100.00 99.94  8.13 27.32 21.78
Mx bootstrap       96.05  98.63 97.67  2.40  3.83  3.84
Mx quality-driven  98.51  99.55 98.40  2.96  3.87  3.81
Mx polynomial      96.22  98.75 98.29  3.14  5.58  5.80
My bootstrap       96.84  98.26 97.89  2.76  5.76  6.39
My quality-driven  99.13  99.65 98.84  3.75  6.11  7.20
My polynomial      96.04  98.54 98.00  2.95  7.19  8.18
Mz bootstrap       98.05 100.00 98.85  6.36  8.77  8.41
Mz quality-driven  97.86 100.00 97.89  5.28  7.08  6.57
Mz polynomial      96.75 100.00 96.92  4.64  6.00  5.77
"""


def published_tables() -> dict[str, dict[str, PublishedAxis]]:
    """What the paper found, by method and axis."""
    tables: dict[str, dict[str, PublishedAxis]] = {method: {} for method in METHODS}
    for line in _TABLES.split("\n")[1:-1]:
        axis, method, *cells = line.split()
        values = [round(float(cell) / 100.0, 4) for cell in cells]
        pairs = zip(values[:3], values[3:], strict=True)
        tables[method][axis] = PublishedAxis(*(PublishedCoverage(*pair) for pair in pairs))
    return tables


@dataclass(frozen=True)
class PublishedCase:
    """The paper's validation, and the noisy flights that its models were identified on."""

    case: ValidationCase
    training: tuple[PreparedFlight, ...]


def published_case(
    *,
    methods: tuple[MethodName, ...] = METHODS,
    settings: Settings = "paper",
    noise: str = "paper",
    confidence: float = 0.95,
    seed: int = 0,
    device: str = "cpu",
    folder: Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> PublishedCase:
    """Simulate the paper's flights, put noise on the training set, and identify a model by each method.

    Args:
        methods: to identify.
        settings: of the methods.
        noise: name in config/noise, or path, of the noise on training and validation flights.
        confidence: of the intervals.
        seed: of all noise, and of the ensembles.
        device: that trains the ensembles.
        folder: where models are kept, and taken from when they come from the same data and settings.
        progress: called with what is being done.

    Raises:
        ModelError: if a method cannot be identified, naming method and axis.
        OutputError: if a model cannot be kept.
    """
    states = SensorSuite.load(noise).states
    plans = load_scenario(TRAINING).flights
    vehicle = Vehicle.load(plans[0].vehicle)
    clean = simulated_flights(plans, lambda name: progress(f"Simulating {name}"))
    training = tuple(_noisy(flight, vehicle, states, seed) for flight in clean)
    pools = load_pools(CANDIDATES)
    models: dict[str, AerodynamicModel] = {}
    for method in methods:
        models[method] = identify_or_take(
            training,
            vehicle,
            pools,
            None if folder is None else folder / method,
            method=method,
            settings=settings,
            cutoff_hz=UNFILTERED_HZ,
            confidence=confidence,
            seed=seed,
            device=device,
            progress=named(progress, method),
        )
    flights = simulated_flights(
        load_scenario(VALIDATION).flights, lambda name: progress(f"Simulating {name}")
    )
    case = ValidationCase(vehicle, models, tuple(flights), states, confidence, seed)
    return PublishedCase(case, training)


def _noisy(clean: Flight, vehicle: Vehicle, noise: StateNoise, seed: int) -> PreparedFlight:
    """A training flight with noise; no realisation of a validation flight has the same."""
    flight = contaminate(clean, noise, noise_seed(seed, f"{TRAINING} {clean.name}", 0))
    return PreparedFlight.of(flight, vehicle, flight_hash(flight))
