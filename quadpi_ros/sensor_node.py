# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Base of the nodes: serialized messages into the core and back out, diagnostics once a second."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, qos_policy_name_from_kind
from rclpy.subscription import Subscription

from quadpi_core.errors import LogError
from quadpi_core.flight import Recording, Stream
from quadpi_core.messages.frame_ids import BodyFrames
from quadpi_core.messages.mounting import Mounting
from quadpi_core.messages.transforms import TF_TOPIC, TF_TYPE
from quadpi_core.monitor.health import TopicHealth
from quadpi_core.screening.first_seconds import STRETCHES, FirstSeconds, contradictions
from quadpi_core.vehicle import Vehicle
from quadpi_ros import diagnostics
from quadpi_ros.dds_profile import OUTPUT_QOS, SENSOR_QOS, TRANSFORMS_QOS
from quadpi_ros.input_sources import AdapterError, message_class
from quadpi_ros.node_parameters import STRICT
from quadpi_ros.parameters import Parameters
from quadpi_ros.runtime import ManagedNode

Sample = TypeVar("Sample", bound=Stream)

# No clock of a sensor or a simulation stops it.
STEADY = Clock(clock_type=ClockType.STEADY_TIME)
# After the first sample that needs one.
_TRANSFORMS_COME_S = 1.0
_WARNING_PERIOD_S = 5.0
DIAGNOSTICS_PERIOD_S = 1.0
# How often in a row a problem is seen before it is logged.
_LOGGED_AT = 2
# Why a topic gave no sample.
_SILENT, _UNREAD = "nothing arrives on", "every message is refused on"


@dataclass
class _Input:
    """A topic that the node listens to; `mismatch` says why a publisher cannot be heard."""

    subscription: Subscription
    health: TopicHealth
    required: bool
    lost: int = 0
    mismatch: str | None = None


@dataclass
class _Output:
    """A topic that the node publishes; `mismatch` says why a subscriber cannot hear it."""

    publisher: Publisher | None = None
    mismatch: str | None = None


@dataclass
class _Problem:
    """What keeps a node from working, and how often in a row it was seen."""

    text: str | None = None
    seen: int = 0


