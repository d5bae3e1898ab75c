# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages in other frames over real DDS: what the nodes refuse, and why."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import String

from quadpi_core.flight import ImuStream, PoseStream, Recording
from quadpi_core.messages import sensor_messages
from quadpi_ros import sensor_node
from quadpi_ros.dds_profile import TRANSFORMS_QOS
from quadpi_ros.node_parameters import parameter
from quadpi_ros.processes import Child
from quadpi_ros.runtime import start
from quadpi_ros.sensor_node import SensorNode

from ..core.messages.test_frame_ids import BACKWARD, PLACE, transforms
from .rig import Rig, arguments, assert_alive, values_of, wait_until

pytestmark = pytest.mark.usefixtures("ros_domain")


@dataclass(frozen=True)
class Parameters:
    """As the nodes have them."""

    autostart: bool = parameter(True, "at the start")


class Hearing(SensorNode[Parameters]):
    """Hears static transforms."""

    def configure(self) -> None:
        """As the estimator does."""
        self.body = self.frames_of("base_link", "warn")

    def activate(self) -> None:
        """As the estimator does."""
        self.hear_transforms(self.body)


LEVEL = np.array([[1.0, 0.0, 0.0, 0.0]])


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
            status = rig.await_status(f"estimator: {topic}", DiagnosticStatus.WARN, "samples refused")
            assert any(reason in key for key in values_of(status))
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
