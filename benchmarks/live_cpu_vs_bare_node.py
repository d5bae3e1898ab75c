# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""CPU time of the live process against a bare rclpy node with the same topics, on the same executor.

The live process runs three models of six axes, one of each method. Both processes get the same messages from
the same player (IMU and rotor speeds 500 Hz, mocap 120 Hz) and publish to the same collector. CPU time is
user and system time of all threads, from the first message to the last.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import Result, require_ros
from benchmarks.process_usage import cpu_seconds
from benchmarks.swings import IMU_HZ, VEHICLE, swings, three_models
from quadpi_core.frames import Array
from quadpi_core.logs.bags import write_bag
from quadpi_core.vehicle import Vehicle

NAMES = ("live_cpu_vs_bare_node", "live_dropped")

BARE = "benchmarks.bare_node"
PLAYED_S = 20.0
# Until the last messages have come, long after them.
AFTERWARDS_S = 1.0
TOPICS = ("imu", "rotor_speeds", "mocap/pose")


class Run(NamedTuple):
    """CPU seconds of one process, latency of each prediction, and samples without one."""

    cpu_s: float
    latency_ms: Array
    dropped: int


def run() -> list[Result]:
    require_ros()
    vehicle = Vehicle.load(VEHICLE)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        played = folder / "played.mcap"
        write_bag(played, swings(vehicle, PLAYED_S))
        models = [str(folder / model.name) for model in three_models(folder, vehicle).values()]
        arguments = ("vehicle:=" + VEHICLE, f"model:=[{', '.join(models)}]", f"imu_rate_hz:={IMU_HZ}")
        bare = measure(BARE, (), played)
        live = measure("quadpi_ros.live_process", arguments, played)
    samples = PLAYED_S * IMU_HZ
    baseline = (
        f"bare node: {1e6 * bare.cpu_s / samples:.0f} us of CPU per IMU sample, latency p99 "
        f"{np.percentile(bare.latency_ms, 99):.2f} ms; live: {1e6 * live.cpu_s / samples:.0f} us, "
        f"{np.percentile(live.latency_ms, 99):.2f} ms"
    )
    return [
        Result(NAMES[0], live.cpu_s / bare.cpu_s, "times the CPU", baseline, goal=1.1, at_most=True),
        Result(NAMES[1], live.dropped, "samples", f"bare node: {bare.dropped}", goal=0.0, at_most=True),
    ]


def measure(module: str, parameters: tuple[str, ...], bag: Path) -> Run:
    """Play the bag through a process of nodes."""
    from quadpi_ros.live_session import Child, Collector, await_start, isolated_domain, play

    arguments = ("--ros-args", *(part for parameter in parameters for part in ("-p", parameter)))
    with isolated_domain() as folder, Collector(start_ns=0) as collector:
        with Child(module, arguments, folder) as nodes:
            await_start(nodes, collector)
            before_s = cpu_seconds(nodes.pid)
            managed = () if module == BARE else ("estimator", "monitor")
            imu_sent = play(bag, TOPICS, 1.0, folder, nodes, collector, managed)
            collector.spin(AFTERWARDS_S)
            cpu_s = cpu_seconds(nodes.pid) - before_s
        predicted_ns, arrived_ns = collector.predictions().time_ns, collector.arrived_ns
    stamps_ns, sent_ns = imu_sent.T
    latency_ms = 1e-6 * (arrived_ns - sent_ns[np.searchsorted(stamps_ns, predicted_ns)])
    return Run(cpu_s, latency_ms, int(np.sum(stamps_ns >= predicted_ns[0])) - len(predicted_ns))
