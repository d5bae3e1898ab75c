# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi replay` with models of six axes, against the time that the flight took.

The first replay, which loads the compiled kernels, does not count; reading, estimation, monitor and writing
all do.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

from benchmarks import Result
from benchmarks.swings import FLIGHT_S, METHODS, VEHICLE, swings, three_models
from quadpi_core.logs.bags import write_bag
from quadpi_core.models import AerodynamicModel
from quadpi_core.monitor.replay import replay
from quadpi_core.vehicle import Vehicle

NAMES = ("replay_realtime_polynomial", "replay_realtime_ensemble")

REPEATS = 3
GOAL = 100.0


def run() -> list[Result]:
    vehicle = Vehicle.load(VEHICLE)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag, output = folder / "swings.mcap", folder / "replayed.mcap"
        write_bag(bag, swings(vehicle))
        seconds = {
            method: _median_seconds(model, vehicle, bag, output)
            for method, model in three_models(folder, vehicle).items()
        }
    slower = max(METHODS[1:], key=seconds.__getitem__)
    return [
        Result(
            name,
            FLIGHT_S / seconds[method],
            "times real time",
            f"a flight of {FLIGHT_S:.0f} s, {method}: replayed in {seconds[method]:.2f} s on one core",
            goal=GOAL,
        )
        for name, method in zip(NAMES, (METHODS[0], slower), strict=True)
    ]


def _median_seconds(model: AerodynamicModel, vehicle: Vehicle, bag: Path, output: Path) -> float:
    replay(model, vehicle, bag, output)
    return statistics.median(_one_core_seconds(model, vehicle, bag, output) for _ in range(REPEATS))


def _one_core_seconds(model: AerodynamicModel, vehicle: Vehicle, bag: Path, output: Path) -> float:
    """Wall time of a replay, or its CPU time where threads made that longer."""
    wall, cpu = time.perf_counter(), time.process_time()
    replay(model, vehicle, bag, output)
    return max(time.perf_counter() - wall, time.process_time() - cpu)
