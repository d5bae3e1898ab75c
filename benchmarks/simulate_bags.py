# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""1000 s of flight from scenario files to bags, two flights at a time.

Flights of the paper's sets and of the wind tunnel, with truth at 500 Hz beside the sensors, as `quadpi
simulate` writes them. The first flight, which loads the compiled kernels, does not count.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks import Result
from quadpi_core.parallel import Workers
from quadpi_core.simulation.scenario import FlightPlan, load_scenario
from quadpi_core.simulation.simulated_bags import simulate

NAMES = ("simulate_bags",)

SCENARIOS = ("paper", "tunnel")
FLOWN_S = 1000.0
WORKERS = 2
REPEATS = 3
MEGABYTE = 1e6


def run() -> list[Result]:
    plans = [plan for scenario in SCENARIOS for plan in load_scenario(scenario).flights]
    flown = sum(plan.duration_s for plan in plans)
    with tempfile.TemporaryDirectory() as folder:
        _seconds(plans[:1], Path(folder))
        seconds = statistics.median(_seconds(plans, Path(folder)) for _ in range(REPEATS))
        size = sum(bag.stat().st_size for bag in Path(folder).iterdir()) / MEGABYTE
    baseline = (
        f"real time: {len(plans)} flights of {flown:.0f} s together, written by {WORKERS} workers in "
        f"{seconds:.1f} s, {size:.0f} MB; scaled to {FLOWN_S:.0f} s"
    )
    return [Result(NAMES[0], seconds * FLOWN_S / flown, "s", baseline, goal=60.0, at_most=True)]


def _seconds(plans: Sequence[FlightPlan], folder: Path) -> float:
    start = time.perf_counter()
    simulate(plans, folder, workers=Workers(WORKERS))
    return time.perf_counter() - start
