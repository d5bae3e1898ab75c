# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From ten prepared flights of a minute each to a physical model of six axes, beside its first fit alone.

The whole fits again without each flight and calibrates intervals and alarm; the first fit searches the delay
and the bandwidth, sums up, weighs and chooses terms.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path

from benchmarks import Result
from benchmarks.identify_minute import CANDIDATES, DURATION_S, FLIGHTS, SCENARIO
from quadpi_core.identification.identify import identify, joined
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.models.kinds.physical import PhysicalStudy
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.physical_fit import flights_of
from quadpi_core.models.regressors import load_pools
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.simulated_bags import simulate
from quadpi_core.vehicle import Vehicle

NAMES = ("physical_identify_seconds", "physical_first_fit_seconds")


def run() -> list[Result]:
    plans = [replace(plan, duration_s=DURATION_S) for plan in load_scenario(SCENARIO).flights[:FLIGHTS]]
    vehicle, pools = Vehicle.load(plans[0].vehicle), load_pools(CANDIDATES)
    with tempfile.TemporaryDirectory() as folder:
        flights = prepare_flights([flight.bag for flight in simulate(plans, Path(folder))], vehicle)
    # The first time makes or loads the compiled kernels.
    for _ in range(2):
        start = time.perf_counter()
        PhysicalStudy.from_flights(flights_of(joined(flights, vehicle)), vehicle).fit(choose=True)
        fitted = time.perf_counter()
        identify(flights, vehicle, pools, IdentifyOptions(method="physical"))
        whole_s, first_s = time.perf_counter() - fitted, fitted - start
    minutes = f"{FLIGHTS} flights of {DURATION_S:.0f} s, prepared"
    return [
        Result(
            NAMES[0], whole_s, "s", f"{minutes}; one fit to all: {first_s:.1f} s", goal=120.0, at_most=True
        ),
        Result(NAMES[1], first_s, "s", minutes, goal=5.0, at_most=True),
    ]
