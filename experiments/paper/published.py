# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The two experiments of van Beers and de Visser repeated in simulation.

- Validation under noise (Sec. IV): models of noisy flights of a simulated quadrotor, judged under
  realisations of noise on other flights.
- Wind tunnel (Sec. V): models of the HDBeetle from flights in 0, 5 and 10 m/s interpolate to 8 m/s and
  extrapolate to 14 m/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from paper.model_cache import ModelCache
from paper.numbers import GROUPS, METHODS, CoverageAndWidth
from quadpi_core.evaluation import metrics
from quadpi_core.evaluation.evaluate import ComparisonCase, compare
from quadpi_core.evaluation.evaluation_result import Comparison
from quadpi_core.flight import AXES, Flight
from quadpi_core.identification.prepared_flights import PreparedFlight, prepare_flights
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.kind_registry import kind_named
from quadpi_core.models.model_kind import CUTOFF_HZ, IdentifyOptions, Settings
from quadpi_core.models.regressors import load_pools
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import FlightPlan, load_scenario
from quadpi_core.simulation.sensor_noise import SensorSuite, StateNoise, contaminate
from quadpi_core.simulation.simulated_bags import fly_plan, simulate
from quadpi_core.simulation.truth import LOG_HZ
from quadpi_core.validation.validation_case import ValidationCase, flight_hash, noise_seed, run_realisations
from quadpi_core.validation.validation_result import Validation, summarise
from quadpi_core.vehicle import Vehicle

SETTINGS: tuple[Settings, ...] = ("paper", "default")
NOISE = "paper"

TRAINING, VALIDATION, CANDIDATES = "training", "validation", "bebop2_simulation"
# The paper does not filter its simulated flights: a cut-off at half the sample rate leaves them as they are.
UNFILTERED_HZ = 0.5 * LOG_HZ

TUNNEL, TUNNEL_CANDIDATES = "tunnel", "hdbeetle"


@dataclass(frozen=True)
class PublishedCase:
    """The paper's validation, and the noisy flights that its models were identified on."""

    case: ValidationCase
    training: tuple[PreparedFlight, ...]


@dataclass(frozen=True)
class PublishedValidation:
    """What the intervals of the paper's methods cover.

    Attributes:
        result: under noise.
        training: on the flights that the models were identified on, by model and axis.
    """

    result: Validation
    training: Mapping[str, Mapping[str, CoverageAndWidth]]


def validate(
    settings: Settings, realisations: int, folder: Path, methods: Sequence[str] = METHODS
) -> PublishedValidation:
    """Judge models of each method under realisations of noise.

    Args:
        settings: of the methods.
        realisations: of the noise, on each flight.
        folder: of the folders `models` and `realisations`, from which a later run continues.
        methods: to identify.
    """
    own = published_case(folder / "models", settings=settings, methods=methods)
    own.case.check()
    tally = run_realisations(own.case, realisations, folder=folder / "realisations")
    training = {name: training_coverage(model, own.training) for name, model in own.case.models.items()}
    return PublishedValidation(summarise(own.case, tally), training)


def published_case(
    folder: Path,
    *,
    methods: Sequence[str] = METHODS,
    settings: Settings = "paper",
    confidence: float = 0.95,
    seed: int = 0,
) -> PublishedCase:
    """Simulate the paper's flights, put noise on the training set, and identify a model by each method.

    Args:
        folder: of stored models, see :class:`.model_cache.ModelCache`.
        methods: to identify.
        settings: of the methods.
        confidence: of the intervals.
        seed: of all noise, and of the ensembles.

    Raises:
        ModelError: if a method cannot be identified, naming the axis.
        OutputError: if a model cannot be stored.
    """
    states = SensorSuite.load(NOISE).states
    plans = load_scenario(TRAINING).flights
    vehicle = Vehicle.load(plans[0].vehicle)
    training = tuple(_noisy(flight, vehicle, states, seed) for flight in _flown(plans))
    cache = ModelCache(vehicle, load_pools(CANDIDATES), folder)
    models: dict[str, AerodynamicModel] = {}
    for method in methods:
        options = IdentifyOptions(
            method=kind_named(method).having(seed=seed),
            settings=settings,
            cutoff_hz=UNFILTERED_HZ,
            confidence=confidence,
        )
        models[method] = cache.model(method, training, options)
    flights = tuple(_flown(load_scenario(VALIDATION).flights))
    return PublishedCase(ValidationCase(vehicle, models, flights, states, confidence, seed), training)


