# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From ten bags of a minute each to a polynomial model of six axes, beside rosbags deserialising them.

Ours reads, checks, estimates and smooths the states, computes the causal states of the live path, selects and
fits with each flight left out in turn, and calibrates intervals and alarm. rosbags only turns the same
messages into Python objects, on one core.
"""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from rosbags.highlevel import AnyReader

from benchmarks import Result
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.models.model_kind import CUTOFF_HZ, IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.simulated_bags import simulate
from quadpi_core.vehicle import Vehicle

NAMES = ("identify_minute",)

SCENARIO, CANDIDATES = "training", "bebop2_simulation"
FLIGHTS, DURATION_S = 10, 60.0
TRUTH = "/truth/"


def run() -> list[Result]:
    plans = [replace(plan, duration_s=DURATION_S) for plan in load_scenario(SCENARIO).flights[:FLIGHTS]]
    vehicle, pools = Vehicle.load(plans[0].vehicle), load_pools(CANDIDATES)
    cutoff_hz = CUTOFF_HZ["default"]
    with tempfile.TemporaryDirectory() as folder:
        bags = [flight.bag for flight in simulate(plans, Path(folder))]
        # The first time makes or loads the compiled kernels.
        for _ in range(2):
            start = time.perf_counter()
            flights = prepare_flights(bags, vehicle, cutoff_hz)
            prepared = time.perf_counter()
            identify(flights, vehicle, pools, IdentifyOptions(method="polynomial", cutoff_hz=cutoff_hz))
            identified = time.perf_counter()
        messages = sum(map(deserialise, bags))
        rosbags_s = time.perf_counter() - identified
    baseline = (
        f"rosbags deserialising the same {messages} messages: {rosbags_s:.1f} s on one core; ours on "
        f"{os.cpu_count()} cores: flights prepared in {prepared - start:.1f} s, identified in "
        f"{identified - prepared:.1f} s"
    )
    return [Result(NAMES[0], identified - start, "s", baseline)]


def deserialise(bag: Path) -> int:
    """Turn the sensor messages of a bag into objects, and give their number."""
    with AnyReader([bag]) as reader:
        sensors = [one for one in reader.connections if not one.topic.startswith(TRUTH)]
        return sum(
            1
            for connection, _, data in reader.messages(connections=sensors)
            if reader.deserialize(data, connection.msgtype) is not None
        )
