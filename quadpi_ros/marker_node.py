# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The newest wrench and alarm as markers for RViz and Foxglove: arrows at the vehicle, and words above it.

A node of its own, which takes what is newest. Markers are in the world of the odometry, so that no transform
is needed to see them.
"""

from __future__ import annotations

import time
from typing import Any

import rclpy
from geometry_msgs.msg import Point, Vector3
from nav_msgs.msg import Odometry
from quadpi.msg import ExtrapolationAlarm, WrenchPrediction
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import Marker, MarkerArray

from quadpi_core.errors import LogError
from quadpi_core.messages import result_messages
from quadpi_core.results import ReportedAlarms
from quadpi_core.view.trust import State, states_of
from quadpi_ros.callbacks import GuardedNode
from quadpi_ros.input_sources import NEWEST_QOS, Inbox
from quadpi_ros.parameters import MarkerParameters, read_parameters
from quadpi_ros.runtime import run

TOPIC = "markers"
# Reasons that are written above the vehicle.
_REASONS_SHOWN = 3
# Markers vanish when nothing has come for this time.
_LIFETIME_S = 0.5
_WARNING_PERIOD_S = 5.0
_TEXT_HEIGHT_M, _TEXT_ABOVE_M = 0.12, 0.4
_SHAFT_M, _HEAD_M = 0.02, 0.045

# Colours that colour-blind people tell apart (Okabe and Ito), red, green, blue from 0 to 1.
_MEASURED, _RESIDUAL = (0.90, 0.62, 0.0), (0.84, 0.37, 0.0)
_OF_STATE = {
    State.TRUSTED: (0.0, 0.62, 0.45),
    State.WARNING: (0.90, 0.62, 0.0),
    State.ALARM: (0.84, 0.37, 0.0),
    State.NO_DATA: (0.7, 0.7, 0.7),
    State.NOT_JUDGED: (0.7, 0.7, 0.7),
}


class MarkerNode(GuardedNode):
    """Makes a MarkerArray of the newest odometry, prediction and alarm.

    It is on no executor, which would take the messages one by one, and so offers no services.
    """

    def __init__(self) -> None:
        silent = Parameter("start_type_description_service", value=False)
        super().__init__("markers", start_parameter_services=False, parameter_overrides=[silent])
        self.values = read_parameters(self, MarkerParameters)
        # Predictions of the first of several models; those of the others are on topics below it.
        self._odometry, self._predictions, self._alarms = (
            Inbox(self, kind, topic, NEWEST_QOS)
            for kind, topic in (
                (Odometry, "odometry"),
                (WrenchPrediction, "prediction"),
                (ExtrapolationAlarm, "extrapolation_alarm"),
            )
        )
        self._alarm: ReportedAlarms | None = None
        self._publisher = self.create_publisher(MarkerArray, TOPIC, 1)

    def publish(self) -> None:
        """Publish the markers of what has come since the last call, if there is odometry and a subscriber."""
        states, predictions = self._odometry.take(), self._predictions.take()
        try:
            self._alarm = self._alarms.unpacked(result_messages.unpack_alarms) or self._alarm
        except LogError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=_WARNING_PERIOD_S)
        if not states or self._publisher.get_subscription_count() == 0:
            return
        odometry = deserialize_message(states[-1], Odometry)
        markers = [] if self._alarm is None else [words(odometry, self._alarm)]
        if predictions:
            prediction = deserialize_message(predictions[-1], WrenchPrediction)
            markers += arrows(odometry, prediction, self.values.m_per_n, self.values.m_per_nm)
        self._publisher.publish(MarkerArray(markers=markers))


def arrows(odometry: Odometry, prediction: WrenchPrediction, m_per_n: float, m_per_nm: float) -> list[Marker]:
    """Measured and residual (measured - predicted) force and moment as arrows from the body's origin.

    Args:
        odometry: pose of the body, forward-left-up.
        prediction: wrench in the body.
        m_per_n: length of an arrow per force, m/N.
        m_per_nm: length of an arrow per moment, m/Nm.
    """
    measured, predicted = prediction.measured, prediction.predicted
    markers = []
    for name, scale, of_measured, of_predicted in (
        ("force", m_per_n, measured.force, predicted.force),
        ("moment", m_per_nm, measured.torque, predicted.torque),
    ):
        residual = [getattr(of_measured, axis) - getattr(of_predicted, axis) for axis in "xyz"]
        for kind, colour, vector in (
            ("measured", _MEASURED, [of_measured.x, of_measured.y, of_measured.z]),
            ("residual", _RESIDUAL, residual),
        ):
            marker = _marker(odometry, f"{name}/{kind}", Marker.ARROW, colour)
            marker.pose = odometry.pose.pose
            x, y, z = (scale * value for value in vector)
            marker.points = [Point(), Point(x=x, y=y, z=z)]
            marker.scale = Vector3(x=_SHAFT_M, y=_HEAD_M, z=_HEAD_M)
            markers.append(marker)
    return markers


def words(odometry: Odometry, alarm: ReportedAlarms) -> Marker:
    """How far the model can be trusted, and why, above the vehicle: what the last alarm message says."""
    state = states_of(alarm)[-1]
    marker = _marker(odometry, "trust", Marker.TEXT_VIEW_FACING, _OF_STATE[state])
    marker.pose.position.x = odometry.pose.pose.position.x
    marker.pose.position.y = odometry.pose.pose.position.y
    marker.pose.position.z = odometry.pose.pose.position.z + _TEXT_ABOVE_M
    marker.scale.z = _TEXT_HEIGHT_M
    marker.text = "\n".join((state.name.replace("_", " "), *alarm.reasons[-1][:_REASONS_SHOWN]))
    return marker


def _marker(odometry: Odometry, namespace: str, kind: Any, colour: tuple[float, float, float]) -> Marker:
    marker = Marker(header=odometry.header, ns=namespace, type=kind, action=Marker.ADD)
    marker.color.r, marker.color.g, marker.color.b, marker.color.a = *colour, 1.0
    marker.lifetime = Duration(seconds=_LIFETIME_S).to_msg()
    return marker


def main() -> int:
    """Run the node in its own process."""
    return run(_serve)


def _serve() -> None:
    node = MarkerNode()
    while rclpy.ok():
        time.sleep(1.0 / node.values.rate_hz)
        node.guard("markers", node.publish)()


if __name__ == "__main__":
    raise SystemExit(main())
