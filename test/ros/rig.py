# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A vehicle over real DDS for tests: it hovers, and listens to what the nodes say of it."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from nav_msgs.msg import Odometry
from quadpi.msg import ExtrapolationAlarm, RotorSpeeds, WrenchPrediction
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from quadpi_core.flight import ImuStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.messages import sensor_messages
from quadpi_ros.callbacks import SENSOR_QOS, DiscoveryError, await_listeners
from quadpi_ros.live_session import Child, ChildError

IMU_HZ = 500.0
STEP_NS = round(1e9 / IMU_HZ)
# Beyond the second that the estimator collects before it starts.
STARTED_S = 1.3
DEEP = QoSProfile(depth=5000)
TOPICS = {
    "prediction": WrenchPrediction,
    "prediction/other": WrenchPrediction,
    "odometry": Odometry,
    "extrapolation_alarm": ExtrapolationAlarm,
}
SENSORS = (("imu", Imu), ("rotor_speeds", RotorSpeeds), ("mocap/pose", PoseStamped))
START_S = 300.0
# A test that fails may take this long; one that passes does not wait.
PATIENCE_S = 180.0
# Whether the nodes have died is seen this often while they are awaited.
GLANCE_S = 20.0
# A flight that is late by up to this much catches up.
LATE_S = 0.02
Change = Callable[[int, dict[str, Any]], dict[str, Any]]


@contextmanager
def started(domain: int, *arguments: str) -> Iterator[None]:
    """A process that was started with these arguments."""
    rclpy.init(args=["--ros-args", *arguments], domain_id=domain)
    try:
        yield
    finally:
        rclpy.try_shutdown()