class SensorNode(ManagedNode[Parameters]):
    """A node whose messages stay serialized in rclpy: `messages.sensor_messages` knows their bytes.

    That is the code that bags go through, and it costs less than rclpy's own conversion. Subscriptions
    exist while the node is active, publishers while it is configured.

    Attributes:
        lacking: topics that gave no sample in the period before the last status, and why.
    """

    def __init__(self, name: str, parameters: type[Parameters]) -> None:
        super().__init__(name, parameters)
        self._next_warning_s: dict[str, float] = {}
        self._inputs: dict[str, _Input] = {}
        self._outputs: dict[str, _Output] = {}
        self._problem = _Problem()
        self._transforms: Subscription | None = None
        self.lacking: dict[str, str] = {}
        self._diagnosed_s = time.monotonic()
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._diagnose, clock=STEADY)

    def listen(
        self,
        message_type: type,
        topic: str,
        unpack: Callable[[bytes], Sample],
        handle: Callable[[Sample], None],
        *,
        required: bool = True,
        rate_hz: float | None = None,
    ) -> TopicHealth:
        """Subscribe best effort; every message becomes a stream of one sample for `handle`.

        A required topic that stays silent is an error in the diagnostics and in the log, and so is one whose
        stamps are not `rate_hz` apart. Gives the health of the topic, to count what `handle` refuses.
        """
        health = TopicHealth(rate_hz)

        def receive(payload: bytes) -> None:
            try:
                sample = unpack(payload)
            except LogError as error:
                health.refuse(str(error))
                self.warn(f"topic {topic}", f"message refused: {error}")
                return
            health.take(int(sample.time_ns[0]))
            handle(sample)

        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda event: self._note_policy(self._inputs[topic], event),
            message_lost=lambda event: self._note_lost(self._inputs[topic], event.total_count),
        )
        subscription = self.create_subscription(
            message_type, topic, receive, SENSOR_QOS, raw=True, event_callbacks=events
        )
        self._inputs[topic] = _Input(subscription, health, required)
        return health

    def frames_of(self, body_frame: str, frames: str) -> BodyFrames:
        """Frames as the parameters `body_frame` and `frames` say, with the static transforms that come.

        Those are heard from the next :meth:`hear_transforms` on.
        """
        Mounting(np.eye(3), np.zeros(3))  # compiled before the flight
        try:
            message_class(TF_TYPE)
            patience_s, hint = _TRANSFORMS_COME_S, ""
        except AdapterError as error:
            patience_s, hint = 0.0, f" (/{TF_TOPIC} is not heard: {error})"
        return BodyFrames(
            body_frame,
            strict=frames == STRICT,
            patience_s=patience_s,
            hint=hint,
            warn=lambda text: self.warn("frames", text),
        )

    def hear_transforms(self, frames: BodyFrames) -> None:
        """Listen to static transforms, where their message type is installed."""
        try:
            message_type = message_class(TF_TYPE)
        except AdapterError:
            return

        def receive(payload: bytes) -> None:
            try:
                frames.transforms.take(payload)
            except LogError as error:
                self.warn(f"topic /{TF_TOPIC}", f"message refused: {error}")

        self._transforms = self.create_subscription(
            message_type, f"/{TF_TOPIC}", receive, TRANSFORMS_QOS, raw=True
        )

    def announce(
        self, message_type: type, topic: str, qos: QoSProfile = OUTPUT_QOS
    ) -> Callable[[bytes], None]:
        """Create a publisher and return its function for serialized messages.

        Lifecycle publishers would ask at every message whether the node is active; this node hears nothing
        that it could answer while it is not.
        """
        output = self._outputs[topic] = _Output()
        events = PublisherEventCallbacks(incompatible_qos=lambda event: self._note_policy(output, event))
        output.publisher = self.create_publisher(message_type, topic, qos, event_callbacks=events)
        publish: Callable[[Any], None] = output.publisher.publish
        return publish

    def deactivate(self) -> None:
        """Stop listening."""
        for topic in self._inputs.values():
            self.destroy_subscription(topic.subscription)
        self._inputs.clear()
        if self._transforms is not None:
            self.destroy_subscription(self._transforms)
            self._transforms = None

    def cleanup(self) -> None:
        """Stop publishing."""
        for output in self._outputs.values():
            if output.publisher is not None:
                self.destroy_publisher(output.publisher)
        self._outputs.clear()

    def warn(self, about: str, text: str) -> None:
        """Log a warning, at most one about the same thing every few seconds.

        rclpy's own throttle counts all that is logged from one line of code as the same.
        """
        now_s = time.monotonic()
        if now_s >= self._next_warning_s.get(about, now_s):
            self._next_warning_s[about] = now_s + _WARNING_PERIOD_S
            self.get_logger().warning(f"{about}: {text}")

    def problem(self) -> str | None:
        """What keeps the node from working although it is active; None if nothing does."""
        found = []
        for why in (_SILENT, _UNREAD):
            names = sorted(
                n for n, given in self.lacking.items() if given == why and self._inputs[n].required
            )
            endpoints = [self._inputs[name].subscription for name in names]
            reasons = [reason for endpoint in endpoints if (reason := self._other_types(endpoint))]
            if names:
                found.append(": ".join((f"{why} {', '.join(names)}", *reasons)))
        return "; ".join(found) or None

    def lack(self, topic: str) -> str | None:
        """Why a topic gave no sample in the period before the last status; None if it gave some."""
        why = self.lacking.get(topic)
        return f"{why} {topic}" if why else None

    def count_refused(self) -> None:
        """Bring the health of the topics up to date with what became of samples since they came."""

    def statuses(self) -> list[DiagnosticStatus]:
        """What `/diagnostics` says of the core, beside the topics."""
        return []

    def _diagnose(self) -> None:
        """Publish the health of every topic, and log a problem that stays; once, until it changes."""
        now_s = time.monotonic()
        period_s, self._diagnosed_s = now_s - self._diagnosed_s, now_s
        problem = None
        if self.state == "active":
            self.lacking = {
                name: _SILENT if topic.health.silent else _UNREAD
                for name, topic in self._inputs.items()
                if topic.health.silent or topic.health.unread
            }
            problem = self.problem()
            self.count_refused()
        self._follow(problem)
        level = diagnostics.ERROR if problem else diagnostics.OK
        statuses = [self.status("state", level, problem or self.state, {"state": self.state})]
        statuses += self.exceptions.statuses()
        statuses += [self._input_status(name, topic, period_s) for name, topic in self._inputs.items()]
        statuses += [
            self.status(name, diagnostics.ERROR, mismatch, {})
            for name, output in self._outputs.items()
            if (mismatch := self._standing_mismatch(output))
        ]
        if self.state == "active":
            statuses += self.statuses()
        self._diagnostics.publish(diagnostics.array(self, statuses))

    def _follow(self, problem: str | None) -> None:
        same = problem == self._problem.text
        self._problem = _Problem(problem, self._problem.seen + 1 if same else 1)
        if problem and self._problem.seen == _LOGGED_AT:
            self.get_logger().warning(problem)

    def status(self, name: str, level: bytes, message: str, values: Mapping[str, Any]) -> DiagnosticStatus:
        """A status under the node's name."""
        return diagnostics.status(diagnostics.full_name(self, name), level, message, values)

    def _input_status(self, name: str, topic: _Input, period_s: float) -> DiagnosticStatus:
        report = topic.health.report(period_s)
        age_s = None
        if report.newest_ns is not None:
            age_s = 1e-9 * (self.get_clock().now().nanoseconds - report.newest_ns)
        return diagnostics.topic_status(
            diagnostics.full_name(self, name),
            report,
            required=topic.required,
            rate_hz=topic.health.rate_hz,
            mismatch=topic.mismatch or (None if report.samples else self._other_types(topic.subscription)),
            values={
                "stamp_age_s": age_s,
                "lost_in_transport": topic.lost,
                "publishers": topic.subscription.get_publisher_count(),
            },
        )

    def _other_types(self, endpoint: Subscription | Publisher) -> str | None:
        """Which nodes use a topic with another message type; the middleware passes them over."""
        topic, expected = endpoint.topic_name, diagnostics.type_name(endpoint.msg_type)
        if isinstance(endpoint, Subscription):
            others, what = self.get_publishers_info_by_topic(topic), "publishes"
        else:
            others, what = self.get_subscriptions_info_by_topic(topic), "expects"
        found = {
            f"{one.node_namespace.rstrip('/')}/{one.node_name} {what} {one.topic_type}"
            for one in others
            if one.topic_type != expected
        }
        return f"topic {topic}: {', '.join(sorted(found))}, not {expected}" if found else None

    def _note_policy(self, endpoint: _Input | _Output, event: Any) -> None:
        if isinstance(endpoint, _Input):
            name, role = endpoint.subscription.topic_name, "a publisher offers"
        else:
            name = endpoint.publisher.topic_name if endpoint.publisher else ""
            role = "a subscriber asks for"
        policy = qos_policy_name_from_kind(event.last_policy_kind).lower()
        what = f"{role} an incompatible quality of service, policy {policy}"
        endpoint.mismatch = f"topic {name}: {what}"
        self.warn(f"topic {name}", what)

    @staticmethod
    def _note_lost(topic: _Input, total: int) -> None:
        topic.lost = total

    def _standing_mismatch(self, output: _Output) -> str | None:
        """Why a subscriber that is still there cannot hear this output; forgets a mismatch that is gone."""
        if output.publisher is None:
            return None
        if self.count_subscribers(output.publisher.topic_name) == output.publisher.get_subscription_count():
            output.mismatch = None
            return None
        return self._other_types(output.publisher) or output.mismatch


