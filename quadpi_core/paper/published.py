# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The two experiments of van Beers and de Visser repeated in simulation, and their published tables.

- Validation under noise (Sec. IV): models of noisy flights of a simulated quadrotor, judged under
  realisations of noise on other flights.
- Wind tunnel (Sec. V): models of the HDBeetle from flights in 0, 5 and 10 m/s interpolate to 8 m/s and
  extrapolate to 14 m/s.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from quadpi_core.evaluation.evaluate import ComparisonCase
from quadpi_core.evaluation.evaluation_result import PublishedMetrics
from quadpi_core.flight import Flight
from quadpi_core.identification.prepared_flights import PreparedFlight, prepare_flights
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.candidate_pool import load_pools
from quadpi_core.models.kind_registry import kind_named
from quadpi_core.models.model_kind import CUTOFF_HZ, IdentifyOptions, Settings
from quadpi_core.paper.model_cache import ModelCache
from quadpi_core.paper.realisations import noise_seed
from quadpi_core.paper.validation_case import ValidationCase, flight_hash, simulated_flights
from quadpi_core.paper.validation_result import PublishedAxis, PublishedCoverage
from quadpi_core.parallel import DEFAULT_WORKERS, ReportProgress, Workers, ignore_progress
from quadpi_core.scratch import scratch_folder
from quadpi_core.simulation.run import simulate
from quadpi_core.simulation.scenario import FlightPlan, load_scenario
from quadpi_core.simulation.sensor_noise import SensorSuite, StateNoise, contaminate
from quadpi_core.simulation.truth import LOG_HZ
from quadpi_core.vehicle import Vehicle

TRAINING, VALIDATION, CANDIDATES = "training", "validation", "bebop2_simulation"
# The paper does not filter its simulated flights: a cut-off at half the sample rate leaves them as they are.
UNFILTERED_HZ = 0.5 * LOG_HZ

TUNNEL, TUNNEL_CANDIDATES = "tunnel", "hdbeetle"
TUNNEL_SETTINGS: tuple[Settings, ...] = ("paper", "default")
# Winds in m/s; the models are identified on the first group.
GROUPS = {"identification": (0.0, 5.0, 10.0), "interpolation": (8.0,), "extrapolation": (14.0,)}

# Tables of the force and the moment models: PICP and MPIW over the range of the data, each on the training
# data, under model variation and under measurement variation, in percent.
_VALIDATION_TABLES = """
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
# Table of the HDBeetle: PICP in percent, and MPIW in N or Nm, of each group.
_TUNNEL_TABLE = """
Fx bootstrap       98.26 97.35  97.15 0.89 0.77 1.26
Fx quality-driven  98.25 97.30  96.97 0.89 0.77 1.20
Fx polynomial      95.29 96.06  89.19 0.83 0.83 0.83
Fz bootstrap       98.04 97.79  39.21 0.73 0.69 1.06
Fz quality-driven  97.98 97.78  33.48 0.71 0.69 1.03
Fz polynomial      95.70 97.54  75.85 0.69 0.69 0.69
My bootstrap       99.95 99.97 100.00 0.06 0.04 0.08
My quality-driven  99.79 99.84  99.85 0.04 0.03 0.05
My polynomial      97.15 97.31  98.92 0.02 0.02 0.02
"""


def _rows(table: str) -> Iterator[tuple[str, str, list[float], list[float]]]:
    """Method, axis, three coverages as fractions and three widths of each line."""
    for line in table.split("\n")[1:-1]:
        axis, method, *cells = line.split()
        yield (
            method,
            axis,
            [_fraction(float(cell)) for cell in cells[:3]],
            [float(cell) for cell in cells[3:]],
        )


def _fraction(percent: float) -> float:
    """Rounded to the digits that the paper states."""
    return round(percent / 100.0, 4)


# In the order of the tables.
METHODS = tuple(dict.fromkeys(method for method, *_ in _rows(_TUNNEL_TABLE)))


def published_tables() -> dict[str, dict[str, PublishedAxis]]:
    """Coverage and width that the paper states under noise, by method and axis."""
    tables: dict[str, dict[str, PublishedAxis]] = {method: {} for method in METHODS}
    for method, axis, coverages, widths in _rows(_VALIDATION_TABLES):
        pairs = zip(coverages, widths, strict=True)
        tables[method][axis] = PublishedAxis(
            *(PublishedCoverage(picp, _fraction(width)) for picp, width in pairs)
        )
    return tables


def published_table() -> dict[str, dict[str, dict[str, PublishedMetrics]]]:
    """Coverage and width that the paper states in the wind tunnel, by method, axis and group.

    The text says that 0, 5 and 10 m/s are the identification data, the caption of the table 10 m/s alone.
    """
    table: dict[str, dict[str, dict[str, PublishedMetrics]]] = {method: {} for method in METHODS}
    for method, axis, coverages, widths in _rows(_TUNNEL_TABLE):
        cells = map(PublishedMetrics, coverages, widths)
        table[method][axis] = dict(zip(GROUPS, cells, strict=True))
    return table


@dataclass(frozen=True)
class PublishedCase:
    """The paper's validation, and the noisy flights that its models were identified on."""

    case: ValidationCase
    training: tuple[PreparedFlight, ...]


