# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator node: what it refuses, what it imports in flight, and the stamps of its odometry."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import String

from quadpi_core.flight import ImuStream, PoseStream
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import codec, typestore
from quadpi_core.messages.frame_ids import TF_TYPE
from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.sensor_messages import ODOMETRY
from quadpi_ros import estimator_node
from quadpi_ros.estimator_node import EstimatorNode
from quadpi_ros.runtime import start

from .rig import started

POSE = np.array([[1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]])
STEP_NS = 2_000_000
pytestmark = pytest.mark.usefixtures("ros_domain")


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["vehicle:=neurobem", "vehikel:=x"],
            "node estimator: unknown parameter `vehikel`; known: adapters, autostart, body_frame",
        ),
        ([], "node estimator: parameter `vehicle` is required"),
        (
            ["vehicle:=neurobem", "imu_rate_hz:=fast"],
            "parameter `imu_rate_hz` must be a double, found 'fast'",
        ),
        (
            ["vehicle:=neurobem", "imu_rate_hz:=9000"],
            "parameter `imu_rate_hz` must lie between 0 and 5000, found 9000",
        ),
        (["vehicle:=neurobem", "imu_rate_hz:=.nan"], "parameter `imu_rate_hz` must lie between"),
        (["vehicle:=no_such"], "no such vehicle file; known vehicles:"),
    ],
)
def test_estimator_refuses_wrong_parameters(
    run_main: Callable[..., tuple[int, str]], overrides: list[str], message: str
) -> None:
    arguments = [part for override in overrides for part in ("-p", override)]
    status, errors = run_main("estimator_node", "--ros-args", *arguments)
    assert status == 2
    (line,) = errors.splitlines()
    assert line.startswith("quadpi: ")
    assert message in line


