# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes in what the nodes are given, found by them in the first seconds of a flight over real DDS."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.vehicle import Vehicle
from quadpi_ros.processes import Child
from test.core.mistakes import MISTAKES

from .rig import assert_alive

ROOT = Path(__file__).parents[2]
VEHICLE = "bebop2"
RATE = 4.0
DEADLINE_S = 360.0


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize(
    ("mistake", "status", "said"),
    [
        ("neighbours swapped", "monitor: consistency", "look swapped"),
        ("imu yawed by 90", "estimator: consistency", "IMU"),
    ],
)
def test_mistakes_are_said(mistake: str, status: str, said: str, tmp_path: Path) -> None:
    vehicle = Vehicle.load(VEHICLE)
    recording, _ = MISTAKES[mistake].done(read_recording(ROOT / "bags/train_2.mcap", vehicle), vehicle)
    write_bag(tmp_path / "flight.mcap", recording)
    latest: dict[str, DiagnosticStatus] = {}
    node = rclpy.create_node("listener")
    node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda array: latest.update({s.name: s for s in array.status}), 100
    )
    given = {"vehicle": VEHICLE, "model": str(ROOT / "test/golden/model")}
    arguments = [part for name, value in given.items() for part in ("-p", f"{name}:={value}")]
    topics = ("imu", "rotor_speeds", "mocap/pose")
    played = (str(tmp_path / "flight.mcap"), "--rate", str(RATE), "--topics", *topics, "--wait", "300")
    with (
        Child("quadpi_ros.live_process", ("--ros-args", *arguments), tmp_path) as live,
        Child("quadpi_ros.player", (*played, "--nodes", "estimator", "monitor"), tmp_path) as player,
    ):
        began_s = time.monotonic()
        while not (status in latest and latest[status].level == DiagnosticStatus.WARN):
            assert_alive(live)
            player.finished()  # raises if it has failed
            assert time.monotonic() < began_s + DEADLINE_S, latest.get(status)
            rclpy.spin_once(node, timeout_sec=0.5)
    assert said in latest[status].message
    assert f"consistency: {latest[status].message}" in "".join(
        path.read_text(errors="replace") for path in tmp_path.iterdir() if path.suffix != ".mcap"
    )
    node.destroy_node()
