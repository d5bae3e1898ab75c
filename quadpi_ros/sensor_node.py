# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Base of estimator and monitor node: serialized messages to and from the core, diagnostics once a second."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, qos_policy_name_from_kind
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.type_hash import TypeHash

from quadpi_core.errors import LogError
from quadpi_core.flight import Recording, Stream
from quadpi_core.messages.frame_ids import TF_TOPIC, TF_TYPE, BodyFrames
from quadpi_core.monitor.health import TopicHealth
from quadpi_core.screening.first_seconds import STRETCHES, FirstSeconds, contradictions
from quadpi_core.vehicle import Vehicle
from quadpi_ros import callbacks
from quadpi_ros.callbacks import OUTPUT_QOS, SENSOR_QOS, TRANSFORMS_QOS, GuardedNode
from quadpi_ros.input_sources import AdapterError, message_class
from quadpi_ros.parameters import STRICT, Parameters
from quadpi_ros.runtime import ManagedNode

Sample = TypeVar("Sample", bound=Stream)

# How long static transforms may take to arrive after the first sample that needs one.
_TRANSFORMS_COME_S = 1.0
# A warning about the same thing is logged at this period.
_WARNING_PERIOD_S = 5.0
DIAGNOSTICS_PERIOD_S = 1.0
# A problem is logged when this many diagnostics in a row report it.
_LOGGED_AT = 2
# Why a topic gave no sample.
_SILENT, _UNREAD = "nothing arrives on", "every message is refused on"


_STEADY = Clock(clock_type=ClockType.STEADY_TIME)
# Shares of the period: sooner after the work a timer has nothing to do, later a message does what is due.
_EARLY, _LATE = 0.5, 1.5


class Watch:
    """Work at a steady period, done even where messages come faster than they can be taken.

    rclpy's events executor takes what happens in its order. Once more messages arrive than a process can
    take, a timer waits behind all of them, longer and longer; :meth:`look` does what it is late with.

    Args:
        node: on whose executor it is done.
        period_s: by this computer's steady clock, not by the node's.
        work: to be done.
    """

    def __init__(self, node: GuardedNode, period_s: float, work: Callable[[], None]) -> None:
        self._node, self._period_s, self._done_s = node, period_s, time.monotonic()
        self._work = node.guard(f"watch {work.__name__}", work)
        self._timer = node.create_timer(period_s, self._on_time, clock=_STEADY)

    def look(self, now_s: float) -> None:
        """Do what is overdue by this instant of the steady clock; called at every message."""
        if now_s - self._done_s > _LATE * self._period_s:
            self._do(now_s)

    def destroy(self) -> None:
        """Stop."""
        self._node.destroy_timer(self._timer)

    def _on_time(self) -> None:
        now_s = time.monotonic()
        if now_s - self._done_s > _EARLY * self._period_s:
            self._do(now_s)

    def _do(self, now_s: float) -> None:
        self._done_s = now_s
        self._work()


@dataclass
class _Input:
    """A subscribed topic; `mismatch` is the reason why a publisher on it is incompatible."""

    subscription: Subscription
    health: TopicHealth
    required: bool
    lost: int = 0
    mismatch: str | None = None


@dataclass
class _Output:
    """A published topic; `mismatch` is the reason why a subscriber to it is incompatible."""

    publisher: Publisher
    mismatch: str | None = None