def published_case(
    *,
    methods: Sequence[str] = METHODS,
    settings: Settings = "paper",
    noise: str = "paper",
    confidence: float = 0.95,
    seed: int = 0,
    device: str = "cpu",
    folder: Path | None = None,
    progress: ReportProgress = ignore_progress,
) -> PublishedCase:
    """Simulate the paper's flights, put noise on the training set, and identify a model by each method.

    Args:
        methods: to identify.
        settings: of the methods.
        noise: name in config/noise, or path, of the noise on training and validation flights.
        confidence: of the intervals.
        seed: of all noise, and of the ensembles.
        device: that trains the ensembles.
        folder: of stored models, see :class:`.model_cache.ModelCache`.
        progress: called as the work goes on.

    Raises:
        ModelError: if a method cannot be identified, naming the axis.
        OutputError: if a model cannot be stored.
    """
    states = SensorSuite.load(noise).states
    plans = load_scenario(TRAINING).flights
    vehicle = Vehicle.load(plans[0].vehicle)
    clean = simulated_flights(plans, progress)
    training = tuple(_noisy(flight, vehicle, states, seed) for flight in clean)
    cache = ModelCache(vehicle, load_pools(CANDIDATES), folder, progress)
    models: dict[str, AerodynamicModel] = {}
    for method in methods:
        options = IdentifyOptions(
            method=kind_named(method).having(seed=seed, device=device),
            settings=settings,
            cutoff_hz=UNFILTERED_HZ,
            confidence=confidence,
        )
        models[method] = cache.model(method, training, options)
    flights = simulated_flights(load_scenario(VALIDATION).flights, progress)
    case = ValidationCase(vehicle, models, tuple(flights), states, confidence, seed)
    return PublishedCase(case, training)


def _noisy(clean: Flight, vehicle: Vehicle, noise: StateNoise, seed: int) -> PreparedFlight:
    """A training flight with noise, independent of all realisations on validation flights."""
    flight = contaminate(clean, noise, noise_seed(seed, f"{TRAINING} {clean.name}", 0))
    return PreparedFlight.of(flight, vehicle, flight_hash(flight))


def wind_tunnel(
    *,
    methods: Sequence[str] = METHODS,
    confidence: float = 0.95,
    device: str = "cpu",
    folder: Path | None = None,
    workers: Workers = DEFAULT_WORKERS,
) -> ComparisonCase:
    """Simulate the wind tunnel, and identify a model by each method and settings on the first group.

    Bags are simulated again at each call, to the same bytes. Models are named after method and settings, such
    as "bootstrap-paper".

    Args:
        methods: to identify.
        confidence: of the intervals.
        device: that trains the ensembles.
        folder: of the folders `bags` and `models`, see :class:`.model_cache.ModelCache`; None for neither.
        workers: that read flights; as many flights are simulated at a time.

    Raises:
        ModelError: if a method cannot be identified, naming the axis.
        OutputError: if a bag or model cannot be stored.
    """
    plans = load_scenario(TUNNEL).flights
    vehicle = Vehicle.load(plans[0].vehicle)
    groups = {name: _in_wind(plans, winds) for name, winds in GROUPS.items()}
    used = [plan for plan in plans if any(plan.name in members for members in groups.values())]
    with scratch_folder() if folder is None else nullcontext(folder) as place:
        flown = simulate(used, Path(place) / "bags", workers=workers)
        bags = [flight.bag for flight in flown]
        flights = {}
        for settings in TUNNEL_SETTINGS:
            cutoff_hz = CUTOFF_HZ[settings]
            flights[cutoff_hz] = prepare_flights(bags, vehicle, cutoff_hz, workers=workers)
    stored = None if folder is None else folder / "models"
    cache = ModelCache(vehicle, load_pools(TUNNEL_CANDIDATES), stored, workers.progress)
    training = set(next(iter(groups.values())))
    models = {}
    for method in methods:
        for settings in TUNNEL_SETTINGS:
            name, cutoff_hz = f"{method}-{settings}", CUTOFF_HZ[settings]
            options = IdentifyOptions(
                method=kind_named(method).having(device=device),
                settings=settings,
                cutoff_hz=cutoff_hz,
                confidence=confidence,
            )
            own = [flight for flight in flights[cutoff_hz] if flight.name in training]
            models[name] = cache.model(name, own, options)
    return ComparisonCase(models, flights, groups, confidence, published_table())


def _in_wind(plans: Sequence[FlightPlan], winds: Sequence[float]) -> list[str]:
    return [plan.name for plan in plans if plan.head_wind_m_s in winds]
