# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What every node does with its topics: mistakes, other frames and silence are said, over real DDS."""

from __future__ import annotations

import importlib.util
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from quadpi.msg import RotorSpeeds
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.task import Future
from rclpy.type_hash import TypeHash
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from quadpi_core.flight import ImuStream, PoseStream, Recording
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.messages import sensor_messages
from quadpi_core.vehicle import Vehicle
from quadpi_ros import sensor_node
from quadpi_ros.callbacks import TRANSFORMS_QOS
from quadpi_ros.live_session import Child
from quadpi_ros.parameters import parameter
from quadpi_ros.runtime import start
from quadpi_ros.sensor_node import SensorNode
from test.core.mistakes import MISTAKES

from ..core.messages.test_frame_ids import BACKWARD, PLACE, transforms
from .rig import Rig, arguments, assert_alive, values_of, wait_until

pytestmark = pytest.mark.usefixtures("ros_domain")

ROOT = Path(__file__).parents[2]
VEHICLE = "bebop2"
# A computer that is busy keeps up with real time, and what it misses is played again.
RATE = 1.0
DEADLINE_S = 360.0
LEVEL = np.array([[1.0, 0.0, 0.0, 0.0]])


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
    parameters = [part for name, value in given.items() for part in ("-p", f"{name}:={value}")]
    topics = ("imu", "rotor_speeds", "mocap/pose")
    bag = str(tmp_path / "flight.mcap")
    played = (bag, "--rate", str(RATE), "--loop", "--topics", *topics, "--wait", "300")
    with (
        Child("quadpi_ros.live_process", ("--ros-args", *parameters), tmp_path) as live,
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


@dataclass(frozen=True)
class Parameters:
    """As the nodes have them."""

    autostart: bool = parameter(True, "at the start")


@dataclass(frozen=True)
class NoParameters:
    autostart: bool = parameter(False, "as the nodes have it")


class Hearing(SensorNode[Parameters]):
    """Hears static transforms."""

    def configure(self) -> None:
        """As the estimator does."""
        self.body = self.frames_of("base_link", "warn")

    def activate(self) -> None:
        """As the estimator does."""
        self.hear_transforms(self.body)


def refused_for(reason: str, name: str, rig: Rig) -> bool:
    """Whether a status of that name that is not OK gives the reason."""
    told = [
        status for status in list(rig.told) if status.name == name and status.level != DiagnosticStatus.OK
    ]
    return any(reason in key for status in told for key in values_of(status))


def test_other_frames_are_refused_with_their_reason(folder: Path, hover: Recording, tmp_path: Path) -> None:
    strict = (*arguments(str(folder / "model")), "-p", "frames:=strict")
    with Child("quadpi_ros.live_process", strict, tmp_path) as nodes, Rig(hover, nodes) as rig:
        for k in range(10):
            stamp = np.array([rig.now_ns + 2_000_000 * k])
            imu = ImuStream(stamp, np.zeros((1, 3)), np.array([[0.0, 0.0, -9.81]]))
            rig.send("imu", sensor_messages.pack_imu(imu, "imu_link"))
            pose = PoseStream(stamp, np.zeros((1, 3)), LEVEL)
            rig.send("mocap/pose", sensor_messages.pack_pose(pose, "world_ned"))
        for topic, reason in (
            ("imu", "the frame `imu_link` is not the body's, `base_link`, and no static transform"),
            ("mocap/pose", "the frame `world_ned` says north-east-down: east-north-up is expected"),
        ):
            # Later statuses say that nothing arrives, and keep the reason.
            rig.until(lambda topic=topic, reason=reason: refused_for(reason, f"estimator: {topic}", rig))
        assert_alive(nodes)


@pytest.mark.usefixtures("ros")
def test_static_transforms_that_were_sent_before_are_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their package is pretended by another type: what travels is the bytes."""
    monkeypatch.setattr(sensor_node, "message_class", lambda _: String)
    sender = Node("sender")
    sent = transforms(("base_link", "imu_link", BACKWARD, PLACE))
    sender.create_publisher(String, "/tf_static", TRANSFORMS_QOS).publish(sent)
    node = Hearing("hearing", Parameters)
    start([node])
    wait_until(lambda: node.body.transforms.changes, lambda: rclpy.spin_once(node, timeout_sec=0.1))
    moved = node.body.imu(("imu_link",))
    assert moved is not None
    np.testing.assert_allclose(moved.arm, np.array(PLACE) * [1.0, -1.0, -1.0])
    for one in (node, sender):
        one.destroy_node()


def test_without_the_package_of_static_transforms_the_reason_is_said(
    ros: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    del ros
    if importlib.util.find_spec("tf2_msgs"):
        pytest.skip("tf2_msgs is installed")
    node = Hearing("hearing", Parameters)
    start([node])
    told: list[str] = []
    monkeypatch.setattr(node, "warn", lambda _, text: told.append(text))
    assert node.body.imu(("imu_link",)) is None
    assert "/tf_static is not heard: tf2_msgs/msg/TFMessage: the package tf2_msgs" in told[0]
    node.destroy_node()


@pytest.mark.usefixtures("ros")
def test_the_log_says_once_what_keeps_a_node_from_working(monkeypatch: pytest.MonkeyPatch) -> None:
    class Watched(SensorNode[NoParameters]):
        def activate(self) -> None:
            self.listen(Imu, "imu", sensor_messages.unpack_imu, lambda _: None)
            self.listen(PoseStamped, "mocap/pose", sensor_messages.unpack_pose, lambda _: None)
            self.listen(PoseStamped, "wind", sensor_messages.unpack_pose, lambda _: None, required=False)

    # The diagnostics are called for below, sooner and later than once a second.
    monkeypatch.setattr(sensor_node, "_EARLY", 0.0)
    monkeypatch.setattr(sensor_node, "_LATE", np.inf)
    node, receivers = Watched("watched", NoParameters), {}
    create = node.create_subscription

    def create_and_keep(kind: type, topic: str, receive: Any, *rest: Any, **options: Any) -> Any:
        receivers[topic] = receive
        return create(kind, topic, receive, *rest, **options)

    monkeypatch.setattr(node, "create_subscription", create_and_keep)
    start([node])
    (diagnose,) = node.timers
    assert node.state == "unconfigured"
    node.must(node.trigger_configure)
    node.must(node.trigger_activate)
    logged: list[str] = []
    monkeypatch.setattr(
        node, "get_logger", lambda: SimpleNamespace(warning=logged.append, info=logged.append)
    )

    pose = PoseStamped()
    pose.pose.orientation.w = 1.0
    pose.header.stamp.sec = 1
    imu = Imu()
    imu.header.stamp.sec = 1
    sent = {"imu": serialize_message(imu), "mocap/pose": serialize_message(pose)}

    def watch(*topics: str) -> list[str]:
        logged.clear()
        for topic in topics:
            receivers[topic](sent[topic])
        diagnose.callback()
        return list(logged)

    assert [watch() for _ in range(3)] == [[], ["nothing arrives on imu, mocap/pose"], []]
    assert [watch("imu") for _ in range(2)] == [[], ["nothing arrives on mocap/pose"]]
    assert [watch("imu", "mocap/pose") for _ in range(2)] == [["over: nothing arrives on mocap/pose"], []]
    node.warn("topic imu", "one")
    node.warn("topic imu", "two")
    node.warn("topic mocap/pose", "three")
    assert logged == ["topic imu: one", "topic mocap/pose: three"]
    sent["imu"] = sent["imu"][:20]
    assert watch("imu", "mocap/pose") == []
    refused = "every message is refused on imu: sample 0: 20 bytes where sensor_msgs/msg/Imu takes 316"
    assert watch("imu", "mocap/pose") == [refused]
    assert (node.lack("imu"), node.lack("mocap/pose")) == ("every message is refused on imu", None)
    assert [watch("imu") for _ in range(2)] == [[], [f"nothing arrives on mocap/pose; {refused}"]]
    sent["imu"] = serialize_message(Imu())
    zero = "every message is refused on imu: stamps are zero"
    assert [watch("imu", "mocap/pose") for _ in range(2)] == [[], [zero]]
    assert node.refusals() == ("imu: stamps are zero",)
    # What is wrong with a message is said once, however long it lasts.
    monkeypatch.setattr(sensor_node, "_WARNING_PERIOD_S", 0.0)
    logged.clear()
    for size in (20, 20, 20, 21, 21):
        receivers["wind"](sent["mocap/pose"][:size])
    said = "topic wind: message refused: sample 0: {} bytes where geometry_msgs/msg/PoseStamped takes 76"
    assert logged == [said.format(20), said.format(21)]
    node.must(node.trigger_deactivate)
    assert watch() == []
    assert watch() == []


class RotorListener(SensorNode[NoParameters]):
    """Hears rotor speeds."""

    def activate(self) -> None:
        """As the monitor does."""
        self.listen(RotorSpeeds, "rotor_speeds", sensor_messages.unpack_rotor_speeds, lambda _: None)


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize("foreign", [False, True])
def test_who_publishes_another_version_of_a_message_is_named(
    monkeypatch: pytest.MonkeyPatch, foreign: bool
) -> None:
    """Its hash is pretended: a program built against other definitions has another one."""
    node, driver = RotorListener("watched", NoParameters), Node("driver")
    publisher = driver.create_publisher(RotorSpeeds, "rotor_speeds", 1)
    start([node])
    node.must(node.trigger_configure)
    node.must(node.trigger_activate)
    wait_until(lambda: node.get_publishers_info_by_topic("/rotor_speeds"))
    infos = node.get_publishers_info_by_topic("/rotor_speeds")
    if foreign:
        infos[0].topic_type_hash = TypeHash(version=1, value=bytes(range(32)))
        monkeypatch.setattr(node, "get_publishers_info_by_topic", lambda _: infos)
    monkeypatch.setattr(node, "lacking", {"rotor_speeds": "nothing arrives on"})
    expected = ": topic /rotor_speeds: /driver publishes quadpi/msg/RotorSpeeds of another version"
    problem = node.problem() or ""
    assert problem.startswith("nothing arrives on rotor_speeds")
    assert (expected in problem) == foreign
    driver.destroy_publisher(publisher)
    driver.destroy_node()
    node.destroy_node()
    node.destroy_node()


@pytest.mark.usefixtures("ros")
def test_what_is_watched_is_done_where_more_messages_come_than_can_be_taken() -> None:
    """The executor takes events in their order: a timer alone would wait behind ever more messages."""
    taken, done, enough = [], [], threading.Event()

    class Busy(SensorNode[NoParameters]):
        def activate(self) -> None:
            self.listen(Imu, "imu", sensor_messages.unpack_imu, self.take)
            self.watch(0.1, lambda: done.append(len(taken)))

        def take(self, imu: ImuStream) -> None:
            taken.append(imu)
            enough.wait(0.01)

    node, driver = Busy("busy", NoParameters), Node("driver")
    imu = driver.create_publisher(Imu, "imu", 10)
    executor = EventsExecutor()
    executor.add_node(node)
    start([node])
    node.must(node.trigger_configure)
    node.must(node.trigger_activate)
    wait_until(lambda: imu.get_subscription_count() > 0)

    def flood() -> None:
        while not enough.wait(0.002):
            imu.publish(Imu())

    def spin() -> None:
        while not enough.is_set():
            executor.spin_until_future_complete(Future(), timeout_sec=0.1)

    threads = [threading.Thread(target=work, daemon=True) for work in (flood, spin)]
    for thread in threads:
        thread.start()
    try:
        wait_until(lambda: len(taken) > 300 or len(done) > 10)
    finally:
        enough.set()
        for thread in threads:
            thread.join()
        executor.shutdown()
    assert len(done) > 10
    for one in (node, driver):
        one.destroy_node()