class ConsistencyWatch:
    """Looks for mistakes in frames, units, clocks and vehicle while the node goes on.

    Args:
        node: whose samples they are.
        vehicle: whose rotor speeds are among the samples; without one only the motion is looked at.
    """

    def __init__(self, node: SensorNode[Any], vehicle: Vehicle | None) -> None:
        self._node = node
        self._vehicle = vehicle
        self._samples = FirstSeconds(node.get_name())
        self._found: dict[str, None] = {}
        self._judged = 0

    @property
    def complete(self) -> bool:
        """Whether no more samples are needed."""
        return self._samples.complete

    def take(self, *streams: Stream) -> None:
        """Take samples; those of the IMU last, as they complete a stretch."""
        stretch = self._samples.take(*streams)
        if stretch is not None:
            work = self._node.guard("consistency check", self._judge)
            threading.Thread(target=work, args=(stretch,), name="consistency", daemon=True).start()

    def _judge(self, stretch: Recording) -> None:
        for problem in contradictions(stretch, self._vehicle):
            self._found[problem] = None
            self._node.get_logger().warning(f"consistency: {problem}")
        self._judged += 1

    def status(self) -> DiagnosticStatus:
        """What `/diagnostics` says: every contradiction that was found since the node became active."""
        found, judged = list(self._found), self._judged
        level, message = diagnostics.OK, "sensors and vehicle agree"
        if found:
            level, message = diagnostics.WARN, "; ".join(found)
        elif judged == 0:
            message = "not judged yet: it takes some seconds of motion"
        values = {"stretches": f"{judged} of {STRETCHES}"}
        return self._node.status("consistency", level, message, values)