def _flown(plans: Sequence[FlightPlan]) -> list[Flight]:
    """The flights as they were; nothing senses them."""
    return [fly_plan(plan, SimulatedVehicle.load(plan.vehicle)).flight() for plan in plans]


def _noisy(clean: Flight, vehicle: Vehicle, noise: StateNoise, seed: int) -> PreparedFlight:
    """A training flight with noise, independent of all realisations on validation flights."""
    flight = contaminate(clean, noise, noise_seed(seed, f"{TRAINING} {clean.name}", 0))
    return PreparedFlight.from_flight(flight, vehicle, flight_hash(flight))


def training_coverage(
    model: AerodynamicModel, flights: Sequence[PreparedFlight]
) -> dict[str, CoverageAndWidth]:
    """Coverage and width on the flights that a model was identified on, by axis."""
    said = model.evaluate(np.concatenate([flight.inputs for flight in flights]), model.confidence)
    measured = np.concatenate([flight.wrench for flight in flights])
    found = {}
    for axis in model.axes:
        column = (slice(None), AXES.index(axis))
        lower, upper, extent = said.lower[column], said.upper[column], float(np.ptp(measured[column]))
        picp = metrics.picp(measured[column], lower, upper)
        found[axis] = CoverageAndWidth(picp, metrics.nmpiw(lower, upper, extent))
    return found


def wind_tunnel(
    folder: Path, *, methods: Sequence[str] = METHODS, confidence: float = 0.95
) -> ComparisonCase:
    """Simulate the wind tunnel, and identify a model by each method and settings on the first group.

    Bags are simulated again at each call, to the same bytes. Models are named after method and settings, such
    as "bootstrap-paper".

    Args:
        folder: of the folders `bags` and `models`, see :class:`.model_cache.ModelCache`.
        methods: to identify.
        confidence: of the intervals.

    Raises:
        ModelError: if a method cannot be identified, naming the axis.
        OutputError: if a bag or model cannot be stored.
    """
    plans = load_scenario(TUNNEL).flights
    vehicle = Vehicle.load(plans[0].vehicle)
    groups = {name: _in_wind(plans, winds) for name, winds in GROUPS.items()}
    used = [plan for plan in plans if any(plan.name in members for members in groups.values())]
    bags = [flight.bag for flight in simulate(used, folder / "bags")]
    cache = ModelCache(vehicle, load_pools(TUNNEL_CANDIDATES), folder / "models")
    training = set(next(iter(groups.values())))
    flights = {
        CUTOFF_HZ[settings]: prepare_flights(bags, vehicle, CUTOFF_HZ[settings]) for settings in SETTINGS
    }
    models = {}
    for method in methods:
        for settings in SETTINGS:
            name, cutoff_hz = f"{method}-{settings}", CUTOFF_HZ[settings]
            options = IdentifyOptions(
                method=kind_named(method), settings=settings, cutoff_hz=cutoff_hz, confidence=confidence
            )
            own = [flight for flight in flights[cutoff_hz] if flight.name in training]
            models[name] = cache.model(name, own, options)
    return ComparisonCase(models, flights, groups, confidence)


def tunnel_comparison(folder: Path) -> Comparison:
    """Judge the models of the wind tunnel, see :func:`wind_tunnel`."""
    return compare(wind_tunnel(folder))[1]


def _in_wind(plans: Sequence[FlightPlan], winds: Sequence[float]) -> list[str]:
    return [plan.name for plan in plans if plan.head_wind_m_s in winds]
