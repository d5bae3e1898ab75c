# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a topic taken in batches when they are asked for, without an executor.

Waking an executor for every message costs more than taking it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from quadpi_core.messages.payloads import Payloads

# Half a second at 500 Hz: what may come while the process does something else. Best effort, so that no
# publisher ever waits for whoever takes in batches.
TAKEN_QOS = QoSProfile(depth=250, reliability=ReliabilityPolicy.BEST_EFFORT)
# For those who need the newest message alone.
NEWEST_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

_Content = TypeVar("_Content")


class Inbox:
    """Messages of one topic, taken when they are asked for.

    Attributes:
        topic: its name.
        count: messages so far.
        arrived_s: when the last one was taken, on the monotonic clock.
    """

    def __init__(
        self, node: Node, message_type: type, topic: str, qos: QoSProfile = TAKEN_QOS, raw: bool = True
    ) -> None:
        self.topic = topic
        self.count = 0
        self.arrived_s = time.monotonic()
        self._type, self._raw = message_type, raw
        self._subscription: Subscription = node.create_subscription(message_type, topic, _never, qos, raw=raw)

    def take(self) -> list[Any]:
        """All that have come since the last call."""
        taken = []
        handle = self._subscription.handle
        with handle:
            while (message := handle.take_message(self._type, self._raw)) is not None:
                taken.append(message[0])
        if taken:
            self.count += len(taken)
            self.arrived_s = time.monotonic()
        return taken

    def unpacked(self, unpack: Callable[[Payloads], _Content]) -> _Content | None:
        """What has come as arrays; None where nothing has.

        Raises:
            SampleError: for bytes that are no such message.
        """
        payloads = self.take()
        return unpack(Payloads.join(payloads)) if payloads else None

    def close(self, node: Node) -> None:
        """Leave the topic."""
        node.destroy_subscription(self._subscription)


def _never(_: object) -> None:
    """Callback of a subscription that no executor serves."""
