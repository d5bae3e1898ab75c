# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Speed of `quadpi replay` with models of six axes, relative to the duration of the flight.

Reading, estimation, monitor and writing are timed; a first replay loads the compiled kernels. No baseline
shares the disturbances of the machine, so the fastest of several replays counts, with the median beside it.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks import Result
from benchmarks.swings import FLIGHT_S, METHODS, VEHICLE, swings, three_models
from quadpi_core.logs.bags import write_bag
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.replay import replay
from quadpi_core.vehicle import Vehicle

NAMES = ("replay_realtime_polynomial", "replay_realtime_ensemble")

REPEATS = 7
GOAL = 100.0


def run() -> list[Result]:
    vehicle = Vehicle.load(VEHICLE)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag, output = folder / "swings.mcap", folder / "replayed.mcap"
        write_bag(bag, swings(vehicle))
        seconds = {
            method: _seconds(model, vehicle, bag, output)
            for method, model in three_models(folder, vehicle).items()
        }
    slower = max(METHODS[1:], key=lambda method: min(seconds[method]))
    return [
        Result(
            name,
            FLIGHT_S / min(seconds[method]),
            "times real time",
            f"a flight of {FLIGHT_S:.0f} s, {method}: replayed in {min(seconds[method]):.2f} s on one core, "
            f"median of {REPEATS} {np.median(seconds[method]):.2f} s",
            goal=GOAL,
        )
        for name, method in zip(NAMES, (METHODS[0], slower), strict=True)
    ]


def _seconds(model: AerodynamicModel, vehicle: Vehicle, bag: Path, output: Path) -> list[float]:
    replay(model, vehicle, bag, output)
    return [_one_core_seconds(model, vehicle, bag, output) for _ in range(REPEATS)]


def _one_core_seconds(model: AerodynamicModel, vehicle: Vehicle, bag: Path, output: Path) -> float:
    """Wall time of a replay, or its CPU time where threads made that longer."""
    wall, cpu = time.perf_counter(), time.process_time()
    replay(model, vehicle, bag, output)
    return max(time.perf_counter() - wall, time.process_time() - cpu)
