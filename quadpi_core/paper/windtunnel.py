# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's wind tunnel: what it found on the HDBeetle, and the same on simulated flights.

Models learn from flights in 0, 5 and 10 m/s, interpolate to 8 m/s and extrapolate to 14 m/s
(van Beers and de Visser, Sec. V).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path

from quadpi_core.evaluation.compare import ComparisonCase
from quadpi_core.evaluation.evaluation_result import PublishedMetrics
from quadpi_core.identification.identify import CUTOFF_HZ, MethodName, Settings
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.models.candidate_pool import load_pools
from quadpi_core.paper.model_cache import identify_or_take, named
from quadpi_core.paper.published import METHODS
from quadpi_core.scratch import scratch_folder
from quadpi_core.simulation.flight_plan import FlightPlan
from quadpi_core.simulation.run import simulate
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.vehicle import Vehicle

SCENARIO, CANDIDATES = "tunnel", "hdbeetle"
SETTINGS: tuple[Settings, ...] = ("paper", "default")
# Winds in m/s; the models learn from the first group.
GROUPS = {"identification": (0.0, 5.0, 10.0), "interpolation": (8.0,), "extrapolation": (14.0,)}

# The table of the HDBeetle: PICP in percent, and MPIW in N or Nm, of each group.
_TABLE = """
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


def published_table() -> dict[str, dict[str, dict[str, PublishedMetrics]]]:
    """What the paper found, by method, axis and group.

    The text says that 0, 5 and 10 m/s are the identification data, the caption of the table 10 m/s alone.
    """
    table: dict[str, dict[str, dict[str, PublishedMetrics]]] = {method: {} for method in METHODS}
    for line in _TABLE.split("\n")[1:-1]:
        axis, method, *cells = line.split()
        values = [float(cell) for cell in cells]
        pairs = zip(values[:3], values[3:], strict=True)
        table[method][axis] = {
            group: PublishedMetrics(round(picp / 100.0, 4), mpiw)
            for group, (picp, mpiw) in zip(GROUPS, pairs, strict=True)
        }
    return table


def wind_tunnel(
    *,
    methods: Sequence[MethodName] = METHODS,
    confidence: float = 0.95,
    device: str = "cpu",
    folder: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> ComparisonCase:
    """Fly the scenario, and identify a model by each method and settings on the first group.

    Flights are the same bytes each time, so they are flown anew and replaced. Models are named after method
    and settings, such as "bootstrap-paper".

    Args:
        methods: to identify.
        confidence: of the intervals.
        device: that trains the ensembles.
        folder: where `bags` and `models` are kept, and models taken from when they come from the same.
        workers: see `prepared_flights.prepare_flights`; as many flights fly at a time.
        scheduler: see there.
        progress: called with what is being done.

    Raises:
        ModelError: if a method cannot be identified, naming the axis.
        OutputError: if a bag or model cannot be kept.
    """
    plans = load_scenario(SCENARIO).flights
    vehicle = Vehicle.load(plans[0].vehicle)
    pools = load_pools(CANDIDATES)
    groups = {name: _in_wind(plans, winds) for name, winds in GROUPS.items()}
    used = [plan for plan in plans if any(plan.name in members for members in groups.values())]
    with scratch_folder() if folder is None else nullcontext(folder) as place:
        flown = simulate(
            used,
            Path(place) / "bags",
            workers=workers,
            progress=lambda flight, _: progress(f"Flying {flight}"),
        )
        bags = [flight.bag for flight in flown]
        flights = {}
        for settings in SETTINGS:
            progress(f"Reading flights for {settings} settings")
            flights[CUTOFF_HZ[settings]] = prepare_flights(
                bags, vehicle, CUTOFF_HZ[settings], workers=workers, scheduler=scheduler
            )
    learned_from = set(next(iter(groups.values())))
    models = {}
    for method in methods:
        for settings in SETTINGS:
            name = f"{method}-{settings}"
            models[name] = identify_or_take(
                [flight for flight in flights[CUTOFF_HZ[settings]] if flight.name in learned_from],
                vehicle,
                pools,
                None if folder is None else folder / "models" / name,
                method=method,
                settings=settings,
                cutoff_hz=CUTOFF_HZ[settings],
                confidence=confidence,
                device=device,
                progress=named(progress, name),
            )
    return ComparisonCase(models, flights, groups, confidence, published_table())


def _in_wind(plans: Sequence[FlightPlan], winds: Sequence[float]) -> list[str]:
    return [plan.name for plan in plans if plan.head_wind_m_s in winds]
