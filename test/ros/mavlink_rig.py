# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A bridge and what it publishes, vehicles in processes of their own, and senders of single packets."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from quadpi.msg import RotorSpeeds
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

from quadpi_core.logs.mavlink_frames import load_dialect
from quadpi_core.messages import sensor_messages
from quadpi_ros.mavlink_bridge import MavlinkBridge

from .rig import spinning, wait_until

TOPICS = {"imu": Imu, "rotor_speeds": RotorSpeeds, "mocap/odometry": Odometry, "mocap/pose": PoseStamped}
# On a busy machine the test itself may be late, and best effort then loses what the bridge has not.
LONG_QUEUE = QoSProfile(depth=5000, reliability=ReliabilityPolicy.BEST_EFFORT)


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    """Below the ports of DDS and those that the system gives away: nobody takes it before the bridge does."""
    for port in np.random.default_rng().permutation(np.arange(5000, 7400)).tolist():
        with socket.socket(socket.AF_INET, kind) as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return int(port)
    raise AssertionError("no free port")


def await_link(bridge: MavlinkBridge) -> None:
    """Wait until the bridge has its port, which a thread of its own opens: what is sent before is lost."""
    wait_until(lambda: bridge.connections)


class Listener:
    """Everything that a bridge publishes, while the test spins."""

    def __init__(self, bridge: MavlinkBridge, port: int) -> None:
        self.bridge, self.port = bridge, port
        self.node = rclpy.create_node("listener")
        self.payloads: dict[str, list[bytes]] = {topic: [] for topic in TOPICS}
        self.statuses: list[dict[str, str]] = []
        self.callbacks: list[str] = []
        self._subscriptions = [
            self.node.create_subscription(kind, topic, self.payloads[topic].append, LONG_QUEUE, raw=True)
            for topic, kind in TOPICS.items()
        ]
        about = self.node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnose, 10)
        self._subscriptions.append(about)
        self.executor = EventsExecutor()
        self.executor.add_node(bridge)
        self.executor.add_node(self.node)

    def await_bridge(self) -> None:
        """Wait until the bridge is heard and, where it does not wait for a vehicle, has its port."""
        self.until(lambda: all(one.get_publisher_count() for one in self._subscriptions))
        if not self.bridge.get_parameter("connection").value.startswith("tcp"):
            await_link(self.bridge)

    def _diagnose(self, array: Any) -> None:
        status, *others = array.status
        self.callbacks += [one.message for one in others if one.name == "mavlink_bridge: callbacks"]
        values = {item.key: item.value for item in status.values}
        told = {"name": status.name, "message": status.message, "level": str(status.level[0])}
        self.statuses.append(values | told)

    def until(self, happened: Callable[[], bool]) -> None:
        def found() -> str:
            return f"{ {topic: self.count(topic) for topic in TOPICS} } {self.statuses[-1:]}"

        wait_until(happened, spinning(self.executor), found)

    def message(self) -> str:
        """What the last status says."""
        return self.statuses[-1]["message"] if self.statuses else ""

    def count(self, topic: str = "imu") -> int:
        return len(self.payloads[topic])

    def samples(self) -> np.ndarray:
        """Numbers of the IMU samples that came, which the vehicle sends as rates."""
        numbers = [sensor_messages.unpack_imu(p).angular_velocity[0, 0] * 1024 for p in self.payloads["imu"]]
        return np.rint(numbers).astype(int)


@contextmanager
def listening(**parameters: Any) -> Iterator[Listener]:
    """What a bridge with these parameters publishes; it listens to a UDP port, unless they say otherwise."""
    port = free_port()
    given = {"vehicle": "neurobem", "connection": f"udp:127.0.0.1:{port}"} | parameters
    bridge = MavlinkBridge(parameter_overrides=[Parameter(name, value=one) for name, one in given.items()])
    listener = Listener(bridge, port)
    try:
        listener.await_bridge()
        yield listener
    finally:
        listener.executor.shutdown()
        bridge.destroy_node()
        listener.node.destroy_node()


@contextmanager
def flying(port: int, *options: str, ago_s: float = 1234.5) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A vehicle in a process of its own, and when its clock was zero."""
    epoch_ns = time.time_ns() - int(ago_s * 1e9)
    command = [sys.executable, str(Path(__file__).parent / "mavlink_vehicle.py"), str(port)]
    process = subprocess.Popen(
        [*command, "--epoch-ns", str(epoch_ns), *options],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield process, epoch_ns
    finally:
        process.terminate()
        process.wait(10)


class Sender:
    """Packets by UDP from a port of its own."""

    def __init__(self, port: int, system: int) -> None:
        self.dialect = load_dialect()
        self._mav = self.dialect.MAVLink(None, system, 1)
        # Not connected: a connected socket raises at the next call if nobody received a packet.
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._address = ("127.0.0.1", port)

    def send(self, name: str, *values: Any) -> None:
        kind = getattr(self.dialect, f"MAVLink_{name.lower()}_message")
        self.socket.sendto(bytes(kind(*values).pack(self._mav)), self._address)