class SensorNode(ManagedNode[Parameters]):
    """A node that leaves messages serialized and decodes them with `messages.sensor_messages`.

    Bags are read by the same code, and it is faster than rclpy's conversion. Subscriptions exist while the
    node is active, publishers while it is configured.

    Attributes:
        lacking: topics without a sample in the last diagnostics period, and the reason.
    """

    def __init__(self, name: str, parameters: type[Parameters]) -> None:
        super().__init__(name, parameters)
        self._next_warning_s: dict[str, float] = {}
        self._inputs: dict[str, _Input] = {}
        self._outputs: dict[str, _Output] = {}
        # What keeps the node from working, and in how many diagnostics in a row it was found.
        self._problem: tuple[str | None, int] = (None, 0)
        # What was logged of it and is not over.
        self._logged = ""
        self._transforms: Subscription | None = None
        self.lacking: dict[str, str] = {}
        self._diagnosed_s = time.monotonic()
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._watches: list[Watch] = []
        self.watch(DIAGNOSTICS_PERIOD_S, self._diagnose)

    def watch(self, period_s: float, work: Callable[[], None]) -> Watch:
        """Do something once per period, whether messages come, pause or flood; until it is unwatched."""
        watch = Watch(self, period_s, work)
        self._watches.append(watch)
        return watch

    def unwatch(self, watch: Watch) -> None:
        """Stop what :meth:`watch` began."""
        self._watches.remove(watch)
        watch.destroy()

    def look_at_watches(self) -> None:
        """Do what the timers are late with; called at every sample."""
        now_s = time.monotonic()
        for watch in self._watches:
            watch.look(now_s)

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
        """Subscribe best effort and pass every message to `handle` as a stream of one sample.

        In diagnostics and log it is an error if a required topic is silent, or if its stamps contradict
        `rate_hz`. Returns the health of the topic, which counts the samples that `handle` refuses too.
        """
        health = TopicHealth(rate_hz)
        told = ""

        def receive(payload: bytes) -> None:
            nonlocal told
            self.look_at_watches()
            try:
                sample = unpack(payload)
                if not sample.time_ns[0]:
                    raise LogError("stamps are zero")
            except LogError as error:
                reason = str(error)
                health.refuse(reason)
                # A driver that sends the same mistake at every message is told once; diagnostics count on.
                if reason != told and self.warn(f"topic {topic}", f"message refused: {reason}"):
                    told = reason
                return
            health.take(int(sample.time_ns[0]))
            handle(sample)

        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda event: self._note_policy(self._inputs[topic], event),
            message_lost=lambda event: self._note_lost(topic, event),
        )
        subscription = self.create_subscription(
            message_type, topic, receive, SENSOR_QOS, raw=True, event_callbacks=events
        )
        self._inputs[topic] = _Input(subscription, health, required)
        return health

    def frames_of(self, body_frame: str, frames: str) -> BodyFrames:
        """Body frames by the parameters `body_frame` and `frames`, with the static transforms received.

        Transforms are received after :meth:`hear_transforms`.
        """
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
        """Subscribe to static transforms if their message type is installed."""
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
        """Create a publisher and return its function that publishes a serialized message.

        An ordinary publisher, as a lifecycle publisher checks the node's state at every message; a node that
        is not active receives nothing and so publishes nothing.
        """
        events = PublisherEventCallbacks(
            incompatible_qos=lambda event: self._note_policy(self._outputs[topic], event)
        )
        publisher = self.create_publisher(message_type, topic, qos, event_callbacks=events)
        self._outputs[topic] = _Output(publisher)
        return publisher.publish

    def deactivate(self) -> None:
        """Destroy the subscriptions."""
        self._logged = ""
        for topic in self._inputs.values():
            self.destroy_subscription(topic.subscription)
        self._inputs.clear()
        if self._transforms is not None:
            self.destroy_subscription(self._transforms)
            self._transforms = None

    def cleanup(self) -> None:
        """Destroy the publishers."""
        for output in self._outputs.values():
            self.destroy_publisher(output.publisher)
        self._outputs.clear()

    def warn(self, about: str, text: str) -> bool:
        """Log a warning, at most one every few seconds with the same `about`; says whether it was logged.

        rclpy's throttle would treat everything logged from this line as the same.
        """
        now_s = time.monotonic()
        if now_s < self._next_warning_s.get(about, now_s):
            return False
        self._next_warning_s[about] = now_s + _WARNING_PERIOD_S
        self.get_logger().warning(f"{about}: {text}")
        return True

    def problem(self) -> str | None:
        """Why the active node cannot work, such as a silent topic; None if it can."""
        problems = []
        for why in (_SILENT, _UNREAD):
            names = sorted(
                n for n, given in self.lacking.items() if given == why and self._inputs[n].required
            )
            reasons = [reason for name in names if (reason := self._reason(self._inputs[name]))]
            if names:
                problems.append(": ".join((f"{why} {', '.join(names)}", *reasons)))
        return "; ".join(problems) or None

    def lack(self, topic: str) -> str | None:
        """Why a topic had no sample in the last diagnostics period; None if it had some."""
        why = self.lacking.get(topic)
        return f"{why} {topic}" if why else None

    def refusals(self) -> tuple[str, ...]:
        """Why every message of a required topic is refused, such as "imu: stamps are zero"."""
        return tuple(
            f"{name}: {topic.health.latest}"
            for name, topic in self._inputs.items()
            if topic.required and self.lacking.get(name) == _UNREAD
        )

    def count_refused(self) -> None:
        """Count in the health of the topics the samples that were refused after they were received."""

    def statuses(self) -> list[DiagnosticStatus]:
        """Statuses of the core, which `/diagnostics` adds to those of the topics."""
        return []

    def _diagnose(self) -> None:
        """Publish the health of every topic, and log a persistent problem once until it changes or ends."""
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
        level = callbacks.ERROR if problem else callbacks.OK
        statuses = [self.status("state", level, problem or self.state, {"state": self.state})]
        statuses += self.exceptions.statuses()
        statuses += [self._input_status(name, topic, period_s) for name, topic in self._inputs.items()]
        statuses += [
            self.status(name, callbacks.ERROR, mismatch, {})
            for name, output in self._outputs.items()
            if (mismatch := self._standing_mismatch(output))
        ]
        if self.state == "active":
            statuses += self.statuses()
        self._diagnostics.publish(callbacks.array(self, statuses))

    def _follow(self, problem: str | None) -> None:
        before, seen = self._problem
        self._problem = problem, seen + 1 if problem == before else 1
        if problem and self._problem[1] == _LOGGED_AT:
            self.get_logger().warning(problem)
            self._logged = problem
        elif self._logged and not problem and self.state == "active":
            self.get_logger().info(f"over: {self._logged}")
            self._logged = ""

    def status(self, name: str, level: bytes, message: str, values: Mapping[str, Any]) -> DiagnosticStatus:
        """A status named after the node."""
        return callbacks.status(callbacks.full_name(self, name), level, message, values)

    def _input_status(self, name: str, topic: _Input, period_s: float) -> DiagnosticStatus:
        report = topic.health.report(period_s)
        age_s = None
        if report.newest_ns is not None:
            age_s = 1e-9 * (self.get_clock().now().nanoseconds - report.newest_ns)
        return callbacks.topic_status(
            callbacks.full_name(self, name),
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

    def _reason(self, topic: _Input) -> str | None:
        """Why a topic gives no sample, as far as its publishers or its refused messages tell."""
        refused = topic.health.latest if topic.health.unread else ""
        return self._other_types(topic.subscription) or refused or None

    def _other_types(self, endpoint: Subscription | Publisher) -> str | None:
        """Nodes that use the topic with another message type or another version of it.

        DDS silently does not connect types of other names, and hands over the bytes of other versions.
        """
        topic, expected = endpoint.topic_name, callbacks.type_name(endpoint.msg_type)
        publishers = self.get_publishers_info_by_topic(topic)
        subscriptions = self.get_subscriptions_info_by_topic(topic)
        if isinstance(endpoint, Subscription):
            others, own, what = publishers, subscriptions, "publishes"
        else:
            others, own, what = subscriptions, publishers, "expects"
        me = self.get_fully_qualified_name()
        # What a distribution before Iron sends tells no version.
        versions = {str(TypeHash()), *(str(one.topic_type_hash) for one in own if _node_of(one) == me)}
        others_found = set()
        for one in others:
            if one.topic_type != expected:
                others_found.add(f"{_node_of(one)} {what} {one.topic_type}, not {expected}")
            elif str(one.topic_type_hash) not in versions:
                others_found.add(
                    f"{_node_of(one)} {what} {expected} of another version: build it with this quadpi"
                )
        return f"topic {topic}: {'; '.join(sorted(others_found))}" if others_found else None

    def _note_policy(self, endpoint: _Input | _Output, event: Any) -> None:
        if isinstance(endpoint, _Input):
            name, role = endpoint.subscription.topic_name, "a publisher offers"
        else:
            name, role = endpoint.publisher.topic_name, "a subscriber asks for"
        policy = qos_policy_name_from_kind(event.last_policy_kind).lower()
        what = f"{role} an incompatible quality of service, policy {policy}"
        endpoint.mismatch = f"topic {name}: {what}"
        self.warn(f"topic {name}", what)

    def _note_lost(self, topic: str, event: Any) -> None:
        self._inputs[topic].lost = event.total_count

    def _standing_mismatch(self, output: _Output) -> str | None:
        """Why a present subscriber cannot receive this output; a mismatch that is gone is forgotten."""
        if self.count_subscribers(output.publisher.topic_name) == output.publisher.get_subscription_count():
            output.mismatch = None
            return None
        return self._other_types(output.publisher) or output.mismatch


def _node_of(endpoint: TopicEndpointInfo) -> str:
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


class ConsistencyWatch:
    """Checks the first seconds of motion for mistakes in frames, units, clocks and vehicle, in a thread.

    Args:
        node: receives the samples; problems go to its log and diagnostics.
        vehicle: for samples with rotor speeds; without it only the motion is checked.

    Attributes:
        complete: whether all stretches of motion have been collected.
    """

    def __init__(self, node: SensorNode[Any], vehicle: Vehicle | None) -> None:
        self.complete = False
        self._node = node
        self._vehicle = vehicle
        self._samples = FirstSeconds(node.get_name())
        self._found: dict[str, None] = {}
        self._judged = 0

    def take(self, kind: type[Stream] | None, *columns: NDArray[Any]) -> None:
        """Collect samples, see :meth:`FirstSeconds.take`."""
        if self.complete:
            return
        stretch = self._samples.take(kind, *columns)
        self.complete = self._samples.complete
        if stretch is not None:
            work = self._node.guard("consistency check", self._judge)
            threading.Thread(target=work, args=(stretch,), name="consistency", daemon=True).start()

    def take_copy(self, stream: Stream) -> None:
        """Collect the samples of a stream that the next message overwrites."""
        if not self.complete:
            self.take(type(stream), *(column.copy() for column in vars(stream).values()))

    def _judge(self, stretch: Recording) -> None:
        for problem in contradictions(stretch, self._vehicle):
            self._found[problem] = None
            self._node.get_logger().warning(f"consistency: {problem}")
        self._judged += 1

    def status(self) -> DiagnosticStatus:
        """Status for `/diagnostics`: every contradiction found since the node became active."""
        found, judged = list(self._found), self._judged
        level, message = callbacks.OK, "sensors and vehicle agree"
        if found:
            level, message = callbacks.WARN, "; ".join(found)
        elif judged == 0:
            message = f"not judged yet: {self._samples.lacking}"
        values = {"stretches": f"{judged} of {STRETCHES}"}
        return self._node.status("consistency", level, message, values)
