# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's validation: 1000 realisations of noise on 60 s of flight, six axes, three methods.

On two workers: noise, input vectors, predictions and bounds from the noisy inputs, and counting, at 500 Hz.
The polynomial is identified on the paper's training set; the ensembles have its size and random weights,
which take as long as trained ones. Some realisations are timed, and what they take is scaled to all; what the
start of the workers takes on top, which few realisations show, is counted once.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks import Result
from benchmarks.random_ensembles import random_ensembles, simulation_inputs
from quadpi_core.flight import Flight
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.parallel import Workers
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import FlightPlan, load_scenario
from quadpi_core.simulation.sensor_noise import SensorSuite, contaminate
from quadpi_core.simulation.simulated_bags import fly_plan
from quadpi_core.simulation.truth import LOG_HZ
from quadpi_core.validation.validation_case import CHUNK, ValidationCase, run_realisations
from quadpi_core.vehicle import Vehicle

NAMES = ("validation_minutes",)

WORKERS = 2
REALISATIONS, FLIGHT_S = 1000, 60.0
FEW, MANY = 2 * CHUNK, 16 * CHUNK


def run() -> list[Result]:
    case = three_methods()
    few, many = (seconds(case, count) for count in (FEW, MANY))
    each = (many - few) / (MANY - FEW)
    total = few + (REALISATIONS - FEW) * each
    samples = sum(len(flight) for flight in case.flights)
    per_sample = WORKERS * each / (samples * len(case.models)) * 1e6
    baseline = (
        f"{REALISATIONS} realisations of {FLIGHT_S:.0f} s on {WORKERS} workers, from {MANY} in {many:.0f} s; "
        f"{per_sample:.1f} µs of a core per sample and method, all six axes"
    )
    return [Result(NAMES[0], total / 60.0, "min", baseline, goal=5.0, at_most=True)]


def three_methods() -> ValidationCase:
    """The paper's case with as many of its validation flights as together last FLIGHT_S."""
    plans = load_scenario("training").flights
    vehicle, noise = Vehicle.load(plans[0].vehicle), SensorSuite.load("paper").states
    training = [
        PreparedFlight.from_flight(contaminate(flight, noise, seed), vehicle, "")
        for seed, flight in enumerate(flown(plans))
    ]
    # Half the sample rate: the paper does not filter these flights.
    options = IdentifyOptions(method="polynomial", settings="paper", cutoff_hz=0.5 * LOG_HZ)
    polynomial = identify(training, vehicle, load_pools("bebop2_simulation"), options)
    X = np.concatenate([flight.inputs for flight in training])
    inputs = simulation_inputs()
    ensembles = {
        method: replace(polynomial, fitted=random_ensembles(method, X, inputs))
        for method in ("bootstrap", "quality-driven")
    }
    plans = load_scenario("validation").flights
    ends = np.cumsum([plan.duration_s for plan in plans])
    flights = flown(plans[: int(np.searchsorted(ends, FLIGHT_S)) + 1])
    return ValidationCase(vehicle, ensembles | {"polynomial": polynomial}, flights, noise, 0.95, seed=0)


def flown(plans: Sequence[FlightPlan]) -> tuple[Flight, ...]:
    """The flights as they were; nothing senses them."""
    return tuple(fly_plan(plan, SimulatedVehicle.load(plan.vehicle)).flight() for plan in plans)


def seconds(case: ValidationCase, count: int) -> float:
    """Wall time of a number of realisations, the start of the workers included."""
    start = time.perf_counter()
    run_realisations(case, count, workers=Workers(WORKERS))
    return time.perf_counter() - start
