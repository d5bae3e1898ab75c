# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Predictions as geometry_msgs/WrenchStamped, for tools that know the standard types alone."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import WrenchStamped

from quadpi_core.messages.result_messages import wrench_message, wrenches_of
from quadpi_core.results import Predictions
from quadpi_ros.sensor_node import SensorNode

TOPICS = {name: f"wrench/{name}" for name in ("predicted", "measured", "residual")}


class WrenchPublisher:
    """Publishes what one model predicts, what was measured, and the measured less the predicted.

    Args:
        node: to publish from.
        frame_id: body frame.
        below: name of the model, a part of its topics; none for the first.
    """

    def __init__(self, node: SensorNode[Any], frame_id: str, below: str = "") -> None:
        self._message = wrench_message(frame_id)
        self._publish = {}
        for name, topic in TOPICS.items():
            # Below the resolved topic of the first: a remapping does not cover topics below the one it names.
            whole = f"{node.resolve_topic_name(topic)}/{below}" if below else topic
            self._publish[name] = node.announce(WrenchStamped, whole)

    def publish(self, predictions: Predictions) -> None:
        """Publish the wrenches of predictions."""
        for name, wrenches in wrenches_of(predictions).items():
            for time_ns, wrench in zip(predictions.time_ns.tolist(), wrenches, strict=True):
                self._message.values[:] = wrench
                self._publish[name](self._message.stamped(time_ns))
