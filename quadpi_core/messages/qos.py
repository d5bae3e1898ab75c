# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service of quadpi's topics: what its nodes offer, and what its bags say that was offered."""

from __future__ import annotations

from typing import NamedTuple

from quadpi_core.results import EVENTS_KEPT


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

    def in_bag(self) -> str:
        """The profile as rosbag2 writes it into a channel, from its metadata version 9 (Jazzy) on."""
        return _IN_BAG.format(
            depth=self.depth,
            reliability="reliable" if self.reliable else "best_effort",
            durability="transient_local" if self.latched else "volatile",
        )


# Sensors publish best effort, which a reliable subscription would not match: silently nothing would arrive.
# The depth is what a busy machine may keep the process from taking: two seconds of an IMU.
SENSOR = Qos(depth=1000, reliable=False)
OUTPUT = Qos(depth=200)
# Whoever subscribes late gets the events that the log keeps.
LOG = Qos(depth=EVENTS_KEPT, latched=True)

_OUTPUTS = {"odometry": OUTPUT, "prediction": OUTPUT, "extrapolation_alarm": OUTPUT, "alarm_log": LOG}
# Deadline, lifespan and lease are infinite: the largest duration that ROS 2 knows.
_IN_BAG = """\
- history: keep_last
  depth: {depth}
  reliability: {reliability}
  durability: {durability}
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: automatic
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false"""


def qos_of(topic: str) -> Qos:
    """What is offered on a topic, by its name without a leading slash: outputs of quadpi, else sensors."""
    return _OUTPUTS.get(topic, SENSOR)
