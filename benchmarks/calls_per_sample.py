# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Functions that one live IMU sample runs through and their files, from its message to its prediction.

This is how much code a reader follows from sensor to alarm. Estimator and monitor run in one process, as
live, with one polynomial model of six axes; their subscriptions are called with serialized messages, without
an executor. The rotor speeds with the stamp of the IMU sample belong to it, as they complete it. What counts
is a sample at which nothing rare happens: no pose arrives, the alarm publishes nothing, and the consistency
check of the first minute is over.

Python functions and compiled kernels of quadpi count, each once, however often it is called. What a kernel
calls does not count, nor do generated methods of dataclasses and the code of ROS.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from benchmarks import Result, require_ros
from benchmarks.swings import IMU_HZ, VEHICLE, swings, three_models
from quadpi_core.flight import Recording
from quadpi_core.messages import sensor_messages
from quadpi_core.vehicle import Vehicle

NAMES = ("calls_per_sample", "files_per_sample")

# The consistency check of the nodes takes three stretches of 15 s.
FLOWN_S, SETTLED_S = 48.0, 47.0

# A function: file, first line and name.
Function = tuple[str, int, str]

_PACKAGES = tuple(
    str(Path(__file__).resolve().parent.parent / name) for name in ("quadpi_core", "quadpi_ros")
)


def run() -> list[Result]:
    require_ros()
    samples = calls_of_samples()
    usual = int(np.median([len(calls) for calls in samples]))
    calls = next(calls for calls in samples if len(calls) == usual)
    functions = set(calls)
    files = {file for file, _, _ in functions}
    return [
        Result(NAMES[0], len(functions), "functions", f"called {usual} times", goal=45.0, at_most=True),
        Result(NAMES[1], len(files), "files", f"{', '.join(sorted(map(_stem, files)))}", 20.0, at_most=True),
    ]


def calls_of_samples() -> list[list[Function]]:
    """The calls of each IMU sample in the last second of a made-up flight."""
    vehicle = Vehicle.load(VEHICLE)
    recording = swings(vehicle, FLOWN_S)
    with tempfile.TemporaryDirectory() as name:
        model = Path(name) / three_models(Path(name), vehicle)["polynomial"].name
        parameters = {"vehicle": VEHICLE, "model": f"[{model}]", "imu_rate_hz": str(IMU_HZ)}
        with live_subscriptions(parameters) as receive:
            return list(_fly(recording, receive))


def _fly(recording: Recording, receive: dict[str, Callable[[bytes], None]]) -> Iterator[list[Function]]:
    imu, poses, rotors = recording.imu, recording.pose, recording.rotor_speeds
    assert poses
    assert rotors
    settled_ns = int(imu.time_ns[0]) + round(1e9 * SETTLED_S)
    imu_messages, pose_messages = sensor_messages.pack_imu(imu), sensor_messages.pack_pose(poses)
    rotor_messages = sensor_messages.pack_rotor_speeds(rotors)
    pose = 0
    for k, time_ns in enumerate(imu.time_ns.tolist()):
        while pose < len(poses) and poses.time_ns[pose] < time_ns:
            receive["mocap/pose"](pose_messages[pose])
            pose += 1
        messages = imu_messages[k], rotor_messages[k]
        with recorded_calls() if time_ns > settled_ns else nullcontext() as calls:
            receive["imu"](messages[0])
            receive["rotor_speeds"](messages[1])
        if calls is not None:
            yield calls


@contextmanager
def live_subscriptions(parameters: dict[str, str]) -> Iterator[dict[str, Callable[[bytes], None]]]:
    """What the live nodes' subscriptions call with a serialized message, by topic."""
    import rclpy

    from quadpi_ros.live_process import create_nodes
    from quadpi_ros.live_session import isolated_domain
    from quadpi_ros.runtime import start

    arguments = [part for name, value in parameters.items() for part in ("-p", f"{name}:={value}")]
    with ExitStack() as stack:
        stack.enter_context(isolated_domain())
        rclpy.init(args=["--ros-args", *arguments])
        stack.callback(rclpy.try_shutdown)
        nodes = create_nodes()
        for node in nodes:
            stack.callback(node.destroy_node)
        start(nodes)
        yield {
            subscription.topic_name.lstrip("/"): subscription.callback
            for node in nodes
            for subscription in node.subscriptions
        }


@contextmanager
def recorded_calls() -> Iterator[list[Function]]:
    """The functions of quadpi that are called within the block, in order."""
    calls: list[Function] = []

    def note(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(_PACKAGES):
            calls.append((code.co_filename, code.co_firstlineno, code.co_name))

    sys.setprofile(note)
    try:
        yield calls
    finally:
        sys.setprofile(None)


def _stem(file: str) -> str:
    return Path(file).stem
