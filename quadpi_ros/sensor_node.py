# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Base of the nodes: serialized messages from a topic into the core, and back out."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from quadpi_core.errors import LogError
from quadpi_core.flight import Stream
from quadpi_ros.runtime import OUTPUT_QOS, SENSOR_QOS

Sample = TypeVar("Sample", bound=Stream)

_WARNING_PERIOD_S = 5.0
_WATCH_PERIOD_S = 2.0


class SensorNode(Node):
    """A node whose messages stay serialized in rclpy: `quadpi_core.logs.messages` knows their bytes.

    That is the code that bags go through, and it costs less than rclpy's own conversion.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self._next_warning_s: dict[str, float] = {}
        self._required: set[str] = set()
        self._heard: set[str] = set()
        self._problem: str | None = None
        self._told = False
        self.create_timer(_WATCH_PERIOD_S, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def listen(
        self,
        message_type: type,
        topic: str,
        unpack: Callable[[bytes], Sample],
        handle: Callable[[Sample], None],
        *,
        required: bool = True,
    ) -> None:
        """Subscribe best effort; every message becomes a stream of one sample for `handle`.

        A required topic that stays silent is reported in the log.
        """

        def receive(payload: bytes) -> None:
            self._heard.add(topic)
            try:
                sample = unpack(payload)
            except LogError as error:
                self.warn(f"topic {topic}", f"message refused: {error}")
                return
            handle(sample)

        if required:
            self._required.add(topic)
        self.create_subscription(message_type, topic, receive, SENSOR_QOS, raw=True)

    def announce(self, message_type: type, topic: str) -> Callable[[bytes], None]:
        """Create a reliable publisher and return its function for serialized messages."""
        publish: Callable[[Any], None] = self.create_publisher(message_type, topic, OUTPUT_QOS).publish
        return publish

    def warn(self, about: str, text: str) -> None:
        """Log a warning, at most one about the same thing every few seconds.

        rclpy's own throttle counts all that is logged from one line of code as the same.
        """
        now_s = time.monotonic()
        if now_s >= self._next_warning_s.get(about, now_s):
            self._next_warning_s[about] = now_s + _WARNING_PERIOD_S
            self.get_logger().warning(f"{about}: {text}")

    def problem(self) -> str | None:
        """What keeps the node from working although it runs; None if nothing does."""
        silent = self._required - self._heard
        return f"nothing arrives on {', '.join(sorted(silent))}" if silent else None

    def _watch(self) -> None:
        """Log a problem once it has stood for a whole period; once, until it changes."""
        problem = self.problem()
        self._heard.clear()
        if problem != self._problem:
            self._problem, self._told = problem, False
        elif problem and not self._told:
            self._told = True
            self.get_logger().warning(problem)
