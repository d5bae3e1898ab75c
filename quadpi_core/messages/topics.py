# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The standard topics: the type of each, and the quality of service that nodes offer and bags record."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quadpi_core.messages import sensor_messages
from quadpi_core.results import EVENTS_KEPT

if TYPE_CHECKING:
    from rosbags.interfaces import Qos as ProfileInBag

# Types of messages by topic, in any namespace.
TOPIC_TYPES = {
    "imu": sensor_messages.IMU,
    "erpm": sensor_messages.ERPM,
    "rotor_speeds": sensor_messages.ROTOR_SPEEDS,
    "mocap/pose": sensor_messages.POSE,
    "mocap/transform": sensor_messages.TRANSFORM,
    "mocap/odometry": sensor_messages.ODOMETRY,
    "mocap/twist": sensor_messages.TWIST,
    "odometry": sensor_messages.ODOMETRY,
    "wind": sensor_messages.WIND,
    "motor_commands": sensor_messages.MOTOR_COMMANDS,
    "battery": sensor_messages.BATTERY,
    "pressure": sensor_messages.PRESSURE,
    "temperature": sensor_messages.TEMPERATURE,
    "simulation/wrench": sensor_messages.WRENCH,
    "prediction": sensor_messages.PREDICTION,
    "extrapolation_alarm": sensor_messages.ALARM,
    "alarm_log": sensor_messages.EVENT,
    "truth/odometry": sensor_messages.ODOMETRY,
    "truth/wrench": sensor_messages.WRENCH,
    "truth/acceleration": sensor_messages.ACCELERATION,
    "truth/rotor_speeds": sensor_messages.ROTOR_SPEEDS,
    "truth/wind": sensor_messages.WIND,
    "truth/reference": sensor_messages.POSE,
}


# The streams that sensor topics give. The words `imu`, `mocap/pose`, … stand for them everywhere: on the
# command line (`--topics imu=/uav1/imu`), in mapping files, and as launch arguments (`imu_topic:=`). Of
# several topics of one kind the first counts, as a node listens to one of them.
SENSOR_KINDS = {
    "imu": "imu",
    "rotor_speeds": "rotor_speeds",
    "erpm": "rotor_speeds",
    "mocap/pose": "mocap",
    "mocap/transform": "mocap",
    "mocap/odometry": "mocap",
    "mocap/twist": "mocap",
    "odometry": "odometry",
    "wind": "wind",
    "simulation/wrench": "simulation",
}
# Those that live nodes listen to as they come, each with a launch argument.
LIVE_SENSORS = tuple(name for name, kind in SENSOR_KINDS.items() if kind not in {"odometry", "simulation"})
MOCAP_TOPICS = tuple(name for name, kind in SENSOR_KINDS.items() if kind == "mocap")


class Qos(NamedTuple):
    """Policies of a publisher; all others are those that ROS 2 takes by default.

    Attributes:
        depth: samples kept for a subscriber that is slow, or late where `latched`.
        reliable: else best effort.
        latched: transient local, a late subscriber gets what came before it; else volatile.
    """

    depth: int
    reliable: bool = True
    latched: bool = False

    def profile(self) -> ProfileInBag:
        """The profile as rosbags writes it into a bag."""
        # Imported here, as live nodes write no bags.
        from rosbags import interfaces as bag

        forever = bag.QosTime(*_FOREVER)
        return bag.Qos(
            history=bag.QosHistory.KEEP_LAST,
            depth=self.depth,
            reliability=bag.QosReliability.RELIABLE if self.reliable else bag.QosReliability.BEST_EFFORT,
            durability=bag.QosDurability.TRANSIENT_LOCAL if self.latched else bag.QosDurability.VOLATILE,
            deadline=forever,
            lifespan=forever,
            liveliness=bag.QosLiveliness.AUTOMATIC,
            liveliness_lease_duration=forever,
            avoid_ros_namespace_conventions=False,
        )


# The largest duration that ROS 2 knows [s, ns]: no deadline, no end.
_FOREVER = (9223372036, 854775807)
# Sensors publish best effort, which a reliable subscription would not match: silently nothing would arrive.
# The depth is what a busy machine may keep the process from taking: two seconds of an IMU.
SENSOR = Qos(depth=1000, reliable=False)
OUTPUT = Qos(depth=200)
# Whoever subscribes late gets the events that the log keeps.
LOG = Qos(depth=EVENTS_KEPT, latched=True)

_OUTPUTS = {
    **dict.fromkeys(("odometry", "prediction", "extrapolation_alarm"), OUTPUT),
    **dict.fromkeys(("wrench/predicted", "wrench/measured", "wrench/residual"), OUTPUT),
    "alarm_log": LOG,
}


def qos_of(topic: str) -> Qos:
    """What is offered on a topic, by its name without a leading slash: outputs of quadpi, else sensors."""
    return _OUTPUTS.get(topic, SENSOR)
