# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Base of the nodes: serialized messages from a topic into the core, and back out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.node import Node

from quadpi_core.errors import LogError
from quadpi_core.flight import Stream
from quadpi_ros.runtime import OUTPUT_QOS, SENSOR_QOS

Sample = TypeVar("Sample", bound=Stream)

_WARNING_PERIOD_S = 5.0


class SensorNode(Node):
    """A node whose messages stay serialized in rclpy: `quadpi_core.logs.messages` knows their bytes.

    That is the code that bags go through, and it costs less than rclpy's own conversion.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)

    def listen(
        self,
        message_type: type,
        topic: str,
        unpack: Callable[[bytes], Sample],
        handle: Callable[[Sample], None],
    ) -> None:
        """Subscribe best effort; every message becomes a stream of one sample for `handle`."""

        def receive(payload: bytes) -> None:
            try:
                sample = unpack(payload)
            except LogError as error:
                self.warn(f"topic {topic}: message refused: {error}")
                return
            handle(sample)

        self.create_subscription(message_type, topic, receive, SENSOR_QOS, raw=True)

    def announce(self, message_type: type, topic: str) -> Callable[[bytes], None]:
        """Create a reliable publisher and return its function for serialized messages."""
        publish: Callable[[Any], None] = self.create_publisher(message_type, topic, OUTPUT_QOS).publish
        return publish

    def warn(self, text: str) -> None:
        """Log a warning, at most one per place every few seconds."""
        self.get_logger().warning(text, throttle_duration_sec=_WARNING_PERIOD_S)
