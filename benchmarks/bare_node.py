# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The least that a node with the live nodes' topics can do: take typed messages, publish typed messages."""

from __future__ import annotations

from geometry_msgs.msg import PoseStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from quadpi.msg import ExtrapolationAlarm, RotorSpeeds, WrenchPrediction
from rclpy.node import Node
from sensor_msgs.msg import Imu

from quadpi_ros.callbacks import OUTPUT_QOS, SENSOR_QOS
from quadpi_ros.runtime import run, spin

# The monitor repeats its alarm at 10 Hz while the IMU comes at 500 Hz.
_IMU_SAMPLES_PER_ALARM = 50


# As three models make it.
PREDICTION_TOPICS = ("prediction", "prediction/bootstrap", "prediction/quality_driven")


class BareNode(Node):
    """Answers every IMU sample with an odometry and three predictions, every fiftieth with an alarm."""

    def __init__(self) -> None:
        super().__init__("bare")
        self._odometry = self.create_publisher(Odometry, "odometry", OUTPUT_QOS)
        self._predictions = [
            self.create_publisher(WrenchPrediction, topic, OUTPUT_QOS) for topic in PREDICTION_TOPICS
        ]
        self._alarm = self.create_publisher(ExtrapolationAlarm, "extrapolation_alarm", OUTPUT_QOS)
        self._samples = 0
        self.create_subscription(Imu, "imu", self._take_imu, SENSOR_QOS)
        for message_type, topic in (
            (RotorSpeeds, "rotor_speeds"),
            (PoseStamped, "mocap/pose"),
            (Vector3Stamped, "wind"),
        ):
            self.create_subscription(message_type, topic, lambda _: None, SENSOR_QOS)

    def _take_imu(self, imu: Imu) -> None:
        self._samples += 1
        self._odometry.publish(Odometry(header=imu.header))
        for publisher in self._predictions:
            publisher.publish(WrenchPrediction(header=imu.header))
        if self._samples % _IMU_SAMPLES_PER_ALARM == 0:
            self._alarm.publish(ExtrapolationAlarm(header=imu.header))


if __name__ == "__main__":
    raise SystemExit(run(lambda: spin([BareNode()])))
