# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""CPU time that the page costs: of the live nodes with it and without, and of its own server.

The live process runs three models of six axes; the page shows all of them in a headless Chromium. CPU time is
user and system time of all threads of a process, the browser's not counted, over the same flight at 500 Hz,
with the page and without in turns.
"""

from __future__ import annotations

import socket
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import Result, require_ros
from benchmarks.chromium import chromium, require_chromium
from benchmarks.live_cpu_vs_bare_node import AFTERWARDS_S, TOPICS
from benchmarks.process_usage import cpu_seconds
from benchmarks.swings import IMU_HZ, VEHICLE, swings, three_models
from quadpi_core.logs.bags import write_bag
from quadpi_core.vehicle import Vehicle

NAMES = ("view_overhead", "view_server_cpu")

PLAYED_S = 20.0
TURNS = 2
_START_S = 120.0
_POLL_S = 0.05


class Cost(NamedTuple):
    """CPU seconds of the nodes and of the page's server, and how long that took."""

    nodes_s: float
    server_s: float
    wall_s: float


def run() -> list[Result]:
    require_ros()
    require_chromium()
    vehicle = Vehicle.load(VEHICLE)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        played = folder / "played.mcap"
        write_bag(played, swings(vehicle, PLAYED_S))
        models = [str(folder / model.name) for model in three_models(folder, vehicle).values()]
        costs = [(measure(played, models, False), measure(played, models, True)) for _ in range(TURNS)]
    overhead = float(np.median([with_page.nodes_s / without.nodes_s for without, with_page in costs]))
    share = float(np.median([100.0 * with_page.server_s / with_page.wall_s for _, with_page in costs]))
    nodes = 100.0 * float(np.median([without.nodes_s / without.wall_s for without, _ in costs]))
    baseline = f"the live nodes without the page, {nodes:.0f} % of a core at {IMU_HZ:g} Hz with three models"
    return [
        Result(NAMES[0], overhead, "times the CPU", baseline, goal=1.05, at_most=True),
        Result(NAMES[1], share, "% of a core", baseline, goal=25.0, at_most=True),
    ]


def measure(bag: Path, models: list[str], with_page: bool) -> Cost:
    """Play the bag through the live nodes, with the page open or without it."""
    from quadpi_ros.live_session import Child, Collector, await_start, isolated_domain, play

    parameters = (f"vehicle:={VEHICLE}", f"model:=[{', '.join(models)}]", f"imu_rate_hz:={IMU_HZ}")
    arguments = ("--ros-args", *(part for parameter in parameters for part in ("-p", parameter)))
    with isolated_domain() as folder, Collector(start_ns=0) as collector, ExitStack() as stack:
        server = None
        if with_page:
            port = free_port()
            given = [part for model in models for part in ("--model", model)]
            page = ("--port", str(port), "--no-open", *given)
            server = stack.enter_context(Child("quadpi_ros.view_node", page, folder))
            await_port(port)
            tab = stack.enter_context(chromium(folder))
            tab.open(f"http://127.0.0.1:{port}/")
        nodes = stack.enter_context(Child("quadpi_ros.live_process", arguments, folder))
        await_start(nodes, collector)
        before = cpu_seconds(nodes.pid), cpu_seconds(server.pid) if server else 0.0, time.monotonic()
        play(bag, TOPICS, 1.0, folder, nodes, collector)
        collector.spin(AFTERWARDS_S)
        after = cpu_seconds(nodes.pid), cpu_seconds(server.pid) if server else 0.0, time.monotonic()
    return Cost(*(later - earlier for later, earlier in zip(after, before, strict=True)))


def free_port() -> int:
    """A port that nobody listens on now."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def await_port(port: int) -> None:
    """Wait until somebody listens there.

    Raises:
        RuntimeError: if nobody does in time.
    """
    deadline_s = time.monotonic() + _START_S
    while time.monotonic() < deadline_s:
        with socket.socket() as one:
            if one.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(_POLL_S)
    raise RuntimeError("the page's server does not start")