def wait_until(
    condition: Callable[[], Any],
    turn: Callable[[], object] = lambda: time.sleep(0.02),
    found: Callable[[], object] = lambda: "",
) -> None:
    """Take turns until the condition holds; fail after PATIENCE_S, showing what was found instead."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, found()
        turn()


def spinning(executor: EventsExecutor) -> Callable[[], None]:
    """A turn of a test that spins its nodes itself."""
    return lambda: executor.spin_until_future_complete(Future(), timeout_sec=0.05)


def assert_alive(nodes: Child) -> None:
    """Fail with everything that the nodes wrote to stderr if their process has ended."""
    try:
        ended = nodes.finished()
    except ChildError:
        ended = True
    assert not ended, nodes.errors.read_text(errors="replace")


def known_client(node: Node, kind: type, name: str, until: Callable[[Callable[[], bool]], None]) -> Client:
    """A client of the service NODE/SERVICE that its server knows too.

    A server may find a client later than the client finds the server; its answers until then are lost. A
    participant announces its endpoints in the order of their creation, so a server that has answered a client
    created later knows both.
    """
    client = node.create_client(kind, name)
    later = node.create_client(GetParameters, f"{name.rpartition('/')[0]}/get_parameters")
    until(lambda: client.service_is_ready() and later.service_is_ready())
    asked: list[Future] = []
    asked_s = 0.0

    def answered() -> bool:
        nonlocal asked_s
        if time.monotonic() > asked_s + 1.0:
            asked_s = time.monotonic()
            asked.append(later.call_async(GetParameters.Request()))
        return any(answer.done() for answer in asked)

    until(answered)
    node.destroy_client(later)
    return client


class Rig:
    """A vehicle that hovers as long as it is asked to, and listens to what the nodes say of it.

    A context manager; what waits for the nodes fails at once when their process ends, with its stderr.
    """

    def __init__(self, hover: Recording, nodes: Child) -> None:
        self._hover = hover
        self.nodes = nodes
        self.now_ns = int(hover.imu.time_ns[0])
        self.heard: dict[str, list[bytes]] = {topic: [] for topic in TOPICS}
        self.told: list[DiagnosticStatus] = []
        self.diagnosed_ns = 0
        self._context = Context()
        self._context.init()
        self.node = Node("rig", context=self._context)
        self._clock = self.node.create_publisher(Clock, "/clock", 10)
        self.sim_time = False
        self._start_sensors()
        for topic, kind in TOPICS.items():
            self.node.create_subscription(kind, topic, self.heard[topic].append, DEEP, raw=True)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._take_diagnostics, DEEP)
        self._clients: dict[str, Client] = {}
        self._executor = EventsExecutor(context=self._context)
        self._thread = threading.Thread(target=self._spin)
        self._closing = False

    def _start_sensors(self) -> None:
        """In a participant of their own, as a driver or a player has it; wait until the nodes hear them."""
        deadline = time.monotonic() + START_S
        while True:
            context = Context()
            context.init()
            self._sensors = Node("sensors", context=context)
            self._publishers = {
                topic: self._sensors.create_publisher(kind, topic, SENSOR_QOS) for topic, kind in SENSORS
            }
            try:
                await_listeners(
                    self._sensors, [*self._publishers.values()], ("estimator", "monitor"), GLANCE_S
                )
                return
            except DiscoveryError:
                assert_alive(self.nodes)
                if time.monotonic() > deadline:
                    raise
                self._stop_sensors()

    def _stop_sensors(self) -> None:
        self._sensors.destroy_node()
        self._sensors.context.try_shutdown()

    def restart_sensors(self) -> None:
        self._stop_sensors()
        self._start_sensors()

    def __enter__(self) -> Rig:
        self._executor.add_node(self.node)
        self._thread.start()
        return self

    def _spin(self) -> None:
        never = Future()
        while not self._closing:
            self._executor.spin_until_future_complete(never, timeout_sec=0.1)

    def __exit__(self, *_: object) -> None:
        self._closing = True
        self._thread.join()
        self._executor.remove_node(self.node)
        self.node.destroy_node()
        self._executor.shutdown()
        self._context.try_shutdown()
        self._stop_sensors()

    def fly(
        self, seconds: float, change: Change = lambda _, sample: sample, imu_hz: float = IMU_HZ
    ) -> tuple[int, int]:
        """Publish for so long; gives the stamps of the first and the last IMU sample."""
        first_ns, step_ns = self.now_ns, round(1e9 / imu_hz)
        due_s = time.monotonic()
        for count in range(round(seconds * imu_hz)):
            time.sleep(max(0.0, due_s - time.monotonic()))
            # After a longer delay it goes on at its rate: a burst may be more samples than the nodes keep.
            due_s = max(due_s, time.monotonic() - LATE_S) + 1e-9 * step_ns
            if self.sim_time and count % 5 == 0:
                self.tick()
            self._publish(count, change)
            self.now_ns += step_ns
        last_ns = self.now_ns - step_ns
        self.send("rotor_speeds", sensor_messages.pack_rotor_speeds(self._rotors(self.now_ns, 0)))
        return first_ns, last_ns

    def tick(self) -> None:
        sec, nanosec = divmod(self.now_ns, 10**9)
        self._clock.publish(Clock(clock=Time(sec=sec, nanosec=nanosec)))

    def _publish(self, count: int, change: Change) -> None:
        index = count % 1000
        stamp = np.array([self.now_ns])
        imu = self._hover.imu
        sample = change(
            count,
            {
                "imu": ImuStream(stamp, imu.angular_velocity[[index]], imu.specific_force[[index]]),
                "rotor_speeds": self._rotors(self.now_ns, index),
                "mocap/pose": PoseStream(stamp, self._hover.pose.position[[index % 100]], np.eye(4)[:1]),
            },
        )
        if count % 4 == 0:
            self.send("mocap/pose", sensor_messages.pack_pose(sample["mocap/pose"]))
        self.send("imu", sensor_messages.pack_imu(sample["imu"]))
        self.send("rotor_speeds", sensor_messages.pack_rotor_speeds(sample["rotor_speeds"]))

    def _rotors(self, time_ns: int, index: int) -> RotorSpeedStream:
        return RotorSpeedStream(np.array([time_ns]), self._hover.rotor_speeds.speeds[[index]])

    def send(self, topic: str, payloads: Any) -> None:
        self._publishers[topic].publish(payloads[0])

    def stamps(self, topic: str, first_ns: int, last_ns: int) -> np.ndarray:
        # Every message begins with its header, whose stamp follows the four bytes of the encapsulation.
        parts = [struct.unpack_from("<iI", payload, 4) for payload in list(self.heard[topic])]
        stamps = [10**9 * sec + nanosec for sec, nanosec in parts]
        return np.array([stamp for stamp in stamps if first_ns <= stamp <= last_ns])

    def fly_until_heard(self, *topics: str) -> None:
        """Fly until every topic comes whole: each finds its subscriber on its own, at its own time."""
        last_ns = 0

        def fly() -> None:
            nonlocal last_ns
            assert_alive(self.nodes)
            _, last_ns = self.fly(0.1)

        def whole() -> bool:
            return all(len(self.stamps(topic, last_ns - 50_000_000, last_ns)) for topic in topics)

        wait_until(whole, fly, lambda: (topics, self.told[-20:]))
        for topic in topics:
            self.await_stamp(topic, last_ns)

    def await_stamp(self, topic: str, time_ns: int) -> None:
        """Wait until the message of a stamp has come."""
        self.until(lambda: len(self.stamps(topic, time_ns, time_ns)) > 0)

    def until(self, condition: Callable[[], bool]) -> None:
        def turn() -> None:
            assert_alive(self.nodes)
            time.sleep(0.02)

        wait_until(condition, turn, lambda: self.told[-20:])

    def forget(self) -> None:
        for heard in self.heard.values():
            heard.clear()
        self.told.clear()

    def latest(self, name: str) -> DiagnosticStatus | None:
        return next((status for status in reversed(list(self.told)) if status.name == name), None)

    def await_status(self, name: str, level: bytes, part: str) -> DiagnosticStatus:
        """Wait for a status of that level whose message holds `part`."""

        def found() -> list[DiagnosticStatus]:
            return [
                status
                for status in list(self.told)
                if status.name == name and status.level == level and part in status.message
            ]

        self.until(lambda: bool(found()))
        return found()[-1]

    def call(self, kind: type, name: str, request: Any) -> Any:
        return self.call_later(kind, name, request)()

    def client(self, kind: type, name: str) -> Client:
        """A client that its server knows, made at the first call."""
        if name not in self._clients:
            self._clients[name] = known_client(self.node, kind, name, self.until)
        return self._clients[name]

    def call_later(self, kind: type, name: str, request: Any) -> Callable[[], Any]:
        answer = self.client(kind, name).call_async(request)

        def result() -> Any:
            self.until(answer.done)
            return answer.result()

        return result

    def change_state(self, node: str, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.call(ChangeState, f"{node}/change_state", request).success)

    def set_parameter(self, name: str, value: Any, node: str = "monitor") -> Any:
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, f"{node}/set_parameters", request).results[0]

    def _take_diagnostics(self, array: DiagnosticArray) -> None:
        self.diagnosed_ns = 10**9 * array.header.stamp.sec + array.header.stamp.nanosec
        self.told.extend(array.status)


def arguments(models: str) -> tuple[str, ...]:
    settings = ("vehicle:=neurobem", f"monitor:model:={models}")
    return ("--ros-args", *(part for setting in settings for part in ("-p", setting)))


def assert_whole(rig: Rig, topic: str, first_ns: int, last_ns: int) -> None:
    rig.await_stamp(topic, last_ns)
    missing = np.setdiff1d(np.arange(first_ns, last_ns + 1, STEP_NS), rig.stamps(topic, first_ns, last_ns))
    assert not len(missing), f"{topic} lacks {1e-9 * (missing - first_ns)} s; {rig.told[-20:]}"
    assert np.all(np.diff(rig.stamps(topic, first_ns, last_ns)) > 0)


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    return {item.key: item.value for item in status.values}


def values_of_wrench(wrench: Any) -> np.ndarray:
    """Force and torque of a geometry_msgs/Wrench, (6,)."""
    return np.array([getattr(part, axis) for part in (wrench.force, wrench.torque) for axis in "xyz"])
