# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The estimate on /tf: how often, between which frames, and what is said where its messages are missing."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from std_msgs.msg import String

from quadpi_core.flight import ImuStream, PoseStream
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.frame_ids import TF_TYPE
from quadpi_core.messages.sensor_messages import ODOMETRY
from quadpi_ros import transform_publisher
from quadpi_ros.estimator_node import EstimatorNode
from quadpi_ros.node_parameters import EstimatorParameters
from quadpi_ros.runtime import start
from quadpi_ros.transform_publisher import TransformPublisher

from .rig import started

POSE = np.array([[1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]])
STEP_NS = 2_000_000


def published(monkeypatch: pytest.MonkeyPatch, rate_hz: float, stamps_ns: list[int]) -> list[Any]:
    """The transforms that a flight with these stamps gives; the package of the messages may be missing."""
    monkeypatch.setattr(transform_publisher, "message_class", lambda _: String)
    sent: dict[str, list[bytes]] = {}

    def announce(_: type, topic: str) -> Callable[[bytes], None]:
        return sent.setdefault(topic, []).append

    given = EstimatorParameters(
        vehicle="neurobem", world_frame="odom", body_frame="uav/base_link", tf_rate_hz=rate_hz
    )
    node: Any = SimpleNamespace(parameters=given, announce=announce)
    publisher = TransformPublisher(node)
    for time_ns in stamps_ns:
        publisher.publish(time_ns, POSE)
    assert set(sent) == {"/tf"}
    return [typestore().deserialize_cdr(payload, TF_TYPE).transforms[0] for payload in sent["/tf"]]


@pytest.mark.parametrize(("rate_hz", "count"), [(50.0, 50), (30.0, 30), (500.0, 500), (5000.0, 500)])
def test_the_rate_is_kept_and_no_estimate_is_sent_twice(
    monkeypatch: pytest.MonkeyPatch, rate_hz: float, count: int
) -> None:
    stamps = [1_700_000_000_000_000_000 + STEP_NS * k for k in range(500)]
    sent = published(monkeypatch, rate_hz, stamps)
    assert abs(len(sent) - count) <= 1
    times = [10**9 * one.header.stamp.sec + one.header.stamp.nanosec for one in sent]
    assert set(times) <= set(stamps)
    assert len(set(times)) == len(times)
    (one, *_) = sent
    assert (one.header.frame_id, one.child_frame_id) == ("odom", "uav/base_link")
    p, q = one.transform.translation, one.transform.rotation
    assert [p.x, p.y, p.z, q.x, q.y, q.z, q.w] == POSE[0].tolist()


def test_stamps_that_jump_back_are_sent_again(monkeypatch: pytest.MonkeyPatch) -> None:
    stamps = [10**10 + STEP_NS * k for k in range(50)]
    assert len(published(monkeypatch, 50.0, [*stamps, *stamps])) == 10


def test_the_estimate_and_its_transform_are_the_same(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every second IMU sample of 100 Hz, once there is a state."""
    monkeypatch.setattr(transform_publisher, "message_class", lambda _: String)
    published: dict[str, list[bytes]] = {}
    given = ("vehicle:=neurobem", "tf_rate_hz:=50", "world_frame:=odom")
    with started(ros_domain, *(part for one in given for part in ("-p", one)), "-r", "__ns:=/uav"):
        node = EstimatorNode()

        def announce(_: type, topic: str, **__: Any) -> Callable[[bytes], None]:
            return published.setdefault(topic, []).append

        monkeypatch.setattr(node, "announce", announce)
        start([node])
        take = {one.topic_name: one.callback for one in node.subscriptions}
        attitude, still = np.array([[0.8, 0.0, 0.0, 0.6]]), np.zeros((1, 3))
        for step in range(130):
            stamp = np.array([10_000_000 * step])
            pose = PoseStream(stamp, np.array([[0.01 * step, 2.0, -3.0]]), attitude)
            take["/uav/mocap/pose"](sensor_messages.pack_pose(pose)[0])
            imu = ImuStream(stamp, still, np.array([[0.0, 0.0, -9.81]]))
            take["/uav/imu"](sensor_messages.pack_imu(imu)[0])
        node.destroy_node()
    poses = {
        10**9 * one.header.stamp.sec + one.header.stamp.nanosec: one.pose.pose
        for one in (typestore().deserialize_cdr(payload, ODOMETRY) for payload in published["odometry"])
    }
    sent = [typestore().deserialize_cdr(payload, TF_TYPE).transforms[0] for payload in published["/tf"]]
    assert len(sent) == pytest.approx(len(poses) / 2, abs=1)
    assert len(sent) > 10
    for one in sent:
        assert (one.header.frame_id, one.child_frame_id) == ("odom", "uav/base_link")
        pose = poses[10**9 * one.header.stamp.sec + one.header.stamp.nanosec]
        assert vars(one.transform.rotation) == vars(pose.orientation)
        moved = one.transform.translation
        assert [moved.x, moved.y, moved.z] == [pose.position.x, pose.position.y, pose.position.z]


@pytest.mark.skipif(importlib.util.find_spec("tf2_msgs") is not None, reason="tf2_msgs is installed")
def test_without_the_package_of_its_messages_the_estimator_does_not_start(
    run_main: Callable[..., tuple[int, str]],
) -> None:
    arguments = ("-p", "vehicle:=neurobem", "-p", "tf_rate_hz:=50.0")
    status, errors = run_main("estimator_node", "--ros-args", *arguments)
    assert status == 2
    (line,) = errors.splitlines()
    expected = (
        "node estimator: parameter `tf_rate_hz`: tf2_msgs/msg/TFMessage: the package tf2_msgs that defines"
    )
    assert expected in line