def test_no_sample_waits_for_an_import() -> None:
    """Whichever motion capture comes, and of a monitor with and without an estimator beside it."""
    child = Path(__file__).with_name("first_seconds_child.py")
    ended = subprocess.run([sys.executable, str(child)], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    flown = json.loads(ended.stdout)
    motion_capture = {"mocap/pose", "mocap/transform", "mocap/odometry", "mocap/twist"}
    assert set(flown) == motion_capture | {"monitor", "both"}
    for name, found in flown.items():
        assert found["imported"] == [], name
        assert found["exceptions"] == 0
        for topic in {"monitor": ["prediction"], "both": ["odometry", "prediction"]}.get(name, ["odometry"]):
            assert found["published"][topic] > 100


def test_an_odometry_bears_the_stamp_of_its_estimate(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which is older than the IMU sample at the start, if the IMU's rate has changed since the last pose.

    The vehicle moves at 1 m/s, so that its place tells the instant.
    """
    imu_s = 1.0 + np.concatenate((np.arange(0.0, 0.62, 0.002), np.arange(0.62, 1.01, 0.01)))
    published: list[bytes] = []
    with started(ros_domain, "-p", "vehicle:=neurobem"):
        node = EstimatorNode()
        monkeypatch.setattr(node, "announce", lambda *_, **__: published.append)
        start([node])
        take = {one.topic_name: one.callback for one in node.subscriptions}
        for seconds in imu_s:
            stamp = np.array([round(1e9 * seconds)])
            if seconds < 1.62 and stamp[0] % 10_000_000 == 0:
                pose = PoseStream(stamp, np.array([[seconds, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0, 0.0]]))
                take["/mocap/pose"](sensor_messages.pack_pose(pose)[0])
            imu = ImuStream(stamp, np.zeros((1, 3)), np.array([[0.0, 0.0, -9.81]]))
            take["/imu"](sensor_messages.pack_imu(imu)[0])
        node.destroy_node()
    odometry = sensor_messages.unpack_odometry(Payloads.join(published))
    assert len(odometry) == 1
    assert odometry.position[0, 0] == pytest.approx(1e-9 * odometry.time_ns[0], abs=0.01)
    assert 1.8 < odometry.position[0, 0] < 1.96


@pytest.mark.parametrize(
    ("apart_s", "problems"),
    [(0.9, [None, None, None, "a second of both is needed"]), (1.1, ["stamped 1.1 s apart: by different"])],
)
def test_samples_that_give_no_state_are_a_problem_after_three_seconds(
    ros_domain: int, apart_s: float, problems: list[str | None]
) -> None:
    """One diagnostics a second; at once where stamps are more than a second apart."""
    stamp, zeros = np.array([5_000_000_000]), np.zeros((1, 3))
    pose = PoseStream(stamp + round(1e9 * apart_s), zeros, np.array([[1.0, 0.0, 0.0, 0.0]]))
    with started(ros_domain, "-p", "vehicle:=neurobem"):
        node = EstimatorNode()
        start([node])
        take = {one.topic_name: one.callback for one in node.subscriptions}
        take["/imu"](sensor_messages.pack_imu(ImuStream(stamp, zeros, zeros))[0])
        take["/mocap/pose"](sensor_messages.pack_pose(pose)[0])
        for expected in problems:
            found = node.problem()
            assert found is None if expected is None else expected in str(found)
        # Poses that are ahead give a state, a wrong one, once the IMU has come to their stamps.
        node._ekf = cast(Any, SimpleNamespace(initialised=True))
        assert (node.problem() is None) == (apart_s < 1.0)
        node.destroy_node()


def test_the_estimate_and_its_transform_are_the_same(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every second IMU sample of 100 Hz, once there is a state."""
    monkeypatch.setattr(estimator_node, "message_class", lambda _: String)
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


def test_satellites_give_the_position_and_the_imu_the_attitude(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """North at 1 m/s, the nose to the east; the IMU comes at 100 Hz, fixes at 5 Hz."""
    published: list[bytes] = []
    # Of a body whose forward is east: that is no rotation from east-north-up.
    orientation = {"orientation": np.array([[0.0, 0.0, 0.0, 1.0]])}
    known = {**orientation, "orientation_covariance": 1e-4 * np.eye(3).reshape(1, 9)}
    felt = {"angular_velocity": np.zeros((1, 3)), "linear_acceleration": np.array([[0.0, 0.0, 9.81]])}
    with started(ros_domain, "-p", "vehicle:=neurobem", "-p", "mocap_topic:=fix"):
        node = EstimatorNode()
        monkeypatch.setattr(node, "announce", lambda *_, **__: published.append)
        start([node])
        take = {one.topic_name: one.callback for one in node.subscriptions}
        for step in range(800):
            stamp = np.array([10_000_000 * (100 + step)])
            header = sensor_messages.header_columns(stamp, "base_link")
            take["/imu"](codec(sensor_messages.IMU).encode(1, {**header, **known, **felt})[0])
            if step % 20 == 10:
                fix = NavSatFix(latitude=47.0 + np.rad2deg(0.01 * step / 6.3726e6), longitude=8.0)
                fix.status.status = 0
                fix.header.stamp.sec, fix.header.stamp.nanosec = divmod(int(stamp[0]), 10**9)
                fix.position_covariance, fix.position_covariance_type = np.diag([0.04] * 3).ravel(), 2
                take["/fix"](serialize_message(fix))
        node.destroy_node()
    odometry = sensor_messages.unpack_odometry(Payloads.join(published))
    assert len(odometry) > 500
    # Forward-right-down, with the nose to the east: north is on the left.
    np.testing.assert_allclose(odometry.velocity[-1], [0.0, -1.0, 0.0], atol=0.15)
    np.testing.assert_allclose(odometry.position[-1], [7.8, 0.0, 0.0], atol=0.3)


def test_a_late_fix_has_the_orientation_of_its_stamp(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Yaw at 1 rad/s; the IMU comes at 100 Hz, fixes at 5 Hz, 0.15 s after their stamps."""
    told: list[list[float]] = []
    felt = {"angular_velocity": np.array([[0.0, 0.0, 1.0]]), "linear_acceleration": np.array([[0, 0, 9.81]])}
    with started(ros_domain, "-p", "vehicle:=neurobem", "-p", "mocap_topic:=fix"):
        node = EstimatorNode()
        start([node])
        monkeypatch.setattr(
            node._ekf, "update_pose", lambda *given: told.append([given[0], *given[2], given[3][1]])
        )
        take = {one.topic_name: one.callback for one in node.subscriptions}
        for step in range(100):
            stamp, half = np.array([10_000_000 * (100 + step)]), 0.005 * step
            header = sensor_messages.header_columns(stamp, "base_link")
            known = {
                "orientation": np.array([[0.0, 0.0, np.sin(half), np.cos(half)]]),
                "orientation_covariance": np.eye(3).reshape(1, 9),
            }
            take["/imu"](codec(sensor_messages.IMU).encode(1, {**header, **known, **felt})[0])
            if step % 20 == 19:
                fix = NavSatFix(latitude=47.0, longitude=8.0)
                fix.status.status = 0
                fix.header.stamp.sec, fix.header.stamp.nanosec = divmod(int(stamp[0]) - 150_000_000, 10**9)
                take["/fix"](serialize_message(fix))
        node.destroy_node()
    time_ns, *attitude, deviation = np.array(told).T
    # Forward-right-down of a body that turns to the left from east.
    yaw = 2.0 * np.arctan2(attitude[3], attitude[0])
    np.testing.assert_allclose(np.pi / 2.0 - (1e-9 * time_ns - 1.0), yaw, atol=1e-6)
    assert np.all(deviation < 1.0), "ones are filled in"


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
