# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Receive what the live nodes publish, in the caller's process, and report alarm changes at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from nav_msgs.msg import Odometry
from quadpi.msg import ExtrapolationAlarm, WrenchPrediction
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future

from quadpi_core.flight import Stamps
from quadpi_core.messages import result_messages
from quadpi_core.messages.payloads import Payloads
from quadpi_core.results import CAUSE_NAMES, LEVEL_OK, Predictions, ReportedAlarms

_LEVEL_NAMES = ("ok", "warning", "ALARM")
# Deep enough to lose nothing while the caller, in the same process, is busy.
_DEEP_QOS = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
_POLL_S = 0.05
# Inputs outside the envelope that are shown, so that a change fits one line of a terminal.
_NAMES_SHOWN = 3


@dataclass(frozen=True)
class AlarmChange:
    """A change of the alarm: another level, other causes, or a further input outside the envelope.

    Attributes:
        time_s: stamp, in seconds since the start of the flight.
        level: 0 ok, 1 warning, 2 alarm.
        causes: names of the causes.
        inputs_outside: names of the inputs outside the envelope, the farthest first.
        envelope_distance: distance of the farthest from its training range, in widths of that range.
    """

    time_s: float
    level: int
    causes: tuple[str, ...]
    inputs_outside: tuple[str, ...]
    envelope_distance: float

    def __str__(self) -> str:
        text = f"{self.time_s:7.2f} s  {_LEVEL_NAMES[self.level]:8}{', '.join(self.causes)}"
        if self.inputs_outside:
            more = len(self.inputs_outside) - _NAMES_SHOWN
            text += f": {', '.join(self.inputs_outside[:_NAMES_SHOWN])}"
            text += f" +{more}" if more > 0 else ""
            text += f", {self.envelope_distance:.0%} out"
        return text


class AlarmFollower:
    """Finds the changes in a sequence of alarm messages, which repeat at a steady rate."""

    def __init__(self, start_ns: int) -> None:
        self._start_ns = start_ns
        self._state = (LEVEL_OK, 0)
        self._named: set[str] = set()

    def follow(self, alarms: ReportedAlarms) -> AlarmChange | None:
        """The change in the next alarm message; None if nothing changed."""
        level, causes = int(alarms.level[0]), int(alarms.causes[0])
        inputs = alarms.inputs_outside[0] if level != LEVEL_OK else ()
        changed = (level, causes) != self._state or not self._named.issuperset(inputs)
        self._state = (level, causes)
        self._named = self._named.union(inputs) if level != LEVEL_OK else set()
        if not changed:
            return None
        return AlarmChange(
            time_s=1e-9 * (int(alarms.time_ns[0]) - self._start_ns),
            level=level,
            causes=tuple(name for bit, name in CAUSE_NAMES.items() if causes & bit),
            inputs_outside=inputs,
            envelope_distance=float(alarms.envelope_distance[0]),
        )


Entered = TypeVar("Entered", bound="Listener")


class Listener:
    """A node in the caller's process that receives serialized messages; a context manager.

    Args:
        name: of the node.
        topics: message type, name, and callback of each topic.
    """

    def __init__(self, name: str, topics: Sequence[tuple[type, str, Callable[[bytes], None]]]) -> None:
        self._context = Context()
        self._context.init()
        self._node = Node(name, context=self._context, start_parameter_services=False)
        self._subscriptions = {
            topic: self._node.create_subscription(message_type, topic, take, _DEEP_QOS, raw=True)
            for message_type, topic, take in topics
        }
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)

    def __enter__(self: Entered) -> Entered:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.remove_node(self._node)
        self._node.destroy_node()
        self._executor.shutdown()
        self._context.try_shutdown()

    @property
    def connected(self) -> bool:
        """Whether every topic has a publisher."""
        return all(map(self.hears, self._subscriptions))

    def hears(self, topic: str) -> bool:
        """Whether that topic has a publisher."""
        return bool(self._subscriptions[topic].get_publisher_count() > 0)

    def spin(self, seconds: float) -> None:
        """Receive messages for a time."""
        self._executor.spin_until_future_complete(Future(), timeout_sec=seconds)

    def spin_until(self, condition: Callable[[], bool], timeout_s: float = float("inf")) -> bool:
        """Receive messages until the condition holds; False on timeout."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.spin(_POLL_S)
        return True


class Collector(Listener):
    """Keeps every message that the live nodes publish.

    Args:
        start_ns: stamp from which the seconds of an alarm change count.
        on_alarm: called at once for every change of the alarm.

    Attributes:
        silent_ns: stamp of the newest alarm that reports silence; None if a sample was judged since.
    """

    def __init__(self, start_ns: int, on_alarm: Callable[[AlarmChange], None] | None = None) -> None:
        self.silent_ns: int | None = None
        self._follower = AlarmFollower(start_ns)
        self._on_alarm = on_alarm
        self._odometry: list[bytes] = []
        self._predictions: list[bytes] = []
        self._alarms: list[bytes] = []
        self._arrived_ns: list[int] = []
        super().__init__(
            "collector",
            (
                (Odometry, "odometry", self._odometry.append),
                (WrenchPrediction, "prediction", self._take_prediction),
                (ExtrapolationAlarm, "extrapolation_alarm", self._take_alarm),
            ),
        )

    @property
    def arrived_ns(self) -> Stamps:
        """(P,) arrival of each prediction, monotonic clock."""
        return np.array(self._arrived_ns, dtype=np.int64)

    def odometry(self) -> Payloads:
        """Messages of all states so far."""
        return Payloads.join(self._odometry)

    def predictions(self) -> Predictions:
        """All predictions so far."""
        return result_messages.unpack_predictions(Payloads.join(self._predictions))

    def alarms(self) -> ReportedAlarms:
        """All alarms so far that follow from samples, without those that report silence around a flight."""
        return result_messages.unpack_alarms(Payloads.join(self._alarms))

    def _take_prediction(self, payload: bytes) -> None:
        self._arrived_ns.append(time.monotonic_ns())
        self._predictions.append(payload)
        self.silent_ns = None

    def _take_alarm(self, payload: bytes) -> None:
        alarm = result_messages.unpack_alarms(payload)
        if not alarm.of_samples.all():
            self.silent_ns = int(alarm.time_ns[0])
            return
        self.silent_ns = None
        self._alarms.append(payload)
        change = self._follower.follow(alarm)
        if change is not None and self._on_alarm is not None:
            self._on_alarm(change)
