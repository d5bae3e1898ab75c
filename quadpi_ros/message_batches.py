# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a node publishes within 50 ms, once more as one message, for a page that draws 20 times a second.

A message to one more process costs its publisher 50 to 80 us of CPU, and the receiver as much, whatever its
size: for three models and the state at 500 Hz a tenth of a core. Twenty batches a second cost a hundredth of
that.

A batch is a std_msgs/UInt8MultiArray on the private topic `~/batch`: the bytes of the messages one behind the
other, and for each topic a dimension with label "TOPIC TYPE", the number of its messages as size and the
length of each as stride.
"""

from __future__ import annotations

import itertools
import time
from array import array
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import MultiArrayDimension, MultiArrayLayout, UInt8MultiArray

from quadpi_core.errors import LogError
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.messages.payloads import Payloads

TOPIC = "~/batch"
PERIOD_S = 0.05
# Type of rows that are no message: a little-endian int64 stamp in ns, then float64 values.
ROWS = "rows"
# Best effort: no publisher waits for a page. Half a second of batches.
BATCH_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
_STAMP_BYTES = _VALUE_BYTES = 8


class OutgoingBatch:
    """Collects what a node publishes while somebody listens, and publishes it every :data:`PERIOD_S`.

    Args:
        node: to publish from.

    Attributes:
        heard: whether somebody listens; while nobody does, nothing need be added.
    """

    def __init__(self, node: Node) -> None:
        self.heard = False
        self._node = node
        self._publisher = node.create_publisher(
            UInt8MultiArray,
            TOPIC,
            BATCH_QOS,
            event_callbacks=PublisherEventCallbacks(matched=self._note_listeners),
        )
        self._waiting: dict[str, list[bytes]] = {}
        self._due_s = 0.0

    def _note_listeners(self, matched: Any) -> None:
        self.heard = matched.current_count > 0
        if not self.heard:
            # Whoever comes next, an hour later perhaps, is not to begin with what the last one left.
            self._waiting = {}

    def adding(self, topic: str, type_name: str) -> Callable[[bytes], None]:
        """A function that takes the serialized messages of a topic."""
        label = f"{topic} {type_name}"

        def add(payload: bytes) -> None:
            if time.monotonic() >= self._due_s:
                self.send()
            if self.heard:
                self._waiting.setdefault(label, []).append(payload)

        return add

    def adding_rows(self, name: str) -> Callable[[Stamps, Array], None]:
        """A function that takes rows (K, width) with their stamps (K,), of one width."""
        add = self.adding(name, ROWS)

        def add_rows(time_ns: Stamps, values: Array) -> None:
            for k in range(len(time_ns)):
                add(time_ns[k].tobytes() + values[k].tobytes())

        return add_rows

    def send(self) -> None:
        """Publish what waits."""
        self._due_s = time.monotonic() + PERIOD_S
        self.heard = self._publisher.get_subscription_count() > 0
        waiting, self._waiting = self._waiting, {}
        if self.heard and waiting:
            self._publisher.publish(batch_of(waiting))

    def destroy(self) -> None:
        """Leave the topic."""
        self._node.destroy_publisher(self._publisher)


def batch_of(payloads: dict[str, list[bytes]]) -> UInt8MultiArray:
    """One message of the payloads of each label."""
    dimensions = [
        MultiArrayDimension(label=label, size=len(list(same)), stride=length)
        for label, several in payloads.items()
        for length, same in itertools.groupby(several, len)
    ]
    data = array("B", b"".join(itertools.chain.from_iterable(payloads.values())))
    return UInt8MultiArray(layout=MultiArrayLayout(dim=dimensions), data=data)


class BatchPart(NamedTuple):
    """Messages of one topic in a batch."""

    topic: str
    type_name: str
    payloads: Payloads


def parts_of(batch: UInt8MultiArray) -> Iterator[BatchPart]:
    """The messages of a batch, topic by topic.

    Raises:
        LogError: for a layout that the bytes do not follow.
    """
    data, place = np.frombuffer(batch.data, dtype=np.uint8), 0
    for dimension in batch.layout.dim:
        count, length = dimension.size, dimension.stride
        end = place + count * length
        if end > len(data) or not count or not length:
            raise LogError(f"a batch of {len(data)} bytes holds no {count} messages of {length} bytes")
        topic, _, type_name = dimension.label.partition(" ")
        yield BatchPart(topic, type_name, Payloads.from_rows(data[place:end].reshape(count, length)))
        place = end


def unpack_rows(payloads: Payloads, width: int) -> tuple[Stamps, Array]:
    """Stamps (K,) and rows (K, width) of a part of type :data:`ROWS`.

    Raises:
        LogError: for rows of another width.
    """
    length = _STAMP_BYTES + _VALUE_BYTES * width
    if not (payloads.lengths == length).all():
        raise LogError(f"rows of a batch have {payloads.lengths.max()} bytes, not {length}")
    rows = payloads.rows(np.arange(len(payloads)), length)
    return rows[:, :_STAMP_BYTES].copy().view("<i8")[:, 0], rows[:, _STAMP_BYTES:].copy().view("<f8")
