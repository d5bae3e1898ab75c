# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The markers of wrench and trust."""

from __future__ import annotations

import pytest
import rclpy
from geometry_msgs.msg import Vector3
from nav_msgs.msg import Odometry
from quadpi.msg import ExtrapolationAlarm, WrenchPrediction
from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from quadpi_core.messages import result_messages
from quadpi_ros.callbacks import OUTPUT_QOS
from quadpi_ros.marker_node import TOPIC, MarkerNode, arrows, words

from .rig import wait_until


def odometry() -> Odometry:
    message = Odometry()
    message.header.frame_id = "map"
    message.header.stamp.sec = 17
    message.pose.pose.position.x, message.pose.pose.position.z = 3.0, 2.0
    message.pose.pose.orientation.w = message.pose.pose.orientation.z = 0.5**0.5
    return message


def prediction() -> WrenchPrediction:
    message = WrenchPrediction()
    message.measured.force = Vector3(x=1.0, y=2.0, z=10.0)
    message.predicted.force = Vector3(x=0.5, y=2.0, z=8.0)
    message.measured.torque = Vector3(z=0.2)
    message.predicted.torque = Vector3(y=0.1)
    return message


def alarm(level: int, *reasons: str, health: int = 0) -> ExtrapolationAlarm:
    return ExtrapolationAlarm(level=level, reasons=list(reasons), cause_health=[health] * 3)


def test_arrows_are_the_wrench_in_the_body_at_its_pose() -> None:
    markers = {marker.ns: marker for marker in arrows(odometry(), prediction(), 0.1, 2.0)}
    ends = {
        "force/measured": (0.1, 0.2, 1.0),
        "force/residual": (0.05, 0.0, 0.2),
        "moment/measured": (0.0, 0.0, 0.4),
        "moment/residual": (0.0, -0.2, 0.4),
    }
    assert markers.keys() == ends.keys()
    for name, (x, y, z) in ends.items():
        marker = markers[name]
        assert (marker.type, marker.header.frame_id, marker.header.stamp.sec) == (Marker.ARROW, "map", 17)
        assert marker.pose == odometry().pose.pose
        start, end = marker.points
        assert (start.x, start.y, start.z) == (0.0, 0.0, 0.0)
        assert (end.x, end.y, end.z) == pytest.approx((x, y, z))
        assert marker.color.a == 1.0


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (alarm(0), "TRUSTED"),
        (alarm(0, health=1), "NOT JUDGED"),
        (alarm(2, health=2), "NO DATA"),
        (
            alarm(1, "mean rotor speed 1.4 x the training range", "a", "b", "c"),
            "WARNING\nmean rotor speed 1.4 x the training range\na\nb",
        ),
        (alarm(2, "coverage is 41 %"), "ALARM\ncoverage is 41 %"),
    ],
)
def test_words_stand_above_the_vehicle(given: ExtrapolationAlarm, text: str) -> None:
    marker = words(odometry(), result_messages.unpack_alarms(bytes(serialize_message(given))))
    assert marker.text == text
    assert marker.pose.position.x == 3.0
    assert marker.pose.position.z > 2.0
    assert marker.scale.z > 0.0


@pytest.mark.usefixtures("ros")
def test_the_node_publishes_what_is_newest_while_it_comes() -> None:
    heard: list[MarkerArray] = []
    node, user = MarkerNode(), rclpy.create_node("user")
    user.create_subscription(MarkerArray, TOPIC, heard.append, 10)
    kinds = {"odometry": Odometry, "prediction": WrenchPrediction, "prediction/other": WrenchPrediction}
    publishers = {topic: user.create_publisher(kind, topic, OUTPUT_QOS) for topic, kind in kinds.items()}
    alarms = user.create_publisher(ExtrapolationAlarm, "extrapolation_alarm", OUTPUT_QOS)

    def fly(**messages: Odometry | WrenchPrediction) -> None:
        for topic, one in messages.items():
            publishers[topic.replace("__", "/")].publish(one)
        rclpy.spin_once(user, timeout_sec=0.02)
        node.publish()

    def found() -> set[str]:
        return {marker.ns for array in heard for marker in array.markers}

    def raise_alarm() -> None:
        alarms.publish(alarm(2, "why"))
        fly(odometry=odometry())

    wait_until(lambda: "trust" in found(), raise_alarm)
    assert found() == {"trust"}
    for _ in range(10):
        fly(odometry=odometry(), prediction__other=prediction())
    assert found() == {"trust"}
    wait_until(lambda: "force/residual" in found(), lambda: fly(odometry=odometry(), prediction=prediction()))
    assert found() == {"trust", "force/measured", "force/residual", "moment/measured", "moment/residual"}
    # What is still under way comes first.
    for _ in range(20):
        fly(prediction=prediction())
    heard.clear()
    for _ in range(20):
        fly(prediction=prediction())
    assert not heard
    for each in (node, user):
        each.destroy_node()
